"""Implicit Euler step of discrete rods by Newton's method, one banded system a rod and iteration (THEORY §6).

The velocity v at the end of the step makes stationary, for impulses r of contact,

    Π(v) − (Hᵀr)·v,    Π(v) = ½ (v − v_t)ᵀ 𝕄 (v − v_t) + E(x) + nu/dt V(x) − F·x,    x = x_t + dt v

with the lumped inertia 𝕄, gravity F and `V = ½ ‖strain(x) − strain(x_t)‖²` in the norm of the elastic law. The
viscous term is the damping `nu K` of the strains' rates [Bergou 2010]: rigid motions are not damped. Drag in
air, lumped to the nodes like the inertia, adds `dt/2 (v − wind)ᵀ C (v − wind)` to Π (see `air`). An
iteration replaces Π by its quadratic model about the last iterate v_k,

    M = 𝕄 + dt² (∇²E + nu/dt ∇²V),    f = 𝕄 (v_k − v_t) + dt (∇E + nu/dt ∇V − F) − M v_k,

and solves `M v + f = Hᵀ r`: v is again the velocity at the end of the step.

M is made definite rod by rod (see `discrete_assembly`).

Inextensible edges obey `|e_j| = const` in place of springs. Their linear form about the iterate,
`Gᵀ v + c = 0`, joins each system, `M v + f = Hᵀ r + G lambda`, and the tensions lambda of the last iteration
enter M: this is Newton's method, which starts from the true lengths at each iteration, so that they do not
drift. Without springs M would never be definite (a bent rod's energy falls when its edges grow), so
`sigma G (Gᵀ v + c)`, which is zero, is added to the left-hand side, sigma being what the springs' would be.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from fibercontact.rods import bands
from fibercontact.rods.air import Drag
from fibercontact.rods.discrete_assembly import assemble_gradient, definite_matrix
from fibercontact.rods.discrete_energy import (
    Derivatives,
    Frames,
    Law,
    derivatives,
    elastic_law,
    frames,
    law_energy,
    strains,
)
from fibercontact.rods.discrete_model import (
    PRESCRIBED,
    DiscreteRods,
    DiscreteState,
    displaced,
    join,
    material_director,
    signed_angle,
    split,
    tangents,
    transported,
)
from fibercontact.rods.dynamics import Energy
from fibercontact.rods.model import RootMotion, checked_points, still

__all__ = ["BandedSystem", "ImplicitStep", "begin", "discrete_energy", "discrete_points", "implicit_step"]

Array = NDArray[np.float64]

HALVINGS = 8
_SUFFICIENT = 1e-4  # share of the predicted decrease that a step must bring [Armijo]


class BandedSystem(NamedTuple):
    """The system `M v + f = Hᵀ r + G lambda`, `Gᵀ v + c = 0` of R rods, with D dofs each that are not prescribed.

    An inextensible edge is a row of `rigid`; there is none (l = 0) when edges are springs.
    """

    M: Array  # (R, 11, D) lower bands
    f: Array  # (R, D)
    factor: Array  # (R, 11, D) Cholesky factor of M
    rigid: Array  # (R, l, D) the transposes of G
    c: Array  # (R, l) m/s

    def matrix(self) -> csr_array:
        """The matrix M (R D, R D) of all rods."""
        return bands.sparse(self.M)

    def constraints(self) -> tuple[csr_array, Array] | None:
        """`G` (R D, R l) and `c` (R l,), or None when edges are springs."""
        R, count, D = self.rigid.shape
        if count == 0:
            return None
        rod, edge, dof = np.nonzero(self.rigid)
        G = (self.rigid[rod, edge, dof], (rod * D + dof, rod * count + edge))
        return csr_array(G, shape=(R * D, R * count)), self.c.ravel()

    def free_velocities(self, impulse: Array | float = 0.0) -> Array:
        """Velocities (R, D) at the end of the step without contact, or under known impulses (R, D)."""
        G = self.rigid.transpose(0, 2, 1)
        answers = bands.solve(self.factor, np.concatenate([G, (self.f - impulse)[:, :, None]], axis=2))
        of_rigid, of_f = answers[:, :, :-1], answers[:, :, -1:]
        tension = np.linalg.solve(self.rigid @ of_rigid, self.rigid @ of_f - self.c[:, :, None])
        return np.asarray((of_rigid @ tension - of_f)[:, :, 0], dtype=np.float64)


class NodeDrag(NamedTuple):
    """Drag forces `−C (v − wind)` on the nodes."""

    C: Array  # (R, N + 1, 3, 3) kg/s
    wind: Array  # (3,) m/s

    def pull(self, v: Array) -> Array:
        """`C (v − wind)` of the nodes' velocities (R, N + 1, 3)."""
        return np.asarray((self.C @ (v - self.wind)[..., None])[..., 0], dtype=np.float64)


