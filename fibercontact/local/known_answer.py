"""One contact in rational arithmetic, built round its answer.

The answer comes first: `r` and `u` that obey Coulomb's law exactly, in so few binary digits that they are doubles;
Pythagorean triples make `|r_T| = mu r_N` an identity between integers. Then `W` is rounded to doubles, and
`b = u - W r` is computed exactly and rounded once. So the answer is that of the contact as it stands to a natural map
of at most `(1 + mu) 2⁻⁵³ |b|`, whatever the condition number: an error of u grows by `1 + mu` at most in it.
"""

import math
import random
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import islice
from typing import NamedTuple

__all__ = [
    "NOTHING", "Exact", "Known", "Operator", "Plane", "between", "coupled", "decade", "dot", "gram", "impulse",
    "load", "needed", "pick", "planar", "ray", "rounded", "short", "slip", "solve2", "stick", "turned", "unit",
    "weak_along",
]  # fmt: skip

Exact = tuple[Fraction, ...]
"""Three numbers (N, T1, T2), or two in the tangent plane."""
Operator = tuple[Exact, Exact, Exact]
Plane = tuple[Fraction, Fraction]
Reduced = tuple[Fraction, Fraction, Fraction]
"""A symmetric 2×2 matrix: 11, 12, 22."""

NOTHING: Exact = (Fraction(0), Fraction(0), Fraction(0))


class Known(NamedTuple):
    """A contact and its answer; `r`, `u`, `mu` and `start` are doubles, `W` is still to be rounded."""

    W: Operator
    mu: Fraction
    r: Exact
    u: Exact
    start: Exact = NOTHING


# Numbers of few digits


def short(x: float, bits: int = 20) -> Fraction:
    """`x` rounded to few significant bits, so that products with it remain doubles."""
    mantissa, exponent = math.frexp(x)
    return Fraction(round(math.ldexp(mantissa, bits))) * Fraction(2) ** (exponent - bits)


def decade(k: float) -> Fraction:
    """The power of two next to `10^k`."""
    return Fraction(2) ** round(k * math.log2(10.0))


def pick(rng: random.Random, count: int) -> int:
    """An integer from 0 to `count - 1`."""
    return int(rng.random() * count)


def between(rng: random.Random, low: float, high: float) -> Fraction:
    """A number of few bits, log-uniform."""
    return short(low * (high / low) ** rng.random(), 8)


def pythagorean(rng: random.Random) -> tuple[int, int, int]:
    """Integers `a² + b² = c²`, a and b in any order and of any sign."""
    m, n = 1 + pick(rng, 12), 1 + pick(rng, 12)
    a, b = m * m - n * n, 2 * m * n * (1 - 2 * pick(rng, 2))
    return (a, b, m * m + n * n) if pick(rng, 2) else (b, a, m * m + n * n)


def unit(rng: random.Random) -> Plane:
    """A rational unit vector of the tangent plane."""
    a, b, c = pythagorean(rng)
    return Fraction(a, c), Fraction(b, c)


def ray(rng: random.Random) -> tuple[Fraction, Plane]:
    """`r_N` between 1/2 and 1, and a vector e of the tangent plane of that length: doubles of few bits."""
    a, b, c = pythagorean(rng)
    scale = Fraction(1, 1 << c.bit_length())
    return c * scale, (a * scale, b * scale)


# Operators


def dot(x: Exact, y: Exact) -> Fraction:
    """Scalar product."""
    return sum((a * b for a, b in zip(x, y, strict=True)), Fraction(0))


def gram(columns: tuple[Exact, ...], weights: Exact) -> Operator:
    """`Σ weight c cᵀ` over the columns."""

    def row(i: int) -> Exact:
        return tuple(dot(weights, tuple(c[i] * c[j] for c in columns)) for j in range(3))

    return row(0), row(1), row(2)


def rotation(rng: random.Random) -> tuple[Exact, ...]:
    """Columns of a rational rotation, from an integer quaternion."""
    a, b, c, d = 1 + pick(rng, 6), pick(rng, 13) - 6, pick(rng, 13) - 6, pick(rng, 13) - 6
    columns = (
        (a * a + b * b - c * c - d * d, 2 * (b * c + a * d), 2 * (b * d - a * c)),
        (2 * (b * c - a * d), a * a - b * b + c * c - d * d, 2 * (c * d + a * b)),
        (2 * (b * d + a * c), 2 * (c * d - a * b), a * a - b * b - c * c + d * d),
    )
    n = a * a + b * b + c * c + d * d
    return tuple(tuple(Fraction(k, n) for k in column) for column in columns)


