"""The re-check of certificates: small problems both ways, and exact arithmetic that it must never exceed."""

import ast
import math
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import oracles
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import bsr_array, coo_array, csc_matrix

from fibercontact.reference import recheck
from fibercontact.reference.recheck import solvable_slack, unsolvable_radius

SEEDS = st.integers(0, 2**32 - 1)
NUMBERS = st.one_of(
    st.floats(-4, 4),
    st.integers(-3, 3).map(float),
    st.floats(-1e12, 1e12),
    st.floats(-1e-290, 1e-290),
    st.floats(allow_nan=False, allow_infinity=False),
)
FRICTION = st.one_of(st.sampled_from([0.0, 0.5, 1.0, 100.0]), st.floats(0, 1e3))

# A mass between two walls: the normals are opposite, an impulse at one is an impulse against the other.
MASS = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
CLOSING = np.array([-1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
PASSING = np.array([-1.0, 0.0, 0.0, 2.0, 0.0, 0.0])
BOTH = np.array([1.0, 0.0, 0.0, 1.0, 0.0, 0.0])


def test_it_imports_nothing_of_the_package():
    """The makers of certificates cannot share a line with it."""
    tree = ast.parse(Path(recheck.__file__).read_text("utf-8"))
    froms = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.level]
    assert {name.split(".")[0] for name in froms | names} <= {"fractions", "typing", "numpy", "scipy"}


# ---- exact arithmetic


def exactly(W, z, b):
    """`W z + b` as fractions."""
    return [
        sum((Fraction(w) * Fraction(x) for w, x in zip(row, z, strict=True)), Fraction(c))
        for row, c in zip(W.tolist(), b.tolist(), strict=True)
    ]


def length(x):
    """Norm of fractions, to 60 digits whatever their exponents."""
    return mpmath.sqrt(sum((number(c) ** 2 for c in x), mpmath.mpf(0)))


def number(x):
    return mpmath.mpf(x.numerator) / x.denominator


def root_mean_square(lengths):
    return mpmath.sqrt(sum(x**2 for x in lengths) / len(lengths))


def triples(x):
    return [x[k : k + 3] for k in range(0, len(x), 3)]


def exact_slack(W, b, mu, z):
    """`min_i (u_N,i - mu_i ‖u_T,i‖)` and `b_ref`, in 60 digits."""
    slacks = [
        number(u[0]) - number(Fraction(m)) * length(u[1:])
        for u, m in zip(triples(exactly(W, z, b)), mu, strict=True)
    ]
    return min(slacks), root_mean_square([length(c) for c in triples([Fraction(c) for c in b])])


def exact_radius(W, b, r):
    """The theorem's radius over `b_ref`, in 60 digits; infinite where `W r` vanishes, 0 for no certificate."""
    gain = -sum(Fraction(x) * Fraction(y) for x, y in zip(b, r, strict=True))
    if gain <= 0 or (r[::3] < 0).any() or r[1::3].any() or r[2::3].any():
        return mpmath.mpf(0)
    sigma = [sum(Fraction(d) for d in three) / 3 for three in triples(np.diag(W))]
    g = [length(x) for x in triples(exactly(W.T, r, np.zeros(len(b))))]
    if not any(g):
        return mpmath.inf
    if any(x and s <= 0 for x, s in zip(g, sigma, strict=True)):
        return mpmath.mpf(0)
    dual = root_mean_square([x / number(s) if x else x for x, s in zip(g, sigma, strict=True)]) * len(g)
    return number(gain) / dual / root_mean_square([length(c) for c in triples([Fraction(c) for c in b])])


@st.composite
def problems(draw):
    """Any finite `W`, b, mu and a candidate of one to three contacts; `W` is symmetric with a diagonal >= 0."""
    n = draw(st.integers(1, 3))
    numbers = draw(st.lists(NUMBERS, min_size=9 * n * n + 6 * n, max_size=9 * n * n + 6 * n))
    W = np.tril(np.reshape(numbers[: 9 * n * n], (3 * n, 3 * n)))
    W = W + np.tril(W, -1).T
    np.fill_diagonal(W, np.abs(np.diag(W)))
    b, z = np.reshape(numbers[9 * n * n :], (2, 3 * n))
    return W, b, np.array(draw(st.lists(FRICTION, min_size=n, max_size=n))), z


@given(problems())
def test_the_slack_is_never_more_than_the_exact_one(problem):
    """Rounding never accepts: the returned slack is at most that of exact arithmetic, for any doubles."""
    with mpmath.workdps(60):
        slack, scale = exact_slack(*problem)
        assert solvable_slack(*problem) <= (slack / scale if scale >= recheck.TINY else slack)


@given(problems())
def test_the_radius_is_never_more_than_the_exact_one(problem):
    W, b, _, r = problem
    r = np.where(np.arange(len(r)) % 3 == 0, np.abs(r), 0.0)
    with mpmath.workdps(60):
        assert unsolvable_radius(W, b, r) <= exact_radius(W, b, r)


@given(SEEDS, st.integers(1, 8))
def test_on_ordinary_numbers_almost_nothing_is_lost(seed, n):
    """The bound on rounding is a few hundred eps, relative to what is added."""
    rng = np.random.default_rng(seed)
    W, b, mu, z = (
        oracles.definite(rng, 1e3, 3 * n),
        rng.standard_normal(3 * n),
        rng.random(n),
        rng.random(3 * n),
    )
    with mpmath.workdps(60):
        slack, scale = exact_slack(W, b, mu, z)
        assert solvable_slack(W, b, mu, z) == pytest.approx(float(slack / scale), abs=1e-12)
        r = np.where(np.arange(3 * n) % 3 == 0, z, 0.0)
        exact = exact_radius(W, b, r)
        assert unsolvable_radius(W, b, r) == pytest.approx(float(exact), rel=1e-11, abs=1e-11)


@given(SEEDS)
def test_a_certificate_ruined_by_a_perturbation_is_refused(seed):
    """From `u` on the edge of a dual cone, a step outward by 1e-13 is seen although it is near rounding."""
    rng = np.random.default_rng(seed)
    W, mu, z = oracles.definite(rng, 10.0), np.array([rng.uniform(0.1, 2)]), rng.standard_normal(3)
    angle = rng.uniform(0, 2 * np.pi)
    edge = np.array([mu[0], np.cos(angle), np.sin(angle)])
    for inward, proved in ((1e-13, True), (-1e-13, False)):
        b = edge + np.array([inward, 0, 0]) - W @ z
        assert (solvable_slack(W, b, mu, z) > 0) == proved


# ---- problems whose answer is known


def test_a_mass_between_closing_walls_has_no_solution():
    assert unsolvable_radius(MASS, CLOSING, BOTH) == math.inf
    assert unsolvable_radius(MASS, PASSING, BOTH) == 0.0  # they pass: b·r > 0
    for z in np.random.default_rng(1).standard_normal((20, 6)):
        assert solvable_slack(MASS, CLOSING, np.zeros(2), z) <= 0.0


def test_a_mass_between_passing_walls_has_a_solution():
    z = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])  # u_N = 0.5 at both
    scale = math.sqrt((PASSING**2).sum() / 2)
    assert solvable_slack(MASS, PASSING, np.array([0.3, 2.0]), z) == pytest.approx(0.5 / scale, rel=1e-12)
    sliding = PASSING + np.array([0, 0.2, 0, 0, 0, 0.2])
    assert solvable_slack(MASS, sliding, np.array([0.3, 2.0]), z) > 0.0
    assert solvable_slack(MASS, sliding, np.array([0.3, 3.0]), z) <= 0.0  # outside the second contact's cone


