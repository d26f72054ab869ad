"""Scalar 3×3 algebra shared by the local solvers, and the elimination of the normal impulse."""

import math
from typing import NamedTuple

from fibercontact.jit import jit
from fibercontact.lanes import ratio
from fibercontact.local.contract import Matrix
from fibercontact.problem.cone import COULOMB, Vector, natural_map, norm

__all__ = [
    "FRICTIONLESS",
    "GRAZING",
    "LARGEST",
    "OPEN",
    "SHIFT",
    "SINGULAR",
    "SLIP",
    "STICK",
    "Tangential",
    "affine",
    "eliminate_normal",
    "is_finite",
    "is_regular",
    "law_residual",
    "meets",
    "open_or_stick",
    "separates",
    "slip_impulse",
    "solve3",
    "stick_impulse",
    "stopping_impulse",
]

OPEN, STICK, SLIP = 0, 1, 2

LARGEST = 1e10
"""Impulse, relative to b in velocity units, above which rounding makes a residual meaningless."""

EPSILON = 2.0**-52

SINGULAR = 1e-10
"""Ratio of the least eigenvalue of `W_TT - w wᵀ/W_NN` to `tr(W_TT)` below which it counts as singular."""
SHIFT = 1e-9
"""What replaces that eigenvalue, relative to the same trace."""
GRAZING = 1e-16
"""Approach speed, relative to the tangential one, that is nothing but rounding: the contact is open."""
FRICTIONLESS = 1e-30
"""Friction coefficient below which the tangential impulse is nothing but rounding."""
LEFT_OVER = 1e-7
"""Sliding speed, relative to b, that the shift may leave in stick."""


class Tangential(NamedTuple):
    """The contact after elimination of `r_N` by `u_N = 0` (THEORY §3, enumerative)."""

    W_NN: float
    b_N: float
    w1: float  # w = W_TN
    w2: float
    A11: float  # W̄ = W_TT - w wᵀ / W_NN
    A12: float
    A22: float
    c1: float  # b̄ = b_T - (b_N / W_NN) w
    c2: float
    trace: float
    det: float


@jit
def affine(W: Matrix, r: Vector, b: Vector) -> Vector:
    """`u = W r + b`."""
    return (
        b[0] + W[0][0] * r[0] + W[0][1] * r[1] + W[0][2] * r[2],
        b[1] + W[1][0] * r[0] + W[1][1] * r[1] + W[1][2] * r[2],
        b[2] + W[2][0] * r[0] + W[2][1] * r[1] + W[2][2] * r[2],
    )


@jit
def is_finite(W: Matrix, b: Vector, mu: float) -> bool:
    """Whether the contact's data are finite, and so is `-b_N/W_NN`, which stops an approach without friction.

    `W` is symmetric, so its lower triangle is looked at.
    """
    stops = (W[0][0] > 0.0) & (abs(ratio(b[0], W[0][0], math.inf)) < math.inf)
    total = ((W[0][0] + W[1][1]) + (W[2][2] + W[1][0])) + ((W[2][0] + W[2][1]) + (b[0] + b[1])) + (b[2] + mu)
    return ((b[0] >= 0.0) | stops) & (abs(total) < math.inf)


@jit
def separates(b: Vector) -> bool:
    """Whether the contact takes off without an impulse, but for rounding."""
    return b[0] >= -GRAZING * (abs(b[1]) + abs(b[2]))


@jit
def law_residual(W: Matrix, b: Vector, mu: float, r: Vector) -> float:
    """Norm of the natural map of Coulomb's law at `r`, in the unit of `b`; infinite for impulses too large."""
    sigma = (W[0][0] + W[1][1] + W[2][2]) / 3.0
    if sigma * norm(r) > LARGEST * norm(b):
        return math.inf
    return norm(natural_map(affine(W, r, b), r, mu, sigma, COULOMB))


@jit
def meets(W: Matrix, b: Vector, mu: float, r: Vector, residual: float, tolerance: float) -> bool:
    """Whether a residual at `r` is at most `tolerance |b|`, and what rounding of r and u alone can leave of it.

    `r` rounded and `W r + b` evaluated in doubles are off by `2 tr(W) |r| eps`, which `ũ` grows by `1 + mu` at most.
    """
    trace = W[0][0] + W[1][1] + W[2][2]
    bound = tolerance * norm(b) + 2.0 * (1.0 + mu) * EPSILON * trace * norm(r)
    return residual <= bound and math.isfinite(residual)


