"""The problem of one time step, `M v + f = Hᵀ r`, `u = H v + w`, and its condensation to `(W, b, mu)`."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fibercontact.jit import jit
from fibercontact.problem.incremental import (
    IncrementalProblem,
    ProblemError,
    check_csr,
    check_finite,
    check_friction,
    check_vector,
    symmetric_part,
)
from fibercontact.problem.mobility import Mobility

__all__ = ["StepProblem"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StepProblem:
    """The problem of one step with `d` dofs and `n` contacts: `M v + f = Hᵀ r`, `u = H v + w`, Coulomb's law.

    `M` (d, d) CSR, symmetric positive definite, one block a rod (the blocks are found); `f` (d,);
    `H` (3n, d) CSR; `w` (3n,) in m/s; `mu` (n,). Raises `ProblemError` naming the fault; that `M` is positive
    definite is checked when it is factorised (`mobility`).
    """

    M: csr_array
    f: F64
    H: csr_array
    w: F64
    mu: F64

    def __post_init__(self) -> None:
        check_friction(self.mu)
        check_vector("w", self.w, 3 * self.n)
        check_finite("w", self.w, 3, "contact")
        check_vector("f", self.f, np.size(self.f))
        check_finite("f", self.f, 1, "degree of freedom")
        check_csr("M", self.M, (self.d, self.d))
        check_csr("H", self.H, (3 * self.n, self.d))
        symmetric_part(self.M, "M")
        _check_contacts_move(self.H)

    @property
    def n(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    @property
    def d(self) -> int:
        """Number of degrees of freedom."""
        return len(self.f)

    @cached_property
    def mobility(self) -> Mobility:
        """`M⁻¹`; raises `ProblemError` if `M` is not positive definite."""
        return Mobility(self.M)

    def condense(self) -> IncrementalProblem:
        """Eliminate the velocities: `W = H M⁻¹ Hᵀ`, `b = w − H M⁻¹ f` (THEORY §1)."""
        W = self.mobility.delassus(self.H)
        b = self.w - self.H @ self.mobility.solve(self.f)
        return IncrementalProblem(W, b, self.mu)

    def velocities(self, r: F64) -> F64:
        """Generalised velocities `v = M⁻¹ (Hᵀ r − f)`, (d,), under the impulses `r` (3n,)."""
        return self.mobility.solve(self.H.T @ r - self.f)


def _check_contacts_move(H: csr_array) -> None:
    at = _immovable_contact(H.indptr, H.data)
    if at >= 0:
        raise ProblemError(f"contact {at} moves no degree of freedom: its rows of H are 0")


@jit
def _immovable_contact(indptr: NDArray[np.int32], values: F64) -> int:
    """The first contact whose three rows of `H` are zero, −1 if there is none."""
    for i in range(len(indptr) // 3):
        if not values[indptr[3 * i] : indptr[3 * i + 3]].any():
            return i
    return -1
