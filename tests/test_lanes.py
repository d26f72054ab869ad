"""Several contacts at once are several times one: the same bits, lane by lane."""

import math
import operator

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import types
from numba.core import config

from fibercontact.gauss_seidel import parts as module
from fibercontact.gauss_seidel import solver as outer
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.parts import divide, undivided
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.jit import jit
from fibercontact.lanes import LANES, every, load, ratio, store, where
from fibercontact.local import several
from fibercontact.local.registry import configure, registered
from fibercontact.local.several import solve_several

compiled = pytest.mark.skipif(bool(config.DISABLE_JIT), reason="lanes are there in compiled code alone")
KNOWN = registered()
HAVE = [name for name, entry in KNOWN.items() if entry.solver.several]
SPECIAL = [0.0, -0.0, 1.0, -2.5, math.inf, -math.inf, math.nan, 1e-310]


def table(function):
    """Numbers from every lane of `function(x, y)`."""

    @jit
    def kernel(x, y, found):
        store(found, 0, function(load(x, 0), load(y, 0)))

    return kernel


@jit
def add(x, y):
    return x + y - 0.5


@jit
def multiply(x, y):
    return -x * y * 2


@jit
def divide_(x, y):
    return x / y


@jit
def root(x, y):
    return math.sqrt(abs(x)) + max(x, y)


@jit
def chosen(x, y):
    return where((x < y) | ((x >= 1.0) & ~(y > x)), x, 3.0)


@jit
def compared(x, y):
    return where(x <= y, 1.0, 0.0 * 1) + where(x != y, 2.0, 0.0)


@jit
def quotient(x, y):
    return ratio(x, y, -7.0)


@compiled
@pytest.mark.parametrize("function", [add, multiply, divide_, root, chosen, compared, quotient])
@pytest.mark.parametrize("seed", range(4))
def test_lanes_compute_what_numbers_do(function, seed):
    rng = np.random.default_rng(seed)
    x, y, found = rng.permutation(SPECIAL), rng.permutation(SPECIAL), np.empty(LANES)
    table(function)(x, y, found)
    one = jit(lambda a, b: float(function(a, b))) if function is not chosen else None
    with np.errstate(all="ignore"):
        expected = [
            (a if a < b or (a >= 1.0 and not b > a) else 3.0) if one is None else one(a, b)
            for a, b in zip(x, y, strict=True)
        ]
    np.testing.assert_array_equal(found, expected)
    assert [math.copysign(1, a) for a in found if a == 0] == [math.copysign(1, a) for a in expected if a == 0]


@compiled
def test_every_asks_all_lanes():
    ask = jit(lambda x: every(load(x, 0) > 0.0))
    x = np.ones(LANES)
    assert ask(x)
    for k in range(LANES):
        assert not ask(np.where(np.arange(LANES) == k, -1.0, x))


@compiled
def test_operators_of_plain_numbers_are_what_they_were():
    assert jit(lambda a, b: (operator.add(a, b), max(a, b), a & 1))(3, 4) == (7, 4, 1)


# local solvers


def contacts(rng, m, rank, spread):
    """Contacts of all three regimes; of rank 2 they have no answer in general."""
    G = rng.standard_normal((m, 3, rank)) * 10.0 ** rng.uniform(-spread, spread, (m, 1, 1))
    W = G @ G.transpose(0, 2, 1)
    b = rng.standard_normal((m, 3)) * 10.0 ** rng.uniform(-spread, spread, (m, 1))
    b[:, 0] -= rng.choice([0.0, 1.0], m)
    r = rng.standard_normal((m, 3)) / np.trace(W, axis1=1, axis2=2)[:, None] * rng.choice([0.0, 1.0], (m, 1))
    return W, b, rng.choice([0.0, 1e-40, 0.1, 0.7, 3.0], m), r


def triple(x):
    return tuple(x.tolist())


@compiled
@pytest.mark.parametrize("name", HAVE)
@given(seed=st.integers(0, 10**6), rank=st.sampled_from([2, 3, 3, 6]), spread=st.sampled_from([0.5, 4.0]))
def test_several_contacts_are_solved_as_one_is(name, seed, rank, spread):
    local = configure(name, KNOWN)
    W, b, mu, r = contacts(np.random.default_rng(seed), 20, rank, spread)
    done, found, iterations = solve_several(local, W, b, mu, r)
    for k in np.flatnonzero(done):
        status, answer, count = local.kernel()(
            tuple(map(triple, W[k])), triple(b[k]), float(mu[k]), triple(r[k]), local.options
        )
        assert status == 0
        assert answer == triple(found[k])
        assert count == iterations[k]