def test_the_radius_of_almost_closing_walls():
    """Walls of stiffness eps between: `W r = eps r`, and the radius is the speed that has to be stopped over eps."""
    for eps in (2.0**-10, 2.0**-30):
        W = MASS + eps * np.eye(6)
        z = CLOSING / -eps  # the least impulse that stops both
        least = (1 + eps) * np.sqrt(np.mean((z.reshape(2, 3) ** 2).sum(axis=1)))
        assert unsolvable_radius(W, CLOSING, BOTH) == pytest.approx(least, rel=1e-5)


@given(SEEDS, st.integers(1, 6))
def test_no_impulse_within_the_radius_opens_the_contacts(seed, n):
    """The theorem, at a short impulse that stops all approaches, found by a linear programme."""
    rng = np.random.default_rng(seed)
    W, b = oracles.definite(rng, 1e6, 3 * n), rng.standard_normal(3 * n) - 1.0
    r = np.zeros(3 * n)
    r[::3] = rng.random(n)
    radius = unsolvable_radius(W, b, r)
    assume(radius > 0)
    z = least_opening_impulse(W, b)
    sigma = np.diag(W).reshape(n, 3).mean(axis=1)
    size = np.sqrt(np.mean((sigma * np.linalg.norm(z.reshape(n, 3), axis=1)) ** 2))
    assert size >= radius * np.sqrt((b**2).sum() / n) * (1 - 1e-6)


def least_opening_impulse(W, b):
    """The `z` with `(W z + b)_N >= 0` of least sum of absolute values."""
    answer = linprog(np.ones(2 * len(b)), A_ub=-np.hstack([W[::3], -W[::3]]), b_ub=b[::3], method="highs")
    assert answer.status == 0
    return answer.x[: len(b)] - answer.x[len(b) :]


@given(SEEDS)
def test_the_radius_is_attained_by_the_best_certificate_of_one_contact(seed):
    """One contact: the shortest `z` with `(W z + b)_N = 0` lies along `W e`, and the radius is its length."""
    rng = np.random.default_rng(seed)
    W, b = oracles.definite(rng, 1e3), np.array([-1.0, 0.3, 0.2])
    z = W[0] / (W[0] @ W[0])
    expected = np.trace(W) / 3 * np.linalg.norm(z) / np.linalg.norm(b)
    assert unsolvable_radius(W, b, np.array([2.0, 0.0, 0.0])) == pytest.approx(expected, rel=1e-12)


