"""The visit log inside the compiled sweeps: exact counts, uniform samples, the same answer with it and without."""

from functools import cache

import numpy as np
import oracles
import pytest

from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.loop import CURE, MARK, PATIENCE
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.gauss_seidel.visit_log import (
    BY_SWEEP,
    CURED,
    FAILED,
    RANDOM,
    RECENT,
    SEEN,
    SWEEPS,
    SWITCHES,
    new_log,
    place,
    recent_impulses,
    samples,
)
from fibercontact.local.contract import Status
from fibercontact.local.registry import configure, registered

ACCELERATED = {"proximal": 0.05, "acceleration": Acceleration()}
STATUSES = len(Status)
FAILING = "pac:max_iterations=2"
"""Fails here and there."""


@cache
def local(name):
    return configure(name, registered())


@cache
def degenerate():
    """More contact equations than degrees of freedom: sweeps are many."""
    return oracles.strands(1, rods=4, dofs=6, contacts=24, mu=0.8, spread=1e4).condense()


def run(name="secular", problem=None, sweeps=40, capacity=2000, log=None, **how):
    """A run to the last sweep, and its log."""
    problem = problem or degenerate()
    log = new_log(problem.n, sweeps, capacity) if log is None else log
    settings = {"tolerance": 1e-300, "max_sweeps": sweeps, "check_every": 1, "negligible": 0.0} | how
    solver = GaussSeidel(local(name), **(LOOPS["plain"] | settings))
    return solver.solve_system(block_system(problem), problem.b_ref, history=True, log=log), log


def oracle_iterates(problem, name, sweeps):
    """The iterates of dense Gauss–Seidel over the same kernel, from zero."""
    chosen = local(name)

    def solve(W, b, mu, r):
        return np.array(
            chosen.kernel()(tuple(map(tuple, W.tolist())), tuple(b), mu, tuple(r), chosen.options)[1]
        )

    return oracles.gauss_seidel(problem.W.toarray(), problem.b, problem.mu, solve, sweeps)


# Counts


@pytest.mark.parametrize("name", ["secular", FAILING, "hybrid", "pyramid"])
@pytest.mark.parametrize("how", [{}, ACCELERATED], ids=["plain", "accelerated"])
def test_counts_agree_with_those_of_the_run(name, how):
    found, log = run(name, **how)
    visits, by_sweep = found.visits, dict(zip(BY_SWEEP, log.by_sweep.T, strict=True))
    assert log.state[SWEEPS] == found.sweeps == 40
    assert log.state[SEEN] == visits.total - visits.left_out
    assert (visits.left_out > 0) == bool(how)
    assert log.state[FAILED] == visits.failures == by_sweep["failures"].sum()
    assert {s: int(log.by_contact[:, s].sum()) for s in Status} == visits.by_status
    assert by_sweep["iterations"].sum() == visits.iterations
    assert [by_sweep[k].sum() for k in ("open", "stick", "slip")] == [visits.open, visits.stick, visits.slip]
    assert (log.by_sweep[:, :3].sum(axis=1) == degenerate().n).all()
    assert log.by_contact[:, :STATUSES].sum() == visits.total - visits.left_out
    assert how or (log.by_contact[:, :STATUSES].sum(axis=1) == found.sweeps).all()
    assert by_sweep["switches"].sum() == log.by_contact[:, SWITCHES].sum()
    assert by_sweep["switches"][0] == 0


def test_local_solves_fail_in_the_runs_of_these_tests():
    found = run(FAILING)[0].visits
    assert 20 < found.failures < found.total - 20


def test_changes_of_regime_are_those_of_the_sample_of_everything():
    _, log = run(FAILING)
    visits, _ = samples(log)
    regimes = visits["regime"].reshape(40, -1)
    np.testing.assert_array_equal(log.by_contact[:, SWITCHES], (regimes[1:] != regimes[:-1]).sum(axis=0))
    np.testing.assert_array_equal(log.by_sweep[1:, 5], (regimes[1:] != regimes[:-1]).sum(axis=1))


