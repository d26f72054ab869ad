"""Newton's method for one contact: the loop, over any nonsmooth function of the impulse."""

import math
from typing import Any, NamedTuple

from fibercontact.jit import jit, jit_inline
from fibercontact.local.algebra import is_finite, law_residual, meets, solve3
from fibercontact.local.contract import HONEST, Matrix, Option, Status
from fibercontact.problem.cone import Vector, norm

__all__ = ["NEWTON_OPTIONS", "Contact", "newton"]

NEWTON_OPTIONS = {
    "tolerance": Option(1e-10, "norm of the function, relative to b, at which to stop"),
    "max_iterations": Option(50, "Newton iterations"),
}

ARMIJO = 1e-4
SHORTEST_STEP = 2.0**-20


class Contact(NamedTuple):
    """One contact problem, scaled so that `trace(W) = 3` and the impulse has the unit of `b`."""

    W: Matrix
    b: Vector
    mu: float
    rho: float = 1.0  # steps of the Alart–Curnier function, times 1/W_NN and 1/lambda_max(W_TT)
    disc: float = 0.0  # its friction disc: 0 for the radius mu max(0, r_N - rho_N u_N), 1 for mu max(0, r_N)


@jit
def scaled(W: Matrix, b: Vector, mu: float, rho: float, disc: float) -> tuple[Contact, float]:
    """The contact in velocity units, and sigma: impulses are multiplied by it."""
    sigma = (W[0][0] + W[1][1] + W[2][2]) / 3.0
    s = 1.0 / sigma
    return Contact(
        (
            (s * W[0][0], s * W[0][1], s * W[0][2]),
            (s * W[1][0], s * W[1][1], s * W[1][2]),
            (s * W[2][0], s * W[2][1], s * W[2][2]),
        ),
        b,
        mu,
        rho,
        disc,
    ), sigma


@jit
def step_along(r: Vector, d: Vector, t: float) -> Vector:
    """`r - t d`."""
    return (r[0] - t * d[0], r[1] - t * d[1], r[2] - t * d[2])


@jit_inline
def newton(
    function: Any,
    W: Matrix,
    b: Vector,
    mu: float,
    r: Vector,
    tolerance: float,
    budget: int,
    damped: bool,
    rho: float,
    disc: float,
) -> tuple[int, Vector, int]:
    """Find a zero of `function(contact, r) -> (f, J)` from `r`, by full steps or with a line search on `½|f|²`.

    Returns the status, the last impulse (the best one when damped) and the number of iterations.
    """
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    contact, sigma = scaled(W, b, mu, rho, disc)
    threshold = tolerance * norm(b)
    x = (sigma * r[0], sigma * r[1], sigma * r[2])
    f, J = function(contact, x)
    size = norm(f)
    status = Status.ITERATIONS
    done = 0
    for k in range(budget):
        done = k
        if size <= threshold:
            status = Status.CONVERGED
            break
        regular, d = solve3(J, f)
        if not regular:
            status = Status.SINGULAR
            break
        t = 1.0
        trial = step_along(x, d, t)
        f, J = function(contact, trial)
        new_size = norm(f)
        while damped and not new_size <= (1.0 - ARMIJO * t) * size and t > SHORTEST_STEP:
            t *= 0.5
            trial = step_along(x, d, t)
            f, J = function(contact, trial)
            new_size = norm(f)
        if damped and not new_size < size:
            status = Status.STALLED
            break
        x, size = trial, new_size
    if size <= threshold:
        status = Status.CONVERGED
    accepted = max(HONEST, 10.0 * tolerance)
    if status == Status.CONVERGED and not meets(
        contact.W, b, mu, x, law_residual(contact.W, b, mu, x), accepted
    ):
        status = Status.INACCURATE
    if not math.isfinite(x[0] + x[1] + x[2]):
        status = Status.NOT_FINITE
    return status, (x[0] / sigma, x[1] / sigma, x[2] / sigma), done
