"""Block Gauss–Seidel over any local solver, on strand-like problems that have a solution."""

import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.gauss_seidel.anderson import Acceleration, newest
from fibercontact.gauss_seidel.blocks import block_system, residual_from, squares, velocity
from fibercontact.gauss_seidel.loop import compile_loop, new_guard, new_state, run_sweeps, watch
from fibercontact.gauss_seidel.parts import undivided
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel, Outcome
from fibercontact.gauss_seidel.vectors import STRIDE
from fibercontact.gauss_seidel.visit_log import no_log
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Status
from fibercontact.local.registry import Configured, configure, registered
from fibercontact.local.several import one_by_one
from fibercontact.problem.cone import project
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

CORE = Path(__file__).parents[1] / "problems" / "core306"
EXACT = ["pac", "dac", "mfb", "enum-quartic", "enum-companion", "hybrid", "secular"]
ALL = [*EXACT, "pyramid", "pyramid:facets=8"]
PERIOD = 3


@cache
def local(name):
    return configure(name, known())


@cache
def known():
    return registered()


@cache
def strands(seed=0, **how):
    return oracles.strands(seed, **how).condense()


@cache
def degenerate(seed=1):
    """More contact equations than degrees of freedom: `W` has rank 24 of 72."""
    return strands(seed, rods=4, dofs=6, contacts=24, mu=0.5, spread=1e4)


def solver(name="secular", **how):
    return GaussSeidel(local(name), **(LOOPS["plain"] | {"tolerance": 1e-10, "max_sweeps": 3000} | how))


def sweeps_from_zero(problem, name, count, proximal=0.0, acceleration=None):
    """The last iterate after some sweeps, none skipped and none kept, whatever its residual."""
    compile_loop()
    system, c = block_system(problem), local(name)
    method = GaussSeidel(
        c, tolerance=0.0, check_every=1, proximal=proximal, acceleration=acceleration, negligible=0.0
    )
    parts, start = undivided(system.columns, problem.n), np.zeros(3 * problem.n)
    state, memory = new_state(system, parts, start, acceleration or Acceleration(window=0), 1)
    (member,) = method._members(system, state, memory, 1)
    done, _, _ = run_sweeps(
        c.kernel(),
        one_by_one,
        c.options,
        system,
        method._sweeper(problem.b_ref),
        state,
        *member,
        no_log(),
        np.empty(0),
        math.inf,
        0,
        count,
    )
    u = np.empty(3 * problem.n)
    row = newest(member.memory)
    r, kept = member.memory.G[row], member.memory.V[row]
    velocity(system, r, u)
    kept = kept.reshape(-1, STRIDE)[: problem.n, :3].ravel()
    np.testing.assert_allclose(kept, u, rtol=0, atol=1e-9 * np.abs(u).max())
    return r, u, done


# ---- what a sweep is


@pytest.mark.parametrize("count", range(1, 18))
@pytest.mark.parametrize(
    "problem", [strands(3, rods=3, contacts=5), degenerate()], ids=["regular", "degenerate"]
)
def test_extrapolated_impulses_have_their_velocities(problem, count):
    """After each map: `sweeps_from_zero` looks."""
    sweeps_from_zero(problem, "secular", count, 0.05, Acceleration(sweeps=1, window=4))


@pytest.mark.parametrize("name", ["secular", "pyramid", "pyramid:facets=3"])
@pytest.mark.parametrize("seed", range(3))
def test_extrapolated_impulses_end_in_their_cones(name, seed):
    """Also those of contacts that are left out."""
    problem, c = strands(seed, rods=4, contacts=20), local(name)
    run = solver(name, **LOOPS["accelerated"], tolerance=1e-6, negligible=1.0).solve(problem)
    for r, mu in zip(run.r.reshape(-1, 3), problem.mu, strict=True):
        np.testing.assert_allclose(project(tuple(r), mu, c.facets), r, rtol=0, atol=1e-12 * np.abs(r).max())


