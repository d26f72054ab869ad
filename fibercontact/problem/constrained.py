"""The problem of a step with bilateral constraints: inextensible rods (THEORY §7)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array
from scipy.sparse.linalg import splu

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem, condense_constrained

__all__ = ["ConstrainedStep"]

F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ConstrainedStep:
    """A step `M v + f = Hᵀ r + G lambda`, `u = H v + w` with the constraints `Gᵀ v + c = 0`.

    `G` (d, l) CSR, `c` (l,); the rest is that of `step`.
    """

    step: StepProblem
    G: csr_array
    c: F64

    @property
    def n(self) -> int:
        """Number of contacts."""
        return self.step.n

    @property
    def d(self) -> int:
        """Number of degrees of freedom, before the constraints."""
        return self.step.d

    @property
    def mu(self) -> F64:
        """Friction coefficients (n,)."""
        return self.step.mu

    @property
    def H(self) -> csr_array:
        """Contact Jacobian (3n, d)."""
        return self.step.H

    @property
    def w(self) -> F64:
        """Velocity (3n,) in m/s that does not come from the dofs."""
        return self.step.w

    def condense(self) -> IncrementalProblem:
        """Eliminate multipliers and velocities, exactly; raises `ProblemError` as `condense_constrained`."""
        return condense_constrained(self.step, self.G, self.c)

    def velocities(self, r: F64) -> F64:
        """Generalised velocities (d,) under the impulses `r` (3n,)."""
        matrix = block_array([[self.step.M, -self.G], [self.G.T, None]], format="csc")
        known = np.concatenate([self.step.H.T @ r - self.step.f, -self.c])
        return np.asarray(splu(matrix).solve(known)[: self.d], dtype=np.float64)
