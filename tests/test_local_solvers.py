"""Local solvers: a table of solvers × a table of cases, and the mathematics they must obey."""

import math
from fractions import Fraction
from functools import cache

import numpy as np
import oracles
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fibercontact.local.alart_curnier import alart_curnier
from fibercontact.local.algebra import eliminate_normal, slip_impulse, solve3
from fibercontact.local.contract import SENTENCES, LocalSolver, Option, Status
from fibercontact.local.fischer_burmeister import modified_fischer_burmeister
from fibercontact.local.newton import Contact
from fibercontact.local.registry import configure, registered
from fibercontact.local.slip_quartic import closed_roots, companion_roots, slip_quartic
from fibercontact.local.slip_refinement import refine_slip

NEWTON = ["pac", "dac", "mfb"]
STEADY = ["enum-companion", "hybrid", "secular"]  # never fail on the condition numbers met here
EXACT = [*NEWTON, "enum-quartic", *STEADY]
PYRAMIDS = ["pyramid", "pyramid:facets=3", "pyramid:facets=7", "pyramid:facets=8", "pyramid:facets=16"]
ALL = EXACT + PYRAMIDS

HONEST = 2e-6
"""A claim of convergence is worth this residual, relative to b; the enumerative solvers ask for 1e-6."""

SEEDS = st.integers(0, 2**32 - 1)


@cache
def known():
    return registered()


@cache
def configured(name):
    return configure(name, known())


def triple(x):
    return tuple(float(c) for c in x)


def matrix(W):
    return tuple(triple(row) for row in W)


def solve(name, W, b, mu, r=(0.0, 0.0, 0.0)):
    """Status and impulse of one local solve."""
    c = configured(name)
    with np.errstate(all="ignore"):  # when interpreted, numpy speaks of NaN
        status, answer, iterations = c.kernel()(matrix(W), triple(b), float(mu), triple(r), c.options)
    assert iterations >= 0
    return Status(status), np.array(answer)


def residual(name, W, b, mu, r):
    """Residual of the solver's own law, relative to b."""
    return oracles.local_residual(W, b, mu, r, configured(name).facets) / (np.linalg.norm(b) or 1.0)


def contact(seed, largest_condition, mu=(0.0, 1.0)):
    """A random contact that is pressed together, of any condition number up to the largest."""
    rng = np.random.default_rng(seed)
    W = oracles.definite(rng, largest_condition ** rng.uniform())
    b = rng.standard_normal(3)
    b[0] = -abs(b[0]) * 10.0 ** rng.uniform(-3, 1)
    return W, b, rng.uniform(*mu), rng.standard_normal(3) * rng.integers(0, 2)


W_PLAIN = np.array([[2.0, 0.2, -0.1], [0.2, 1.0, 0.1], [-0.1, 0.1, 1.5]])
W_SPLIT = np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.3], [0.0, 0.3, 1.5]])  # normal and tangents uncoupled
W_BALL = 0.7 * np.eye(3)

