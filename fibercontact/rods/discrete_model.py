"""Discrete elastic rods [Bergou 2008, 2010]: material data, configuration, reference frames (THEORY §6).

A rod is a chain of N edges between N + 1 nodes; edge j carries a material frame `(t, m_1, m_2)`, which a
reference director `d` and a twist θ describe: `m_1 = cos θ d + sin θ t×d`. The 4N + 3 degrees of freedom are
numbered along the rod, `x_0, θ_0, x_1, θ_1, …, x_N`, so that x_i begins at 4i, θ_j is 4j + 3, and an inner node
couples 11 dofs in a row: matrices have 10 bands beside the diagonal.

The root of a clamped rod holds its first edge: `x_0, θ_0, x_1`, the first 7 dofs, are prescribed. What that
edge would bend and twist is done by its inner end, whose cell is 3/2 edges long; clamped ends are then of
second order like free ones.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fibercontact.rods.basis import HELIX
from fibercontact.rods.model import Rods, checked_roots, circular_rods

__all__ = [
    "PRESCRIBED",
    "DiscreteRods",
    "DiscreteState",
    "discrete_rods",
    "discrete_state",
    "discretise",
    "displaced",
    "join",
    "material_director",
    "signed_angle",
    "split",
    "tangents",
    "transported",
]

Array = NDArray[np.float64]

PRESCRIBED = 7
"""Dofs that a clamped root prescribes: its two nodes and the twist between them."""


class DiscreteRods(NamedTuple):
    """R discrete rods of N edges each; `discrete_rods` builds them from material data.

    Their law is that of `Rods`, for the strains (twist, kappa_1, kappa_2) of the inner nodes. Edges are springs of
    stiffness `stretching`, or rigid (`inextensible`).
    """

    length: Array  # (R,) m
    line_density: Array  # (R,) rho S, kg/m
    radius: Array  # (R,) m
    stiffness: Array  # (R, 3) GJ, EI_1, EI_2, N·m²
    stretching: Array  # (R,) ES, N; not used when inextensible
    rest_curvature: Array  # (R, N − 1, 3) at the inner nodes, rad/m
    damping: Array  # (R,) nu, s
    free: bool  # False: the roots are clamped and their motion is prescribed
    inextensible: bool

    @property
    def edges(self) -> int:
        """Number N of edges of a rod."""
        return self.rest_curvature.shape[1] + 1

    @property
    def edge_length(self) -> Array:
        """Rest length of the edges (R,), m."""
        return np.asarray(self.length / self.edges, dtype=np.float64)

    @property
    def cells(self) -> Array:
        """Length (R, N − 1) of rod whose strain each inner node stands for, m."""
        cells = np.repeat(self.edge_length[:, None], self.edges - 1, axis=1)
        cells[:, 0] *= 1.0 if self.free else 1.5
        return cells

    @property
    def prescribed(self) -> int:
        """Number of the first dofs that are prescribed."""
        return 0 if self.free else PRESCRIBED

    @property
    def inertia(self) -> Array:
        """Diagonal (R, 4N + 3) of the lumped inertia: kg of the nodes, kg·m² of the sections' spin."""
        edge_mass = self.line_density * self.edge_length
        nodes = np.repeat(edge_mass[:, None], self.edges + 1, axis=1)
        nodes[:, [0, -1]] /= 2
        spins = np.repeat((edge_mass * self.radius**2 / 2)[:, None], self.edges, axis=1)
        return join(np.repeat(nodes[:, :, None], 3, axis=2), spins)


class DiscreteState(NamedTuple):
    """Configuration and velocity of R discrete rods.

    `reference_twist` is the angle about the next edge's tangent from an edge's director, carried there by
    parallel transport in space, to the next edge's; it is kept to count whole turns.
    """

    position: Array  # (R, N + 1, 3) nodes, m
    theta: Array  # (R, N) rad
    director: Array  # (R, N, 3) reference directors, unit and orthogonal to the edges
    reference_twist: Array  # (R, N − 1) rad
    v: Array  # (R, 4N + 3) rates of the dofs, those that are prescribed included

    @property
    def root_position(self) -> Array:
        """First nodes (R, 3), m."""
        return self.position[:, 0]


