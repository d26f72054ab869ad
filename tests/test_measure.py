"""The measures of a candidate impulse, against plain numpy written from THEORY §2 and against hand-made cases."""

import math
from dataclasses import astuple

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure, relative

SEEDS = st.integers(0, 2**32 - 1)
LAWS = st.sampled_from([0, 3, 4, 5, 8, 16])
SCALES = st.sampled_from([1e-12, 1e-3, 0.7, 1e4, 1e12])


def candidate(seed, n=3):
    """A random problem and an impulse that is in the cones here, outside there, and zero elsewhere."""
    rng = np.random.default_rng(seed)
    W = oracles.definite(rng, 100.0, 3 * n)
    b, mu, r = rng.standard_normal(3 * n), rng.choice([0.0, 0.3, 1.0, 5.0], n), rng.standard_normal(3 * n)
    r *= np.repeat(rng.integers(0, 2, n), 3)
    return W, b, mu, r


def problem(W, b, mu):
    return IncrementalProblem.from_sparse(W, b, mu)


@given(SEEDS, LAWS)
def test_residuals_are_those_of_the_definition(seed, facets):
    W, b, mu, r = candidate(seed)
    found = measure(problem(W, b, mu), r, facets)
    assert found.residual == pytest.approx(oracles.residual(W, b, mu, r, facets), rel=1e-9, abs=1e-12)
    assert found.coulomb == pytest.approx(oracles.residual(W, b, mu, r), rel=1e-9, abs=1e-12)
    assert found.fischer_burmeister == pytest.approx(
        oracles.residual(W, b, mu, r, modified=True), rel=1e-6, abs=1e-7
    )


def test_coulomb_residual_does_not_depend_on_the_law_asked_for():
    W, b, mu, r = candidate(1)
    b[:], mu[:], r[:] = [-3, 2, 1] * 3, 0.7, 0
    by_law = [measure(problem(W, b, mu), r, facets) for facets in (0, 4, 16)]
    assert len({m.coulomb for m in by_law}) == 1
    assert by_law[0].residual == by_law[0].coulomb
    assert len({m.residual for m in by_law}) == 3


@given(SEEDS, SCALES, SCALES, LAWS)
def test_residuals_have_no_unit(seed, s, t, facets):
    """`W → sW` with `r → r/s`, then `b → tb` with `r → tr`."""
    W, b, mu, r = candidate(seed)
    before = measure(problem(W, b, mu), r, facets)
    after = measure(problem(s * W, t * b, mu), r * (t / s), facets)
    for name in ("residual", "coulomb", "fischer_burmeister"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), rel=1e-8, abs=1e-7)


