"""The 50-digit oracle of one contact, against what is known exactly and against the scan in doubles."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import oracle_mp
import oracles
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from oracle_mp import coulomb_solutions, positive_roots, residual

SEEDS = st.integers(0, 2**32 - 1)
FEW_DIGITS = st.integers(-64, 64).map(lambda k: k / 8)
DIGITS = 1e-40

# In the plane of N and T1, where mu |W_TN| > W_NN: pressing harder against friction pushes the contact apart.
JAMMING = [[1, 2, 0], [2, 5, 0], [0, 0, 1]]


def random_contact(seed, condition=1e6, mu=10.0):
    rng = np.random.default_rng(seed)
    W = oracles.definite(rng, condition ** rng.uniform()) * 10.0 ** rng.uniform(-12, 12)
    return W, rng.standard_normal(3) * 10.0 ** rng.uniform(-12, 12), mu * rng.random()


def floats(solution):
    return [float(c) for c in solution.r]


# ---- what is known exactly


@pytest.mark.parametrize(
    ("W", "b", "mu", "expected"),
    [
        (np.eye(3), (1, 5, 0), 0.5, [("take-off", 0, (0, 0, 0))]),
        (np.eye(3), (0, 5, 0), 0.5, [("take-off", 0, (0, 0, 0))]),
        (np.eye(3), (0, 0, 0), 0.5, [("take-off", 0, (0, 0, 0))]),
        (np.eye(3), (-2, 0, 1), 0.5, [("stick", 0, (2, 0, -1))]),  # on the edge of the cone
        (np.eye(3), (-2, 0, 3), 0.5, [("slip", 2, (2, 0, -1))]),
        (np.eye(3), (-2, 3, 4), 2.5, [("stick", 0, (2, -3, -4))]),
        (np.eye(3), (-2, 30, 40), 2.5, [("slip", 9, (2, -3, -4))]),
        (np.diag([2.0, 1.0, 3.0]), (-4, 0, 12), 1.5, [("slip", 1, (2, 0, -3))]),
        (np.eye(3), (-2, 3, 4), 0.0, [("slip", 0, (2, 0, 0))]),  # no friction: a matter of the normal alone
        (np.eye(3), (2, 3, 4), 0.0, [("take-off", 0, (0, 0, 0))]),
        (JAMMING, (0, 4, 0), 1.0, [("take-off", 0, (0, 0, 0)), ("stick", 0, (8, -4, 0))]),
        (JAMMING, (1, 3, 0), 1.0, [("take-off", 0, (0, 0, 0)), ("stick", 0, (1, -1, 0))]),
        (
            JAMMING,
            (1, 4, 0),
            1.0,
            [("take-off", 0, (0, 0, 0)), ("stick", 0, (3, -2, 0)), ("slip", 1, (1, -1, 0))],
        ),
    ],
)
def test_solutions_found_by_hand(W, b, mu, expected):
    found = coulomb_solutions(W, b, mu)
    assert [s.regime for s in found] == [regime for regime, _, _ in expected]
    for solution, (_, alpha, r) in zip(found, expected, strict=True):
        assert abs(solution.alpha - alpha) <= DIGITS
        assert max(abs(c - v) for c, v in zip(solution.r, r, strict=True)) <= DIGITS


THREE = {
    "approaching 63": ["stick", "slip", "slip"],
    "approaching 121": ["stick", "slip", "slip"],
    "approaching 136": ["stick", "slip", "slip"],
    "parting": ["take-off", "slip", "slip"],
}


@pytest.mark.parametrize("case", THREE)
def test_three_solutions_of_one_contact(case):
    """Strong coupling and friction; the scan in doubles sees them too."""
    if case == "parting":
        W, b, mu = (
            np.array([[1.0, 3.0, 0.0], [3.0, 12.0, 0.0], [0.0, 0.0, 1.0]]),
            np.array([0.5, 3.0, 1.0]),
            1.0,
        )
    else:
        rng = np.random.default_rng(int(case.split()[1]))
        b = rng.standard_normal(3)
        b[0], W, mu = -abs(b[0]), oracles.definite(rng, 100.0), rng.uniform(1, 10)
    found, scanned = coulomb_solutions(W, b, mu), oracles.coulomb_solutions(W, b, mu)
    assert [s.regime for s in found] == THREE[case]
    np.testing.assert_allclose(scanned, [floats(s) for s in found], rtol=1e-9)


@given(st.lists(st.integers(-6, 6), min_size=1, max_size=4), st.integers(1, 9))
def test_positive_roots_of_products(roots, leading):
    """Integer roots of any multiplicity, each once."""
    p = [Fraction(leading)]
    for root in roots:
        p = oracle_mp.product(p, [Fraction(-root), Fraction(1)])
    found = positive_roots(p)
    assert len(found) == len({r for r in roots if r > 0})
    assert all(
        abs(x - r) < 2.0**-260 for x, r in zip(found, sorted({r for r in roots if r > 0}), strict=True)
    )


def test_positive_roots_of_special_polynomials():
    assert positive_roots([Fraction(0)] * 5) == []
    assert positive_roots([Fraction(3)]) == []
    assert positive_roots([Fraction(1), Fraction(0), Fraction(1)]) == []
    (root,) = positive_roots([Fraction(-2), Fraction(0), Fraction(1)])
    assert abs(oracle_mp.number(root) - oracle_mp.MP.sqrt(2)) < 1e-79
    far = positive_roots(
        oracle_mp.product([Fraction(-1, 10**300), Fraction(1)], [Fraction(-(10**300)), Fraction(1)])
    )
    assert [float(x) for x in far] == [1e-300, 1e300]
    near = positive_roots(
        oracle_mp.product([Fraction(-1), Fraction(1)], [Fraction(-1) - Fraction(1, 10**60), Fraction(1)])
    )
    assert len(near) == 2


@pytest.mark.parametrize(
    "W",
    [
        np.diag([1.0, 1.0, 0.0]),
        -np.eye(3),
        [[1, 2, 0], [2, 4, 0], [0, 0, 1]],
        [[1, 1, 0], [0, 1, 0], [0, 0, 1]],
    ],
)
def test_a_singular_or_asymmetric_W_is_refused(W):
    with pytest.raises(ValueError, match="symmetric positive definite"):
        coulomb_solutions(W, (-1, 0, 0), 0.5)


@pytest.mark.parametrize("mu", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("sigma", [0.25, 1.0, 8.0])
def test_the_natural_map_vanishes_at_solutions_and_nowhere_else(mu, sigma):
    """`W = sigma I`; the size at the others by hand: an impulse or a velocity that ought not to be there."""
    W, r = sigma * np.eye(3), np.array([2.0, 1.2 * mu, -1.6 * mu])
    lawful = [
        ((0, 0, 0), r),
        ((0, -3, 4), r),
        ((0, 0, 0), r * [1, 0.5, 0.5]),
        ((1, 2, 3), 0 * r),
        ((0, 2, 3), 0 * r),
    ]
    for u, impulse in lawful:
        if mu > 0 or u[0] == 0 or not impulse.any():
            assert residual(W, u - W @ impulse, mu, impulse) <= 1e-15
    for u, impulse, size in [
        ((-1, 0, 0), 0 * r, 1.0),
        ((0.1, 0, 0), r * [1, 0, 0], 0.1),
        ((0, 0, 0), -r * [1, 0, 0], 2 * sigma),
    ]:
        b = u - W @ impulse
        assert float(residual(W, b, mu, impulse) * oracle_mp.length(b)) == pytest.approx(size)


# ---- theorems


@settings(max_examples=40)
@given(SEEDS)
def test_the_law_holds_to_forty_digits(seed):
    """Each solution obeys each clause of Coulomb's law, and the natural map vanishes at it."""
    W, b, mu = random_contact(seed)
    size = oracle_mp.length(b)
    for s in coulomb_solutions(W, b, mu):
        u, friction = oracle_mp.velocity(W, b, s.r), oracle_mp.length(s.r[1:])
        assert residual(W, b, mu, s.r) <= DIGITS
        if s.regime == "take-off":
            assert s.r == [0, 0, 0]
            assert u[0] >= 0
            continue
        assert s.r[0] > 0
        assert abs(u[0]) <= DIGITS * size
        if s.regime == "stick":
            assert oracle_mp.length(u) <= DIGITS * size
            assert friction <= mu * s.r[0] * (1 + DIGITS)
        else:
            assert s.alpha > 0
            assert abs(friction - mu * s.r[0]) <= DIGITS * mu * s.r[0]
            assert (
                max(abs(v + oracle_mp.number(s.alpha) * c) for v, c in zip(u[1:], s.r[1:], strict=True))
                <= DIGITS * size
            )


