"""Cadoux's fixed point, and references."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import STEPS, coulomb_solutions, definite, residual, walls

from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem
from fibercontact.reference.cadoux import STAGES, Cadoux
from fibercontact.reference.conic import impulse_form, velocity_form
from fibercontact.reference.truth import NONE, polish, reference

SHARED = Path(__file__).parents[2] / "shared" / "fclib"
SMALL = sorted(path for path in SHARED.glob("*.hdf5") if path.stat().st_size < 40_000)
FORMS = {"velocity": velocity_form, "impulse": impulse_form}


def velocity(problem, r):
    return problem.W @ r + problem.b


# Cadoux's fixed point


def cadoux(problem, tolerance=1e-6, **how):
    """The loop without a clock: its iterations end it."""
    return Cadoux(tolerance=tolerance, max_seconds=math.inf, **how).solve(problem)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("name", STEPS)
def test_the_fixed_point_obeys_coulombs_law(name, form):
    step = STEPS[name]
    problem = step.condense()
    run = cadoux(step, form=form)
    assert residual(problem.W.toarray(), problem.b, problem.mu, run.r) <= 1.001e-6
    assert run.residual == pytest.approx(
        residual(problem.W.toarray(), problem.b, problem.mu, run.r), rel=1e-3
    )


@given(seed=st.integers(0, 10**6), mu=st.floats(0.01, 2.0))
def test_one_contact_is_solved_as_by_scanning(seed, mu):
    rng = np.random.default_rng(seed)
    W, b = definite(rng, 10.0), rng.standard_normal(3)
    run = cadoux(IncrementalProblem.from_sparse(W, b, np.array([mu])), 1e-8)
    assert min(np.abs(run.r - r).max() for r in coulomb_solutions(W, b, mu)) <= 1e-4


def one_contact(condition, seed):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.3, 2.0)
    return IncrementalProblem.from_sparse(definite(rng, condition), rng.standard_normal(3), np.array([mu]))


@pytest.mark.parametrize("stages", [STAGES[:1], STAGES[2:3], STAGES], ids=["accelerated", "damped", "all"])
@pytest.mark.parametrize(("condition", "seed"), [(1e2, 54), (1e2, 103), (1e2, 56), (1e2, 75)])
def test_the_plain_loop_cycles_on_ill_conditioned_contacts_and_the_others_do_not(condition, seed, stages):
    problem = one_contact(condition, seed)
    assert cadoux(problem, stages=STAGES[1:2]).residual > 1e-2
    run = cadoux(problem, stages=stages)
    assert run.residual <= 1e-6
    assert run.stage == stages[0].name


@pytest.mark.parametrize(
    ("condition", "seed", "stage"),
    [(1e3, 54, "damped"), (1e3, 116, "damped"), (1e4, 104, "damped"), (1e4, 116, "damped")],
)
def test_a_stage_takes_over_where_the_last_stalls(condition, seed, stage):
    problem = one_contact(condition, seed)
    assert cadoux(problem, stages=STAGES[:1]).residual > 1e-2
    run = cadoux(problem)
    assert run.residual <= 1e-6
    assert run.stage.startswith(stage)


# References


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("known", ["step", "incremental"])
def test_a_reference_is_what_gauss_seidel_converges_to(name, known):
    step = STEPS[name]
    problem = step.condense()
    found = reference(step if known == "step" else problem, max_seconds=10.0)
    assert found.accepted
    assert residual(problem.W.toarray(), problem.b, problem.mu, found.r) <= 1.01e-10
    run = GaussSeidel(configure("enum-companion", registered()), tolerance=1e-11).solve(problem)
    assert run.claimed
    difference = velocity(problem, found.r) - velocity(problem, run.r)
    assert np.linalg.norm(difference) <= 1e-6 * np.linalg.norm(problem.b)


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::fibercontact.problem.incremental.ProblemWarning")
def test_problems_of_other_simulators_have_a_reference(path):
    problem = read(path).problem
    found = reference(problem, max_seconds=20.0)
    assert found.accepted
    assert residual(problem.W.toarray(), problem.b, problem.mu, found.r) <= 1.01e-10


def test_a_problem_without_solution_has_no_reference():
    problem = walls()
    found = reference(problem, max_seconds=0.3)
    assert found.method == NONE
    assert not found.accepted
    assert np.isfinite(found.r).all()
    assert found.residual == min(attempt.residual for attempt in found.attempts) > 0.1
    assert residual(problem.W.toarray(), problem.b, problem.mu, found.r) == pytest.approx(found.residual)


def test_a_bar_that_cannot_be_met_gives_none_and_the_best_candidate():
    found = reference(STEPS["dense"], bar=0.0, max_seconds=0.5)
    assert found.method == NONE
    assert 0.0 < found.residual < 1e-10


@pytest.mark.parametrize("b", [np.array([1.0, 2.0, 3.0]), np.zeros(3)], ids=["separating", "at rest"])
def test_contacts_that_open_need_no_impulse(b):
    found = reference(IncrementalProblem.from_sparse(np.eye(3), b, np.array([0.5])))
    assert (found.method, found.residual) == ("no impulse", 0.0)
    assert (found.r == 0.0).all()


def test_no_contact_at_all():
    step = STEPS["stiff"]
    free = StepProblem(step.M, step.f, step.H[:0], np.empty(0), np.empty(0))
    assert reference(free).accepted


def test_polishing_goes_on_from_where_it_starts():
    problem = STEPS["dense"].condense()
    r, _ = polish(problem, None, 1e-12, 5.0)
    again, note = polish(problem, r, 1e-12, 5.0)
    assert (again == r).all()
    assert note.startswith("0 sweeps")
