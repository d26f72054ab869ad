"""Parts of a problem and the threads that sweep them: the answer depends on neither."""

import time

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import random_array

from fibercontact.gauss_seidel import crew
from fibercontact.gauss_seidel import parts as module
from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.blocks import block_system, new_velocity, push, residual_from, velocity
from fibercontact.gauss_seidel.crew import Crew, Member
from fibercontact.gauss_seidel.parts import divide, undivided
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.gauss_seidel.sweep import COUNTERS
from fibercontact.gauss_seidel.team import alone, gather
from fibercontact.gauss_seidel.vectors import STRIDE
from fibercontact.local.registry import configure, registered
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

SMALL = {"SMALLEST": 8, "SHORTEST": 3, "LEAF": 4}


@pytest.fixture(autouse=True)
def small_parts():
    """Problems of a few contacts are divided like those of thousands."""
    before = {name: getattr(module, name) for name in SMALL}
    vars(module).update(SMALL)
    yield
    vars(module).update(before)


def graph(n, density, seed):
    """A symmetric pattern with its diagonal, as block rows."""
    A = random_array((n, n), density=density, rng=seed).tocsr()
    A = (A + A.T).tolil()
    A.setdiag(1.0)
    A = A.tocsr()
    A.sort_indices()
    return A.indptr.astype(np.int32), A.indices.astype(np.int32)


def chain(n, reach=1):
    """Every contact with its next ones: what strands look like."""
    rows = [np.arange(max(0, i - reach), min(n, i + reach + 1)) for i in range(n)]
    starts = np.cumsum([0, *map(len, rows)]).astype(np.int32)
    return starts, np.concatenate(rows).astype(np.int32)


def part_and_phase(parts):
    n = len(parts.order)
    part, phase = np.empty(n, int), np.empty(n, int)
    for q in range(len(parts.parts) - 1):
        part[parts.order[parts.parts[q] : parts.parts[q + 1]]] = q
    for p in range(len(parts.phases) - 1):
        first, end = parts.parts[parts.phases[p]], parts.parts[parts.phases[p + 1]]
        phase[parts.order[first:end]] = p
    return part, phase


@given(n=st.integers(1, 60), density=st.floats(0.0, 0.2), seed=st.integers(0, 10**6))
def test_parts_of_a_phase_do_not_interact_and_hold_every_contact_once(n, density, seed):
    starts, columns = graph(n, density, seed)
    parts = divide(starts, columns)
    assert sorted(parts.order) == list(range(n))
    assert parts.parts[-1] == n
    assert parts.phases[-1] == len(parts.parts) - 1
    part, phase = part_and_phase(parts)
    row = np.repeat(np.arange(n), np.diff(starts))
    assert not ((phase[row] == phase[columns]) & (part[row] != part[columns])).any()


@given(n=st.integers(1, 60), density=st.floats(0.0, 0.2), seed=st.integers(0, 10**6))
def test_no_two_parts_of_a_phase_push_to_the_same_place(n, density, seed):
    """A push goes to the contact itself or to a slot of it; a slot belongs to the phase that flushes it."""
    starts, columns = graph(n, density, seed)
    parts = divide(starts, columns)
    part, phase = part_and_phase(parts)
    row = np.repeat(np.arange(n), np.diff(starts))
    owner = {}
    for source, column, target in zip(row, columns, parts.targets, strict=True):
        if target >= n:
            slot = target - n
            assert parts.slots[slot] == column
            assert parts.flushes[phase[source]] <= slot < parts.flushes[phase[source] + 1]
        else:
            assert target == column
        key = (phase[source], target)
        assert owner.setdefault(key, part[source]) == part[source]
    assert parts.flushes[-1] == len(parts.slots)


def test_a_chain_is_cut_by_single_contacts_into_equal_leaves():
    parts = divide(*chain(67))
    sizes = np.diff(parts.parts)
    leaves, separators = sizes[: parts.phases[1]], sizes[parts.phases[1] :]
    assert len(leaves) == 2 ** int(np.log2(67 / SMALL["LEAF"]))
    assert (separators <= 1).all()
    assert leaves.max() - leaves.min() <= np.log2(len(leaves))  # each cut may be off by one


def test_what_is_small_is_not_divided():
    starts, columns = chain(SMALL["SMALLEST"] - 1)
    found, expected = divide(starts, columns), undivided(columns, len(starts) - 1)
    for name in ("parts", "phases", "targets", "slots", "flushes"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@given(seed=st.integers(0, 1000))
def test_velocity_and_residual_do_not_depend_on_the_division(seed):
    problem = oracles.strands(seed % 7, rods=8, contacts=30).condense()
    system, r = block_system(problem), np.random.default_rng(seed).standard_normal(3 * problem.n)
    assert len(system.parts.slots) > 0
    u = np.empty_like(r)
    velocity(system, r, u)
    np.testing.assert_allclose(u, problem.W @ r + problem.b, rtol=0, atol=1e-12 * np.abs(u).max())
    found = residual_from(system, r, u, 0) / problem.b_ref
    assert found == pytest.approx(measure(problem, r).residual, rel=1e-10)


@given(seed=st.integers(0, 1000), share=st.sampled_from([0.0, 0.02, 0.3, 1.0]))
def test_the_impulses_of_some_visits_are_pushed(seed, share):
    """Which they are is read eight visits at a time."""
    rng, problem = np.random.default_rng(seed), oracles.strands(seed % 7, rods=8, contacts=30).condense()
    system, r = block_system(problem), rng.standard_normal(3 * problem.n)
    parts, some = system.parts, np.zeros(problem.n + -problem.n % 8, np.uint8)
    some[: problem.n] = rng.random(problem.n) < share
    u = new_velocity(parts)
    push(system, parts, r, some, alone(len(parts.parts) - 1), u)
    chosen = np.zeros((problem.n, 1))
    chosen[parts.order, 0] = some[: problem.n]
    expected = problem.W @ (chosen * r.reshape(-1, 3)).ravel()
    found = u.reshape(-1, STRIDE)[: problem.n, :3].ravel()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(problem.W @ r).max())