# Samples


@pytest.mark.parametrize("name", [FAILING, "hybrid"])
@pytest.mark.parametrize("proximal", [0.0, 0.1])
def test_a_sample_of_everything_is_the_run(name, proximal):
    """Every visit once, with the local problem that the kernel solves again to the same answer."""
    problem, chosen = degenerate(), local(name)
    found, log = run(name, proximal=proximal)
    visits, failures = samples(log)
    keys = [(int(v["sweep"]), int(v["contact"])) for v in visits]
    assert keys == [(k, i) for k in range(found.sweeps) for i in range(problem.n)]
    np.testing.assert_array_equal(failures, visits[visits["status"] != Status.CONVERGED])
    shift = proximal * problem.sigma[:, None, None] * np.eye(3)
    np.testing.assert_array_equal(visits["W"][: problem.n], problem.diagonal + shift)
    for visit in visits[::7]:
        W = tuple(map(tuple, visit["W"].tolist()))
        status, r, iterations = chosen.kernel()(
            W, tuple(visit["b"].tolist()), float(visit["mu"]), tuple(visit["start"].tolist()), chosen.options
        )
        assert (status, iterations) == (visit["status"], visit["iterations"])
        if status == Status.CONVERGED:
            assert r == tuple(visit["r"].tolist())


def test_a_visit_starts_from_the_impulse_of_the_visit_before():
    visits, _ = samples(run(FAILING)[1])
    n = degenerate().n
    np.testing.assert_array_equal(visits["start"][n:], visits["r"][:-n])
    np.testing.assert_array_equal(visits["start"][:n], 0.0)


def chance(log_state, stream, capacity):
    """Which items of a stream of visits a sample holds at the end."""
    held = np.full(capacity, -1)
    for item in range(stream):
        slot = place(log_state, item, capacity)
        if slot >= 0:
            held[slot] = item
    return held


@pytest.mark.parametrize(("stream", "capacity"), [(60, 6), (8, 1)])
def test_every_visit_of_a_stream_is_held_with_the_same_chance(stream, capacity):
    trials = 2000
    state = new_log(1, 1, 1).state
    held = np.zeros(stream)
    for _ in range(trials):
        held[chance(state, stream, capacity)] += 1
    share = capacity / stream
    assert held.sum() == capacity * trials
    deviation = (held - share * trials) / np.sqrt(trials * share * (1 - share))
    chi_squared = (deviation**2).sum()  # expectation `stream - 1`, standard deviation about sqrt(2 stream)
    assert abs(chi_squared - (stream - 1)) < 4 * np.sqrt(2 * stream)
    assert np.abs(deviation).max() < 4


def test_the_random_numbers_are_those_of_park_and_miller():
    state = new_log(1, 1, 1).state
    number = int(state[RANDOM])
    for _ in range(1000):
        place(state, 5, 1)
        number = 48271 * number % (2**31 - 1)
        assert state[RANDOM] == number


def test_a_sample_of_a_long_run_is_spread_over_sweeps_and_contacts():
    capacity, sweeps = 500, 400
    found, log = run(FAILING, sweeps=sweeps, capacity=capacity)
    visits, failures = samples(log)
    assert len(visits) == capacity < found.visits.total
    assert len({(v["sweep"], v["contact"]) for v in visits}) == capacity
    for name, size in (("sweep", sweeps), ("contact", degenerate().n)):
        observed = np.histogram(visits[name], bins=8, range=(0, size))[0]
        assert ((observed - capacity / 8) ** 2 / (capacity / 8)).sum() < 24.3  # chi² with 7 degrees, 0.1 %
    assert len(failures) == min(capacity, found.visits.failures)
    assert (failures["status"] > 0).all()


def test_the_same_run_gives_the_same_log():
    (_, first), (_, second) = run(FAILING, sweeps=100, capacity=50), run(FAILING, sweeps=100, capacity=50)
    for one, two in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, two)


# Impulses