@pytest.mark.parametrize(
    "name", ["comb-curly-91-mu1-001", "comb-curly-91-mu1-233", "twist-straight-128-mu0.7-017"]
)
def test_impulses_that_drift_are_found(name):
    """Least squares alone leave 3e-4, 1e-2 and 3e-5 after 1000 sweeps; 210 to 363 are enough."""
    problem = read(CORE / f"{name}.hdf5").problem.condense()
    run = solver(**LOOPS["accelerated"], tolerance=1e-8, max_sweeps=600).solve(problem)
    assert measure(problem, run.r).residual <= 1e-8


@pytest.mark.parametrize("proximal", [0.0, 0.1])
def test_sweeps_are_those_of_the_dense_oracle(proximal):
    """Iterate by iterate, each contact solved by the dense scan over alpha."""
    problem = strands(3, rods=3, contacts=5)
    W = problem.W.toarray()

    def scan(W_ii, b_loc, mu, r):
        (only,) = oracles.coulomb_solutions(W_ii, b_loc, mu)
        return only

    expected = oracles.gauss_seidel(W, problem.b, problem.mu, scan, 4, proximal)
    for count, iterate in enumerate(expected, start=1):
        r, u, done = sweeps_from_zero(problem, "secular", count, proximal)
        assert done == count
        np.testing.assert_allclose(r, iterate, rtol=0, atol=1e-9 * np.abs(iterate).max())
        np.testing.assert_allclose(u, W @ r + problem.b, rtol=0, atol=1e-9 * np.abs(problem.b).max())


@pytest.mark.parametrize("facets", [0, 4])
@given(seed=st.integers(0, 1000))
def test_velocity_and_residual_of_the_layout_are_those_of_the_definition(facets, seed):
    problem = oracles.strands(seed % 7).condense()
    system, r = block_system(problem), np.random.default_rng(seed).standard_normal(3 * problem.n)
    u = np.empty_like(r)
    velocity(system, r, u)
    np.testing.assert_allclose(u, problem.W @ r + problem.b, rtol=1e-12, atol=1e-12 * np.abs(u).max())
    spread = np.full((problem.n, STRIDE), np.nan)
    spread[:, :3] = u.reshape(-1, 3)
    expected = measure(problem, r, facets).residual
    assert residual_from(system, r, u, facets) / problem.b_ref == pytest.approx(expected, rel=1e-10)
    total = squares(system, r, spread.ravel(), STRIDE, facets, 0, problem.n)
    assert math.sqrt(total / problem.n) / problem.b_ref == pytest.approx(expected, rel=1e-10)


# ---- what a run promises


@pytest.mark.parametrize("seed", [0, 1])
def test_every_exact_solver_finds_the_same_velocity(seed):
    """`W` has full rank and friction is low: one solution."""
    problem = strands(seed, rods=5, contacts=8, mu=0.3)
    assert np.linalg.matrix_rank(problem.W.toarray()) == 3 * problem.n
    velocities = []
    for name in EXACT:
        run = solver(name, tolerance=1e-9).solve(
            problem
        )  # the Newton solvers stop at 1e-10 of each contact's b
        assert run.claimed, name
        assert run.outcome == Outcome.CONVERGED
        velocities.append(problem.W @ run.r + problem.b)
    for u in velocities:
        np.testing.assert_allclose(u, velocities[0], rtol=0, atol=1e-7 * problem.b_ref)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    "how", [{}, {"proximal": 0.1}, {"acceleration": Acceleration(), "proximal": 0.05}], ids=str
)
def test_the_claimed_residual_is_the_measured_one(name, how):
    for problem in (strands(0), degenerate()):
        for tolerance in (1e-2, 1e-6):
            run = solver(name, tolerance=tolerance, max_sweeps=200, **how).solve(problem)
            found = measure(problem, run.r, local(name).facets).residual
            assert run.residual == pytest.approx(found, rel=1e-6, abs=1e-12)
            assert run.claimed == (run.residual <= tolerance)
            assert np.isfinite(run.r).all()


