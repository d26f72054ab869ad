"""Exact slip by a bracketed Newton iteration on a scalar secular equation; a root is always bracketed.

Take-off and stick are tested first. In slip `(W̄ + alpha I) r_T = -b̄`, and the scalar function
`phi(alpha) = |r_T(alpha)| - mu r_N(alpha)` is positive at 0+ (stick is excluded) and negative at
`alpha_max = |b̄| (1/mu + |w|/W_NN) / (-b_N/W_NN)`. Newton runs on `psi = 1/|r_T| - 1/(mu r_N)`, almost
linear in alpha, inside the bracket.

Reference: THEORY §3; the idea of the almost linear reciprocal is that of Moré and Sorensen (SIAM J. Sci. Stat.
Comput. 4, 1983) for trust regions. An impulse that is large beside b is corrected on `W` itself. Fails on data that
are not finite or not positive, for answers of more than 1e10 times b, and where a singular `W` leaves no answer.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.lanes import every, ratio, where
from fibercontact.local.algebra import (
    FRICTIONLESS,
    SHIFT,
    SINGULAR,
    SLIP,
    Tangential,
    eliminate_normal,
    is_finite,
    is_regular,
    meets,
    open_or_stick,
    separates,
    slip_impulse,
    stopping_impulse,
)
from fibercontact.local.contract import HONEST, LocalSolver, Matrix, Option, Status
from fibercontact.local.slip_refinement import on_cone, refine_slip
from fibercontact.problem.cone import Vector

__all__ = ["solver"]

LARGE = 1e4
"""Impulse, relative to b in velocity units, from which rounding may have spoilt it."""
NEAR = 1e-3
"""`|phi|` relative to `mu r_N` below which a short Newton step means that the root is near."""
STEPS = 4
"""Newton steps that several contacts are given at once; most need two."""
CLEARLY = 1.0 + 1e-9
"""Ratio of `|r_T|²` to `mu² r_N²` at alpha = 0 above which rounding cannot hide a stick."""


@jit
def dot(x: Vector, y: Vector) -> float:
    """`x·y`."""
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]


@jit
def last_alpha(W: Matrix, b: Vector, r: Vector) -> tuple[float, float]:
    """`-u_T·r_T` and `|r_T|²` of the last visit; their ratio is its alpha."""
    u1 = b[1] + W[1][0] * r[0] + W[1][1] * r[1] + W[1][2] * r[2]
    u2 = b[2] + W[2][0] * r[0] + W[2][1] * r[1] + W[2][2] * r[2]
    return -(u1 * r[1] + u2 * r[2]), r[1] * r[1] + r[2] * r[2]


@jit
def round_alpha(t: Tangential, mu: float) -> float:
    """The root for `W̄` a multiple of the identity and w = 0."""
    return -math.sqrt(t.c1 * t.c1 + t.c2 * t.c2) * t.W_NN / (mu * t.b_N) - 0.5 * t.trace


class Polynomials(NamedTuple):
    """What `phi` is made of, as polynomials in alpha: `D phi = |c| + m`, all without cancellation in `|c|²`."""

    trace: float  # D = det(W̄ + alpha I) = det + trace alpha + alpha²
    det: float
    q0: float  # |c|² = q0 + 2 q1 alpha + q2 alpha², c = adj(W̄) b̄ + alpha b̄ = -D r_T
    q1: float
    q2: float
    m0: float  # m = m0 + m1 alpha + m2 alpha² = -mu D r_N
    m1: float
    m2: float


@jit
def polynomials(t: Tangential, mu: float) -> Polynomials:
    """Coefficients for one contact."""
    B1, B2 = t.A22 * t.c1 - t.A12 * t.c2, t.A11 * t.c2 - t.A12 * t.c1
    scale = mu / t.W_NN
    m2 = scale * t.b_N
    return Polynomials(
        t.trace,
        t.det,
        B1 * B1 + B2 * B2,
        max(0.0, B1 * t.c1 + B2 * t.c2),
        t.c1 * t.c1 + t.c2 * t.c2,
        m2 * t.det - scale * (t.w1 * B1 + t.w2 * B2),
        m2 * t.trace - scale * (t.w1 * t.c1 + t.w2 * t.c2),
        m2,
    )


@jit
def clearly_slips(t: Tangential, p: Polynomials) -> bool:
    """Whether stick is excluded by a margin, which the polynomials at 0 tell without a division.

    They say nothing where `W̄` is singular.
    """
    return is_regular(t) & ((p.m0 >= 0.0) | (p.q0 > CLEARLY * p.m0 * p.m0))


@jit
def newton_step(p: Polynomials, alpha: float) -> tuple[float, float, float]:
    """`D phi` and `mu D r_N` at alpha, and Newton's next alpha for `psi = 1/|r_T| - 1/(mu r_N)`.

    With `g = |c| + m` one has `psi = D g / (|c| m)`, whose Newton step takes one division and one root.
    """
    D = p.det + alpha * (p.trace + alpha)
    q = p.q0 + alpha * (2.0 * p.q1 + alpha * p.q2)
    m = p.m0 + alpha * (p.m1 + alpha * p.m2)
    size = math.sqrt(q)
    g = size + m
    P = m * q * g
    N = (p.m1 + 2.0 * alpha * p.m2) * size * q + (p.q1 + alpha * p.q2) * m * m
    slope = (p.trace + 2.0 * alpha) * P - N * D
    return g, -m, alpha - ratio(D * P, slope, math.inf)


@jit
def bracket_end(t: Tangential, mu: float) -> float:
    """Twice `alpha_max`, where `phi` is negative."""
    coupling = t.W_NN / mu + math.sqrt(t.w1 * t.w1 + t.w2 * t.w2)
    return -2.0 * math.sqrt(t.c1 * t.c1 + t.c2 * t.c2) * coupling / t.b_N


@jit
def is_root(tolerance: float, t: Tangential, low: float, high: float, alpha: float, g: float, limit: float,
            newton: float) -> bool:  # fmt: skip
    """Whether Newton's iteration has come to an end: by its step, by `phi`, or by the bracket."""
    step = newton - alpha
    # Newton's error is of the step squared, but far from a root, where psi has a pole.
    settled = (step * step <= tolerance * alpha * alpha) & (abs(g) <= NEAR * limit)
    return settled | (abs(g) <= tolerance * limit) | (high - low <= 4e-16 * max(low, SINGULAR * t.trace))