@settings(max_examples=40)
@given(SEEDS)
def test_a_solution_exists(seed):
    """For SPD `W` and any mu >= 0 there is one: `W z + b` covers the interior of `K_mu*` [Acary et al. 2011]."""
    assert coulomb_solutions(*random_contact(seed, 1e14, 100.0))


@settings(max_examples=40)
@given(SEEDS)
def test_it_is_the_only_one_for_little_friction(seed):
    """Unique when `mu² lambda_max(W_TT) (W⁻¹)_NN < 1`: then `s ↦ ‖u_T(s)‖` is a contraction.

    For two slip terms s and s', optimality of the convex problems gives, with `d = r(s) - r(s')`,
    `dᵀWd <= -mu (s - s') d_N <= mu |s - s'| sqrt((W⁻¹)_NN) sqrt(dᵀWd)`, and `‖(Wd)_T‖² <= lambda_max(W_TT) dᵀWd`.
    """
    W, b, _ = random_contact(seed)
    limit = 1 / np.sqrt(np.linalg.eigvalsh(W[1:, 1:])[-1] * np.linalg.inv(W)[0, 0])
    for mu in (0.0, 0.1 * limit, 0.99 * limit):
        assert len(coulomb_solutions(W, b, mu)) == 1


@settings(max_examples=40)
@given(SEEDS)
def test_an_approaching_contact_has_an_odd_number_of_solutions(seed):
    """`b_N < 0`: `phi` ends negative; it begins negative where the contact sticks, positive where it does not."""
    W, b, mu = random_contact(seed, 100.0)
    assert len(coulomb_solutions(W, [-abs(b[0]), b[1], b[2]], mu)) % 2 == 1


