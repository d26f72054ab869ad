"""Nonsmooth Newton on the modified Fischer–Burmeister functions of all contacts at once.

Equation: `f = x + y - (x∘x + y∘y)^(1/2) = 0`, `x = (mu r_N, r_T)`, `y = (ũ_N, mu u_T)` at every contact, `u = W r +
b`; `(P + Q (W + delta Sigma)) d = f` with a delta proportional to `|f|`, full steps or a line search on `½|f|²`.
Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011, for the function; Bertails-Descoubes,
Cadoux, Daviet and Acary, ACM TOG 30(1), 2011, for Newton's method on all contacts.
A few tens of iterations, one sparse factorisation each, whose matrix is fuller than with Alart and Curnier's
function: no contact's rows vanish. May cycle; with the line search it may stall. Refuses more contacts than the
factors of W may fit into memory for.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fibercontact.global_methods.contract import GlobalMethod
from fibercontact.global_methods.newton import NEWTON_OPTIONS, NONE, UNIT, Point, newton, put
from fibercontact.global_methods.scaled import Scaled
from fibercontact.jit import jit
from fibercontact.local.contract import Matrix
from fibercontact.local.fischer_burmeister import modified_fischer_burmeister
from fibercontact.local.newton import Contact
from fibercontact.problem.cone import Vector

__all__ = ["solver"]

Array = NDArray[np.float64]


@jit
def frictionless(x: Vector, y: Vector) -> tuple[Vector, Matrix, Matrix]:
    """The scalar Fischer–Burmeister function of the normals, and `r_T = 0`: at mu = 0 the other one is degenerate."""
    size = math.hypot(x[0], y[0])
    P, Q = (1.0 - x[0] / size, 1.0 - y[0] / size) if size > 0.0 else (1.0, 0.0)
    f = (x[0] + y[0] - size, x[1], x[2])
    J_none = ((P, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    return f, J_none, ((P + Q, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@jit
def evaluate(p: Scaled, options: Array, at: Point) -> None:
    """The function and the blocks of its Jacobian at every contact."""
    x, y = at.x, at.y
    for i in range(len(p.root)):
        mu = p.A.mu[i]
        x_i, y_i = (x[3 * i], x[3 * i + 1], x[3 * i + 2]), (y[3 * i], y[3 * i + 1], y[3 * i + 2])
        if mu > 0.0:
            b = (y_i[0] - x_i[0], y_i[1] - x_i[1], y_i[2] - x_i[2])
            f, J_none = modified_fischer_burmeister(Contact(NONE, y_i, mu), x_i)
            _, J_unit = modified_fischer_burmeister(Contact(UNIT, b, mu), x_i)
        else:
            f, J_none, J_unit = frictionless(x_i, y_i)
        put(at, i, f, J_none, J_unit)


solver = GlobalMethod(newton(evaluate), options=NEWTON_OPTIONS)