@jit
def is_trusted(W: Matrix, b: Vector, t: Tangential, alpha: float, r: Vector) -> bool:
    """Whether rounding cannot have spoilt a slip."""
    limit = LARGE / (W[0][0] + W[1][1] + W[2][2])
    return (alpha > SHIFT * (t.trace + t.W_NN)) & (dot(r, r) < limit * limit * dot(b, b))


@jit
def accepted(W: Matrix, b: Vector, mu: float, t: Tangential, alpha: float) -> tuple[int, Vector]:
    """The slip at the root; refined and judged when rounding may have spoilt it."""
    r = on_cone(slip_impulse(t, alpha), mu)
    if is_trusted(W, b, t, alpha, r):
        return Status.CONVERGED, r
    residual, r = refine_slip(W, b, mu, t, r)
    return Status.CONVERGED if meets(W, b, mu, r, residual, HONEST) else Status.INACCURATE, r


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    t = eliminate_normal(W, b)
    p = polynomials(t, mu)
    if separates(b) or mu <= FRICTIONLESS or not clearly_slips(t, p):
        regime, simple = open_or_stick(t, b, mu)
        if regime != SLIP:
            return Status.CONVERGED, simple, 0
    tolerance, budget = options[0], int(options[1])
    low, high = 0.0, math.inf
    dissipated, square = last_alpha(W, b, r)
    alpha = dissipated / square if dissipated > 0.0 else round_alpha(t, mu)
    for k in range(budget):
        if not low < alpha < high:
            high = min(high, bracket_end(t, mu))
            alpha = 0.5 * (low + high) if low > 0.0 else 1e-3 * high
        g, limit, newton = newton_step(p, alpha)
        if is_root(tolerance, t, low, high, alpha, g, limit, newton):
            status, r = accepted(W, b, mu, t, newton if low < newton < high else alpha)
            return status, r, k + 1
        if g > 0.0:
            low = alpha
        else:
            high = alpha
        alpha = newton
    return Status.ITERATIONS, slip_impulse(t, alpha), budget


@jit
def several(W: Any, b: Any, mu: Any, r: Any, options: Any) -> Any:
    """As `kernel`, for `LANES` contacts: all three regimes at once, and a few steps of Newton without bisection."""
    t = eliminate_normal(W, b)
    p = polynomials(t, mu)
    opens, smooth, slips = separates(b), mu <= FRICTIONLESS, clearly_slips(t, p)
    stop = stopping_impulse(t, 0.0)
    within = math.sqrt(stop[1] * stop[1] + stop[2] * stop[2]) <= mu * stop[0]
    sticks = is_regular(t) & ~slips & within & (mu * stop[0] < math.inf)
    simple = opens | smooth | sticks
    dissipated, square = last_alpha(W, b, r)
    alpha = where(dissipated > 0.0, dissipated / square, round_alpha(t, mu))
    zero = where(simple, 0.0, 0.0)
    low, high, root, iterations = zero, zero + math.inf, zero, zero
    found: Any = simple
    lost: Any = zero < zero
    for _ in range(min(STEPS, int(options[1]))):
        lost = lost | ~((low < alpha) & (alpha < high))
        going = ~(found | lost)
        g, limit, newton = newton_step(p, alpha)
        now = going & is_root(options[0], t, low, high, alpha, g, limit, newton)
        root = where(now, where((low < newton) & (newton < high), newton, alpha), root)
        iterations = where(going, iterations + 1.0, iterations)
        found = found | now
        if every(found | lost):
            break
        low, high = where(g > 0.0, alpha, low), where(g > 0.0, high, alpha)
        alpha = newton
    slip = on_cone(slip_impulse(t, root), mu)
    done = is_finite(W, b, mu) & (simple | (found & is_trusted(W, b, t, root, slip)))
    return (
        where(done, 1.0, zero),
        (
            where(opens, 0.0, where(smooth, -b[0] / W[0][0], where(sticks, stop[0], slip[0]))),
            where(opens | smooth, 0.0, where(sticks, stop[1], slip[1])),
            where(opens | smooth, 0.0, where(sticks, stop[2], slip[2])),
        ),
        iterations,
    )


solver = LocalSolver(
    kernel,
    several=several,
    options={
        "tolerance": Option(1e-12, "relative width of | |r_T| - mu r_N | at which to stop"),
        "max_iterations": Option(100, "iterations of the bracketed Newton method"),
    },
)
