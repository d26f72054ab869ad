"""Rod models under one face, so that a validation asks each of them the same questions: `MODELS`.

Rods and roots are those of `cases`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from rods.cases import MATERIAL, Case, follow
from rods.discrete import DiscreteRod
from scipy.linalg import eigh

from fibercontact.rods import (
    CLOTHOID,
    HELIX,
    Rods,
    State,
    centreline,
    circular_rods,
    dofs,
    generalised_force,
    inertia_matrix,
    rest_state,
    stiffness_matrix,
)

Array = NDArray[np.float64]
_STEP = 1e-5  # of the differences that give the Hessian
_CHUNK = 24  # rods in a batch


class Equilibrium(Protocol):
    """A rod at rest under its own weight."""

    def centreline(self, intervals: int) -> Array:
        """Points (intervals + 1, 3) at equal spacing in arc-length."""
        ...

    def stability(self) -> float:
        """A number that passes smoothly through zero where the equilibrium loses its stability."""
        ...


class Model(Protocol):
    """A rod model with a mesh to refine; `order` is the expected order of its equilibria and frequencies."""

    order: int

    def dofs(self, elements: int) -> int:
        """Degrees of freedom of a clamped rod."""
        ...

    def follow(
        self, path: Sequence[Case], elements: int, start: Equilibrium | None = None
    ) -> Iterator[Equilibrium]:
        """Equilibria along a path of cases, each found from the one before.

        The first is found from `start`, or else from the natural shape of the first case.
        """
        ...

    def bending_frequency(self, elements: int) -> float:
        """Lowest angular frequency of the straight clamped rod."""
        ...

    def twist_frequency(self, elements: int) -> float:
        """Lowest angular frequency in twist of the straight free rod."""
        ...


class Balance(NamedTuple):
    """Equilibrium of a rod with curvatures as coordinates."""

    rods: Rods
    state: State
    case: Case

    def centreline(self, intervals: int) -> Array:
        return centreline(self.rods, self.state, intervals)[0]

    def stability(self) -> float:
        """Least share of the elastic energy of a disturbance that gravity leaves."""
        hessian = _hessian(self.rods, self.state, self.case)
        return float(eigh(hessian, stiffness_matrix(self.rods)[0], eigvals_only=True)[0])


@dataclass(frozen=True)
class CurvatureRod:
    """Super-Helix or Super-Clothoid."""

    basis: int
    order: int

    def dofs(self, elements: int) -> int:
        return dofs(self._rods(elements, Case()))

    def follow(self, path: Sequence[Case], elements: int, start: Balance | None = None) -> Iterator[Balance]:
        if start is None:
            natural = Case(path[0].curvature)
            rods = self._rods(elements, natural)
            start = Balance(rods, rest_state(rods), natural)

        def near(case: Case, other: Balance) -> Balance | None:
            """Newton's method from another equilibrium."""
            rods = self._rods(elements, case)
            state = _newton(rods, other.state, case)
            return None if state is None else Balance(rods, state, case)

        return follow(path, start, near)

    def bending_frequency(self, elements: int) -> float:
        rods = self._rods(elements, Case())
        bend = slice(1, None, 3)
        K, inertia = stiffness_matrix(rods)[0], inertia_matrix(rods, rest_state(rods))[0]
        return float(np.sqrt(eigh(K[bend, bend], inertia[bend, bend], eigvals_only=True)[0]))

    def twist_frequency(self, elements: int) -> float:
        rods = self._rods(elements, Case(), free=True)
        twist = [3, *range(6, dofs(rods), 3)]  # the turning of the root about the tangent, then tau
        block = np.ix_(twist, twist)
        K, inertia = stiffness_matrix(rods)[0][block], inertia_matrix(rods, rest_state(rods))[0][block]
        return float(np.sqrt(eigh(K, inertia, eigvals_only=True)[1]))  # the first is that of a rigid body

    def _rods(self, elements: int, case: Case, free: bool = False) -> Rods:
        return circular_rods(
            **MATERIAL,
            elements=elements,
            curvature=case.curvature,
            free=free,
            basis=self.basis,
        )


MODELS: dict[str, Model] = {
    "Super-Helix": CurvatureRod(HELIX, order=2),
    "Super-Clothoid": CurvatureRod(CLOTHOID, order=4),
    "Discrete rod": DiscreteRod(),
}


def _newton(rods: Rods, state: State, case: Case) -> State | None:
    """Equilibrium near a state, or None: where every coefficient would move by less than 1e-10."""
    for _ in range(15):
        force = generalised_force(rods, state, np.array(case.gravity))[0]
        step = np.linalg.solve(_hessian(rods, state, case), force).reshape(state.q.shape)
        state = state._replace(q=state.q + step)
        size = np.abs(step).max()
        if size < 1e-10 * (1 + np.abs(state.q).max()):
            return state
        if not size < 100:
            break
    return None


def _hessian(rods: Rods, state: State, case: Case) -> Array:
    """Second derivatives (D, D) of the energy with respect to the coefficients, by central differences."""
    D = state.q.size
    columns = []
    for first in range(0, D, _CHUNK):
        shift = _STEP * np.eye(D)[first : first + _CHUNK]
        ahead, behind = (_forces(rods, state, case, sign * shift) for sign in (1, -1))
        columns.append((behind - ahead) / (2 * _STEP))
    hessian = np.concatenate(columns)
    return (hessian + hessian.T) / 2


def _forces(rods: Rods, state: State, case: Case, shifts: Array) -> Array:
    """Generalised forces (m, D) on copies of a rod whose coefficients are shifted by `shifts` (m, D)."""
    m = len(shifts)
    many = Rods(*(np.repeat(x, m, axis=0) if isinstance(x, np.ndarray) else x for x in rods))
    q = state.q + shifts.reshape(m, *state.q.shape[1:])
    moved = rest_state(many)._replace(q=q)
    return generalised_force(many, moved, np.array(case.gravity))
