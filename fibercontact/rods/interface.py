"""What a simulation asks of a batch of rods, whatever their model: one interface, two implementations.

A step is a sequence of systems `M v + f = Hᵀ r` in the velocity v at its end: one for curvature-based rods,
whose step is linearly implicit, one an iteration of Newton's method for discrete rods.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array

from fibercontact.rods import discrete_step, dynamics, kinematics
from fibercontact.rods.air import Drag
from fibercontact.rods.basis import CLOTHOID
from fibercontact.rods.discrete_model import DiscreteRods, DiscreteState
from fibercontact.rods.dynamics import Energy
from fibercontact.rods.model import Rods, RootMotion, State

__all__ = ["AnyRods", "AnyState", "RodModel", "RodStep", "System", "rod_model"]

Array = NDArray[np.float64]

AnyRods = Rods | DiscreteRods
AnyState = State | DiscreteState


class System(Protocol):
    """A linear system `M v + f = Hᵀ r` of R rods with D dofs each; `M` holds its stored numbers in any layout."""

    @property
    def M(self) -> Array:  # noqa: D102
        ...

    @property
    def f(self) -> Array:
        """(R, D)."""

    def matrix(self) -> csr_array:
        """`M` (R D, R D), exactly symmetric."""

    def constraints(self) -> tuple[csr_array, Array] | None:
        """`G` (R D, l) and `c` (l,) of bilateral constraints `Gᵀ v + c = 0`, or None."""

    def free_velocities(self, impulse: Array | float = 0.0) -> Array:
        """The velocities (R, D) without contact, or under known impulses `Hᵀ r` (R, D)."""


class RodStep(Protocol):
    """A step between two of its iterations."""

    @property
    def system(self) -> System:
        """The system of the next iteration."""

    @property
    def converged(self) -> bool:
        """Whether no further iteration is needed."""

    def contact_points(self, rod: NDArray[np.int64], s: Array) -> tuple[Array, Array]:
        """Jacobian (m, 3, D) and prescribed velocity (m, 3) of points at arc-lengths s (m,) of rods (m,)."""

    def moved(self, v: Array, impulse: Array) -> Self:
        """The step after an iteration that gave the velocity v (R, D) under the impulses `Hᵀ r` (R, D)."""

    def end(self) -> Any:
        """The state at the end of the step."""


class RodModel(Protocol):
    """A batch of R rods."""

    @property
    def title(self) -> str:
        """What the rods are called in the files of problems."""

    @property
    def iterations(self) -> int:
        """Systems that a step may take at most."""

    @property
    def local_support(self) -> bool:
        """Whether a point moves with few dofs of its rod, so that zeros of `H` are not to be stored."""

    @property
    def held_length(self) -> float:
        """Arc-length at clamped roots within which points have too little freedom for contacts, m."""

    def centreline(self, state: Any, points: int) -> Array:
        """Polylines (R, P + 1, 3) of equal steps in arc-length: `points` of them, or the model's own."""

    def energy(self, state: Any, gravity: Array) -> Energy:
        """Energy of each rod."""

    def begin(
        self, state: Any, root_motion: RootMotion, gravity: Array, dt: float, drag: Drag | None = None
    ) -> RodStep:
        """Begin a step."""


def rod_model(rods: AnyRods) -> RodModel:
    """The model of rods, by their type."""
    return DiscreteModel(rods) if isinstance(rods, DiscreteRods) else CurvatureModel(rods)


class DenseSystem(NamedTuple):
    """A system with one dense block a rod."""

    M: Array  # (R, D, D)
    f: Array  # (R, D)

    def matrix(self) -> csr_array:
        """Block-diagonal M; symmetric bit for bit, so that a file holds the very problem that was solved."""
        R, D, _ = self.M.shape
        blocks = 0.5 * (self.M + self.M.transpose(0, 2, 1))
        return bsr_array((blocks, np.arange(R), np.arange(R + 1)), shape=(R * D, R * D)).tocsr()

    def constraints(self) -> None:
        """There is none."""

    def free_velocities(self, impulse: Array | float = 0.0) -> Array:
        """`M⁻¹ (impulse − f)`, (R, D)."""
        known = -(self.f - impulse)[:, :, None]
        return np.asarray(np.linalg.solve(self.M, known)[:, :, 0], dtype=np.float64)