# mu, r, u: solutions of Coulomb's law; b = u - W r. The friction is low enough for them to be the only ones.
KNOWN = {
    "open": (0.4, (0, 0, 0), (0.3, 0.5, -1)),
    "open at rest": (0.4, (0, 0, 0), (0.3, 0, 0)),
    "grazing": (0.4, (0, 0, 0), (0, 0.5, -1)),
    "nothing": (0.4, (0, 0, 0), (0, 0, 0)),
    "stick": (0.4, (1, 0.1, -0.2), (0, 0, 0)),
    "stick without a tangential load": (0.4, (1, 0, 0), (0, 0, 0)),
    "stick on the edge of the cone": (0.5, (2, 0.6, 0.8), (0, 0, 0)),
    "slip": (0.5, (2, 0.6, -0.8), (0, -3, 4)),
    "hardly slip": (0.5, (2, 0.6, 0.8), (0, -3e-9, -4e-9)),
    "slip along T1": (0.5, (2, -1, 0), (0, 0.1, 0)),
    "little friction": (1e-4, (2, 1.2e-4, 1.6e-4), (0, -3, -4)),
    "no friction, pressed": (0.0, (2, 0, 0), (0, 3, 4)),
    "no friction, pressed straight": (0.0, (2, 0, 0), (0, 0, 0)),
    "no friction, open": (0.0, (0, 0, 0), (1, 3, 4)),
}


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("W", [W_PLAIN, W_SPLIT, W_BALL], ids=["coupled", "uncoupled", "isotropic"])
@pytest.mark.parametrize("case", KNOWN)
def test_known_answers(name, W, case):
    mu, r, u = KNOWN[case]
    b = np.array(u, dtype=float) - W @ r
    status, answer = solve(name, W, b, mu)
    assert status == Status.CONVERGED
    tolerance = 1e-6 if name == "enum-quartic" or "edge" in case or "hardly" in case else 1e-7
    np.testing.assert_allclose(answer, r, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("b_N", [0.0, -0.0])
def test_a_contact_that_does_not_approach_is_left_alone(name, b_N):
    for b_T in ((0.0, 0.0), (-0.0, 0.0), (1.0, -2.0)):
        status, answer = solve(name, W_PLAIN, (b_N, *b_T), 0.4)
        assert status == Status.CONVERGED
        assert np.abs(answer).max() <= 1e-7


@pytest.mark.parametrize("name", EXACT)
@given(
    st.floats(0.01, 5), st.floats(0.1, 10), st.floats(0, 2 * np.pi), st.floats(0.01, 3), st.floats(0.01, 100)
)
def test_closed_form_of_isotropic_slip(name, mu, load, angle, speed, s):
    """With `W = sI`: `r_N = -b_N/s`, and `r_T` against `b_T`, as long as the cone allows, at most what stops it."""
    d = np.array([np.cos(angle), np.sin(angle)])
    assume(abs(speed - mu * load) > 1e-3)
    status, answer = solve(name, s * np.eye(3), (-load, *(speed * d)), mu)
    assert status == Status.CONVERGED
    expected = np.array([load, *(-min(mu * load, speed) * d)]) / s
    np.testing.assert_allclose(s * answer, s * expected, rtol=0, atol=HONEST * max(load, speed))


@pytest.mark.parametrize("name", [*PYRAMIDS, "pac:disc=1", "dac:disc=1", "pac:rho=0.3", "dac:rho=3"])
@given(SEEDS)
def test_a_claim_of_convergence_is_true(name, seed):
    """Whatever the condition number (up to 1e6) and the start, for friction up to 10: no lying.

    The exact solvers as they come are in test_local_theorems.
    """
    W, b, mu, r = contact(seed, 1e6, (0.0, 10.0))
    status, answer = solve(name, W, b, mu, r)
    if status == Status.CONVERGED:
        assert residual(name, W, b, mu, answer) <= HONEST
        assert answer[0] >= 0


@pytest.mark.parametrize("name", ["enum-companion", *PYRAMIDS])
@given(SEEDS)
def test_steady_solvers_never_fail(name, seed):
    W, b, mu, r = contact(seed, 1e6, (0.0, 10.0))
    status, answer = solve(name, W, b, mu, r)
    assert status == Status.CONVERGED
    assert residual(name, W, b, mu, answer) <= 1e-6


@given(SEEDS)
def test_secular_is_as_accurate_as_its_condition_number_allows(seed):
    W, b, mu, r = contact(seed, 1e6, (0.0, 10.0))
    _, answer = solve("secular", W, b, mu, r)
    assert residual("secular", W, b, mu, answer) <= 1e-10 + 1e-13 * np.linalg.cond(W)


@pytest.mark.parametrize("name", [*NEWTON, "enum-quartic"])
def test_the_others_seldom_fail_on_kind_contacts(name):
    """Condition numbers up to 10 and little friction: one failure in fifty at most."""
    contacts = [contact(seed, 10.0, (0.0, 0.5)) for seed in range(150)]
    failures = sum(solve(name, *c)[0] != Status.CONVERGED for c in contacts)
    assert failures <= 3


@pytest.mark.parametrize("name", PYRAMIDS)
@given(SEEDS, st.integers(1, 16))
def test_pyramids_turn_by_their_own_symmetry(name, seed, k):
    W, b, mu, _ = contact(seed, 10.0, (0.0, 0.5))
    Q = oracles.turned(2 * np.pi * k / configured(name).facets)
    r, turned = solve(name, W, b, mu)[1], solve(name, Q @ W @ Q.T, Q @ b, mu)[1]
    np.testing.assert_allclose(turned, Q @ r, rtol=0, atol=1e-7 * np.abs(r).max())


@pytest.mark.parametrize("name", ALL)
@given(SEEDS, st.integers(-40, 40), st.integers(-40, 40))
def test_answers_have_no_unit(name, seed, s, t):
    """`W → sW` gives `r/s`, `b → tb` gives `tr`: bit for bit when s and t are powers of two (to 1e±12)."""
    W, b, mu, r0 = contact(seed, 1e3)
    s, t = 2.0**s, 2.0**t
    status, r = solve(name, W, b, mu, r0)
    scaled_status, scaled = solve(name, s * W, t * b, mu, r0 * (t / s))
    assert scaled_status == status
    np.testing.assert_array_equal(scaled * (s / t), r)


@pytest.mark.parametrize("name", ALL)
@given(SEEDS)
def test_the_same_input_gives_the_same_answer(name, seed):
    W, b, mu, r = contact(seed, 1e6, (0.0, 10.0))
    np.testing.assert_array_equal(solve(name, W, b, mu, r)[1], solve(name, W, b, mu, r)[1])


@pytest.mark.parametrize("name", ALL)
@given(SEEDS)
def test_the_solution_as_a_start_is_kept(name, seed):
    W, b, mu, _ = contact(seed, 10.0, (0.0, 0.5))
    status, r = solve(name, W, b, mu)
    assume(status == Status.CONVERGED)
    status, again = solve(name, W, b, mu, r)
    assert status == Status.CONVERGED
    np.testing.assert_allclose(W @ again, W @ r, rtol=0, atol=1e-5 * np.linalg.norm(b))


# ---- data at the edge


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("rank", [1, 2])
@given(seed=SEEDS)
def test_a_singular_contact_within_reach_is_solved_honestly(name, rank, seed):
    """A straight fibre cannot move along itself: `W` has rank 2, or 1, and b lies in its range."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, rank))
    W, b, mu = A @ A.T, A @ rng.standard_normal(rank), rng.uniform(0, 2)
    assume(W[0, 0] > 1e-3 * np.trace(W))
    status, answer = solve(name, W, b, mu)
    if name not in NEWTON and not (rank == 2 and name == "enum-quartic"):
        assert status == Status.CONVERGED
    if status == Status.CONVERGED:
        assert residual(name, W, b, mu, answer) <= HONEST


@pytest.mark.parametrize("name", ALL)
@given(seed=SEEDS)
def test_a_singular_contact_out_of_reach_is_not_claimed_stuck(name, seed):
    """Rank 2 and a velocity that no impulse can change: it slips, or has no solution."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 2))
    W, b, mu = A @ A.T, rng.standard_normal(3), rng.uniform(0, 2)
    status, answer = solve(name, W, b, mu)
    if status == Status.CONVERGED:
        assert residual(name, W, b, mu, answer) <= HONEST


def test_a_straight_fibre_dragged_along_itself_slips():
    """`W` does nothing along T2, along which the obstacle moves: full friction, sliding speed unchanged."""
    W, b = np.diag([2.0, 1.0, 0.0]), np.array([-2.0, 0.0, 3.0])
    for name in ["enum-companion", "enum-quartic", "hybrid", "secular", "mfb"]:
        status, r = solve(name, W, b, 0.5)
        assert status == Status.CONVERGED, name
        np.testing.assert_allclose(r, [1.0, 0.0, -0.5], atol=1e-6, err_msg=name)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("b_N", [-1.0, 1.0])
def test_data_that_are_not_finite_are_never_solved(name, value, b_N):
    for at in range(10):
        W, b, mu = W_PLAIN.copy(), np.array([b_N, 2.0, 0.5]), 0.5
        if at < 6:
            i, j = np.triu_indices(3)[0][at], np.triu_indices(3)[1][at]
            W[i, j] = W[j, i] = value
        elif at < 9:
            b[at - 6] = value
        else:
            mu = value
        assert solve(name, W, b, mu)[0] != Status.CONVERGED, at


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_start_that_is_not_finite_does_no_harm(name, value):
    for at in range(3):
        start = np.array([1.0, 0.2, -0.1])
        start[at] = value
        status, r = solve(name, W_PLAIN, (-1.0, 2.0, 0.5), 0.5, start)
        assert (
            status != Status.CONVERGED or residual(name, W_PLAIN, np.array([-1.0, 2.0, 0.5]), 0.5, r) < HONEST
        )


# ---- the linearised law


@given(SEEDS)
def test_pyramids_tend_to_coulomb_as_their_facets_grow(seed):
    """A vertex attracts all directions within `pi/m`: the velocity of a well-posed slip is off by as much."""
    W, b, mu, _ = contact(seed, 3.0, (0.1, 0.4))
    exact = solve("secular", W, b, mu)[1]
    speed = np.linalg.norm((W @ exact + b)[1:])
    assume(speed > 0.1 * np.linalg.norm(b))
    for m in (16, 64, 256):
        error = np.linalg.norm(W @ (solve(f"pyramid:facets={m}", W, b, mu)[1] - exact))
        assert error <= 3 * np.pi / m * mu * exact[0] * np.linalg.norm(W)


def test_mean_error_of_pyramids_falls_with_their_facets():
    """Observed over random slips: the error falls in proportion to 1/m."""
    errors = []
    for m in (8, 16, 32, 64, 128):
        gaps = []
        for seed in range(60):
            W, b, mu, _ = contact(seed, 3.0, (0.1, 0.4))
            exact = solve("secular", W, b, mu)[1]
            gaps.append(
                np.linalg.norm(W @ (solve(f"pyramid:facets={m}", W, b, mu)[1] - exact)) / np.linalg.norm(b)
            )
        errors.append(np.mean(gaps))
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert rates.min() > 0.7
    assert rates.mean() > 0.9


@pytest.mark.parametrize("facets", [3, 4, 8, 16])
def test_pyramid_along_a_vertex_is_coulomb_along_a_facet_it_is_weaker(facets):
    """With `W = I`, sliding against a vertex meets friction mu, against a facet `mu cos(pi/m)`."""
    mu, name = 0.4, f"pyramid:facets={facets}"
    for angle, expected in ((0.0, mu), (np.pi / facets, mu * np.cos(np.pi / facets))):
        d = np.array([np.cos(angle), np.sin(angle)])
        status, r = solve(name, np.eye(3), (-1.0, *(-5 * d)), mu)
        assert status == Status.CONVERGED
        assert r[1:] @ d == pytest.approx(expected)


# ---- the pieces


def smooth_contact(seed):
    """A contact and an impulse away from the kinks of both functions."""
    rng = np.random.default_rng(seed)
    return (
        oracles.definite(rng, 20.0),
        rng.standard_normal(3),
        rng.uniform(0.1, 2),
        2 * rng.standard_normal(3),
    )


@pytest.mark.parametrize(
    "function", [alart_curnier, modified_fischer_burmeister], ids=["alart-curnier", "mfb"]
)
@given(seed=SEEDS, rho=st.sampled_from([0.3, 1.0, 3.0]), disc=st.sampled_from([0.0, 1.0]))
def test_jacobians_are_the_finite_differences(function, seed, rho, disc):
    W, b, mu, r = smooth_contact(seed)
    c = Contact(matrix(W), triple(b), mu, rho, disc)

    def f(x):
        return np.array(function(c, triple(x))[0])

    fine, coarse = (oracles.finite_differences(f, r, h) for h in (1e-6, 4e-6))
    assume(np.abs(fine - coarse).max() < 1e-6)  # a kink, or nearly one
    np.testing.assert_allclose(np.array(function(c, triple(r))[1]), fine, rtol=0, atol=2e-5)


@pytest.mark.parametrize("regime", ["open", "stick", "slip"])
def test_jacobian_of_alart_curnier_in_each_regime(regime):
    b = {"open": (5.0, 1.0, 1.0), "stick": (-5.0, 0.1, 0.1), "slip": (-5.0, 30.0, -20.0)}[regime]
    c = Contact(matrix(W_PLAIN), b, 0.5)
    r = np.array([0.1, 0.2, 0.3])
    differences = oracles.finite_differences(lambda x: np.array(alart_curnier(c, triple(x))[0]), r)
    np.testing.assert_allclose(np.array(alart_curnier(c, triple(r))[1]), differences, atol=1e-8)


@pytest.mark.parametrize(
    "function", [alart_curnier, modified_fischer_burmeister], ids=["alart-curnier", "mfb"]
)
@pytest.mark.parametrize("case", [c for c in KNOWN if not c.startswith("no ")])
def test_functions_vanish_exactly_at_solutions(function, case):
    mu, r, u = KNOWN[case]
    b = np.array(u, dtype=float) - W_PLAIN @ r
    f, _ = function(Contact(matrix(W_PLAIN), triple(b), mu), triple(r))
    np.testing.assert_allclose(f, 0, atol=1e-7)  # square roots of rounding
    f, _ = function(Contact(matrix(W_PLAIN), triple(b), mu), triple(np.add(r, (0.3, -0.2, 0.4))))
    assert np.linalg.norm(f) > 1e-6


@given(SEEDS)
def test_elimination_of_the_normal_impulse(seed):
    """At any alpha: no normal velocity, and a sliding velocity of `-alpha r_T`."""
    W, b, _, _ = contact(seed, 1e3)
    t = eliminate_normal(matrix(W), triple(b))
    for alpha in (0.0, 1e-3, 1.0, 1e3):
        r = np.array(slip_impulse(t, alpha))
        np.testing.assert_allclose(
            r, oracles.slip_impulse(W, b, alpha), rtol=1e-9, atol=1e-9 * np.abs(r).max()
        )


@given(SEEDS)
def test_quartic_vanishes_at_the_slips_of_the_scan(seed):
    W, b, mu, _ = contact(seed, 30.0, (0.05, 1.0))
    t = eliminate_normal(matrix(W), triple(b))
    coefficients = np.array(slip_quartic(t, mu))
    for r in oracles.coulomb_solutions(W, b, mu):
        u = W @ r + b
        alpha = -(u[1:] @ r[1:]) / max(r[1:] @ r[1:], 1e-300)
        if alpha > 1e-3:
            terms = coefficients * (alpha / t.trace) ** np.arange(4, -1, -1)
            assert abs(terms.sum()) <= 1e-9 * np.abs(terms).max()


def distance_of_sets(a, b):
    """Largest distance from a root of one set to the other set, each root used once, greedily."""
    left, worst = list(b), 0.0
    for x in a:
        k = int(np.argmin(np.abs(np.array(left) - x)))
        worst = max(worst, abs(left.pop(k) - x))
    return worst


@pytest.mark.parametrize("roots", [closed_roots, companion_roots], ids=["closed", "companion"])
@given(st.lists(st.floats(-3, 3), min_size=4, max_size=4), st.booleans(), st.booleans())
def test_roots_are_those_of_numpy(roots, parts, first_pair, second_pair):
    """Real and complex pairs; apart by 0.1 at least, for a k-fold root is known to the k-th root of eps only."""
    a, b, c, d = parts
    wanted = [complex(a, b), complex(a, -b)] if first_pair else [a, b]
    wanted += [complex(c, d), complex(c, -d)] if second_pair else [c, d]
    assume(min(abs(wanted[i] - wanted[j]) for i in range(4) for j in range(i)) > 0.1)
    polynomial = tuple(float(x) for x in 2.5 * np.real(np.poly(wanted)))
    found, computed = roots(polynomial)
    assert found
    assert distance_of_sets(computed, np.roots(polynomial)) <= 1e-4
    assert distance_of_sets(computed, wanted) <= 1e-4


@pytest.mark.parametrize("roots", [closed_roots, companion_roots], ids=["closed", "companion"])
def test_roots_of_special_quartics(roots):
    for wanted in ((1, -1, 2, -2), (0, 0, 1, -1), (1, 1, 1, 1), (1j, -1j, 2j, -2j), (0, 0, 0, 0)):
        found, computed = roots(tuple(float(x) for x in np.real(np.poly(wanted))))
        assert found
        assert distance_of_sets(computed, np.array(wanted, dtype=complex)) <= 1e-3
    assert not roots((0.0, 1.0, 2.0, 3.0, 4.0))[0]
    assert not roots((math.nan, 1.0, 2.0, 3.0, 4.0))[0]


@given(st.floats(-3, 3), st.floats(-3, 3), st.sampled_from([2, 3]))
def test_closed_roots_bear_multiple_roots(a, b, multiplicity):
    """The resolvent's root is multiple too: known to eps^(1/3), the quartic's by its square root then."""
    assume(max(abs(a), abs(b)) > 1e-3)
    wanted = [a] * multiplicity + [b, -b][: 4 - multiplicity]
    found, computed = closed_roots(tuple(float(x) for x in np.poly(wanted)))
    assert found
    assert distance_of_sets(computed, wanted) <= 0.02 * max(np.abs(wanted))


@given(SEEDS, st.floats(-8, -3))
def test_a_slip_that_is_off_is_brought_back(seed, decades):
    W, b, mu, _ = contact(seed, 1e3, (0.05, 1.0))
    r = solve("secular", W, b, mu)[1]
    u = W @ r + b
    assume(np.linalg.norm(u[1:]) > 1e-2 * np.linalg.norm(b))
    off = r * (1 + 10**decades * np.array([1.0, -1.0, 0.5]))
    t = eliminate_normal(matrix(W), triple(b))
    claimed, refined = refine_slip(matrix(W), triple(b), mu, t, triple(off))
    assert claimed == pytest.approx(
        residual("secular", W, b, mu, np.array(refined)) * np.linalg.norm(b), rel=0.1
    )
    assert claimed <= 1e-5 * residual("secular", W, b, mu, off) * np.linalg.norm(b) + 1e-11 * np.linalg.norm(
        b
    )


@pytest.mark.parametrize("name", ["hybrid", "secular"])
def test_an_answer_much_larger_than_b_is_found(name):
    """`sigma r = 1e9 |b|`: the impulse lies along the weak axis of W, and rounding eats the elimination's digits."""
    r, mu, condition = np.array([1.0, 0.3, -0.4]), 0.5, 2.0**30
    projector = np.outer(r, r) / (r @ r)
    W = np.eye(3) - (1 - 1 / condition) * projector
    W = 0.5 * (W + W.T)
    exact = np.array([[Fraction(x) for x in row] for row in W]) @ np.array([Fraction(x) for x in r])
    b = np.array([0.0, -0.3, 0.4]) / condition - np.array([float(x) for x in exact])
    status, answer = solve(name, W, b, mu)
    assert status == Status.CONVERGED
    assert residual(name, W, b, mu, answer) <= HONEST + 1e-15 * condition
    np.testing.assert_allclose(answer, r, rtol=1e-5)


@given(SEEDS)
def test_three_equations_are_solved_as_numpy_solves_them(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((3, 3)) * rng.integers(0, 2, (3, 3))
    b = rng.standard_normal(3)
    regular, x = solve3(matrix(A), triple(b))
    if abs(np.linalg.det(A)) > 1e-6:
        assert regular
        np.testing.assert_allclose(A @ x, b, atol=1e-7)
    elif np.linalg.matrix_rank(A) < 3 and not np.linalg.det(A):
        assert not regular or np.linalg.norm(x) > 1e8


# ---- declarations


def test_every_status_has_its_sentence():
    assert set(SENTENCES) == set(Status)
    assert len(set(SENTENCES.values())) == len(Status)


@pytest.mark.parametrize(
    "name", ["pac", "dac", "mfb", "enum-quartic", "enum-companion", "hybrid", "secular", "pyramid"]
)
def test_every_solver_declares_itself(name):
    entry = known()[name]
    assert entry.summary.endswith(".")
    assert "Reference" in entry.documentation
    assert all(option.meaning for option in entry.solver.options.values())


def test_options_are_passed_in_declared_order():
    solver = LocalSolver(None, {"a": Option(1.0, "one"), "b": Option(2.0, "two")})
    np.testing.assert_array_equal(solver.option_values({"b": 5.0}), [1.0, 5.0])
    with pytest.raises(ValueError, match=r"unknown option 'c' \(known: a, b\)"):
        solver.option_values({"c": 1.0})


def test_options_are_obeyed():
    """One iteration is not enough for Newton; a loose tolerance is met sooner than a tight one."""
    b = np.array([-1.0, 2.0, 0.5])
    assert solve("mfb:max_iterations=1", W_PLAIN, b, 0.5)[0] == Status.ITERATIONS
    loose = residual("mfb:tolerance=0.01", W_PLAIN, b, 0.5, solve("mfb:tolerance=0.01", W_PLAIN, b, 0.5)[1])
    assert 1e-9 < loose < 0.1
