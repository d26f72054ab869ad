"""Slip by enumeration: the quartic in alpha, two ways to its roots, and the choice of the admissible one."""

import cmath
import math

import numpy as np

from fibercontact.jit import jit
from fibercontact.local.algebra import Tangential, law_residual, meets, slip_impulse
from fibercontact.local.contract import Matrix, Option, Status
from fibercontact.problem.cone import Vector

__all__ = [
    "ENUMERATIVE_OPTIONS",
    "closed_roots",
    "closed_slip",
    "companion_roots",
    "companion_slip",
    "slip_quartic",
]

Quartic = tuple[float, float, float, float, float]
Roots = tuple[complex, complex, complex, complex]

ENUMERATIVE_OPTIONS = {
    "tolerance": Option(1e-6, "local residual, relative to b, above which a root is a failure")
}

REAL_ANGLE = 1e-3
"""A root counts as real up to this ratio of imaginary to real part: rounding splits a double root by sqrt(eps)."""

BIQUADRATIC = 1e-18
"""Relative size of the resolvent's root below which the depressed quartic has no linear term but rounding."""


@jit
def alpha_unit(t: Tangential) -> float:
    """`tr(W̄)`, or `W_NN` where `W̄` vanishes: `W` has rank 1."""
    return t.trace if t.trace > 0.0 else t.W_NN


@jit
def slip_quartic(t: Tangential, mu: float) -> Quartic:
    """Coefficients, highest first, of `mu² p(alpha)² - W_NN² |B + alpha b̄|²` [Daviet 2011, app. B].

    alpha is in units of `alpha_unit`, so that the coefficients do not depend on the scale of `W`.
    """
    B1, B2 = t.A22 * t.c1 - t.A12 * t.c2, t.A11 * t.c2 - t.A12 * t.c1  # adj(W̄) b̄
    unit = alpha_unit(t)
    p2 = mu * t.b_N * unit * unit
    p1 = mu * (t.b_N * t.trace - t.w1 * t.c1 - t.w2 * t.c2) * unit
    p0 = mu * (t.b_N * t.det - t.w1 * B1 - t.w2 * B2)
    d1, d2 = t.c1 * unit * t.W_NN, t.c2 * unit * t.W_NN
    B1, B2 = B1 * t.W_NN, B2 * t.W_NN
    return (
        p2 * p2,
        2.0 * p2 * p1,
        p1 * p1 + 2.0 * p2 * p0 - d1 * d1 - d2 * d2,
        2.0 * (p1 * p0 - d1 * B1 - d2 * B2),
        p0 * p0 - B1 * B1 - B2 * B2,
    )


@jit
def largest_cubic_root(a: float, b: float, c: float) -> float:
    """Largest real root of `x³ + a x² + b x + c` (Cardano and Viète)."""
    q, r = (a * a - 3.0 * b) / 9.0, (2.0 * a * a * a - 9.0 * a * b + 27.0 * c) / 54.0
    if r * r < q * q * q:
        angle = math.acos(max(-1.0, min(1.0, r / math.sqrt(q * q * q))))
        return -2.0 * math.sqrt(q) * math.cos((angle + 2.0 * math.pi) / 3.0) - a / 3.0
    s = -math.copysign((abs(r) + math.sqrt(r * r - q * q * q)) ** (1.0 / 3.0), r)
    return s + (q / s if s != 0.0 else 0.0) - a / 3.0


@jit
def polished_resolvent(m: float, a: float, b: float, c: float) -> float:
    """The root `m` of `x³ + a x² + b x + c` after two Newton steps, which give a small one its relative accuracy.

    A step that does not reduce the value is not taken: near a multiple root it is rounding over rounding.
    """
    value = ((m + a) * m + b) * m + c
    for _ in range(2):
        slope = (3.0 * m + 2.0 * a) * m + b
        if not slope > 0.0:
            break
        trial = m - value / slope
        new = ((trial + a) * trial + b) * trial + c
        if not abs(new) < abs(value):
            break
        m, value = trial, new
    return m


