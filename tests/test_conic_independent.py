"""The convex problem of a fixed slip term, against cvxpy with two solvers, its optimality conditions, and pencil.

What it is compared with is built by numpy from `(M, f, H, w, mu, s)` as in THEORY §5, dense and unscaled.
"""

from functools import cache
from typing import NamedTuple

import cvxpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import STEPS, strands
from scipy.optimize import nnls
from scipy.sparse import eye_array

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem
from fibercontact.reference.conic import (
    associated,
    default_form,
    duality_gap,
    impulse_form,
    sharp_form,
    solve_convex,
    velocity_form,
)

FORMS = {"velocity": velocity_form, "impulse": impulse_form}
SLIPS = ["associated", "slipping"]
SOLVERS = {
    "Clarabel": {"solver": cvxpy.CLARABEL, "tol_gap_rel": 1e-10, "tol_gap_abs": 1e-10, "tol_feas": 1e-10},
    "SCS": {"solver": cvxpy.SCS, "eps_abs": 1e-10, "eps_rel": 1e-10, "max_iters": 200_000},
}


TOLERANCE = {"Clarabel": 3e-5, "SCS": 3e-6}  # of velocities: an energy right to 1e-10 fixes them to its root


def slip_term(step, kind):
    """Zero, the associated model, or random numbers."""
    return np.zeros(step.n) if kind == "associated" else np.random.default_rng(step.n).random(step.n)


class Dense(NamedTuple):
    """`min ½ ‖A r‖² + qᵀr` over `K_mu`, `W = AᵀA`, and what eliminating v leaves behind, `½ fᵀM⁻¹f`."""

    A: np.ndarray
    b: np.ndarray
    q: np.ndarray
    free: float


def dense(step, s):
    L, H = np.linalg.cholesky(step.M.toarray()), step.H.toarray()
    A, y = np.linalg.solve(L, H.T), np.linalg.solve(L, step.f)
    b = step.w - A.T @ y
    q = b.copy()
    q[::3] += step.mu * s
    return Dense(A, b, q, 0.5 * y @ y)


def in_velocities(step, s):
    """`min ½ vᵀM v + fᵀv  s.t. H v + w + mu s e ∈ K_mu*`, and u."""
    v = cvxpy.Variable(step.d)
    u = step.H @ v + step.w
    cones = [
        step.mu[i] * cvxpy.norm(u[3 * i + 1 : 3 * i + 3]) <= u[3 * i] + step.mu[i] * s[i]
        for i in range(step.n)
    ]
    return (
        cvxpy.Minimize(0.5 * cvxpy.sum_squares(np.linalg.cholesky(step.M.toarray()).T @ v) + step.f @ v),
        cones,
        u,
    )


def in_impulses(step, s):
    """`min ½ rᵀW r + (b + mu s e)ᵀr  s.t. r ∈ K_mu`, and u; `r_N >= 0` is said for mu = 0."""
    d, r = dense(step, s), cvxpy.Variable(3 * step.n)
    cones = [r[::3] >= 0] + [
        cvxpy.norm(r[3 * i + 1 : 3 * i + 3]) <= step.mu[i] * r[3 * i] for i in range(step.n)
    ]
    return cvxpy.Minimize(0.5 * cvxpy.sum_squares(d.A @ r) + d.q @ r), cones, d.A.T @ (d.A @ r) + d.b


@cache
def independent(name, kind, form, solver):
    """Velocities u and objective value by cvxpy."""
    step = STEPS[name]
    objective, cones, u = form(step, slip_term(step, kind))
    programme = cvxpy.Problem(objective, cones)
    programme.solve(**SOLVERS[solver])
    assert programme.status == cvxpy.OPTIMAL
    return u.value, programme.value