@pytest.mark.parametrize(
    "how", [{}, {"acceleration": Acceleration(), "proximal": 0.05}], ids=["plain", "accelerated"]
)
@pytest.mark.parametrize("history", [False, True])
def test_the_same_input_gives_the_same_answer_bit_for_bit(how, history):
    problem = degenerate()
    first, second = (solver(max_sweeps=150, **how).solve(problem, history=h) for h in (False, history))
    np.testing.assert_array_equal(first.r, second.r)
    assert (first.residual, first.sweeps, first.visits) == (second.residual, second.sweeps, second.visits)


def test_solving_leaves_problem_and_start_alone():
    problem = oracles.strands(0).condense()
    start = np.ones(3 * problem.n)
    before = problem.content_hash()
    run = solver().solve(problem, start)
    assert run.claimed
    assert problem.content_hash() == before
    np.testing.assert_array_equal(start, np.ones(3 * problem.n))


@pytest.mark.parametrize(
    "start", [np.zeros(4), np.full(24, np.nan), np.full(24, np.inf)], ids=["shape", "nan", "inf"]
)
def test_a_wrong_start_is_refused(start):
    with pytest.raises(ValueError, match=r"finite vector of shape \(24,\)"):
        solver().solve(strands(0), start)


@pytest.mark.parametrize("sweeps", [1, 2])
@pytest.mark.parametrize("last", [7, 20, 37, 60])
def test_the_best_iterate_is_kept(sweeps, last):
    """Full Newton steps on a degenerate problem go up and down; the least residual is what is returned, however many
    maps ago it was: its row may have been used again."""
    problem = degenerate()
    run = solver("pac", check_every=1, max_sweeps=last, acceleration=Acceleration(sweeps, 5)).solve(
        problem, history=True
    )
    past = run.history
    assert (np.diff(past) > 0).any()
    assert run.residual == pytest.approx(np.nanmin(past), rel=1e-6)  # computed afresh, in the cones
    assert run.residual < past[-1] or np.nanargmin(past) == len(past) - 1
    assert measure(problem, run.r).residual == pytest.approx(run.residual, rel=1e-9)


@pytest.mark.parametrize("every", [1, 4, 7])
def test_history_is_written_where_the_residual_is_evaluated(every):
    problem, last = degenerate(), 30
    run = solver(check_every=every, max_sweeps=last, tolerance=1e-14).solve(problem, history=True)
    assert run.sweeps == last
    evaluated = {k for k in range(last + 1) if k % every == 0} | {last}
    assert set(np.flatnonzero(~np.isnan(run.history))) == evaluated
    assert run.history[0] == pytest.approx(measure(problem, np.zeros(3 * problem.n)).residual)


def test_history_does_not_depend_on_how_often_it_is_written():
    problem = degenerate()
    often, seldom = (
        solver(check_every=k, max_sweeps=40, tolerance=1e-14).solve(problem, history=True) for k in (1, 5)
    )
    np.testing.assert_array_equal(often.history[::5], seldom.history[::5])


def test_history_is_empty_unless_asked_for():
    assert solver().solve(strands(0)).history.size == 0


def test_history_of_an_accelerated_run_has_every_map():
    run = solver(check_every=5, max_sweeps=24, tolerance=1e-14, acceleration=Acceleration(PERIOD)).solve(
        degenerate(), history=True
    )
    evaluated = {k for k in range(25) if k % PERIOD == 0 or k % 5 == 0} | {24}
    assert set(np.flatnonzero(~np.isnan(run.history))) == evaluated


# ---- how a run ends


@pytest.mark.parametrize("most", [0, 1, 13])
def test_sweeps_are_limited(most):
    run = solver(max_sweeps=most, tolerance=1e-14).solve(degenerate())
    assert (run.sweeps, run.outcome, run.claimed) == (most, Outcome.SWEEPS, False)
    assert run.visits.total == most * degenerate().n


def test_time_is_limited():
    run = solver(max_seconds=1e-9, tolerance=1e-300, max_sweeps=10**6).solve(degenerate())
    assert run.outcome == Outcome.TIME
    assert run.sweeps < 10**6
    assert not run.claimed


