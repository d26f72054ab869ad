"""The interior-point method: its variables, its answers by the law, and what it is for."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import oracles
import pytest
from scipy.sparse import eye_array

from fibercontact.gauss_seidel import interior_point as method
from fibercontact.gauss_seidel import solver as outer
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.interior_point import interior_point
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel, Outcome
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

CORE = Path(__file__).parents[1] / "problems" / "core306"
JAMMED = CORE / "comb-curly-91-mu1-171.hdf5"
NO_SOLUTION = IncrementalProblem.from_sparse(
    0.0 * eye_array(3) + np.diag([0.0, 1.0, 1.0]), -np.ones(3), np.ones(1)
)


def solver(**how):
    return GaussSeidel(configure("secular", registered()), **how)


def answer(problem, tolerance=1e-6):
    run = interior_point(block_system(problem), problem.b_ref, tolerance * problem.b_ref)
    found = measure(problem, run.r)
    assert run.residual == pytest.approx(found.residual * problem.b_ref, rel=1e-6, abs=1e-14)
    return run, found


# the change of variables


def test_the_variables_are_those_of_the_docstring():
    problem = oracles.strands(3).condense()
    equations, impulse = method._in_cones(block_system(problem), problem.b_ref)
    x = np.random.default_rng(0).standard_normal((problem.n, 3))
    r = (impulse * x).ravel()
    s = np.sqrt(problem.sigma)
    u = (problem.W @ r + problem.b).reshape(-1, 3)
    expected = np.column_stack([u[:, 0] / problem.mu, u[:, 1], u[:, 2]]) / s[:, None]
    expected *= np.sqrt(np.mean(problem.sigma)) / problem.b_ref
    found = (equations.A @ x.ravel()).reshape(x.shape) + equations.c
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    dense = equations.A.toarray()
    blocks = [dense[3 * i : 3 * i + 3, 3 * i : 3 * i + 3].T for i in range(problem.n)]
    np.testing.assert_array_equal(equations.A.data[equations.diagonal], blocks)


def test_contacts_without_friction_take_no_tangential_numbers():
    problem = oracles.strands(3, mu=0.0).condense()
    equations, impulse = method._in_cones(block_system(problem), problem.b_ref)
    assert equations.A.nnz == len(problem.W.indices) + 8 * problem.n
    np.testing.assert_array_equal(impulse[:, 1:], 0)


# its answers


@pytest.mark.parametrize("mu", [0.0, 0.02, 0.3, 1.0, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_it_solves_coulombs_law(seed, mu):
    problem = oracles.strands(seed, contacts=14, mu=mu).condense()
    run, found = answer(problem)
    assert found.residual <= 1e-6
    assert 0 < run.iterations <= 150
    assert found.cone_violation <= 1e-12 * np.abs(run.r).max()


def test_contacts_with_and_without_friction_in_one_problem():
    problem = oracles.strands(5, contacts=12).condense()
    problem = replace(problem, mu=np.where(np.arange(12) % 3 == 0, 0.0, problem.mu))
    run, found = answer(problem)
    assert found.residual <= 1e-6
    np.testing.assert_array_equal(run.r.reshape(-1, 3)[::3, 1:], 0)


def test_its_velocities_are_those_of_the_sweeps():
    problem = oracles.strands(2).condense()
    sweeps = solver(tolerance=1e-11, rescue_after=0).solve(problem)
    u, v = (problem.W @ r + problem.b for r in (answer(problem)[0].r, sweeps.r))
    np.testing.assert_allclose(u, v, atol=1e-4 * problem.b_ref)


@pytest.mark.parametrize(("scale_w", "scale_b"), [(1e6, 1.0), (1.0, 1e-5), (1e-4, 1e3)])
def test_units_change_nothing(scale_w, scale_b):
    problem = oracles.strands(4, contacts=12).condense()
    other = IncrementalProblem.from_sparse(scale_w * problem.W, scale_b * problem.b, problem.mu)
    one, scaled = (answer(p)[0] for p in (problem, other))
    assert one.iterations == scaled.iterations
    np.testing.assert_allclose(scaled.r * scale_w / scale_b, one.r, atol=1e-5 * np.abs(one.r).max())


def test_another_start_is_tried_where_a_path_is_lost(monkeypatch):
    problem = oracles.strands(57, rods=3, dofs=6, contacts=10, mu=5.0).condense()
    run, found = answer(problem)
    assert found.residual <= 1e-6
    monkeypatch.setattr(method, "STARTS", method.STARTS[:1])
    alone, found = answer(problem)
    assert found.residual > 1e-3
    assert alone.iterations < run.iterations


def test_a_problem_without_solution_ends_and_is_not_solved():
    run, found = answer(NO_SOLUTION)
    assert np.isfinite(run.r).all()
    assert found.residual > 1e-3


def test_the_deadline_is_kept():
    problem = read(JAMMED).problem.condense()
    run = interior_point(block_system(problem), problem.b_ref, 1e-12, deadline=0.0)
    assert run.iterations <= 1


# what it is for


@pytest.mark.skipif(not JAMMED.exists(), reason="the set of problems is not here")
def test_a_jammed_problem_is_solved_where_sweeps_stall():
    problem = read(JAMMED.with_name("comb-curly-91-mu1-187.hdf5")).problem.condense()
    sweeps = solver(tolerance=1e-8, max_sweeps=3000, rescue_after=0).solve(problem)
    robust = solver(tolerance=1e-8, max_sweeps=3000, rescue_after=300).solve(problem)
    assert sweeps.outcome == Outcome.SWEEPS
    assert sweeps.rescue == 0
    assert robust.claimed
    assert robust.rescue > 0
    assert robust.sweeps == 300  # the method's own answer was good enough
    assert measure(problem, robust.r).residual <= 1e-8


@pytest.mark.skipif(not JAMMED.exists(), reason="the set of problems is not here")
@pytest.mark.parametrize("name", ["plane-straight-24-mu1-170", "plane-straight-24-mu1-198"])
def test_the_problems_of_worst_conditioning_are_solved(name):
    problem = read(JAMMED.with_name(f"{name}.hdf5")).problem.condense()
    run = solver(tolerance=1e-8).solve(problem)
    assert run.claimed
    assert measure(problem, run.r).residual <= 1e-8


def test_the_rescue_comes_when_it_is_due_and_not_before():
    problem = oracles.strands(0, contacts=12).condense()
    full = solver(tolerance=1e-12, rescue_after=0).solve(problem)
    assert full.claimed
    in_time = solver(tolerance=1e-12, rescue_after=full.sweeps).solve(problem)
    np.testing.assert_array_equal(in_time.r, full.r)
    assert in_time.rescue == 0
    early = solver(tolerance=1e-12, rescue_after=full.sweeps // 2).solve(problem)
    assert early.rescue > 0
    assert early.residual <= 1e-12


def test_only_coulombs_law_is_rescued():
    problem = oracles.strands(0, contacts=12).condense()
    run = GaussSeidel(configure("pyramid", registered()), 1e-14, max_sweeps=30, rescue_after=5).solve(problem)
    assert run.rescue == 0


def test_the_default_loop_is_the_robust_one():
    assert {name: getattr(solver(), name) for name in LOOPS["robust"]} == LOOPS["robust"]


def test_a_problem_too_large_for_the_factors_is_left_to_the_sweeps(monkeypatch):
    problem = oracles.strands(1, contacts=12).condense()
    monkeypatch.setattr(outer, "LARGEST_RESCUE", len(problem.W.indices))
    assert solver(tolerance=1e-10, rescue_after=3).solve(problem).rescue > 0
    monkeypatch.setattr(outer, "LARGEST_RESCUE", len(problem.W.indices) - 1)
    assert solver(tolerance=1e-10, rescue_after=3).solve(problem).rescue == 0


def test_the_same_input_gives_the_same_answer_bit_for_bit():
    problem = oracles.strands(1, contacts=12).condense()
    first, second = (solver(tolerance=1e-10, rescue_after=3).solve(problem) for _ in range(2))
    np.testing.assert_array_equal(first.r, second.r)
    assert first.rescue == second.rescue > 0