@jit
def closed_roots(c: Quartic) -> tuple[bool, Roots]:
    """Roots of the quartic by Ferrari's closed formula; False when its leading coefficient vanishes."""
    zero = complex(0.0, 0.0)
    if not c[0] > 0.0:
        return False, (zero, zero, zero, zero)
    b3, b2, b1, b0 = c[1] / c[0], c[2] / c[0], c[3] / c[0], c[4] / c[0]
    shift = -0.25 * b3
    p = b2 - 0.375 * b3 * b3
    q = b1 - 0.5 * b3 * b2 + 0.125 * b3 * b3 * b3
    r = b0 - 0.25 * b3 * b1 + b3 * b3 * b2 / 16.0 - 3.0 / 256.0 * b3 * b3 * b3 * b3
    m = largest_cubic_root(p, 0.25 * p * p - r, -0.125 * q * q)
    m = polished_resolvent(m, p, 0.25 * p * p - r, -0.125 * q * q)
    if not m > BIQUADRATIC * (abs(p) + math.sqrt(abs(r))):
        s = cmath.sqrt(complex(0.25 * p * p - r, 0.0))
        x, y = cmath.sqrt(-0.5 * p + s), cmath.sqrt(-0.5 * p - s)
        return True, (shift + x, shift - x, shift + y, shift - y)
    n = math.sqrt(2.0 * m)
    x = cmath.sqrt(complex(-2.0 * (p + m) - 2.0 * q / n, 0.0))
    y = cmath.sqrt(complex(-2.0 * (p + m) + 2.0 * q / n, 0.0))
    return True, (
        shift + 0.5 * (n + x), shift + 0.5 * (n - x), shift + 0.5 * (-n + y), shift + 0.5 * (-n - y),
    )  # fmt: skip


@jit
def companion_roots(c: Quartic) -> tuple[bool, Roots]:
    """Roots of the quartic as eigenvalues of its companion matrix; False when it has none."""
    zero = complex(0.0, 0.0)
    if c[0] == 0.0:
        return False, (zero, zero, zero, zero)
    b3, b2, b1, b0 = c[1] / c[0], c[2] / c[0], c[3] / c[0], c[4] / c[0]
    if not math.isfinite(b3 + b2 + b1 + b0):
        return False, (zero, zero, zero, zero)
    companion = np.zeros((4, 4), dtype=np.complex128)
    companion[0, 0], companion[0, 1], companion[0, 2], companion[0, 3] = -b3, -b2, -b1, -b0
    companion[1, 0] = companion[2, 1] = companion[3, 2] = 1.0
    roots = np.linalg.eigvals(companion)
    return True, (roots[0], roots[1], roots[2], roots[3])


@jit
def best_slip(
    W: Matrix, b: Vector, mu: float, t: Tangential, roots: Roots, tolerance: float
) -> tuple[int, Vector]:
    """The admissible root (`alpha > 0`, `r_N > 0`) whose impulse has the least residual, judged by `tolerance`."""
    best, least = (0.0, 0.0, 0.0), math.inf
    for root in roots:
        if root.real > 0.0 and abs(root.imag) <= REAL_ANGLE * root.real:
            r = slip_impulse(t, root.real * alpha_unit(t))
            residual = law_residual(W, b, mu, r)
            if r[0] > 0.0 and residual < least:
                best, least = r, residual
    if math.isinf(least):
        return Status.NO_ROOT, best
    return Status.CONVERGED if meets(W, b, mu, best, least, tolerance) else Status.INACCURATE, best


@jit
def closed_slip(W: Matrix, b: Vector, mu: float, t: Tangential, tolerance: float) -> tuple[int, Vector]:
    """Slip impulse by the closed formula; zero impulse with `NO_ROOT` when there is none."""
    found, roots = closed_roots(slip_quartic(t, mu))
    if not found:
        return Status.NO_ROOT, (0.0, 0.0, 0.0)
    return best_slip(W, b, mu, t, roots, tolerance)


@jit
def companion_slip(W: Matrix, b: Vector, mu: float, t: Tangential, tolerance: float) -> tuple[int, Vector]:
    """Slip impulse by the companion matrix; zero impulse with `NO_ROOT` when there is none."""
    found, roots = companion_roots(slip_quartic(t, mu))
    if not found:
        return Status.NO_ROOT, (0.0, 0.0, 0.0)
    return best_slip(W, b, mu, t, roots, tolerance)