def turned(rng: random.Random, condition: Fraction) -> Operator:
    """An operator of eigenvalues 1, `1/condition` and one between, in any orientation."""
    middle = decade(-rng.random() * math.log10(condition))
    return gram(rotation(rng), (Fraction(1), middle, 1 / condition))


def weak_along(r: Exact, condition: Fraction) -> Operator:
    """The operator of eigenvalue `1/condition` along r and 1 across."""
    one, zero = Fraction(1), Fraction(0)
    axes = ((one, zero, zero), (zero, one, zero), (zero, zero, one), r)
    return gram(axes, (one, one, one, (1 / condition - 1) / dot(r, r)))


def coupled(W_NN: Fraction, w: Plane, reduced: Reduced) -> Operator:
    """The operator with `W_NN`, `W_TN = w` and `W_TT - w wᵀ/W_NN = reduced` (THEORY §3, enumerative)."""
    T11, T12, T22 = (x + w[i] * w[j] / W_NN for x, i, j in zip(reduced, (0, 0, 1), (0, 1, 1), strict=True))
    return (W_NN, *w), (w[0], T11, T12), (w[1], T12, T22)


def planar(axis: Plane, a: Fraction, b: Fraction) -> Reduced:
    """The symmetric 2×2 matrix of eigenvalues a along the unit vector `axis` and b across."""
    c, s = axis
    return a * c * c + b * s * s, (a - b) * c * s, a * s * s + b * c * c


def solve2(A: Reduced, x: Plane) -> Plane:
    """`A⁻¹ x`."""
    det = A[0] * A[2] - A[1] * A[1]
    return (A[2] * x[0] - A[1] * x[1]) / det, (A[0] * x[1] - A[1] * x[0]) / det


def rounded(W: Operator) -> list[list[float]]:
    """`W` in doubles."""
    return [[float(x) for x in row] for row in W]


# Answers


def impulse(r_N: Fraction, e: Plane, mu: Fraction) -> Exact:
    """`(r_N, mu e)`, on the boundary of the cone when `|e| = r_N`."""
    return r_N, mu * e[0], mu * e[1]


def slip(rng: random.Random, W: Operator, mu: Fraction, speed: Fraction) -> Known:
    """A slip with `|u_T| = speed r_N`."""
    r_N, e = ray(rng)
    return Known(W, mu, impulse(r_N, e, mu), (Fraction(0), -speed * e[0], -speed * e[1]))


def stick(rng: random.Random, W: Operator, mu: Fraction) -> Known:
    """A stick inside of the cone."""
    r_N, e = ray(rng)
    return Known(W, mu, impulse(r_N, e, Fraction(pick(rng, 16), 16) * mu), NOTHING)


def load(known: Known) -> list[float]:
    """`b = u - W r` with `W` rounded, itself rounded once."""
    rows = [tuple(map(Fraction, row)) for row in rounded(known.W)]
    return [float(u - dot(row, known.r)) for u, row in zip(known.u, rows, strict=True)]


def needed(count: int, candidates: Iterable[Known]) -> Iterator[Known]:
    """The first `count` candidates that are pressed together and, if they slip, cannot be stopped instead.

    Elsewhere the answer that comes to mind first is another one than that known.
    """
    return islice(filter(is_needed, candidates), count)


def is_needed(known: Known) -> bool:
    """Whether neither take-off nor, beside a slip, stick is an answer."""
    W, b = rounded(known.W), load(known)
    return b[0] < 0.0 and not (any(known.u) and can_be_stopped(W, b, known.mu))


def can_be_stopped(W: list[list[float]], b: list[float], mu: Fraction) -> bool:
    """Whether `-W⁻¹ b` is in the cone, for a regular `W`; by Cramer's rule."""
    x, y, z = (tuple(map(Fraction, row)) for row in W)
    adjugate = (cross(y, z), cross(z, x), cross(x, y))
    det = dot(x, adjugate[0])
    if det == 0 or mu == 0:
        return False
    exact = tuple(map(Fraction, b))
    r = [-dot(row, exact) / det for row in adjugate]
    return r[0] >= 0 and r[1] ** 2 + r[2] ** 2 <= (mu * r[0]) ** 2


def cross(x: Exact, y: Exact) -> Exact:
    """Vector product."""
    return x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]