@dataclass(frozen=True)
class ImplicitStep:
    """A step under way: the state `before` it and the iterate `now`, which is the end of the step for its v.

    It has converged when in the last iteration no edge moved by more than `tolerance`, in edge lengths from
    end to end and in radians of twist.
    """

    rods: DiscreteRods
    before: DiscreteState
    now: DiscreteState
    law: Law
    gravity: Array
    dt: float
    tension: Array  # (R, N) N of inextensible edges, as the last iteration had it
    tolerance: float
    drag: NodeDrag | None = None
    converged: bool = False

    @cached_property
    def system(self) -> BandedSystem:
        """The linear system of this iteration."""
        at = frames(self.now)
        slopes = derivatives(self.law, self.now, at)
        if self.rods.inextensible:
            slopes = self._augmented(slopes, at)
        drag = None if self.drag is None else self.drag.C
        M, factor = definite_matrix(self.rods, slopes, at.tangent, self.dt, drag)
        known = self.rods.prescribed
        residual = self._residual(slopes, at.tangent)[:, known:]
        v = self.now.v[:, known:]
        rigid, c = self._rigid_edges(at, v)
        return BandedSystem(M, residual - bands.times(M, v), factor, rigid, c)

    def contact_points(self, rod: NDArray[np.int64], s: Array) -> tuple[Array, Array]:
        """Jacobian (m, 3, D) and prescribed velocity (m, 3) of points at arc-lengths s (m,) of rods (m,)."""
        jacobian = discrete_points(self.rods, self.now, rod, s)[1]
        known = self.rods.prescribed
        return jacobian[:, :, known:], np.einsum(
            "mij,mj->mi", jacobian[:, :, :known], self.now.v[rod, :known]
        )

    def moved(self, v: Array, impulse: Array | float = 0.0) -> Self:
        """The next iterate, from the solution v (R, D) of the system under the impulses `Hᵀ r` (R, D).

        Rods of springs go towards v as far as `Π − (Hᵀr)·v` falls enough: all the way, or a half, a quarter, …
        """
        known = self.rods.prescribed
        change = np.zeros_like(self.now.v)
        change[:, known:] = v - self.now.v[:, known:]
        share = self._share(change, impulse) if not self.rods.inextensible else 1.0
        now = self._at(share * change)
        tension = self._tensions(v, impulse) if self.rods.inextensible else self.tension
        nodes, twists = split(self.dt * (now.v - self.now.v))
        moves = np.linalg.norm(np.diff(nodes, axis=1), axis=2) / self.rods.edge_length[:, None]
        converged = max(float(moves.max()), float(abs(twists).max())) <= self.tolerance
        return replace(self, now=now, tension=tension, converged=converged)

    def end(self) -> DiscreteState:
        """State at the end of the step."""
        return self.now

    def potential(self, now: DiscreteState) -> Array:
        """The function Π (R,) of an iterate, J."""
        inertia, change = self.rods.inertia, now.v - self.before.v
        kinetic = np.sum(inertia * change**2, axis=1) / 2
        potential = kinetic + law_energy(self.law, now) - _weight(self.rods, now, self.gravity)
        if self.drag is not None:
            v = split(now.v)[0]
            potential += self.dt / 2 * np.sum((v - self.drag.wind) * self.drag.pull(v), axis=(1, 2))
        return np.asarray(potential)

    def _augmented(self, slopes: Derivatives, at: Frames) -> Derivatives:
        """Add the tensions of inextensible edges, and springs that the constraints make idle."""
        spring = self.rods.stretching[:, None] / self.law.natural
        tension = spring * (at.length - self.law.natural)
        return slopes._replace(tension=tension, axial=spring, transverse=self.tension / at.length)

    def _at(self, change: Array) -> DiscreteState:
        return displaced(self.now, self.dt * change)._replace(v=self.now.v + change)

    def _residual(self, slopes: Derivatives, tangent: Array) -> Array:
        """Gradient (R, 4N + 3) of Π with respect to v."""
        force = join(_node_inertia(self.rods)[:, :, None] * self.gravity, np.zeros_like(self.now.theta))
        if self.drag is not None:
            force -= join(self.drag.pull(split(self.now.v)[0]), np.zeros_like(self.now.theta))
        inertia = self.rods.inertia * (self.now.v - self.before.v)
        return np.asarray(inertia + self.dt * (assemble_gradient(slopes, tangent) - force), dtype=np.float64)

    def _share(self, change: Array, impulse: Array | float) -> Array:
        """Shares (R, 1) of the change that let the function of the step fall."""
        known = self.rods.prescribed
        step = change[:, known:]
        system = self.system
        slope = np.sum((bands.times(system.M, self.now.v[:, known:]) + system.f - impulse) * step, axis=1)
        start, power = self.potential(self.now), np.sum(impulse * step, axis=1)
        share = np.ones((len(change), 1))
        for _ in range(HALVINGS):
            trial = self.potential(self._at(share * change))
            allowed = start + share[:, 0] * (power + _SUFFICIENT * slope)
            rising = ~(trial <= allowed + 1e-12 * (abs(start) + abs(trial)))
            if not rising.any():
                break
            share[rising] /= 2
        return share

    def _rigid_edges(self, at: Frames, v: Array) -> tuple[Array, Array]:
        """Rows `Gᵀ` (R, l, D) and `c` (R, l) of the inextensible edges."""
        R, N = at.length.shape
        if not self.rods.inextensible:
            return np.zeros((R, 0, v.shape[1])), np.zeros((R, 0))
        rows, edge = np.zeros((R, N, 4 * N + 3)), np.arange(N)
        for c in range(3):
            rows[:, edge, 4 * edge + c] = -at.tangent[:, :, c]
            rows[:, edge, 4 * edge + 4 + c] = at.tangent[:, :, c]
        held = 0 if self.rods.free else 1  # the first edge of a clamped rod
        rows = np.ascontiguousarray(rows[:, held:, self.rods.prescribed :])
        excess = (at.length - self.law.natural)[:, held:] / self.dt
        return rows, excess - _times_rows(rows, v)

    def _tensions(self, v: Array, impulse: Array | float) -> Array:
        """Tensions (R, N) with `M v + f − Hᵀ r = G lambda`: what acts on all nodes beyond an edge."""
        system = self.system
        unbalanced = np.zeros_like(self.now.v)
        unbalanced[:, self.rods.prescribed :] = bands.times(system.M, v) + system.f - impulse
        nodes, _ = split(unbalanced)
        beyond = np.cumsum(nodes[:, :0:-1], axis=1)[:, ::-1]
        return -np.sum(beyond * tangents(self.now.position), axis=2) / self.dt


