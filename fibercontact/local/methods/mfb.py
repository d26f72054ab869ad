"""Modified Fischer–Burmeister function on the second-order cone, damped Newton.

Equation: `f = x + y - (x∘x + y∘y)^(1/2) = 0`, `x = (mu r_N, r_T)`, `y = (ũ_N, mu u_T)` (THEORY §3).
Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011 (its printed Jacobian has a typo).
Smooth almost everywhere; fails when the line search stalls where the Jacobian is nearly singular, mostly with normal
and tangents strongly coupled, and where rounding hides b behind a far larger impulse. Without friction it is
degenerate and the normal complementarity is solved directly.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import is_finite
from fibercontact.local.contract import LocalSolver, Matrix, Status
from fibercontact.local.fischer_burmeister import mfb
from fibercontact.local.newton import NEWTON_OPTIONS
from fibercontact.problem.cone import Vector

__all__ = ["solver"]


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    if mu <= 0.0:
        return Status.CONVERGED, (-b[0] / W[0][0] if b[0] < 0.0 else 0.0, 0.0, 0.0), 0
    return mfb(W, b, mu, r, options)


solver = LocalSolver(kernel, options=NEWTON_OPTIONS)