@settings(max_examples=40)
@given(SEEDS, st.integers(-100, 100), st.integers(-100, 100))
def test_solutions_scale(seed, s, t):
    """`W → sW`, `b → tb`: the solutions are those of before, times t/s; exactly, for powers of two."""
    W, b, mu = random_contact(seed)
    s, t = 2.0**s, 2.0**t
    before, after = coulomb_solutions(W, b, mu), coulomb_solutions(s * W, t * b, mu)
    assert [x.regime for x in after] == [x.regime for x in before]
    for x, y in zip(before, after, strict=True):
        assert oracle_mp.length(
            [c * s / t - d for c, d in zip(y.r, x.r, strict=True)]
        ) <= DIGITS * oracle_mp.length(x.r)


# ---- the slow references in doubles


@settings(max_examples=40)
@given(SEEDS)
def test_the_scan_finds_the_same_solutions(seed):
    W, b, mu = random_contact(seed, 100.0, 2.0)
    exact, scanned = coulomb_solutions(W, b, mu), oracles.coulomb_solutions(W, b, mu)
    alphas = [float(s.alpha) / np.trace(W) for s in exact if s.regime == "slip"]
    assume(all(1e-8 < a < 1e8 for a in alphas) and all(q > 1.1 * p for p, q in pairwise(alphas)))
    assert len(exact) == len(scanned)
    for s, r in zip(exact, scanned, strict=True):
        np.testing.assert_allclose(r, floats(s), rtol=0, atol=1e-9 * np.linalg.norm(floats(s)))


@given(SEEDS)
def test_the_residual_is_that_of_doubles(seed):
    W, b, mu = random_contact(seed)
    r = np.random.default_rng(seed).standard_normal(3) * np.linalg.norm(b) / np.trace(W)
    expected = oracles.local_residual(W, b, mu, r) / np.linalg.norm(b)
    assert float(residual(W, b, mu, r)) == pytest.approx(expected, rel=1e-9)
