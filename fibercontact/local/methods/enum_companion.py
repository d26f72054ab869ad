"""Enumerate take-off, stick and slip; slip by the eigenvalues of the quartic's companion matrix.

Equation: as in `enum-quartic`; the roots are the eigenvalues of a 4×4 companion matrix.
Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011, appendix B; THEORY §3.
Slower than the closed formula and steadier; possibly ill-conditioned, and without an approximate answer when
no admissible root is found.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import SLIP, eliminate_normal, is_finite, open_or_stick
from fibercontact.local.contract import LocalSolver, Matrix, Status
from fibercontact.local.slip_quartic import ENUMERATIVE_OPTIONS, companion_slip
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
    status, slip = companion_slip(W, b, mu, t, options[0])
    return status, (r if status == Status.NO_ROOT else slip), 0


solver = LocalSolver(kernel, options=ENUMERATIVE_OPTIONS)