def test_sweeps_of_a_divided_problem_are_the_oracles_in_its_order():
    """Visited in the order of the parts, by the dense Gauss–Seidel on the permuted problem."""
    problem = oracles.strands(3, rods=5, contacts=12).condense()
    system, local = block_system(problem), configure("secular", registered())
    assert len(system.parts.parts) > 2
    order = np.ravel(3 * system.parts.order[:, None] + np.arange(3))
    W, b = problem.W.toarray()[np.ix_(order, order)], problem.b[order]

    def scan(W_ii, b_loc, mu, r):
        (only,) = oracles.coulomb_solutions(W_ii, b_loc, mu)
        return only

    for sweeps, expected in enumerate(
        oracles.gauss_seidel(W, b, problem.mu[system.parts.order], scan, 4, 0.05), start=1
    ):
        run = GaussSeidel(local, 0.0, sweeps, negligible=0.0, check_every=sweeps).solve_system(
            system, problem.b_ref
        )
        if sweeps == 1:  # then the sweeps are extrapolated
            np.testing.assert_allclose(run.r[order], expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert run.sweeps == 4


@pytest.mark.parametrize("switches", [False, True])
@pytest.mark.parametrize("threads", [2, 3, 5])
@pytest.mark.parametrize("name", ["secular", "pac:max_iterations=2"])
def test_the_answer_is_the_same_for_any_number_of_threads(monkeypatch, threads, name, switches):
    """Also if the run goes from all of them to one and back at every look."""
    for look in ("FIRST_LOOK", "NEXT_LOOK"):
        monkeypatch.setattr(crew, look, 0.0 if switches else np.inf)
    problem = oracles.strands(5, rods=20, contacts=120, mu=0.8).condense()
    system, local = block_system(problem), configure(name, registered())
    assert system.parts.phases[1] >= 5

    def run(count):
        monkeypatch.setenv("FIBERCONTACT_THREADS", str(count))
        solver = GaussSeidel(local, 1e-8, 300, 600.0, rescue_after=0)
        return solver.solve_system(system, problem.b_ref, history=True)

    alone, together = run(1), run(threads)
    np.testing.assert_array_equal(together.r, alone.r)
    np.testing.assert_array_equal(together.history, alone.history)
    assert together.visits == alone.visits
    assert (together.sweeps, together.residual) == (alone.sweeps, alone.residual)


def test_a_run_goes_on_with_the_threads_that_are_faster():
    """And looks again, since that may change."""
    own = (Acceleration(window=2).memory(np.zeros(6)), np.zeros(4), np.zeros(COUNTERS, dtype=np.int64))
    two = Crew([Member(team, *own) for team in gather(2, np.zeros(1, np.int32))])
    slow = {2}

    def go(elapsed):
        count = two.plan(elapsed, 30, 15)

        def sweep(member):
            time.sleep(count * (1e-3 if member.team.size in slow else 1e-5))
            return member.team.size

        return count, two.sweep(sweep, count, np.zeros(2, dtype=np.int64))

    assert go(0.0) == (30, 2)
    assert go(crew.FIRST_LOOK) == (15, 1)
    assert go(0.2) == (30, 1)
    slow = {1}
    assert go(0.3) == (30, 1)
    again = crew.FIRST_LOOK + crew.NEXT_LOOK
    assert go(again) == (15, 2)
    assert go(again + 0.1) == (30, 2)


def test_many_solves_at_once_do_not_wait_for_each_other(monkeypatch):
    """Teams of several solves share nothing, so none can wait for another's thread."""
    from concurrent.futures import ThreadPoolExecutor

    monkeypatch.setenv("FIBERCONTACT_THREADS", "2")
    problem = oracles.strands(5, rods=20, contacts=120, mu=0.5).condense()
    solver = GaussSeidel(configure("secular", registered()), 1e-8, 500)
    expected = solver.solve(problem)
    with ThreadPoolExecutor(4) as pool:
        runs = list(pool.map(lambda _: solver.solve(problem), range(8)))
    for run in runs:
        np.testing.assert_array_equal(run.r, expected.r)


def test_what_is_left_out_changes_nothing():
    """An open contact that separates, and a contact at rest whose velocity has not changed."""
    W = np.eye(9)
    b = np.array([1.0, 0, 0, -1, 0.1, 0, -1, 3, 0])
    problem = IncrementalProblem.from_sparse(W, b, np.full(3, 0.5))
    local = configure("secular", registered())
    run = GaussSeidel(local, 0.0, 60, proximal=0.05).solve(problem)
    assert run.visits.left_out >= run.sweeps > 0
    assert run.visits.open + run.visits.stick + run.visits.slip == run.visits.total == 3 * run.sweeps
    expected = GaussSeidel(local, 1e-14, proximal=0.0, acceleration=None).solve(problem)
    np.testing.assert_allclose(run.r, expected.r, atol=1e-12)
