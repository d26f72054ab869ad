"""Positions of points on rods and their Jacobians, for any basis of curvature (THEORY §6).

A variation of the coefficient `q_{j,i}` turns everything downstream of where `phi_j` acts, about `n_i`:

    ∂r(s)/∂q_{j,i} = ∫_0^s phi_j n_i × (r(s) − r) ds' = A_{j,i}(s) × r(s) − B_{j,i}(s)
    A_{j,i}(s) = ∫_0^s phi_j n_i ds',   B_{j,i}(s) = ∫_0^s phi_j n_i × r ds'

The moments A and B are kept element by element. Inside an element they are integrated from the element's
start with 8 Gauss nodes, where frames and positions are those of the basis. Their relative error is below
1.7e-23 times the 16th derivative of the integrand over the element, in units of its length.

* Super-Helix: if an element turns by the angle θ, its integrands have frequencies up to 2θ and the derivative
  is below `(2θ)^16`. The error is 5e-15 for θ = 1.5 rad, 3e-12 for θ = 2.3 rad, 4e-10 for θ = π.
* Super-Clothoid: if the curvature times the element's length is θ at most and changes by β, the frame has at
  any point a Taylor series below that of `exp(θ x + β x²/2)` (see `superclothoid`), and the product of frames and
  the hat function `1 + x` below that of `(1 + x) exp(2θ x + β x²)`. The derivative is below `P_16 + 16 P_15`,
  `P_n = Σ_k n!/(k! (n − 2k)!) (2θ)^(n−2k) β^k`. The error is 7e-13, 8e-12, 2e-10 for θ = 1.5 rad and β = θ/4, θ/2, θ.

Positions are relative to the root throughout, so that a rod far from the origin loses no digits.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods.basis import Path, carry, element_count, new_path, shape, shapes
from fibercontact.rods.model import Rods, RootMotion, State, checked_points, dofs, part
from fibercontact.rods.quadrature import Rule, gauss
from fibercontact.rods.vectors import column, cross, row
from fibercontact.threads import over_ranges

__all__ = [
    "Points",
    "add_columns",
    "add_moments",
    "centreline",
    "point_jacobian",
    "prescribed_velocity",
    "set_root_columns",
]

Array = NDArray[np.float64]
_NODES = 8
_RODS, _POINTS = 128, 512  # of a range, for a thread


class Points(NamedTuple):
    """Points on rods: where they are, the material frame there, and how the dofs move them."""

    position: Array  # (m, 3) m
    frame: Array  # (m, 3, 3) columns t, n_1, n_2
    jacobian: Array  # (m, 3, D) ∂r/∂dofs


class Elements(NamedTuple):
    """Frame and position (relative to the root) at the start of each of E elements, and its moments."""

    frame: Array  # (R, E, 3, 3)
    position: Array  # (R, E, 3)
    A: Array  # (R, E, shapes, 3, 3): the vector A of shape a and direction i is A[rod, e, a, i]
    B: Array


def point_jacobian(rods: Rods, state: State, rod: ArrayLike, s: ArrayLike) -> Points:
    """Position, frame and Jacobian of the m points at arc-lengths `s` (m,) in metres of the rods `rod` (m,).

    The velocity of a point is `jacobian @ v[rod]`, plus `prescribed_velocity` where roots are clamped.
    ValueError when a point is not on a rod.
    """
    rod, s = checked_points(rods.length, rod, s)
    m = len(s)
    points = Points(np.empty((m, 3)), np.empty((m, 3, 3)), np.zeros((m, 3, dofs(rods))))
    elements, rule = tabulate(rods, state), gauss(_NODES)

    def fill(first: int, end: int) -> None:
        here = slice(first, end)
        some = Points(*(x[here] for x in points))
        _fill_points(rods, state, elements, rule, rod[here], s[here], some)

    over_ranges(fill, m, _POINTS)
    return points


def prescribed_velocity(
    rods: Rods, state: State, root_motion: RootMotion | None, rod: NDArray[np.int64], position: Array
) -> Array:
    """Velocity (m, 3) that the motion of clamped roots gives points at `position` (m, 3) of `rod` (m,).

    It is `v_root + omega_root × (r − r_root)`; zero when roots are still, or free (then the dofs move them).
    """
    if rods.free or root_motion is None:
        return np.zeros_like(position)
    arm = position - state.root_position[rod]
    return root_motion.velocity[rod] + np.cross(root_motion.angular_velocity[rod], arm)


def centreline(rods: Rods, state: State, points: int) -> Array:
    """Vertices (R, points + 1, 3) of the rods at equal spacing in arc-length, both ends included."""
    if points < 1:
        raise ValueError("a centreline needs at least one interval")
    E, vertex = element_count(rods.basis, state.q), np.arange(points + 1)
    element = np.minimum(vertex * E // points, E - 1)
    first, xi = np.searchsorted(element, np.arange(E + 1)), vertex * E / points - element
    vertices = np.empty((len(rods.length), points + 1, 3))
    elements = tabulate(rods, state)

    def fill(begin: int, end: int) -> None:
        some = (part(whole, begin, end) for whole in (rods, state, elements))
        _fill_centreline(*some, first, xi, vertices[begin:end])

    over_ranges(fill, len(vertices), _RODS)
    return vertices + state.root_position[:, None]


def tabulate(rods: Rods, state: State) -> Elements:
    """Compute what all points of a rod share."""
    R, E = len(rods.length), element_count(rods.basis, state.q)
    moments = (R, E, shapes(rods.basis), 3, 3)
    elements = Elements(np.empty((R, E, 3, 3)), np.empty((R, E, 3)), np.zeros(moments), np.zeros(moments))
    rule = gauss(_NODES)

    def fill(first: int, end: int) -> None:
        rods_, state_, elements_ = (part(whole, first, end) for whole in (rods, state, elements))
        _fill_elements(rods_, state_, rule, elements_)

    over_ranges(fill, R, _RODS)
    return elements


@jit_lean
def add_moments(
    basis: int,
    rule: Rule,
    begin: float,
    end: float,
    length: float,
    frames: Array,
    positions: Array,
    A: Array,
    B: Array,
) -> None:
    """Add the moments of the part [begin, end] of an element to its A and B (shapes, 3, 3)."""
    for k in range(len(rule.nodes)):
        xi = begin + (end - begin) * rule.nodes[k]
        r = row(positions[k])
        for a in range(shapes(basis)):
            weight = (end - begin) * length * rule.weights[k] * shape(basis, a, xi)
            for i in range(3):
                n = column(frames[k], i)
                n_x_r = cross(n, r)
                for c in range(3):
                    A[a, i, c] += weight * n[c]
                    B[a, i, c] += weight * n_x_r[c]


@jit_lean
def add_columns(j: int, A: Array, B: Array, r: Array, jacobian: Array) -> None:
    """Add `A × r − B` of coefficient j, moments (3, 3), to the Jacobian (3, 3N) of the point `r`."""
    for i in range(3):
        turned = cross(row(A[i]), row(r))
        for c in range(3):
            jacobian[c, 3 * j + i] += turned[c] - B[i, c]


@jit_lean
def set_root_columns(r: Array, jacobian: Array) -> None:
    """Set the first six columns of the Jacobian (3, D) of a free rod: `v_root + omega_root × r`."""
    for c in range(3):
        jacobian[c, c] = 1.0
    jacobian[0, 4], jacobian[0, 5] = r[2], -r[1]
    jacobian[1, 3], jacobian[1, 5] = -r[2], r[0]
    jacobian[2, 3], jacobian[2, 4] = r[1], -r[0]


@jit_lean
def _place_nodes(rule: Rule, end: float, path: Path) -> None:
    """Put a path through the nodes of the part [0, end] of an element and through its end."""
    n = len(rule.nodes)
    for k in range(n):
        path.place[k] = end * rule.nodes[k]
    path.place[n] = end


@jit
def _fill_elements(rods: Rods, state: State, rule: Rule, elements: Elements) -> None:
    _walk(rods, state, rule, new_path(len(rule.nodes) + 1), np.zeros(3), elements)


@jit_lean
def _walk(rods: Rods, state: State, rule: Rule, path: Path, origin: Array, elements: Elements) -> None:
    E, n, a = element_count(rods.basis, state.q), len(rule.nodes), shapes(rods.basis)
    _place_nodes(rule, 1.0, path)
    for rod in range(len(rods.length)):
        frame, position = state.root_frame[rod], origin
        length = rods.length[rod] / E
        for e in range(E):
            for c in range(3):
                elements.position[rod, e, c] = position[c]
                for i in range(3):
                    elements.frame[rod, e, c, i] = frame[c, i]
            A, B = elements.A[rod, e], elements.B[rod, e]
            carry(rods.basis, state.q[rod, e : e + a], length, frame, position, path)
            add_moments(rods.basis, rule, 0.0, 1.0, length, path.frame, path.position, A, B)
            frame, position = path.frame[n], path.position[n]


@jit
def _fill_points(
    rods: Rods,
    state: State,
    elements: Elements,
    rule: Rule,
    rod: NDArray[np.int64],
    s: Array,
    points: Points,
) -> None:
    count, path = shapes(rods.basis), new_path(len(rule.nodes) + 1)
    A, B = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    for p in range(len(s)):
        _fill_point(rods, state, elements, rule, rod[p], s[p], path, A, B, points, p)


@jit_lean
def _fill_point(
    rods: Rods,
    state: State,
    elements: Elements,
    rule: Rule,
    k: int,
    s: float,
    path: Path,
    A: Array,
    B: Array,
    points: Points,
    p: int,
) -> None:
    E, n, count = element_count(rods.basis, state.q), len(rule.nodes), shapes(rods.basis)
    length = rods.length[k] / E
    e = min(int(s / length), E - 1)
    xi = s / length - e
    _place_nodes(rule, xi, path)
    frame, start = elements.frame[k, e], elements.position[k, e]
    carry(rods.basis, state.q[k, e : e + count], length, frame, start, path)
    A[:] = 0.0
    B[:] = 0.0
    add_moments(rods.basis, rule, 0.0, xi, length, path.frame, path.position, A, B)
    r, jacobian = points.position[p], points.jacobian[p]
    for c in range(3):
        r[c] = path.position[n, c]
        for i in range(3):
            points.frame[p, c, i] = path.frame[n, c, i]
    columns = jacobian[:, 6 * rods.free :]
    for a in range(count):
        for before in range(e):
            add_columns(before + a, elements.A[k, before, a], elements.B[k, before, a], r, columns)
        add_columns(e + a, A[a], B[a], r, columns)
    if rods.free:
        set_root_columns(r, jacobian)
    for c in range(3):
        r[c] += state.root_position[k, c]


@jit
def _fill_centreline(
    rods: Rods, state: State, elements: Elements, first: NDArray[np.int64], xi: Array, vertices: Array
) -> None:
    """Fill vertices relative to the root: those from `first[e]` up to `first[e + 1]` lie at `xi` in element e."""
    frames = np.empty((len(xi), 3, 3))
    for rod in range(len(rods.length)):
        _fill_vertices(rods, state, elements, first, xi, frames, rod, vertices)


@jit_lean
def _fill_vertices(
    rods: Rods,
    state: State,
    elements: Elements,
    first: NDArray[np.int64],
    xi: Array,
    frames: Array,
    rod: int,
    vertices: Array,
) -> None:
    E, a = element_count(rods.basis, state.q), shapes(rods.basis)
    for e in range(E):
        k, end = first[e], first[e + 1]
        path = Path(xi[k:end], frames[k:end], vertices[rod, k:end])
        frame, start = elements.frame[rod, e], elements.position[rod, e]
        carry(rods.basis, state.q[rod, e : e + a], rods.length[rod] / E, frame, start, path)
