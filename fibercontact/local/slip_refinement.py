"""Newton's corrections of a slip, for impulses that are large beside b.

The elimination of `r_N` loses the digits of an ill-conditioned `W`, and with them the answer when `sigma r` is much
larger than b. A residual computed on `W` itself does not: iterative refinement [Wilkinson 1963, Rounding errors in
algebraic processes] of the slip equations `u_N = 0`, `u_T + alpha r_T = 0`, `|r_T| = mu r_N`.
"""

import math

from fibercontact.jit import jit
from fibercontact.lanes import ratio
from fibercontact.local.algebra import Tangential, affine, law_residual, slip_impulse
from fibercontact.local.contract import Matrix
from fibercontact.problem.cone import Vector, norm

__all__ = ["on_cone", "refine_slip"]

CORRECTIONS = 5
ENOUGH = 1e-12
"""Residual relative to b that is not refined further."""


@jit
def on_cone(r: Vector, mu: float) -> Vector:
    """`r` with `r_T` scaled to the length `mu r_N`, which it has but for rounding."""
    size = math.sqrt(r[1] * r[1] + r[2] * r[2])
    scale = ratio(mu * r[0], size, 0.0)
    return (r[0], scale * r[1], scale * r[2])


@jit
def response(t: Tangential, alpha: float, x: Vector) -> Vector:
    """`-(W + alpha diag(0, 1, 1))⁻¹ x`, by the elimination at hand."""
    stop = x[0] / t.W_NN
    return slip_impulse(
        Tangential(t.W_NN, x[0], t.w1, t.w2, t.A11, t.A12, t.A22,
                   x[1] - stop * t.w1, x[2] - stop * t.w2, t.trace, t.det),
        alpha,
    )  # fmt: skip


@jit
def correct_slip(W: Matrix, b: Vector, mu: float, t: Tangential, r: Vector) -> Vector:
    """One Newton step on the slip equations from `r`."""
    size = math.sqrt(r[1] * r[1] + r[2] * r[2])
    e1, e2 = r[1] / size, r[2] / size
    u = affine(W, r, b)
    alpha = max(0.0, -(e1 * u[1] + e2 * u[2]) / size)
    d = response(t, alpha, (u[0], u[1] + alpha * r[1], u[2] + alpha * r[2]))
    s = response(t, alpha, (0.0, r[1], r[2]))  # dr/dalpha
    gap = size - mu * r[0] + e1 * d[1] + e2 * d[2] - mu * d[0]
    step = -gap / (e1 * s[1] + e2 * s[2] - mu * s[0])
    return on_cone((r[0] + d[0] + step * s[0], r[1] + d[1] + step * s[1], r[2] + d[2] + step * s[2]), mu)


@jit
def refine_slip(W: Matrix, b: Vector, mu: float, t: Tangential, r: Vector) -> tuple[float, Vector]:
    """The slip `r`, corrected as long as its residual falls, and the residual."""
    least = law_residual(W, b, mu, r)
    for _ in range(CORRECTIONS):
        if not least > ENOUGH * norm(b):
            break
        trial = correct_slip(W, b, mu, t, r)
        residual = law_residual(W, b, mu, trial)
        if not residual < least:
            break
        r, least = trial, residual
    return least, r
