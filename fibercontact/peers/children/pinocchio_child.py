"""Pinocchio's solvers of constrained dynamics, given the Delassus operator alone."""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Desk"]

LARGEST = 3000
"""Contacts beyond which the dense matrices (9 n² numbers, some of them) take gigabytes."""
STACK = 1 << 24
"""Bytes."""


class Desk:
    """Contact order (T1, T2, N); the normal comes first everywhere else."""

    def __init__(self) -> None:
        self._pinocchio = importlib.import_module("pinocchio")
        self._sparse = importlib.import_module("scipy.sparse")
        self.version = str(self._pinocchio.__version__)
        if not hasattr(self._pinocchio, "PGSConstraintSolver"):
            raise ImportError(f"pinocchio {self.version} has no PGSConstraintSolver: 4.0 or later is needed")

    def lay_out(
        self,
        starts: NDArray[Any],
        columns: NDArray[Any],
        blocks: NDArray[Any],
        b: NDArray[Any],
        mu: NDArray[Any],
    ) -> Any:
        """The Delassus matrix, sparse, the free velocity, and a point contact with its cone for each contact."""
        n = len(mu)
        if n > LARGEST:
            raise ValueError(f"pinocchio works with dense matrices: {n} contacts are more than {LARGEST}")
        normal_last = np.array([1, 2, 0])
        turned = blocks[:, normal_last][:, :, normal_last]
        W = self._sparse.csc_matrix(self._sparse.bsr_matrix((turned, columns, starts), shape=(3 * n, 3 * n)))
        W.sort_indices()
        W.indices, W.indptr = W.indices.astype(np.int32), W.indptr.astype(np.int32)
        return W, b.reshape(n, 3)[:, normal_last].ravel(), *self._contacts(mu)

    def _contacts(self, mu: NDArray[Any]) -> tuple[Any, Any]:
        """Contacts of one free body: the solvers read no more of them than the cone."""
        pinocchio = self._pinocchio
        body = pinocchio.Model()
        joint = body.addJoint(0, pinocchio.JointModelFreeFlyer(), pinocchio.SE3.Identity(), "body")
        models, datas = pinocchio.StdVec_ConstraintModel(), pinocchio.StdVec_ConstraintData()
        for coefficient in mu.tolist():
            contact = pinocchio.PointContactConstraintModel(body, joint)
            contact.setFriction(coefficient)
            models.append(contact)
            datas.append(contact.createData())
        return models, datas

    def solve(
        self, problem: Any, order: dict[str, Any], start: NDArray[Any]
    ) -> tuple[dict[str, Any], NDArray[Any]]:
        """Solve by `PGS` (dense matrix) or `ADMM` (sparse matrix), with De Saxcé's term, the default."""
        pinocchio, (W, g, models, datas) = self._pinocchio, problem
        settings = self._settings(order)
        result = getattr(pinocchio, f"{order['solver']}SolverResult")()
        result.setConstraintImpulseGuess(start.reshape(-1, 3)[:, [1, 2, 0]].ravel())
        if order["solver"] == "PGS":
            delassus = pinocchio.DelassusOperatorDense(W.toarray())
        else:
            delassus = pinocchio.DelassusOperatorSparse(W)
        solver = getattr(pinocchio, f"{order['solver']}ConstraintSolver")(len(g))
        claimed, seconds = _on_a_deep_stack(
            lambda: solver.solve(delassus, g, models, datas, settings, result), STACK + 8 * len(g) ** 2
        )
        feasibility = max(result.primal_feasibility, result.dual_feasibility)
        found = {
            "claimed": bool(claimed),
            "iterations": int(result.iterations),
            "error": float(max(feasibility, result.complementarity) / (order["b_ref"] or 1.0)),
            "seconds": seconds,
            "note": f"feasibility {feasibility:.1e}, complementarity {result.complementarity:.1e}",
        }
        return found, np.array(result.retrieveConstraintImpulses()).reshape(-1, 3)[:, [2, 0, 1]].ravel()

    def _settings(self, order: dict[str, Any]) -> Any:
        """Pinocchio's defaults, but for the limit and its four tolerances, which are one number by default too."""
        settings = getattr(self._pinocchio, f"{order['solver']}SolverSettings")()
        settings.max_iterations = order["max_iterations"]
        absolute = order["tolerance"] * (order["b_ref"] or 1.0)
        settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = absolute
        settings.relative_feasibility_tol = settings.relative_complementarity_tol = order["tolerance"]
        return settings


def _on_a_deep_stack(work: Callable[[], Any], size: int) -> tuple[Any, float]:
    """What `work` gives and its seconds; PGS keeps a copy of W on the stack, which is too small by default."""

    def timed() -> tuple[Any, float]:
        began = time.perf_counter()
        return work(), time.perf_counter() - began

    threading.stack_size(size - size % 4096)
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(timed).result()
