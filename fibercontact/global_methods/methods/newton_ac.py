"""Nonsmooth Newton on the Alart–Curnier functions of all contacts at once.

Equation: `f_N = r_N - max(0, r_N - rho_N u_N)`, `f_T = r_T - P_disc(r_T - rho_T u_T)` at every contact, `u = W r +
b`; `(P + Q (W + delta Sigma)) d = f` with a delta proportional to `|f|`, full steps or a line search on `½|f|²`.
Reference: Alart and Curnier, CMAME 92, 1991; Bertails-Descoubes, Cadoux, Daviet and Acary, ACM TOG 30(1), 2011, to
whose method `shift=0,line_search=1` is closest.
A few tens of iterations, one sparse factorisation each. May cycle; with the line search it stalls at kinks of the
function; with `shift=0` it fails on most fibre assemblies, whose W is singular. Refuses more contacts than the
factors of W may fit into memory for.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.global_methods.contract import GlobalMethod
from fibercontact.global_methods.newton import NEWTON_OPTIONS, NONE, UNIT, Point, newton, put
from fibercontact.global_methods.scaled import Scaled
from fibercontact.jit import jit
from fibercontact.local.alart_curnier import ALART_CURNIER_OPTIONS, steps, with_steps
from fibercontact.local.newton import Contact

__all__ = ["solver"]

Array = NDArray[np.float64]


@jit
def evaluate(p: Scaled, options: Array, at: Point) -> None:
    """The function and the blocks of its Jacobian at every contact, the steps rho those of its own `W_ii`."""
    x, y = at.x, at.y
    for i in range(len(p.root)):
        W, mu = p.A.diagonal[i], p.A.mu[i]
        own = ((W[0], W[1], W[2]), (W[3], W[4], W[5]), (W[6], W[7], W[8]))
        rho_N, rho_T = steps(own, options[2])
        x_i, y_i = (x[3 * i], x[3 * i + 1], x[3 * i + 2]), (y[3 * i], y[3 * i + 1], y[3 * i + 2])
        b = (y_i[0] - x_i[0], y_i[1] - x_i[1], y_i[2] - x_i[2])
        f, J_none = with_steps(Contact(NONE, y_i, mu, 1.0, options[3]), x_i, rho_N, rho_T)
        _, J_unit = with_steps(Contact(UNIT, b, mu, 1.0, options[3]), x_i, rho_N, rho_T)
        put(at, i, f, J_none, J_unit)


solver = GlobalMethod(
    newton(evaluate), options=NEWTON_OPTIONS | {name: ALART_CURNIER_OPTIONS[name] for name in ("rho", "disc")}
)