def begin(
    rods: DiscreteRods,
    state: DiscreteState,
    root_motion: RootMotion | None,
    gravity: ArrayLike,
    dt: float,
    tolerance: float = 1e-3,
    drag: Drag | None = None,
) -> ImplicitStep:
    """Begin a step: the first iterate keeps the velocity, prescribed dofs have that of the step.

    `root_motion` as in `step_system`; its accelerations are not needed. ValueError when dt is not positive.
    """
    if not dt > 0:
        raise ValueError(f"dt must be positive, not {dt}")
    v = state.v.copy()
    if not rods.free:
        v[:, :PRESCRIBED] = _root_rates(state, root_motion or still(len(v)), dt)
    now = displaced(state, dt * v)._replace(v=v)
    law, tension = _step_law(rods, state, dt), np.zeros((len(v), rods.edges))
    g = np.asarray(gravity, dtype=float)
    of_nodes = None if drag is None else _node_drag(rods, state, drag)
    return ImplicitStep(rods, state, now, law, g, dt, tension, tolerance, of_nodes)


def implicit_step(
    rods: DiscreteRods,
    state: DiscreteState,
    root_motion: RootMotion | None,
    gravity: ArrayLike,
    dt: float,
    tolerance: float = 1e-8,
    iterations: int = 50,
    drag: Drag | None = None,
) -> DiscreteState:
    """Take a step without contact. Raises RuntimeError when Newton's method has not converged."""
    step = begin(rods, state, root_motion, gravity, dt, tolerance, drag)
    for _ in range(iterations):
        step = step.moved(step.system.free_velocities())
        if step.converged:
            return step.end()
    raise RuntimeError(f"the step has not converged in {iterations} iterations; take a smaller dt")