def discrete_rods(
    *,
    length: ArrayLike,
    radius: ArrayLike,
    young: ArrayLike,
    poisson: ArrayLike,
    density: ArrayLike,
    edges: int,
    curvature: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    free: bool = False,
    inextensible: bool = False,
) -> DiscreteRods:
    """Make discrete rods of circular section; arguments as in `circular_rods`, `ES = young pi radius²`.

    The rest `curvature` (rad/m) broadcasts to (R, edges − 1, 3). ValueError names what is out of range.

    >>> rods = discrete_rods(length=0.1, radius=1e-3, young=1e9, poisson=0.5, density=1e3, edges=10)
    >>> rods.rest_curvature.shape, f"{rods.stretching[0]:.0f} N"
    ((1, 9, 3), '3142 N')
    """
    if edges < 2:
        raise ValueError("edges must be at least 2")
    like = circular_rods(
        length=length, radius=radius, young=young, poisson=poisson, density=density,
        elements=edges - 1, curvature=curvature, damping=damping, free=free,
    )  # fmt: skip
    return _with_rest_curvature(like, like.q_rest, inextensible)


def discretise(rods: Rods, edges: int, inextensible: bool = False) -> DiscreteRods:
    """Make discrete rods of the material of Super-Helices; rest curvatures are means over the nodes' cells.

    ValueError when the rods are Super-Clothoids or there is but one edge.
    """
    if rods.basis != HELIX:
        raise ValueError("only Super-Helices can be discretised")
    if edges < 2:
        raise ValueError("edges must be at least 2")
    R, elements = rods.q_rest.shape[:2]
    turned = np.concatenate([np.zeros((R, 1, 3)), np.cumsum(rods.q_rest, axis=1)], axis=1) / elements
    ends = (np.arange(edges) + 0.5) / edges
    ends[0] *= rods.free  # the first cell of a clamped rod begins at the root
    at = np.minimum((ends * elements).astype(int), elements - 1)
    until = turned[:, at] + (ends - at / elements)[:, None] * rods.q_rest[:, at]
    means = np.diff(until, axis=1) / np.diff(ends)[:, None]
    return _with_rest_curvature(rods, means, inextensible)


def _with_rest_curvature(rods: Rods, curvature: Array, inextensible: bool) -> DiscreteRods:
    stretching = 4 * rods.stiffness[:, 1] / rods.radius**2  # of a circular section
    return DiscreteRods(
        rods.length, rods.line_density, rods.radius, rods.stiffness, stretching, curvature, rods.damping,
        rods.free, inextensible,
    )  # fmt: skip


def discrete_state(
    rods: DiscreteRods,
    root_position: ArrayLike = 0.0,
    root_frame: ArrayLike | None = None,
    curvature: ArrayLike | None = None,
) -> DiscreteState:
    """Unstretched rods that do not move, in their natural shape or in that of another `curvature` (rad/m).

    Root data broadcast to (R, 3) and (R, 3, 3), columns `t, m_1, m_2` of the first edge; the default frame is
    the world's. `curvature` broadcasts to (R, N − 1, 3). ValueError when a root frame is not a rotation.
    """
    R, N = len(rods.length), rods.edges
    start, frame = checked_roots(R, root_position, root_frame)
    position = np.empty((R, N + 1, 3))
    position[:, 0] = start
    directors, twists = np.empty((R, N, 3)), np.empty((R, N - 1))
    shape = np.broadcast_to(rods.rest_curvature if curvature is None else curvature, (R, N - 1, 3))
    strains = shape * rods.cells[:, :, None]
    for j in range(N):
        position[:, j + 1] = position[:, j] + rods.edge_length[:, None] * frame[:, :, 0]
        directors[:, j] = frame[:, :, 1]
        if j < N - 1:
            frame, twists[:, j] = _next_frame(frame, strains[:, j]), strains[:, j, 0]
    return DiscreteState(position, np.zeros((R, N)), directors, twists, np.zeros((R, 4 * N + 3)))