@compiled
def test_what_asks_for_several_is_compiled_once_for_all_solvers():
    """The disk cache would keep a version for every solver, and one that is gone cannot be read back."""
    for name in HAVE:
        solve_several(configure(name, KNOWN), *contacts(np.random.default_rng(0), 9, 6, 0.5))
    assert len(several._ask.signatures) == 1
    assert not any(isinstance(given, types.Dispatcher) for given in several._ask.signatures[0])


@compiled
@pytest.mark.parametrize("name", HAVE)
def test_hardly_a_contact_is_left_over(name):
    W, b, mu, r = contacts(np.random.default_rng(0), 2000, 6, 0.5)
    assert solve_several(configure(name, KNOWN), W, b, mu, r)[0].mean() > 0.9


@compiled
@pytest.mark.parametrize("name", HAVE)
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(5))
def test_data_that_are_not_finite_are_never_done(name, bad, place):
    W, b, mu, r = contacts(np.random.default_rng(place), LANES, 6, 0.5)
    spoilt = [W[:, 0, 0], W[:, 2, 1], b[:, 0], b[:, 2], mu][place]
    spoilt[::2] = bad
    assert not solve_several(configure(name, KNOWN), W, b, mu, r)[0][::2].any()


def test_a_solver_of_single_contacts_says_so():
    with pytest.raises(ValueError, match="pac solves one contact at a time"):
        solve_several(configure("pac", KNOWN), *contacts(np.random.default_rng(0), 2, 6, 0.5))


# sweeps


@compiled
@pytest.mark.parametrize("name", HAVE)
@pytest.mark.parametrize(("seed", "mu"), [(0, 0.4), (1, 0.4), (2, 1.0), (3, 0.0)])
def test_a_run_has_the_same_bits_one_by_one(name, seed, mu, monkeypatch):
    problem = oracles.strands(seed, rods=30, contacts=120, mu=mu).condense()
    how = GaussSeidel(configure(name, KNOWN), 1e-10, max_sweeps=200, rescue_after=0)
    assert how._width == LANES
    at_once = how.solve(problem, history=True)
    monkeypatch.setattr(outer, "LANES", 1)
    one_by_one = how.solve(problem, history=True)
    np.testing.assert_array_equal(at_once.r, one_by_one.r)
    np.testing.assert_array_equal(at_once.history, one_by_one.history)
    assert at_once.visits == one_by_one.visits
    assert at_once.visits.left_out > 0


@pytest.mark.parametrize("smallest", [8, 3000])
@given(seed=st.integers(0, 1000), contacts=st.integers(1, 60))
def test_what_a_visit_meets_is_the_first_later_one_of_its_part_that_it_pushes(smallest, seed, contacts):
    system = block_system(oracles.strands(seed, rods=12, contacts=contacts).condense())
    before = module.SMALLEST, module.SHORTEST, module.LEAF
    module.SMALLEST, module.SHORTEST, module.LEAF = smallest, 3, 4
    try:
        parts = divide(system.starts, system.columns)
    finally:
        module.SMALLEST, module.SHORTEST, module.LEAF = before
    for first, end in zip(parts.parts[:-1], parts.parts[1:], strict=True):
        for visit in range(first, end):
            i = parts.order[visit]
            pushed = set(system.columns[system.starts[i] : system.starts[i + 1]])
            later = (k for k in range(visit + 1, end) if parts.order[k] in pushed)
            assert parts.meets[visit] == next(later, end)


def test_contacts_that_do_not_interact_are_put_together():
    """Twelve rods in a row, each touching the next ten times: natural order never has two at once."""
    n, of = 120, np.arange(120) // 10
    neighbours = [np.flatnonzero(np.abs(of - of[i]) <= 1) for i in range(n)]
    starts = np.cumsum([0, *map(len, neighbours)]).astype(np.int32)
    columns = np.concatenate(neighbours).astype(np.int32)
    parts = divide(starts, columns)
    assert sorted(parts.order) == list(range(n))
    fours = parts.order[:40].reshape(-1, 4)
    assert all(np.ptp(of[group]) > 1 and parts.meets[4 * k] >= 4 * k + 4 for k, group in enumerate(fours))


def test_the_textbooks_sweeps_keep_the_order_and_go_one_by_one():
    parts = undivided(np.arange(5, dtype=np.int32), 5)
    np.testing.assert_array_equal(parts.order, range(5))
    np.testing.assert_array_equal(parts.meets, range(1, 6))
    assert GaussSeidel(configure("secular", KNOWN), acceleration=None)._width == 1
