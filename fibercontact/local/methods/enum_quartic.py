"""Enumerate take-off, stick and slip; slip by the closed formula for the roots of a quartic.

Equation: `mu² p(alpha)² - W_NN² |B + alpha b̄|² = 0`, `alpha > 0`, `r_N > 0` (THEORY §3).
Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011, appendix B.
Exact in exact arithmetic. Fails when the admissible root is lost in the rounding of the largest one: at the edge of
stick and slip, for `b_N` just below 0, with a singular `W`; it has no approximate answer to give then.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import SLIP, eliminate_normal, is_finite, open_or_stick
from fibercontact.local.contract import LocalSolver, Matrix, Status
from fibercontact.local.slip_quartic import ENUMERATIVE_OPTIONS, closed_slip
from fibercontact.problem.cone import Vector

__all__ = ["solver"]


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    t = eliminate_normal(W, b)
    regime, simple = open_or_stick(t, b, mu)
    if regime != SLIP:
        return Status.CONVERGED, simple, 0
    status, slip = closed_slip(W, b, mu, t, options[0])
    return status, (r if status == Status.NO_ROOT else slip), 0


solver = LocalSolver(kernel, options=ENUMERATIVE_OPTIONS)