def _next_frame(frame: Array, strain: Array) -> Array:
    """Material frames (R, 3, 3) of the edges behind nodes with given strains (R, 3).

    The strains `½ kappa_b·(m_a + m_a')` of a curvature binormal `kappa_b = β_1 m_1 + β_2 m_2` are β turned by
    `−twist/2` and shortened by `cos(twist/2)`.
    """
    half = strain[:, 0] / 2
    k1, k2 = strain[:, 1] / np.cos(half), strain[:, 2] / np.cos(half)
    beta = np.column_stack([np.cos(half) * k1 - np.sin(half) * k2, np.sin(half) * k1 + np.cos(half) * k2])
    binormal = np.einsum("rci,ri->rc", frame[:, :, 1:], beta)
    t, size = frame[:, :, 0], np.sum(binormal**2, axis=1)[:, None] / 4  # tan² of half the angle
    tangent = ((1 - size) * t + np.cross(binormal, t)) / (1 + size)
    m1, m2 = (transported(t, tangent, frame[:, :, a]) for a in (1, 2))
    c, s = np.cos(2 * half)[:, None], np.sin(2 * half)[:, None]
    return np.stack([tangent, c * m1 + s * m2, c * m2 - s * m1], axis=2)


def split(vector: Array) -> tuple[Array, Array]:
    """Parts (R, N + 1, 3) of the nodes and (R, N) of the twists of vectors (R, 4N + 3) of dofs."""
    padded = np.concatenate([vector, np.zeros((len(vector), 1))], axis=1).reshape(len(vector), -1, 4)
    return padded[:, :, :3], padded[:, :-1, 3]


def join(nodes: Array, twists: Array) -> Array:
    """Vectors (R, 4N + 3) of dofs, the inverse of `split`."""
    padded = np.concatenate([twists, np.zeros((len(twists), 1))], axis=1)
    return np.concatenate([nodes, padded[:, :, None]], axis=2).reshape(len(nodes), -1)[:, :-1]


def tangents(position: Array) -> Array:
    """Unit tangents (R, N, 3) of the edges between nodes (R, N + 1, 3)."""
    edge = np.diff(position, axis=1)
    return np.asarray(edge / np.linalg.norm(edge, axis=2, keepdims=True), dtype=np.float64)


def transported(t: Array, u: Array, vector: Array) -> Array:
    """Carry vectors (…, 3) by the smallest rotation that takes the unit vectors t to u (parallel transport)."""
    axis, cosine = np.cross(t, u), _dot(t, u)
    return cosine * vector + np.cross(axis, vector) + _dot(axis, vector) / (1 + cosine) * axis


def signed_angle(a: Array, b: Array, axis: Array) -> Array:
    """Angle (…,) about the unit `axis` (…, 3) from a to b, in (−π, π]."""
    return np.arctan2(_dot(axis, np.cross(a, b)), _dot(a, b))[..., 0]


def material_director(state: DiscreteState, tangent: Array) -> tuple[Array, Array]:
    """Material directors `m_1, m_2` (R, N, 3) of edges with the tangents (R, N, 3)."""
    across = np.cross(tangent, state.director)
    c, s = np.cos(state.theta)[:, :, None], np.sin(state.theta)[:, :, None]
    return c * state.director + s * across, c * across - s * state.director


def displaced(state: DiscreteState, displacement: Array) -> DiscreteState:
    """Move the dofs by `displacement` (R, 4N + 3); reference frames follow by parallel transport in time."""
    nodes, twists = split(displacement)
    position = state.position + nodes
    old, new = tangents(state.position), tangents(position)
    director = transported(old, new, state.director)
    director -= _dot(director, new) * new  # rounding does not pile up
    director /= np.linalg.norm(director, axis=2, keepdims=True)
    twist = _reference_twist(new, director, state.reference_twist)
    return DiscreteState(position, state.theta + twists, director, twist, state.v)


def _reference_twist(tangent: Array, director: Array, near: Array) -> Array:
    """Reference twists (R, N − 1), in the turn that is nearest to the angles `near`."""
    carried = transported(tangent[:, :-1], tangent[:, 1:], director[:, :-1])
    angle = signed_angle(carried, director[:, 1:], tangent[:, 1:])
    return np.asarray(near + np.angle(np.exp(1j * (angle - near))), dtype=np.float64)


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1, keepdims=True)