@jit
def solve3(A: Matrix, b: Vector) -> tuple[bool, Vector]:
    """Solve `A x = b` by Gaussian elimination with partial pivoting; False when `A` is singular."""
    p = (A[0][0], A[0][1], A[0][2], b[0])
    q = (A[1][0], A[1][1], A[1][2], b[1])
    s = (A[2][0], A[2][1], A[2][2], b[2])
    if abs(q[0]) > abs(p[0]):
        p, q = q, p
    if abs(s[0]) > abs(p[0]):
        p, s = s, p
    if not abs(p[0]) > 0.0:
        return False, b
    f, g = q[0] / p[0], s[0] / p[0]
    q1, q2, q3 = q[1] - f * p[1], q[2] - f * p[2], q[3] - f * p[3]
    s1, s2, s3 = s[1] - g * p[1], s[2] - g * p[2], s[3] - g * p[3]
    if abs(s1) > abs(q1):
        q1, q2, q3, s1, s2, s3 = s1, s2, s3, q1, q2, q3
    if not abs(q1) > 0.0:
        return False, b
    f = s1 / q1
    pivot = s2 - f * q2
    if not abs(pivot) > 0.0:
        return False, b
    z = (s3 - f * q3) / pivot
    y = (q3 - q2 * z) / q1
    x = (p[3] - p[1] * y - p[2] * z) / p[0]
    return math.isfinite(x + y + z), (x, y, z)


@jit
def eliminate_normal(W: Matrix, b: Vector) -> Tangential:
    """Eliminate `r_N` from the contact by `u_N = 0`."""
    w1, w2 = W[1][0], W[2][0]
    inverse = 1.0 / W[0][0]
    A11 = W[1][1] - w1 * w1 * inverse
    A12 = W[1][2] - w1 * w2 * inverse
    A22 = W[2][2] - w2 * w2 * inverse
    r_N = -b[0] * inverse
    return Tangential(
        W[0][0], b[0], w1, w2, A11, A12, A22,
        b[1] + r_N * w1, b[2] + r_N * w2, A11 + A22, max(0.0, A11 * A22 - A12 * A12),
    )  # fmt: skip


@jit
def is_regular(t: Tangential) -> bool:
    """Whether `W̄` is not singular, by the ratio of its determinant to the square of its trace."""
    trace = t.trace * t.W_NN + t.w1 * t.w1 + t.w2 * t.w2  # W_NN tr(W_TT)
    return t.det * t.W_NN > SINGULAR * trace * abs(t.trace)


@jit
def slip_impulse(t: Tangential, alpha: float) -> Vector:
    """The impulse with `u_N = 0` and `u_T = -alpha r_T`: `(W̄ + alpha I) r_T = -b̄`."""
    det = t.det + alpha * (t.trace + alpha)
    scale = ratio(-1.0, det, -math.inf)
    r1 = scale * ((t.A22 + alpha) * t.c1 - t.A12 * t.c2)
    r2 = scale * ((t.A11 + alpha) * t.c2 - t.A12 * t.c1)
    return (-(t.b_N + t.w1 * r1 + t.w2 * r2) / t.W_NN, r1, r2)


@jit
def stopping_impulse(t: Tangential, shift: float) -> Vector:
    """`slip_impulse` by elimination, backward stable: Cramer's rule there leaves a velocity of eps·cond·|b|."""
    pivot = t.A11 + shift
    factor = t.A12 / pivot
    r2 = (factor * t.c1 - t.c2) / (t.A22 + shift - factor * t.A12)
    r1 = -(t.c1 + t.A12 * r2) / pivot
    return (-(t.b_N + t.w1 * r1 + t.w2 * r2) / t.W_NN, r1, r2)


@jit
def stick_impulse(t: Tangential, b: Vector) -> tuple[bool, Vector]:
    """The impulse that stops the contact, and whether there is one.

    A singular `W̄` is shifted: when `b̄` is in its range the impulse stays bounded, when it is not the contact
    cannot be stopped. With `W_TT = 0` any shift does.
    """
    if is_regular(t):
        return True, stopping_impulse(t, 0.0)
    trace = t.trace * t.W_NN + t.w1 * t.w1 + t.w2 * t.w2
    shift = SHIFT * trace / t.W_NN if trace > 0.0 else t.W_NN
    r = stopping_impulse(t, shift)
    return shift * math.sqrt(r[1] * r[1] + r[2] * r[2]) <= LEFT_OVER * norm(b), r


@jit
def open_or_stick(t: Tangential, b: Vector, mu: float) -> tuple[int, Vector]:
    """The two simple cases, take-off (`b_N >= 0` but for rounding) and stick; `SLIP` when neither holds.

    Without friction the answer is the complementarity in the normal direction alone; `SLIP` is not returned.
    """
    if separates(b):
        return OPEN, (0.0, 0.0, 0.0)
    if mu <= FRICTIONLESS:
        return STICK, (-b[0] / t.W_NN, 0.0, 0.0)
    stops, r = stick_impulse(t, b)
    if stops and math.sqrt(r[1] * r[1] + r[2] * r[2]) <= mu * r[0] < math.inf:
        return STICK, r
    return SLIP, r