def discrete_energy(rods: DiscreteRods, state: DiscreteState, gravity: ArrayLike) -> Energy:
    """Measure the energy of each rod; the potential of gravity is zero at the world's origin."""
    kinetic = np.sum(rods.inertia * state.v**2, axis=1) / 2
    return Energy(kinetic, law_energy(elastic_law(rods), state), -_weight(rods, state, gravity))


def discrete_points(
    rods: DiscreteRods, state: DiscreteState, rod: ArrayLike, s: ArrayLike
) -> tuple[Array, Array]:
    """Positions (m, 3) of points at arc-lengths s (m,) of the rods (m,), and their Jacobians (m, 3, 4N + 3).

    A point divides its edge as `s` does the rest length. ValueError when a point is not on a rod.
    """
    rod, s = checked_points(rods.length, rod, s)
    x = s / rods.edge_length[rod]
    edge = np.minimum(x.astype(np.int64), rods.edges - 1)
    share = (x - edge)[:, None]
    position = (1 - share) * state.position[rod, edge] + share * state.position[rod, edge + 1]
    jacobian, m = np.zeros((len(s), 3, state.v.shape[1])), np.arange(len(s))
    for c in range(3):
        jacobian[m, c, 4 * edge + c] = 1 - share[:, 0]
        jacobian[m, c, 4 * edge + 4 + c] = share[:, 0]
    return position, jacobian


def _root_rates(state: DiscreteState, motion: RootMotion, dt: float) -> Array:
    """Rates (R, 7) of the prescribed dofs: the first edge and its material frame turn as a rigid body."""
    turn = Rotation.from_rotvec(dt * motion.angular_velocity).as_matrix()
    edge = state.position[:, 1] - state.position[:, 0]
    tangent = tangents(state.position[:, :2])
    director = material_director(
        state._replace(theta=state.theta[:, :1], director=state.director[:, :1]), tangent
    )[0]
    new_edge, new_tangent, new_director = (
        np.einsum("rij,rj->ri", turn, x) for x in (edge, tangent[:, 0], director[:, 0])
    )
    carried = transported(tangent[:, 0], new_tangent, director[:, 0])
    spin = signed_angle(carried, new_director, new_tangent) / dt
    return np.column_stack([motion.velocity, spin, motion.velocity + (new_edge - edge) / dt])


def _step_law(rods: DiscreteRods, state: DiscreteState, dt: float) -> Law:
    """Elastic and viscous energy of a step: `½ B (k − k⁰)² + nu/(2 dt) B (k − k_t)²` is one square and a constant."""
    law, at = elastic_law(rods), frames(state)
    ratio = (rods.damping / dt)[:, None]
    return Law(
        law.stiffness * (1 + ratio[:, :, None]),
        (law.target + ratio[:, :, None] * strains(state, at)) / (1 + ratio[:, :, None]),
        law.spring * (1 + ratio),
        np.asarray(law.natural if rods.inextensible else (law.natural + ratio * at.length) / (1 + ratio)),
    )


def _node_drag(rods: DiscreteRods, state: DiscreteState, drag: Drag) -> NodeDrag:
    """Each node has the drag of half an edge on either side."""
    half = rods.edge_length[:, None, None, None] / 2 * drag.resistance(tangents(state.position))
    of_nodes = np.zeros((len(half), rods.edges + 1, 3, 3))
    of_nodes[:, :-1] += half
    of_nodes[:, 1:] += half
    return NodeDrag(of_nodes, drag.wind)


def _node_inertia(rods: DiscreteRods) -> Array:
    return split(rods.inertia)[0][:, :, 0]


def _weight(rods: DiscreteRods, state: DiscreteState, gravity: ArrayLike) -> Array:
    """Work `F·x` (R,) of gravity."""
    return np.asarray(np.sum(_node_inertia(rods) * (state.position @ np.asarray(gravity)), axis=1))


def _times_rows(rows: Array, vector: Array) -> Array:
    return np.asarray((rows @ vector[:, :, None])[:, :, 0], dtype=np.float64)