@dataclass(frozen=True)
class LinearlyImplicitStep:
    """A step of curvature-based rods: one system."""

    rods: Rods
    state: State
    root_motion: RootMotion
    gravity: Array
    dt: float
    drag: Drag | None = None
    v: Array | None = None

    @cached_property
    def system(self) -> DenseSystem:
        """The system of the step."""
        return DenseSystem(
            *dynamics.step_system(self.rods, self.state, self.root_motion, self.gravity, self.dt, self.drag)
        )

    @property
    def converged(self) -> bool:
        """True once the system has been solved."""
        return self.v is not None

    def contact_points(self, rod: NDArray[np.int64], s: Array) -> tuple[Array, Array]:
        """Jacobian (m, 3, D) and prescribed velocity (m, 3) of points at arc-lengths s (m,) of rods (m,)."""
        points = kinematics.point_jacobian(self.rods, self.state, rod, s)
        drift = kinematics.prescribed_velocity(self.rods, self.state, self.root_motion, rod, points.position)
        return points.jacobian, drift

    def moved(self, v: Array, impulse: Array) -> Self:
        """The step with its answer."""
        return replace(self, v=v)

    def end(self) -> State:
        """The state at the end of the step."""
        assert self.v is not None
        return dynamics.advance(self.rods, self.state, self.v, self.root_motion, self.dt)


@dataclass(frozen=True)
class CurvatureModel:
    """Curvature-based rods."""

    rods: Rods
    iterations: int = 1
    local_support: bool = False
    held_length: float = 0.0

    @property
    def title(self) -> str:
        """Name of the model."""
        return (
            f"Super-{'Clothoid' if self.rods.basis == CLOTHOID else 'Helix'} fibres, one block of M a fibre"
        )

    def centreline(self, state: State, points: int) -> Array:
        """Vertices (R, points + 1, 3)."""
        return kinematics.centreline(self.rods, state, points)

    def energy(self, state: State, gravity: Array) -> Energy:
        """Energy of each rod, J."""
        return dynamics.energy(self.rods, state, gravity)

    def begin(
        self, state: State, root_motion: RootMotion, gravity: Array, dt: float, drag: Drag | None = None
    ) -> LinearlyImplicitStep:
        """Begin a step."""
        return LinearlyImplicitStep(self.rods, state, root_motion, gravity, dt, drag)


@dataclass(frozen=True)
class DiscreteModel:
    """Discrete elastic rods; Newton's method stops as `begin` of `discrete_step` says, or after `iterations`."""

    rods: DiscreteRods
    tolerance: float = 1e-3
    iterations: int = 8
    local_support: bool = True

    @property
    def title(self) -> str:
        """Name of the model."""
        if self.rods.inextensible:
            return "discrete elastic rods in maximal coordinates, inextensible edges eliminated"
        return (
            "discrete elastic rods in maximal coordinates, one banded block of M a fibre, edges are springs"
        )

    @property
    def held_length(self) -> float:
        """The clamped first edge, and a tenth of the next: a contact there would have no arm."""
        return 0.0 if self.rods.free else 1.1 * float(self.rods.edge_length.max())

    def centreline(self, state: DiscreteState, points: int) -> Array:
        """The nodes (R, N + 1, 3), whatever `points` is."""
        return state.position

    def energy(self, state: DiscreteState, gravity: Array) -> Energy:
        """Energy of each rod, J."""
        return discrete_step.discrete_energy(self.rods, state, gravity)

    def begin(
        self,
        state: DiscreteState,
        root_motion: RootMotion,
        gravity: Array,
        dt: float,
        drag: Drag | None = None,
    ) -> discrete_step.ImplicitStep:
        """Begin a step."""
        return discrete_step.begin(self.rods, state, root_motion, gravity, dt, self.tolerance, drag)
