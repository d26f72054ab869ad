"""Exact slip by a bracketed Newton iteration on a scalar secular equation; cannot fail.

Take-off and stick are tested first. In slip `(W̄ + alpha I) r_T = -b̄`, and the scalar function
`phi(alpha) = |r_T(alpha)| - mu r_N(alpha)` is positive at 0+ (stick is excluded) and negative at
`alpha_max = |b̄| (1/mu + |w|/W_NN) / (-b_N/W_NN)`. Newton runs on `psi = 1/|r_T| - 1/(mu r_N)`, almost
linear in alpha, inside the bracket.

Reference: THEORY §3; the idea of the almost linear reciprocal is that of Moré and Sorensen (SIAM J. Sci. Stat.
Comput. 4, 1983) for trust regions. Fails only on data that are not finite or not positive.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import (
    SHIFT,
    SLIP,
    Tangential,
    eliminate_normal,
    is_finite,
    law_residual,
    open_or_stick,
    slip_impulse,
)
from fibercontact.local.contract import LocalSolver, Matrix, Option, Status
from fibercontact.problem.cone import Vector, norm

__all__ = ["solver"]

ACCEPTED = 1e-6
"""Residual, relative to b, above which a root near stick is a failure: `W` is singular and b out of its range."""


@jit
def first_alpha(W: Matrix, b: Vector, mu: float, r: Vector, t: Tangential) -> float:
    """`-u_T·r_T / |r_T|²` of the last visit, or the root for `W̄` a multiple of the identity and w = 0."""
    square = r[1] * r[1] + r[2] * r[2]
    if square > 0.0:
        u1 = b[1] + W[1][0] * r[0] + W[1][1] * r[1] + W[1][2] * r[2]
        u2 = b[2] + W[2][0] * r[0] + W[2][1] * r[1] + W[2][2] * r[2]
        alpha = -(u1 * r[1] + u2 * r[2]) / square
        if alpha > 0.0:
            return alpha
    return -math.sqrt(t.c1 * t.c1 + t.c2 * t.c2) * t.W_NN / (mu * t.b_N) - 0.5 * t.trace


@jit
def newton_step(t: Tangential, r: Vector, alpha: float, mu: float) -> tuple[float, float]:
    """`phi` at alpha and Newton's next alpha for `psi = 1/|r_T| - 1/(mu r_N)`."""
    scale = -1.0 / (t.det + alpha * (t.trace + alpha))
    d1 = scale * ((t.A22 + alpha) * r[1] - t.A12 * r[2])  # d r_T / d alpha
    d2 = scale * ((t.A11 + alpha) * r[2] - t.A12 * r[1])
    size = math.sqrt(r[1] * r[1] + r[2] * r[2])
    limit = mu * r[0]
    phi = size - limit
    slope = (
        mu * (t.w1 * d1 + t.w2 * d2) / t.W_NN * size * size * size + (r[1] * d1 + r[2] * d2) * limit * limit
    )
    return phi, alpha - limit * size * size * phi / slope


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    t = eliminate_normal(W, b)
    regime, stick = open_or_stick(t, b, mu)
    if regime != SLIP:
        return Status.CONVERGED, stick, 0
    tolerance, budget = options[0], int(options[1])
    low = 0.0
    high = (
        2.0
        * math.sqrt(t.c1 * t.c1 + t.c2 * t.c2)
        * (t.W_NN / mu + math.sqrt(t.w1 * t.w1 + t.w2 * t.w2))
        / (-t.b_N)
    )
    alpha = first_alpha(W, b, mu, r, t)
    for k in range(budget):
        if not low < alpha < high:
            alpha = 0.5 * (low + high) if low > 0.0 else 1e-3 * high
        r = slip_impulse(t, alpha)
        phi, newton = newton_step(t, r, alpha, mu)
        if abs(phi) <= tolerance * mu * r[0] or high - low <= 4e-16 * high:
            r = on_cone(r, mu)
            sound = alpha > SHIFT * (t.trace + t.W_NN) or law_residual(W, b, mu, r) <= ACCEPTED * norm(b)
            return Status.CONVERGED if sound else Status.INACCURATE, r, k + 1
        if phi > 0.0:
            low = alpha
        else:
            high = alpha
        alpha = newton
    return Status.ITERATIONS if math.isfinite(r[0] + r[1] + r[2]) else Status.NOT_FINITE, r, budget


@jit
def on_cone(r: Vector, mu: float) -> Vector:
    """`r` with `r_T` scaled to the length `mu r_N`, which it has but for rounding."""
    size = math.sqrt(r[1] * r[1] + r[2] * r[2])
    scale = mu * r[0] / size if size > 0.0 else 0.0
    return (r[0], scale * r[1], scale * r[2])


solver = LocalSolver(
    kernel,
    options={
        "tolerance": Option(1e-12, "relative width of | |r_T| - mu r_N | at which to stop"),
        "max_iterations": Option(100, "iterations of the bracketed Newton method"),
    },
)