@given(SEEDS, st.lists(st.floats(0, 2 * np.pi), min_size=3, max_size=3))
def test_measures_do_not_depend_on_the_tangents(seed, angles):
    W, b, mu, r = candidate(seed)
    Q = np.zeros((9, 9))
    for i, angle in enumerate(angles):
        Q[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = oracles.turned(angle)
    turned = Q @ W @ Q.T
    before = measure(problem(W, b, mu), r)
    after = measure(problem(0.5 * (turned + turned.T), Q @ b, mu), Q @ r)
    np.testing.assert_allclose(astuple(after), astuple(before), rtol=1e-6, atol=1e-7)


@given(SEEDS, st.permutations(range(3)))
def test_measures_do_not_depend_on_the_order_of_the_contacts(seed, order):
    W, b, mu, r = candidate(seed)
    P = np.kron(np.eye(3)[order], np.eye(3))
    before = measure(problem(W, b, mu), r)
    after = measure(problem(P @ W @ P.T, P @ b, mu[order]), P @ r)
    np.testing.assert_allclose(astuple(after), astuple(before), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", [0, 4, 8])
def test_an_impulse_that_is_not_finite_is_worth_nothing(value, at):
    W, b, mu, r = candidate(1)
    r[at] = value
    assert astuple(measure(problem(W, b, mu), r)) == (math.inf,) * 8


def test_an_impulse_of_the_wrong_size_is_refused():
    W, b, mu, r = candidate(1)
    with pytest.raises(ValueError, match=r"shape \(9,\)"):
        measure(problem(W, b, mu), r[:6])


def test_residual_is_absolute_when_nothing_approaches():
    """With b = 0 and W = I, the impulse (2, 0, 0) lifts off at 2 m/s under a load: the map is (2, 0, 0)."""
    p = problem(np.eye(6), np.zeros(6), np.array([0.5, 0.5]))
    r = np.array([2.0, 0, 0, 0, 0, 0])
    assert measure(p, r).residual == pytest.approx(2 / math.sqrt(2))
    assert measure(problem(np.eye(6), 1e-9 * np.ones(6), np.array([0.5, 0.5])), r).residual > 1e8
    assert (relative(3.0, 2.0), relative(3.0, 0.0)) == (1.5, 3.0)


def test_a_problem_without_contacts_has_nothing_to_measure():
    empty = problem(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    assert astuple(measure(empty, np.zeros(0))) == (0.0,) * 8


# One contact, W = I and mu = 0.5, so that u = r + b: each case is (r, u, what it must show).
SLIPPING = {
    "penetration": 0,
    "cone_violation": 0,
    "complementarity": 0,
    "created_power": 0,
    "misalignment": 0,
}
DEFECTS = {
    "open": ((0, 0, 0), (2, 1, 1), SLIPPING),
    "stick": ((2, 0.3, 0.4), (0, 0, 0), SLIPPING),
    "slip": ((2, 0.6, 0.8), (0, -3, -4), SLIPPING),
    "penetrates": ((0, 0, 0), (-0.7, 0, 0), SLIPPING | {"penetration": 0.7}),
    "lifts off under a load": ((2, 0, 0), (0.1, 0, 0), SLIPPING | {"complementarity": 0.2}),
    "penetrates under a load": ((2, 0, 0), (-0.1, 0, 0), SLIPPING | {"complementarity": 0.2, "penetration": 0.1}),
    "outside the cone": ((2, 3, 0), (0, 0, 0), SLIPPING | {"cone_violation": 2 / math.sqrt(1.25)}),
    "below the cone's apex": ((-4, 0, 3), (0, 0, 0), SLIPPING | {"cone_violation": 5.0}),
    "pulls inside the polar cone": ((-2, 0, 0), (0, 0, 0), SLIPPING | {"cone_violation": 2.0}),
    "across": ((2, 1, 0), (0, 0, 3), SLIPPING | {"misalignment": math.pi / 2}),
    "askew": ((2, 1, 0), (0, -3, 3), SLIPPING | {"misalignment": math.pi / 4}),
    "pushes": ((2, 1, 0), (0, 3, 0), SLIPPING | {"misalignment": math.pi, "created_power": 3.0}),
    "slides inside the cone": ((2, 0.5, 0), (0, -3, 0), SLIPPING),  # a fault that only the residual shows
}  # fmt: skip


@pytest.mark.parametrize("case", DEFECTS)
def test_defects_of_hand_made_contacts(case):
    r, u, expected = (np.array(x, dtype=float) if not isinstance(x, dict) else x for x in DEFECTS[case])
    found = measure(problem(np.eye(3), u - r, np.array([0.5])), r)
    for name, value in expected.items():
        assert getattr(found, name) == pytest.approx(value, abs=1e-12), name
    lawful = case in ("open", "stick", "slip")
    assert (found.residual < 1e-15) == lawful


def test_defects_are_maxima_and_do_not_cancel():
    cases = [
        DEFECTS[c] for c in ("pushes", "slip", "penetrates", "lifts off under a load", "outside the cone")
    ]
    r = np.concatenate([c[0] for c in cases]).astype(float)
    u = np.concatenate([c[1] for c in cases]).astype(float)
    found = measure(problem(np.eye(15), u - r, np.full(5, 0.5)), r)
    for name in SLIPPING:
        assert getattr(found, name) == pytest.approx(max(c[2][name] for c in cases)), name


@pytest.mark.parametrize("size", 10.0 ** np.arange(0, 150, 7.5))
def test_no_impulse_is_an_answer_between_walls_that_close_in(size):
    """However large: two of them that balance leave the penetration as it is, though `r - P_K(r - u)` rounds to 0."""
    assert measure(oracles.walls(), np.array([size, 0, 0, size, 0, 0])).coulomb >= 1.0
