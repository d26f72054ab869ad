"""The convex problem against cvxpy and its optimality conditions, Cadoux's fixed point, references."""

from dataclasses import replace
from pathlib import Path

import cvxpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import coulomb_solutions, definite, residual, strands
from scipy.optimize import nnls

from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem
from fibercontact.reference.cadoux import STAGES, Cadoux
from fibercontact.reference.conic import (
    associated,
    default_form,
    duality_gap,
    impulse_form,
    solve_convex,
    velocity_form,
)
from fibercontact.reference.truth import NONE, polish, reference

SHARED = Path(__file__).parents[2] / "shared" / "fclib"
SMALL = sorted(path for path in SHARED.glob("*.hdf5") if path.stat().st_size < 40_000)
FORMS = {"velocity": velocity_form, "impulse": impulse_form}

STEPS = {
    "stiff": strands(1, spread=1e4),
    "dense": strands(2, rods=3, contacts=12),
    "rank deficient": strands(3, rods=2, dofs=9, contacts=10, mu=0.7),
    "moving": replace(strands(4), w=0.2 * np.random.default_rng(4).random(24)),
    "mixed mu": replace(strands(5), mu=np.array([0.0, 0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 5.0])),
}


def squeezed():
    """A mass between two walls that close in on it: no velocity satisfies both, so there is no solution."""
    W = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3))
    b = np.array([-1.0, 0.0, 0.0, -1.0, 0.0, 0.0])
    return IncrementalProblem.from_sparse(W, b, np.full(2, 0.3))


def slips(step):
    return np.random.default_rng(step.n).random(step.n)


def velocity(problem, r):
    return problem.W @ r + problem.b


def shifted(problem, s):
    """`b + mu s e`, whose convex problem is the associated one."""
    b = problem.b.copy()
    b[::3] += problem.mu * s
    return b


def cvxpy_velocities(step, s):
    """The convex problem written down as in THEORY §5, on unscaled data."""
    v = cvxpy.Variable(step.d)
    u = step.H @ v + step.w
    cones = [
        step.mu[i] * cvxpy.norm(u[3 * i + 1 : 3 * i + 3]) <= u[3 * i] + step.mu[i] * s[i]
        for i in range(step.n)
    ]
    energy = 0.5 * cvxpy.quad_form(v, step.M.toarray()) + step.f @ v
    programme = cvxpy.Problem(cvxpy.Minimize(energy), cones)
    programme.solve(solver=cvxpy.SCS, eps_abs=1e-9, eps_rel=1e-9, max_iters=100_000)
    return v.value, programme.value


# The convex problem


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("name", ["dense", "moving", "mixed mu"])
def test_cvxpy_finds_the_same_velocities_and_energy(name, form):
    step, s = STEPS[name], slips(STEPS[name])
    problem = step.condense()
    answer = solve_convex(step, s, form)
    v, energy = cvxpy_velocities(step, s)
    ours = step.velocities(answer.r)
    assert np.linalg.norm(ours - v) <= 1e-6 * np.linalg.norm(v)
    dual = 0.5 * answer.r @ (problem.W @ answer.r) + shifted(problem, s) @ answer.r
    free = 0.5 * step.f @ step.mobility.solve(step.f)  # what eliminating v leaves behind
    assert energy == pytest.approx(-dual - free, rel=1e-6)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("name", STEPS)
def test_the_answer_is_optimal(name, form):
    step, s = STEPS[name], slips(STEPS[name])
    problem = step.condense()
    answer = solve_convex(step, s, form)
    r = answer.r.reshape(-1, 3)
    y = (problem.W @ answer.r + shifted(problem, s)).reshape(-1, 3)
    small, power = 1e-8 * np.abs(y).max(), 1e-8 * np.abs(y).max() * np.abs(r).max()
    assert answer.status in ("Solved", "AlmostSolved")
    assert (np.hypot(r[:, 1], r[:, 2]) <= step.mu * r[:, 0] + 1e-8 * np.abs(r).max()).all()
    assert (step.mu * np.hypot(y[:, 1], y[:, 2]) <= y[:, 0] + small).all()
    assert np.abs(np.einsum("ij,ij->i", r, y)).max() <= power
    assert 0.0 <= answer.gap <= power


@pytest.mark.parametrize("name", STEPS)
def test_both_forms_give_one_velocity(name):
    step, s = STEPS[name], slips(STEPS[name])
    problem = step.condense()
    u, other = (velocity(problem, solve_convex(step, s, form).r) for form in FORMS.values())
    assert np.linalg.norm(u - other) <= 1e-6 * np.linalg.norm(problem.b)


@pytest.mark.parametrize("name", STEPS)
def test_a_model_is_solved_for_one_slip_term_after_the_other(name):
    step = STEPS[name]
    problem, model = step.condense(), default_form(step)
    for s in (slips(step), np.zeros(step.n), 2.0 * slips(step)):
        again, fresh = model.solve(s).r, solve_convex(step, s).r
        assert np.linalg.norm(velocity(problem, again - fresh) - problem.b) <= 1e-5 * np.linalg.norm(
            problem.b
        )


@given(units=st.floats(1e-6, 1e6), speed=st.floats(1e-6, 1e6), seed=st.integers(0, 50))
def test_units_do_not_matter(units, speed, seed):
    problem = strands(seed, contacts=4).condense()
    changed = IncrementalProblem.from_sparse(units * problem.W, speed * problem.b, problem.mu)
    u, other = (velocity(p, associated(p).r) for p in (problem, changed))
    assert np.linalg.norm(other / speed - u) <= 1e-4 * np.linalg.norm(problem.b)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("seed", range(3))