@pytest.mark.parametrize("sweeps", [7, RECENT + 9])
def test_recent_impulses_are_the_last_iterates(sweeps):
    problem = oracles.strands(3, rods=3, contacts=5).condense()
    _, log = run("secular", problem, sweeps)
    iterates = np.array(oracle_iterates(problem, "secular", sweeps))
    recent = recent_impulses(log)
    assert len(recent) == min(sweeps, RECENT)
    np.testing.assert_allclose(recent, iterates[-RECENT:], rtol=0, atol=1e-9 * np.abs(iterates).max())
    scaled = np.repeat(problem.sigma, 3) * iterates
    size = np.sqrt((scaled**2).sum(axis=1) / problem.n)
    np.testing.assert_allclose(log.size, size, rtol=1e-9)


def test_the_coming_of_the_proximal_term_is_noted():
    """At the floor of rounding there is no new least residual: the guard takes it for a cycle."""
    found, log = run("secular", oracles.strands(0).condense(), 3000)
    marks, least, waited, expected = found.history[MARK::MARK], np.inf, 0, 0
    for k, residual in enumerate(marks, start=1):
        waited = 0 if residual < least else waited + 1
        least = min(least, residual)
        if waited == PATIENCE:
            expected = k * MARK
            break
    assert expected > 0
    assert log.state[CURED] == expected
    assert run("secular", oracles.strands(0).condense(), 3000, proximal=CURE)[1].state[CURED] == 0


# What a log must not do


@pytest.mark.parametrize("name", ["secular", FAILING, "hybrid", "pyramid"])
@pytest.mark.parametrize("how", [{}, ACCELERATED], ids=["plain", "accelerated"])
def test_a_log_does_not_change_the_answer(name, how):
    problem = degenerate()
    solver = GaussSeidel(local(name), tolerance=1e-8, max_sweeps=150, **(LOOPS["plain"] | how))
    system = block_system(problem)
    bare = solver.solve_system(system, problem.b_ref)
    logged = solver.solve_system(system, problem.b_ref, log=new_log(problem.n, 150, 10))
    np.testing.assert_array_equal(logged.r, bare.r)
    assert (logged.residual, logged.sweeps, logged.visits) == (bare.residual, bare.sweeps, bare.visits)


def test_sweeps_beyond_those_of_the_log_are_counted_by_contact_only():
    found, log = run(FAILING, sweeps=40, log=new_log(degenerate().n, 10, 5))
    assert log.by_sweep[:, :3].sum() == 10 * degenerate().n
    assert log.by_contact[:, :STATUSES].sum() == found.visits.total
    assert len(recent_impulses(log)) == 40


def test_a_log_that_does_not_fit_is_refused():
    """It would be written out of its bounds, or go on counting."""
    problem = degenerate()
    for contacts in (problem.n - 1, problem.n + 1, 0):
        with pytest.raises(ValueError, match=f"empty and for {problem.n} contacts, not {contacts}"):
            run(log=new_log(contacts, 40, 10))
    _, used = run()
    with pytest.raises(ValueError, match="after 40 sweeps"):
        run(log=used)


# What a solver with a fall-back says of it


def test_hybrid_is_what_it_tries_first_until_that_fails():
    """At condition numbers near 1e9 damped Newton fails now and then."""
    rng, chosen = np.random.default_rng(3), local("hybrid")
    first, fell_back = chosen.registered.solver.first, 0
    for _ in range(3000):
        W = tuple(map(tuple, oracles.definite(rng, 10 ** rng.uniform(0, 9)).tolist()))
        b, start = tuple(rng.normal(size=3).tolist()), tuple(rng.normal(size=3).tolist())
        given = (W, b, float(10 ** rng.uniform(-1, 1)), start, chosen.options)
        tried, answered = first(*given), chosen.kernel()(*given)
        if tried[0] == Status.CONVERGED:
            assert tried == answered
        else:
            fell_back += 1
            assert answered[2] >= tried[2]
    assert 0 < fell_back < 1000
