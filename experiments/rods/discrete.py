"""Discrete rods as a model of `models`: equilibria of rods with rigid edges by Newton's method on their energy.

The unknowns are what rigid edges leave free: each edge turns about its two material directors, and twists. An
edge `e = h t` that turns by w (orthogonal to t) becomes `h (t + w − |w|² t/2)` to second order, so that the Hessian
of the energy E on these unknowns is that of edge vectors, projected, less `(t·∂E/∂e) h |w|²`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rods.cases import MATERIAL, Case, follow
from scipy.linalg import eigh

from fibercontact.rods import DiscreteRods, DiscreteState, discrete_rods, discrete_state
from fibercontact.rods.discrete_energy import Frames, Law, derivatives, elastic_law, frames, strains
from fibercontact.rods.discrete_model import displaced, join, split

Array = NDArray[np.float64]


class Balance(NamedTuple):
    """Equilibrium of a clamped discrete rod."""

    rods: DiscreteRods
    state: DiscreteState
    case: Case

    def centreline(self, intervals: int) -> Array:
        nodes = self.state.position[0]
        at, of_nodes = np.linspace(0, 1, intervals + 1), np.linspace(0, 1, len(nodes))
        return np.column_stack([np.interp(at, of_nodes, x) for x in nodes.T])

    def stability(self) -> float:
        """Least share of the elastic energy of a disturbance that gravity leaves."""
        law, at = elastic_law(self.rods), frames(self.state)
        at_rest = law._replace(target=strains(self.state, at))
        elastic = _slopes(self.rods, at_rest, self.state, np.zeros(3))[1]
        hessian = _slopes(self.rods, law, self.state, np.array(self.case.gravity))[1]
        return float(eigh(hessian, elastic, eigvals_only=True)[0])


@dataclass(frozen=True)
class DiscreteRod:
    """Discrete elastic rod with rigid edges; `elements` are edges, the first of which the clamp holds."""

    order: int = 2

    def dofs(self, elements: int) -> int:
        return 4 * elements + 3 - self._rods(elements, Case()).prescribed

    def follow(self, path: Sequence[Case], elements: int, start: Balance | None = None) -> Iterator[Balance]:
        if start is None:
            natural = Case(path[0].curvature)
            rods = self._rods(elements, natural)
            start = Balance(rods, discrete_state(rods), natural)

        def near(case: Case, other: Balance) -> Balance | None:
            """Newton's method from another equilibrium."""
            rods = self._rods(elements, case)
            state = _newton(rods, other.state, np.array(case.gravity))
            return None if state is None else Balance(rods, state, case)

        return follow(path, start, near)

    def bending_frequency(self, elements: int) -> float:
        rods = self._rods(elements, Case())
        h = 1 / elements
        bend = slice(1, None, 3)  # about m_2, in the plane of t and m_1
        hessian = _slopes(rods, elastic_law(rods), discrete_state(rods), np.zeros(3))[1][bend, bend]
        arms = h * np.tri(elements - 1)  # displacement of the nodes behind the clamped edge
        masses = split(rods.inertia)[0][0, 2:, 0]
        return float(np.sqrt(eigh(hessian, arms.T * masses @ arms, eigvals_only=True)[0]))

    def twist_frequency(self, elements: int) -> float:
        rods = self._rods(elements, Case(), free=True)
        difference = np.diff(np.eye(elements), axis=0)
        stiffness = difference.T * (rods.stiffness[0, 0] / rods.cells[0]) @ difference
        inertia = np.diag(split(rods.inertia)[1][0])
        return float(
            np.sqrt(eigh(stiffness, inertia, eigvals_only=True)[1])
        )  # the first is that of a rigid body

    def _rods(self, elements: int, case: Case, free: bool = False) -> DiscreteRods:
        return discrete_rods(
            **MATERIAL,
            edges=elements,
            curvature=case.curvature,
            free=free,
            inextensible=True,
        )


def _newton(rods: DiscreteRods, state: DiscreteState, gravity: Array) -> DiscreteState | None:
    """Equilibrium near a state, or None: where no edge would turn by more than 1e-10."""
    law = elastic_law(rods)
    for _ in range(15):
        gradient, hessian = _slopes(rods, law, state, gravity)
        turns = -np.linalg.solve(hessian, gradient).reshape(-1, 3)
        state = _turned(rods, state, turns)
        size = np.abs(turns).max()
        if size < 1e-10:
            return state
        if not size < 10:
            break
    return None


def _slopes(rods: DiscreteRods, law: Law, state: DiscreteState, gravity: Array) -> tuple[Array, Array]:
    """Gradient (D,) and Hessian (D, D) of the energy of the first rod, `D = 3 (N − 1)`.

    The unknowns of an edge are its turns towards m_1 and m_2 and its twist, in rad.
    """
    at, h = frames(state), rods.edge_length[0]
    of_nodes = derivatives(law, state, at)
    beyond = np.cumsum(split(rods.inertia)[0][0, :0:-1, 0])[::-1]  # kg behind each edge
    gradient, hessian = np.zeros((rods.edges, 4)), np.zeros((4 * rods.edges, 4 * rods.edges))
    gradient[:, :3] = -np.outer(beyond, gravity)
    for i in range(rods.edges - 1):
        gradient[i : i + 2] += of_nodes.node_gradient[0, i].reshape(2, 4)
        block = slice(4 * i, 4 * i + 8)
        hessian[block, block] += of_nodes.node_hessian[0, i]
    turns = _turns(at, h)
    free = turns.T @ hessian @ turns
    along = h * np.sum(gradient[:, :3] * at.tangent[0], axis=1)
    free -= np.diag(np.outer(along, [1, 1, 0]).ravel())
    return (gradient.ravel() @ turns)[3:], free[3:, 3:]


def _turns(at: Frames, h: float) -> Array:
    """Change (4 N, 3 N) of the edge vectors and twists with the unknowns of all edges."""
    N = at.length.shape[1]
    turns = np.zeros((N, 4, N, 3))
    edge = np.arange(N)
    turns[edge, :3, edge, 0], turns[edge, :3, edge, 1] = h * at.m1[0], h * at.m2[0]
    turns[edge, 3, edge, 2] = 1.0
    return turns.reshape(4 * N, 3 * N)


def _turned(rods: DiscreteRods, state: DiscreteState, turns: Array) -> DiscreteState:
    """The state after turns (N − 1, 3) of the edges that are not clamped, lengths kept."""
    at, h = frames(state), rods.edge_length[0]
    directions = at.tangent[0].copy()
    directions[1:] += turns[:, :1] * at.m1[0, 1:] + turns[:, 1:2] * at.m2[0, 1:]
    edges = h * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    moved = state.position[0, 0] + np.concatenate([np.zeros((1, 3)), np.cumsum(edges, axis=0)])
    twists = np.concatenate([[0.0], turns[:, 2]])
    return displaced(state, join((moved - state.position[0])[None], twists[None]))
