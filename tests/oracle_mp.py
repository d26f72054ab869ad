"""One contact to 50 digits: every solution of Coulomb's law, and the natural map (THEORY §2, §3), slow and readable.

Doubles are fractions, so everything is rational but two things, the root alpha of a polynomial and the length of a
vector. Which solutions there are is decided exactly; alpha and lengths are then known to 80 digits, which leaves
50 in the impulses for condition numbers up to 1e30. Nothing of the package is used.
"""

from fractions import Fraction
from itertools import pairwise
from math import lcm
from typing import NamedTuple

import mpmath

MP = mpmath.MPContext()
MP.dps = 80
BITS = 270  # of alpha: 81 digits


class Solution(NamedTuple):
    """`regime` is take-off, stick or slip; `u_T = -alpha r_T`; impulse `r`."""

    regime: str
    alpha: Fraction
    r: list


def exact(x):
    """Doubles, in sequences of any depth, as fractions."""
    return [exact(c) for c in x] if hasattr(x, "__len__") else Fraction(float(x))


def number(x):
    return MP.mpf(x.numerator) / x.denominator if isinstance(x, Fraction) else MP.mpf(x)


def length(x):
    return MP.sqrt(sum(number(c) ** 2 for c in x))


# The solutions


def coulomb_solutions(W, b, mu):
    """Every solution of Coulomb's law; raises `ValueError` unless `W` is symmetric positive definite."""
    W, b, mu = exact(W), exact(b), Fraction(float(mu))
    require_definite(W)
    take_off = [Solution("take-off", Fraction(0), [Fraction(0)] * 3)] if b[0] >= 0 else []
    if mu == 0:
        pressed = [Solution("slip", Fraction(0), [-b[0] / W[0][0], Fraction(0), Fraction(0)])]
        return as_numbers(take_off or pressed)
    r = shifted_impulse(W, b, Fraction(0))
    sticks = r[0] > 0 and r[1] ** 2 + r[2] ** 2 <= mu**2 * r[0] ** 2
    stick = [Solution("stick", Fraction(0), r)] if sticks else []
    slips = [Solution("slip", a, shifted_impulse(W, b, a)) for a in positive_roots(slip_polynomial(W, b, mu))]
    return as_numbers(take_off + stick + [s for s in slips if s.r[0] > 0])


def as_numbers(solutions):
    return [s._replace(r=[number(c) for c in s.r]) for s in solutions]


def require_definite(W):
    """Sylvester's criterion."""
    minors = W[0][0], W[0][0] * W[1][1] - W[0][1] * W[1][0], determinant(W)
    if any(W[i][j] != W[j][i] for i in range(3) for j in range(i)) or not min(minors) > 0:
        raise ValueError("W must be symmetric positive definite")


def determinant(A):
    return sum(A[0][j] * cofactor(A, 0, j) for j in range(3))


