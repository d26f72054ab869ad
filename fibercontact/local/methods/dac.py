"""Alart–Curnier function, damped Newton: a line search on `½|f|²`.

Equation: `f_N = r_N - max(0, r_N - rho_N u_N)`, `f_T = r_T - P_disc(r_T - rho_T u_T)` (THEORY §3).
Reference: Alart and Curnier, CMAME 92, 1991; Bertails-Descoubes, Cadoux, Daviet and Acary, ACM TOG 30(1), 2011.
A full step is taken when it decreases the merit. Fails when the line search stalls: the merit of a nonsmooth
function has valleys along its kinks that do not lead to zeros, mostly the kink of stick and slip.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.alart_curnier import ALART_CURNIER_OPTIONS, alart_curnier
from fibercontact.local.contract import LocalSolver, Matrix
from fibercontact.local.newton import newton
from fibercontact.problem.cone import Vector

__all__ = ["solver"]


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    return newton(alart_curnier, W, b, mu, r, options[0], int(options[1]), True, options[2], options[3])


solver = LocalSolver(kernel, options=ALART_CURNIER_OPTIONS)