def test_without_friction_it_is_a_non_negative_least_squares_problem(seed, form):
    """`min ½‖y + L⁻¹ f‖²` over the normals' cone, `y = L⁻¹ H_Nᵀ r_N`."""
    step = strands(seed, mu=0.0)
    L = np.linalg.cholesky(step.M.toarray())
    r_N, _ = nnls(np.linalg.solve(L, step.H.toarray()[::3].T), np.linalg.solve(L, step.f))
    r = solve_convex(step, np.zeros(step.n), form).r.reshape(-1, 3)
    np.testing.assert_allclose(r[:, 0], r_N, atol=1e-7 * r_N.max())
    assert (r[:, 1:] == 0.0).all()


def test_the_associated_model_is_not_coulombs():
    """A sliding contact takes off in it: `u_N = mu ‖u_T‖`."""
    problem = IncrementalProblem.from_sparse(np.eye(3), np.array([-1.0, 3.0, 0.0]), np.array([0.5]))
    u = velocity(problem, associated(problem).r)
    assert u[0] == pytest.approx(0.5 * np.hypot(u[1], u[2]), abs=1e-8)
    assert u[0] > 0.5


@pytest.mark.parametrize("name", ["dense", "moving", "mixed mu"])
def test_the_associated_answer_has_hardly_any_gap(name):
    """Weak duality: the objective at `r`, ½ rᵀWr + bᵀr, is at most `gap · energy` above the least one."""
    step = STEPS[name]
    problem = step.condense()
    answer = associated(step)
    assert duality_gap(problem, answer.r) <= 1e-10
    energy = 0.5 * answer.r @ (problem.W @ answer.r)
    _, objective = cvxpy_velocities(step, np.zeros(step.n))
    ours = step.velocities(answer.r)
    assert 0.5 * ours @ (step.M @ ours) + step.f @ ours <= objective + 1e-6 * energy


def test_impulses_that_are_not_optimal_have_a_gap():
    """One contact, W = I, b = (-1, 0, 0), `r = (t, 0, 0)`: work `t (t - 1)` is left over; for t < 1 u leaves."""
    problem = IncrementalProblem.from_sparse(np.eye(3), np.array([-1.0, 0.0, 0.0]), np.array([0.5]))
    assert duality_gap(problem, np.array([2.0, 0.0, 0.0])) == pytest.approx(2.0 / 2.0)
    assert duality_gap(problem, np.array([0.5, 0.0, 0.0])) == pytest.approx(0.25 / 0.125)
    assert duality_gap(problem, np.array([1.0, 0.0, 0.0])) == 0.0
    assert duality_gap(problem, np.array([np.nan, 0.0, 0.0])) == np.inf


@pytest.mark.parametrize(
    "s", [np.zeros(3), np.full(8, -1.0), np.full(8, np.nan)], ids=["shape", "sign", "nan"]
)
def test_a_bad_slip_term_is_refused(s):
    with pytest.raises(ValueError, match="8 finite numbers >= 0"):
        solve_convex(STEPS["stiff"], s)


def test_the_velocity_form_needs_velocities():
    with pytest.raises(TypeError, match="StepProblem"):
        velocity_form(STEPS["stiff"].condense())


# Cadoux's fixed point


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
@pytest.mark.parametrize("name", STEPS)
def test_the_fixed_point_obeys_coulombs_law(name, form):
    step = STEPS[name]
    problem = step.condense()
    run = Cadoux(form, tolerance=1e-6).solve(step)
    assert residual(problem.W.toarray(), problem.b, problem.mu, run.r) <= 1.001e-6
    assert run.residual == pytest.approx(
        residual(problem.W.toarray(), problem.b, problem.mu, run.r), rel=1e-3
    )


@given(seed=st.integers(0, 10**6), mu=st.floats(0.01, 2.0))
def test_one_contact_is_solved_as_by_scanning(seed, mu):
    rng = np.random.default_rng(seed)
    W, b = definite(rng, 10.0), rng.standard_normal(3)
    run = Cadoux(tolerance=1e-8).solve(IncrementalProblem.from_sparse(W, b, np.array([mu])))
    assert min(np.abs(run.r - r).max() for r in coulomb_solutions(W, b, mu)) <= 1e-4


def one_contact(condition, seed):
    rng = np.random.default_rng(seed)
    mu = rng.uniform(0.3, 2.0)
    return IncrementalProblem.from_sparse(definite(rng, condition), rng.standard_normal(3), np.array([mu]))


@pytest.mark.parametrize("stages", [STAGES[:1], STAGES[2:3], STAGES], ids=["accelerated", "damped", "all"])
@pytest.mark.parametrize(("condition", "seed"), [(1e2, 54), (1e2, 103), (1e2, 56), (1e2, 75)])
def test_the_plain_loop_cycles_on_ill_conditioned_contacts_and_the_others_do_not(condition, seed, stages):
    problem = one_contact(condition, seed)
    assert Cadoux(tolerance=1e-6, stages=STAGES[1:2]).solve(problem).residual > 1e-2
    run = Cadoux(tolerance=1e-6, stages=stages).solve(problem)
    assert run.residual <= 1e-6
    assert run.stage == stages[0].name


@pytest.mark.parametrize(
    ("condition", "seed", "stage"),
    [(1e2, 42, "plain"), (1e2, 63, "plain"), (1e3, 54, "damped"), (1e3, 116, "damped"), (1e4, 104, "damped")],
)
def test_a_stage_takes_over_where_the_last_stalls(condition, seed, stage):
    problem = one_contact(condition, seed)
    assert Cadoux(tolerance=1e-6, stages=STAGES[:1]).solve(problem).residual > 1e-2
    run = Cadoux(tolerance=1e-6).solve(problem)
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
    problem = squeezed()
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