def cofactor(A, i, j):
    """Of a 3×3 matrix; the cyclic order carries the sign."""
    (p, q), (s, t) = ((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3)
    return A[p][s] * A[q][t] - A[p][t] * A[q][s]


def shifted_impulse(W, b, alpha):
    """`r` with `W r + b = -alpha (0, r_T)`, by Cramer's rule: stick for alpha = 0."""
    A = [[W[i][j] + (alpha if i == j > 0 else 0) for j in range(3)] for i in range(3)]
    det = determinant(A)
    return [-sum(cofactor(A, i, j) * b[i] for i in range(3)) / det for j in range(3)]


def slip_polynomial(W, b, mu):
    """`mu² N² - (T1² + T2²)` in alpha, lowest degree first, where `r = (N, T1, T2) / D` by Cramer's rule.

    `D = det(W + alpha diag(0, 1, 1)) > 0` for alpha >= 0. N has degree 2 in alpha, T1 and T2 have degree 1, so three
    values of alpha give them.
    """
    N, T1, T2 = (interpolated([cramer(W, b, Fraction(a), j) for a in range(3)]) for j in range(3))
    squares = [product(N, N), product(T1, T1), product(T2, T2)]
    return [mu**2 * n - s - t for n, s, t in zip(*squares, strict=True)]


def cramer(W, b, alpha, j):
    """Numerator of `r_j(alpha)`."""
    A = [[W[i][k] + (alpha if i == k > 0 else 0) for k in range(3)] for i in range(3)]
    return -sum(cofactor(A, i, j) * b[i] for i in range(3))


def interpolated(y):
    """Coefficients of the quadratic with the values y at 0, 1, 2."""
    second = (y[2] - 2 * y[1] + y[0]) / 2
    return [y[0], y[1] - y[0] - second, second]


def product(p, q):
    return [
        sum(p[i] * q[k - i] for i in range(len(p)) if 0 <= k - i < len(q)) for k in range(len(p) + len(q) - 1)
    ]


# Real roots by Sturm's theorem


def positive_roots(p):
    """The distinct positive roots of a polynomial of rational coefficients, lowest degree first, in order.

    None for the zero polynomial. Sturm's theorem counts them, multiple ones once, and bisection finds them.
    """
    p = trimmed(p)
    while p and p[0] == 0:
        p = p[1:]
    if len(p) < 2:
        return []
    chain = sturm_chain(quotient(p, common_divisor(p, derivative(p))))
    largest = 1 + max(abs(c / p[-1]) for c in p)  # Cauchy's bound, and that of the reciprocals
    least = 1 / (1 + max(abs(c / p[0]) for c in p))
    return list(roots_between(chain, least, largest))


def roots_between(chain, low, high):
    """Roots in `(low, high]`."""
    count = variations(chain, low) - variations(chain, high)
    if count == 1:
        yield bisected(chain[0], low, high)
    elif count > 1:
        middle = halfway(low, high)
        yield from roots_between(chain, low, middle)
        yield from roots_between(chain, middle, high)


def bisected(p, low, high):
    """The only root, a simple one, in `(low, high]`, to `BITS` bits."""
    above = sign_at(p, high)
    while (high - low) * 2**BITS > high and above != 0:
        middle = halfway(low, high)
        sign = sign_at(p, middle)
        if sign in (above, 0):
            high, above = middle, sign
        else:
            low = middle
    return high


def halfway(low, high):
    """The middle; of bounds far apart, the power of two in the middle of their exponents."""
    if high < 64 * low:
        return (low + high) / 2
    exponents = sum(x.numerator.bit_length() - x.denominator.bit_length() for x in (low, high))
    return Fraction(2) ** (exponents // 2)


def sturm_chain(p):
    """`p, p', -(p mod p'), ...`, each with integer coefficients (a positive factor does not matter)."""
    chain = [p, derivative(p)]
    while chain[-1]:
        chain.append([-c for c in remainder(chain[-2], chain[-1])])
    return [integers(q) for q in chain[:-1]]


def variations(chain, x):
    """Sign changes of the chain at x, zeros left out."""
    signs = [s for s in (sign_at(p, x) for p in chain) if s]
    return sum(s != t for s, t in pairwise(signs))


def sign_at(p, x):
    """Sign of an integer polynomial at a fraction n/d, from `d^degree p(n/d)`."""
    value, power = 0, 1
    for c in reversed(p):
        value, power = value * x.numerator + c * power, power * x.denominator
    return (value > 0) - (value < 0)


def integers(p):
    denominator = lcm(*(c.denominator for c in p))
    return [int(c * denominator) for c in p]


def trimmed(p):
    return p[: max((k + 1 for k, c in enumerate(p) if c != 0), default=0)]


def derivative(p):
    return [k * c for k, c in enumerate(p)][1:]


def divided(p, q):
    """Quotient and remainder of polynomials."""
    p, result = list(p), [Fraction(0)] * max(len(p) - len(q) + 1, 1)
    while len(p) >= len(q):
        shift, factor = len(p) - len(q), p[-1] / q[-1]
        result[shift] = factor
        p = trimmed([c - factor * q[k - shift] if k >= shift else c for k, c in enumerate(p)][:-1])
    return result, p


def quotient(p, q):
    return divided(p, q)[0]


def remainder(p, q):
    return divided(p, q)[1]


def common_divisor(p, q):
    while q:
        p, q = q, remainder(p, q)
    return p


# The residual


def velocity(W, b, r):
    """`u = W r + b`."""
    return [
        sum((number(w) * number(c) for w, c in zip(row, r, strict=True)), number(s))
        for row, s in zip(W, b, strict=True)
    ]


def project_cone(x, mu):
    """The nearest point of `K_mu`: the tip, x itself, or a point of the ray `(1, mu d)` in the plane of x."""
    size = length(x[1:])
    if mu * size <= -x[0]:
        return [MP.mpf(0)] * 3
    if size <= mu * x[0]:
        return x
    along = (x[0] + mu * size) / (1 + mu**2)
    return [along, *(mu * along * c / size for c in x[1:])]


def residual(W, b, mu, r):
    """`‖sigma r - P_K(sigma r - ũ)‖ / ‖b‖`, absolute for b = 0, with `sigma = trace(W)/3`."""
    mu, sigma, u = number(mu), sum(number(W[k][k]) for k in range(3)) / 3, velocity(W, b, r)
    x = [sigma * number(c) for c in r]
    changed = [u[0] + mu * length(u[1:]), u[1], u[2]]
    p = project_cone([c - v for c, v in zip(x, changed, strict=True)], mu)
    return length([c - q for c, q in zip(x, p, strict=True)]) / (length(b) or 1)