# ---- two solvers and two formulations


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("theirs", [in_velocities, in_impulses])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", SLIPS)
@pytest.mark.parametrize("name", STEPS)
def test_cvxpy_finds_the_same_velocities_and_energy(name, kind, form, theirs, solver):
    """Impulses are not unique, velocities are; by strong duality the two values add up to `-½ fᵀM⁻¹f`."""
    step = STEPS[name]
    d = dense(step, slip_term(step, kind))
    r = solve_convex(step, slip_term(step, kind), FORMS[form]).r
    ours = d.A @ r
    value = 0.5 * ours @ ours + d.q @ r
    u, energy = independent(name, kind, theirs, solver)
    assert np.linalg.norm(d.A.T @ ours + d.b - u) <= TOLERANCE[solver] * np.linalg.norm(d.b)
    assert energy == pytest.approx(value if theirs is in_impulses else -value - d.free, rel=1e-6)


# ---- optimality


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", SLIPS)
@pytest.mark.parametrize("name", STEPS)
def test_the_answer_is_optimal(name, kind, form):
    """Karush, Kuhn and Tucker: `K_mu ∋ r ⟂ W r + b + mu s e ∈ K_mu*`, contact by contact; here also sufficient."""
    step = STEPS[name]
    d = dense(step, slip_term(step, kind))
    answer = solve_convex(step, slip_term(step, kind), FORMS[form])
    r, y = answer.r.reshape(-1, 3), (d.A.T @ (d.A @ answer.r) + d.q).reshape(-1, 3)
    small, power = 1e-8 * np.abs(y).max(), 1e-8 * np.abs(y).max() * np.abs(r).max()
    assert answer.status in ("Solved", "AlmostSolved")
    assert (np.hypot(r[:, 1], r[:, 2]) <= step.mu * r[:, 0] + 1e-8 * np.abs(r).max()).all()
    assert (step.mu * np.hypot(y[:, 1], y[:, 2]) <= y[:, 0] + small).all()
    assert np.abs(np.einsum("ij,ij->i", r, y)).max() <= power
    assert 0.0 <= answer.gap <= power


# ---- answers by pencil


def by_projection(b, mu, s, sigma):
    """`W = sigma I`: `sigma r` is the projection of `-(b + mu s e)` on `K_mu`, the ray in its plane or the tip."""
    normal, tangent = -(b[0] + mu * s), -b[1:]
    size = np.linalg.norm(tangent)
    if size <= mu * normal:
        return np.array([normal, *tangent]) / sigma
    along = max(0.0, normal + mu * size) / (1 + mu**2)
    return np.array([along, *(mu * along * tangent / size)]) / sigma


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("mass", [0.5, 4.0])
@pytest.mark.parametrize("s", [0.0, 0.7])
@pytest.mark.parametrize(
    ("b", "mu"),
    [
        ((-1, 3, 0), 0.5),
        ((-1, 0.3, 0.2), 0.5),
        ((-1, 0, -4), 2.0),
        ((1, 1, 0), 0.5),
        ((0.1, 3, -4), 0.8),
        ((-1, 1, 2), 0),
    ],
)
def test_a_mass_at_one_contact(b, mu, s, mass, form):
    step = StepProblem(
        eye_array(3, format="csr") * mass, -mass * np.array(b, dtype=float), eye_array(3, format="csr"),
        np.zeros(3), np.array([float(mu)]),
    )  # fmt: skip
    r = solve_convex(step, np.array([s]), FORMS[form]).r
    np.testing.assert_allclose(r, by_projection(np.array(b), mu, s, 1 / mass), atol=1e-7 * mass)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("seed", range(3))
def test_without_friction_it_is_a_non_negative_least_squares_problem(seed, form):
    """`min ½‖y + L⁻¹ f‖²` over the normals' cone, `y = L⁻¹ H_Nᵀ r_N`."""
    step = strands(seed, mu=0.0)
    L = np.linalg.cholesky(step.M.toarray())
    r_N, _ = nnls(np.linalg.solve(L, step.H.toarray()[::3].T), np.linalg.solve(L, step.f))
    r = solve_convex(step, np.zeros(step.n), FORMS[form]).r.reshape(-1, 3)
    np.testing.assert_allclose(r[:, 0], r_N, atol=1e-7 * r_N.max())
    assert (r[:, 1:] == 0.0).all()