@pytest.mark.parametrize("name", ALL)
def test_a_solution_as_a_start_takes_no_sweep(name):
    problem = strands(0)
    first = solver(name).solve(problem)
    again = solver(name).solve(problem, first.r)
    assert first.claimed
    assert (again.sweeps, again.outcome, again.visits.total) == (0, Outcome.CONVERGED, 0)
    np.testing.assert_array_equal(again.r, first.r)


def test_a_tight_tolerance_takes_more_sweeps_than_a_loose_one():
    runs = [solver(tolerance=10.0**-k, check_every=1).solve(strands(0)) for k in (2, 4, 8)]
    assert all(run.claimed for run in runs)
    assert runs[0].sweeps < runs[1].sweeps < runs[2].sweeps
    assert all(run.residual <= 10.0**-k for run, k in zip(runs, (2, 4, 8), strict=True))


def test_every_outcome_has_its_sentence():
    assert len({outcome.sentence for outcome in Outcome}) == len(Outcome)


@pytest.mark.parametrize("name", ALL)
def test_a_problem_without_contacts_is_solved(name):
    run = solver(name, acceleration=Acceleration()).solve(oracles.strands(0, contacts=0).condense())
    assert (run.r.shape, run.residual, run.sweeps, run.outcome) == ((0,), 0.0, 0, Outcome.CONVERGED)


def test_a_problem_without_approach_takes_no_sweep():
    """`b = 0`: nothing to do, residuals are absolute; from another start it is found again."""
    full = strands(0)
    problem = IncrementalProblem(full.W, np.zeros_like(full.b), full.mu)
    assert solver().solve(problem).sweeps == 0
    run = solver(tolerance=1e-8).solve(problem, np.full(len(full.b), 0.1))
    assert run.claimed
    assert run.sweeps > 0
    assert np.abs(problem.W @ run.r).max() <= 1e-6


def test_one_contact_takes_one_sweep():
    problem = strands(2, rods=2, contacts=1)
    run = solver(check_every=1, tolerance=1e-8).solve(problem)
    assert (run.sweeps, run.outcome) == (1, Outcome.CONVERGED)


# ---- local solvers that fail


@jit
def nothing(W, b, mu, r, options):
    """Fail and say so, the impulse as it was."""
    return 4, r, 0


@jit
def nan(W, b, mu, r, options):
    """Fail by NaN."""
    return 6, (b[0] * math.nan, 0.0, 0.0), 3


@jit
def liar(W, b, mu, r, options):
    """Claim success, answer NaN."""
    return 0, (math.nan * b[0], 1.0, 1.0), 0


@jit
def infinite(W, b, mu, r, options):
    """Claim success, answer an infinity, under no known status."""
    return -77, (math.inf, b[0], 0.0), 0


@jit
def enormous(W, b, mu, r, options):
    """Fail with a finite answer that is far too large, under no known status."""
    return 99, (1e200, 1e200 + b[0], 0.0), 0


@pytest.mark.parametrize("kernel", [nothing, nan, liar, infinite, enormous])
@pytest.mark.parametrize(
    "how", [{}, {"acceleration": Acceleration(), "proximal": 0.1}], ids=["plain", "accelerated"]
)
def test_a_local_solver_that_fails_ends_in_a_finite_unclaimed_run(kernel, how):
    entry = SimpleNamespace(solver=LocalSolver(kernel), origin="here")
    problem = strands(0)
    with np.errstate(all="ignore"):  # when interpreted, numpy speaks of the overflows
        run = GaussSeidel(
            Configured("bad", entry, np.empty(0), 0), max_sweeps=20, **(LOOPS["plain"] | how)
        ).solve(problem)
    assert not run.claimed
    assert np.isfinite(run.r).all()
    assert run.residual <= measure(problem, np.zeros(3 * problem.n)).residual * (1 + 1e-12)
    assert run.visits.total == run.sweeps * problem.n
    assert run.visits.failures == run.visits.total - run.visits.left_out


