"""ADMM: a linear system with one matrix and a projection on the cones, in turn.

Equation, with the slip term `s_i = mu_i ‖w_T,i‖` of the last iteration and rho > 0: `(A + rho I) x = rho z + w − c
− s e`, `z ← P_K(x̂ − w/rho)`, `w ← rho (z − x̂) + w`, `x̂ = 1.6 x − 0.6 z`. z and w lie in the cones and their
duals and are orthogonal at every iteration; the impulses are z. rho balances `‖x − z‖` and `rho ‖Δz‖`, and the
matrix is factorised anew when it changes.
Reference: Tasora, Mangoni, Benatti and Garziera, Int. J. Numer. Methods Eng. 122, 2021; Carpentier, Le Lidec and
Montaut, Robotics: Science and Systems 2024; Boyd et al., Found. Trends Mach. Learn. 3, 2011, §3.4.
Creeps where no rho suits the stiff and the weak directions of W alike. Refuses more contacts than the factors of W
may fit into memory for.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import splu

from fibercontact.gauss_seidel.blocks import BlockSystem, matrix, velocity
from fibercontact.global_methods.contract import Answer, GlobalMethod, Task
from fibercontact.global_methods.scaled import (
    MARGIN,
    NO_SLIP,
    Budget,
    answer,
    check_size,
    cone_residual,
    impulse,
    projected,
    scale,
    slip_terms,
    start_of,
)
from fibercontact.local.contract import Option

__all__ = ["solver"]

Array = NDArray[np.float64]

RELAXATION = 1.6
LEAST, MOST = 1e-9, 1e6
"""Bounds of rho."""


class _Penalty:
    """The matrix `A + rho I` and its factors."""

    def __init__(self, A: csc_array, rho: float, unbalanced: float, patience: float) -> None:
        self.A, self.unbalanced, self.patience = A, unbalanced, patience
        self._set(rho)

    def _set(self, rho: float) -> None:
        matrix = csc_array(self.A + rho * eye_array(*self.A.shape))
        # Positive definite: pivots on the diagonal.
        options = {"SymmetricMode": True}
        self.factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        self.rho, self.age = rho, 0

    def solve(self, load: Array) -> Array:
        """`(A + rho I)⁻¹ load`."""
        self.age += 1
        return self.factors.solve(load)

    def balance(self, primal: Array, dual: Array) -> None:
        """Change rho when one of the two residuals has outgrown the other."""
        first, second = np.linalg.norm(primal), np.linalg.norm(dual)
        if self.age < self.patience or not (first > 0.0 and second > 0.0):
            return
        ratio = float(first / second)
        if not 1.0 / self.unbalanced <= ratio <= self.unbalanced:
            self._set(min(max(self.rho * min(max(math.sqrt(ratio), 0.1), 10.0), LEAST), MOST))


def solve(system: BlockSystem, task: Task, options: Array) -> Answer:
    """Solve a problem; see the module's docstring."""
    check_size(system)
    budget, p, target = Budget(task), scale(system), MARGIN * task.target
    z = start_of(p, task)
    y, w = np.empty_like(z), np.zeros_like(z)
    velocity(p.A, z, y)
    residual = cone_residual(p, NO_SLIP, z, y)
    best, penalty = (residual, z), None
    while target < residual < math.inf and budget.slice:
        penalty = penalty or _Penalty(csc_array(matrix(p.A, p.A.blocks)), *options)
        load = penalty.rho * z + w - p.A.b
        load[::3] -= slip_terms(p, w)
        x = penalty.solve(load)
        relaxed, old, z = RELAXATION * x + (1.0 - RELAXATION) * z, z, np.empty_like(z)
        projected(p.A.mu, relaxed - w / penalty.rho, z)
        w = penalty.rho * (z - relaxed) + w
        velocity(p.A, z, y)
        residual = cone_residual(p, NO_SLIP, z, y)
        best = min(best, (residual, z), key=lambda pair: pair[0])
        penalty.balance(x - z, penalty.rho * (z - old))
        budget.done += 1
    return answer(system, task, impulse(p, best[1]), budget.done, budget.note)


solver = GlobalMethod(
    solve,
    options={
        "rho": Option(0.1, "first penalty, in units of trace(W_ii)/3"),
        "unbalanced": Option(5.0, "ratio of the two residuals beyond which rho is changed"),
        "patience": Option(10, "iterations between two changes of rho at least"),
    },
)