def test_the_associated_model_is_not_coulombs():
    """A sliding contact takes off in it: `u_N = mu ‖u_T‖`."""
    problem = IncrementalProblem.from_sparse(np.eye(3), np.array([-1.0, 3.0, 0.0]), np.array([0.5]))
    u = associated(problem).r + problem.b
    assert u[0] == pytest.approx(0.5 * np.hypot(u[1], u[2]), abs=1e-8)
    assert u[0] > 0.5


@pytest.mark.parametrize("name", STEPS)
def test_the_associated_answer_has_hardly_any_gap(name):
    """Weak duality: its energy is above the least one by no more than the gap says."""
    step = STEPS[name]
    answer, none = associated(step), np.zeros(step.n)
    d = dense(step, none)
    assert duality_gap(step.condense(), answer.r) <= 1e-10
    _, least = independent(name, "associated", in_impulses, "Clarabel")
    energy = 0.5 * np.sum((d.A @ answer.r) ** 2)
    assert energy + d.q @ answer.r <= least + 1e-8 * energy


def test_impulses_that_are_not_optimal_have_a_gap():
    """One contact, W = I, b = (-1, 0, 0), `r = (t, 0, 0)`: work `t (t - 1)` is left over; for t < 1 u leaves."""
    problem = IncrementalProblem.from_sparse(np.eye(3), np.array([-1.0, 0.0, 0.0]), np.array([0.5]))
    assert duality_gap(problem, np.array([2.0, 0.0, 0.0])) == pytest.approx(2.0 / 2.0)
    assert duality_gap(problem, np.array([0.5, 0.0, 0.0])) == pytest.approx(0.25 / 0.125)
    assert duality_gap(problem, np.array([1.0, 0.0, 0.0])) == 0.0
    assert duality_gap(problem, np.array([np.nan, 0.0, 0.0])) == np.inf


# ---- forms, models, units, bad input


@pytest.mark.parametrize("name", ["stiff", "moving"])
def test_the_sharp_form_is_the_same_programme(name):
    step, s = STEPS[name], slip_term(STEPS[name], "associated")
    d = dense(step, s)
    r, other = solve_convex(step, s, sharp_form).r, solve_convex(step, s, impulse_form).r
    assert np.linalg.norm(d.A.T @ (d.A @ (r - other))) <= 1e-4 * np.linalg.norm(d.b)


@pytest.mark.parametrize("name", STEPS)
def test_both_forms_give_one_velocity(name):
    step = STEPS[name]
    d = dense(step, slip_term(step, "slipping"))
    u, other = (d.A.T @ (d.A @ solve_convex(step, slip_term(step, "slipping"), f).r) for f in FORMS.values())
    assert np.linalg.norm(u - other) <= 1e-6 * np.linalg.norm(d.b)


@pytest.mark.parametrize("name", STEPS)
def test_a_model_is_solved_for_one_slip_term_after_the_other(name):
    step, model = STEPS[name], default_form(STEPS[name])
    for s in (slip_term(step, "slipping"), np.zeros(step.n), 2.0 * slip_term(step, "slipping")):
        d = dense(step, s)
        again, fresh = model.solve(s).r, solve_convex(step, s).r
        assert np.linalg.norm(d.A.T @ (d.A @ (again - fresh))) <= 1e-5 * np.linalg.norm(d.b)


@given(units=st.floats(1e-6, 1e6), speed=st.floats(1e-6, 1e6), seed=st.integers(0, 50))
def test_units_do_not_matter(units, speed, seed):
    problem = strands(seed, contacts=4).condense()
    changed = IncrementalProblem.from_sparse(units * problem.W, speed * problem.b, problem.mu)
    u, other = (p.W @ associated(p).r + p.b for p in (problem, changed))
    assert np.linalg.norm(other / speed - u) <= 1e-4 * np.linalg.norm(problem.b)


@pytest.mark.parametrize(
    "s", [np.zeros(3), np.full(8, -1.0), np.full(8, np.nan)], ids=["shape", "sign", "nan"]
)
def test_a_bad_slip_term_is_refused(s):
    with pytest.raises(ValueError, match="8 finite numbers >= 0"):
        solve_convex(STEPS["stiff"], s)


def test_the_velocity_form_needs_velocities():
    with pytest.raises(TypeError, match="StepProblem"):
        velocity_form(STEPS["stiff"].condense())