# ---- statistics


@pytest.mark.parametrize("name", ALL)
def test_visits_add_up(name):
    problem = degenerate()
    run = solver(name, max_sweeps=25).solve(problem)
    visits = run.visits
    assert visits.total == run.sweeps * problem.n
    assert visits.open + visits.stick + visits.slip == visits.total
    assert visits.failures == visits.total - visits.by_status[Status.CONVERGED]
    assert (visits.iterations > 0) == (
        name not in ("enum-quartic", "enum-companion") and "pyramid" not in name
    )


def test_regimes_are_those_of_the_solution():
    """Three uncoupled contacts, one in each regime, two sweeps: each is counted as what it is."""
    problem = IncrementalProblem.from_sparse(
        np.eye(9), np.array([1.0, 0, 0, -1, 0.1, 0, -1, 3, 0]), np.array([0.5, 0.5, 0.5])
    )
    visits = solver(tolerance=0.0, max_sweeps=2).solve(problem).visits
    assert (visits.open, visits.stick, visits.slip) == (2, 2, 2)


# ---- what cures a degenerate problem


@pytest.mark.parametrize("seed", [2, 3])
def test_acceleration_reaches_what_plain_sweeps_do_not(seed):
    problem = strands(seed, dofs=6, contacts=24, mu=0.3)
    assert np.linalg.matrix_rank(problem.W.toarray()) == 24 < 3 * problem.n
    how = {"tolerance": 1e-10, "max_sweeps": 2000}
    plain = solver(**how).solve(problem)
    accelerated = solver(**how, proximal=0.05, acceleration=Acceleration(PERIOD, 8)).solve(problem)
    assert not plain.claimed
    assert accelerated.claimed
    assert measure(problem, accelerated.r).residual <= 1.01e-10


@pytest.mark.parametrize("proximal", [0.01, 0.1, 1.0])
def test_the_proximal_term_leaves_solutions_where_they_are(proximal):
    problem = strands(0)
    solution = solver(tolerance=1e-12).solve(problem)
    assert solution.claimed
    run = solver(tolerance=0.0, max_sweeps=20, proximal=proximal, negligible=0.0).solve(problem, solution.r)
    np.testing.assert_allclose(run.r, solution.r, rtol=0, atol=1e-9 * np.abs(solution.r).max())
    assert run.residual <= 1e-11


@pytest.mark.parametrize(
    "how",
    [{"proximal": 0.1}, {"acceleration": Acceleration()}, {"negligible": 0.0}, {"check_every": 1}],
    ids=str,
)
def test_the_way_there_does_not_change_the_answer(how):
    problem = strands(1, rods=5, contacts=8, mu=0.3)
    u = [problem.W @ solver(**h).solve(problem).r for h in ({}, how)]
    np.testing.assert_allclose(u[1], u[0], rtol=0, atol=1e-7 * problem.b_ref)


@pytest.mark.parametrize("s", [1e-6, 1e6])
def test_runs_have_no_unit(s):
    """`W → sW` divides the impulses by s and takes as many sweeps."""
    problem = strands(0)
    scaled = IncrementalProblem(problem.W * s, problem.b, problem.mu)
    first, second = solver().solve(problem), solver().solve(scaled)
    assert abs(first.sweeps - second.sweeps) <= 5
    np.testing.assert_allclose(s * second.r, first.r, rtol=0, atol=1e-6 * np.abs(first.r).max())


def test_a_cycle_gets_a_proximal_term_and_a_local_failure_does_not():
    guard = new_guard(0.0)
    for residual in (3.0, 2.0, 2.5, 2.1, 2.0, 2.4):
        watch(guard, residual, 0)
    assert guard[0] == 0.0
    watch(guard, 2.2, 0)  # five marks without a new minimum
    assert guard[0] > 0.0
    failing = new_guard(0.0)
    for mark in range(50):
        watch(failing, 2.0, mark + 1)
    assert failing[0] == 0.0
    assert new_guard(0.3)[0] == 0.3
