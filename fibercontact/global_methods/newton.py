"""Nonsmooth Newton on all contacts at once, over a function of one contact.

The equations are `f_i(x_i, y_i) = 0`, `y = A x + c`, one function of the local solvers a contact. Their generalised
Jacobian is `J = P + Q A` with the blocks `P_i = ∂f_i/∂x_i` and `Q_i = ∂f_i/∂y_i`. A is often singular, and J with
it where contacts stick: the step solves `(P + Q (A + delta I)) d = f` with delta proportional to `‖f‖`, which
vanishes at the end so that convergence stays fast. Steps are full, or halved until `½ ‖f‖²` decreases enough: with
the delta the former solve more, for the search comes to a halt at kinks of f.

References: Alart and Curnier, CMAME 92, 1991; Bertails-Descoubes, Cadoux, Daviet and Acary, ACM TOG 30(1), 2011,
who report convergence for systems that are not over-constrained, without the delta. Qi and Sun, Math. Program. 58,
1993, for the method; Li, Fukushima, Qi and Yamashita, Comput. Optim. Appl. 28, 2004, for a shift of the order of
the residual.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from fibercontact.gauss_seidel.blocks import BlockSystem, matrix, velocity
from fibercontact.global_methods.contract import Answer, Solve, Task
from fibercontact.global_methods.scaled import (
    MARGIN,
    NO_SLIP,
    Budget,
    Scaled,
    answer,
    check_size,
    cone_residual,
    impulse,
    scale,
    start_of,
)
from fibercontact.jit import jit
from fibercontact.local.contract import Matrix, Option
from fibercontact.problem.cone import Vector

__all__ = ["NEWTON_OPTIONS", "NONE", "UNIT", "Point", "newton", "put"]

Array = NDArray[np.float64]

NEWTON_OPTIONS = {
    "shift": Option(0.1, "delta over |f| / |f at the start|, in units of trace(W_ii)/3"),
    "line_search": Option(0.0, "0: full steps, 1: halve the step until |f| decreases"),
}

ARMIJO = 1e-4
SHORTEST = 2.0**-20
NONE: Matrix = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
UNIT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Point(NamedTuple):
    """Impulses, velocities, the function there and the blocks of its Jacobian."""

    x: Array  # (3n,)
    y: Array  # (3n,) A x + c
    f: Array  # (3n,)
    P: Array  # (n, 3, 3) ∂f/∂x
    Q: Array  # (n, 3, 3) ∂f/∂y


Evaluate = Callable[[Scaled, Array, Point], None]
"""Fill f, P and Q of a point from its x and y; the array has the method's options."""


@jit
def put(at: Point, i: int, f: Vector, J_none: Matrix, J_unit: Matrix) -> None:
    """Store contact i, from its function's Jacobian `P + Q W` at W = 0 and at W = I."""
    for a in range(3):
        at.f[3 * i + a] = f[a]
        for c in range(3):
            at.P[i, a, c] = J_none[a][c]
            at.Q[i, a, c] = J_unit[a][c] - J_none[a][c]


@jit
def jacobian(p: Scaled, at: Point, delta: float, J: Array) -> None:
    """Write the blocks of `P + Q (A + delta I)`."""
    A, blocks = p.A, p.A.blocks
    for i in range(len(p.root)):
        P, Q = at.P[i], at.Q[i]
        for j in range(A.starts[i], A.starts[i + 1]):
            for a in range(3):
                for c in range(3):
                    k = 9 * j + c
                    J[k + 3 * a] = Q[a, 0] * blocks[k] + Q[a, 1] * blocks[k + 3] + Q[a, 2] * blocks[k + 6]
                    if A.columns[j] == i:
                        J[k + 3 * a] += P[a, c] + delta * Q[a, c]


def newton(evaluate: Evaluate) -> Solve:
    """The method over a function of one contact; its options begin with `NEWTON_OPTIONS`."""

    def solve(system: BlockSystem, task: Task, options: Array) -> Answer:
        check_size(system)
        budget, p, target = Budget(task), scale(system), MARGIN * task.target
        at, note = _point(p, options, evaluate, start_of(p, task)), ""
        first = np.linalg.norm(at.f)
        residual = cone_residual(p, NO_SLIP, at.x, at.y)
        best = (residual, at.x)
        while target < residual < math.inf and budget.slice:
            d = _direction(p, at, options[0] * np.linalg.norm(at.f) / first)
            if d is None:
                note = "the Jacobian is singular"
                break
            new = _step(p, options, evaluate, at, d)
            if new is None:
                note = "the line search found no decrease"
                break
            at, budget.done = new, budget.done + 1
            residual = cone_residual(p, NO_SLIP, at.x, at.y)
            best = min(best, (residual, at.x), key=lambda pair: pair[0])
        return answer(system, task, impulse(p, best[1]), budget.done, note or budget.note)

    return solve


def _point(p: Scaled, options: Array, evaluate: Evaluate, x: Array) -> Point:
    """Everything at the impulses x."""
    at = Point(x, np.empty_like(x), np.empty_like(x), *np.zeros((2, len(p.root), 3, 3)))
    velocity(p.A, x, at.y)
    evaluate(p, options, at)
    return at


def _direction(p: Scaled, at: Point, delta: float) -> Array | None:
    """Newton's step, None when the Jacobian is singular."""
    blocks = np.empty_like(p.A.blocks)
    jacobian(p, at, delta, blocks)
    J = matrix(p.A, blocks)
    J.eliminate_zeros()  # the rows of open contacts
    try:
        d = splu(csc_array(J)).solve(at.f)
    except RuntimeError:
        return None
    return d if np.isfinite(d).all() else None


def _step(p: Scaled, options: Array, evaluate: Evaluate, at: Point, d: Array) -> Point | None:
    """The point after the step, None when no share of it decreases the function."""
    size, t = np.linalg.norm(at.f), 1.0
    while t >= SHORTEST:
        new = _point(p, options, evaluate, at.x - t * d)
        if options[1] == 0.0 or np.linalg.norm(new.f) <= (1.0 - ARMIJO * t) * size:
            return new
        t *= 0.5
    return None