# ---- units, storage, edges


@given(SEEDS, st.integers(-60, 60), st.integers(-60, 60), st.integers(-60, 60))
def test_neither_depends_on_units(seed, s, t, k):
    """`W → sW`, `b → tb` with `z → (t/s) z`; a Farkas `r` may have any length. Exactly, for powers of two."""
    rng = np.random.default_rng(seed)
    W, b, mu = oracles.definite(rng, 1e3, 6), rng.standard_normal(6), rng.random(2)
    z, r = rng.random(6), np.array([1.0, 0, 0, 2.0, 0, 0])
    s, t, k = 2.0**s, 2.0**t, 2.0**k
    assert solvable_slack(s * W, t * b, mu, t / s * z) == pytest.approx(
        solvable_slack(W, b, mu, z), rel=1e-12
    )
    assert unsolvable_radius(s * W, t * b, k * r) == pytest.approx(unsolvable_radius(W, b, r), rel=1e-12)


def test_the_format_of_W_does_not_matter():
    rng = np.random.default_rng(0)
    W, b, mu, z = oracles.definite(rng, 10.0, 6), rng.standard_normal(6), rng.random(2), rng.random(6)
    halves = np.tile(np.indices((6, 6)).reshape(2, -1), 2)
    twice = coo_array((np.tile(W.ravel() / 2, 2), tuple(halves)))
    before = twice.data.copy()
    for stored in (bsr_array(W, blocksize=(3, 3)), csc_matrix(W), twice, W.tolist()):
        assert solvable_slack(stored, b, mu, z) == pytest.approx(solvable_slack(W, b, mu, z), rel=1e-14)
        assert unsolvable_radius(stored, CLOSING, BOTH) == pytest.approx(unsolvable_radius(W, CLOSING, BOTH))
    assert (twice.data == before).all()


def test_without_a_free_velocity_the_slack_is_absolute():
    slack = solvable_slack(2.0 * np.eye(3), np.zeros(3), [0.5], [3.0, 1.0, 0.0])
    assert slack == pytest.approx(6.0 - 0.5 * 2.0, rel=1e-12)


def test_a_contact_that_nothing_moves():
    """`W = 0`: approaching there is no solution, parting there is one."""
    W, e = np.zeros((3, 3)), np.array([1.0, 0.0, 0.0])
    assert unsolvable_radius(W, -e, e) == math.inf
    assert unsolvable_radius(W, e, e) == 0.0
    assert solvable_slack(W, e, [0.5], np.zeros(3)) == pytest.approx(1.0)
    assert solvable_slack(W, -e, [0.5], e) == pytest.approx(-1.0)


@pytest.mark.parametrize(
    "r", [[-1.0, 0, 0, 3.0, 0, 0], [1.0, 1e-300, 0, 1.0, 0, 0], [1.0, 0, 0, 1.0, 0, 1e-9], np.zeros(6)]
)
def test_what_is_no_certificate_proves_nothing(r):
    assert unsolvable_radius(MASS, CLOSING, r) == 0.0


def test_where_something_overflows_nothing_is_proved():
    big = np.full(3, 1e300)
    assert solvable_slack(np.diag(big), np.ones(3), [0.5], 1e300 * np.ones(3)) == -math.inf
    assert unsolvable_radius(np.diag(big), -big, [1e300, 0, 0]) == 0.0


GOOD = {"W": MASS, "b": CLOSING, "mu": np.ones(2), "z": BOTH}


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("W", MASS[:5], r"shape \(3n, 3n\)"),
        ("W", MASS[:4, :4], r"shape \(3n, 3n\)"),
        ("W", np.where(MASS == 1, np.nan, MASS), "W must be finite"),
        ("W", bsr_array(np.where(MASS == 1, np.inf, MASS)), "W must be finite"),
        ("b", CLOSING[:3], "b must go with the 2 contacts"),
        ("b", CLOSING[:, None], "one dimension"),
        ("b", np.full(6, np.nan), "b must be finite"),
        ("z", BOTH[:5], "must go with the 2 contacts"),
        ("z", np.full(6, -np.inf), "must be finite"),
        ("mu", np.ones(3), "mu must go with the 2 contacts"),
        ("mu", np.array([0.5, np.nan]), "mu must be finite"),
        ("mu", np.array([0.5, -1.0]), "mu must not be negative"),
    ],
)
def test_bad_input_is_refused(name, value, message):
    given_values = GOOD | {name: value}
    with pytest.raises(ValueError, match=message):
        solvable_slack(**given_values)
    if name != "mu":
        with pytest.raises(ValueError, match=message):
            unsolvable_radius(given_values["W"], given_values["b"], given_values["z"])
