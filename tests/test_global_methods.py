"""Methods for all contacts at once: their answers against the law, oracles and invariances; their honesty."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import STEPS, finite_differences, project, residual, strands, turned
from scipy.sparse import block_diag, bsr_array, csr_array, eye_array

from fibercontact.gauss_seidel.blocks import block_system, matrix, residual_from, velocity
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.global_methods import methods, scaled
from fibercontact.global_methods import registry as global_registry
from fibercontact.global_methods.accelerated import accelerated, begin_accelerated
from fibercontact.global_methods.contract import Task, Unsuited
from fibercontact.global_methods.methods import admm, apgd, newton_ac, newton_fb
from fibercontact.global_methods.newton import NEWTON_OPTIONS, Point, jacobian
from fibercontact.global_methods.registry import ConfiguredMethod, configure, is_global, registered
from fibercontact.global_methods.scaled import NO_SLIP, cone_residual, scale
from fibercontact.global_methods.spectral import begin_spectral, spectral
from fibercontact.local import registry as local
from fibercontact.local import template as local_template
from fibercontact.problem.cone import COULOMB
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

ROOT = Path(__file__).parents[1]
KNOWN = registered()
METHODS = [
    "admm", "apgd", "cadoux-apgd", "cadoux-spg", "interior-point", "newton-ac", "newton-fb", "spg",
]  # fmt: skip
FACTORISING = ["admm", "interior-point", "newton-ac", "newton-fb"]
FIRST_ORDER = [name for name in METHODS if name not in FACTORISING]
SMALL = ["cylinder-straight-40-mu0.1-043", "head-straight-96-mu0.2-148", "wisp-straight-19-mu0.3-007"]
FCLIB = sorted((ROOT.parent / "shared" / "fclib").glob("*.hdf5"))[:1]


def whole(problem):
    return problem if isinstance(problem, IncrementalProblem) else problem.condense()


def problems():
    """Small problems by name; those of the files are read when asked for."""
    yield from ((name, whole(step)) for name, step in STEPS.items())
    for file in [*(ROOT / "problems" / "core306" / f"{name}.hdf5" for name in SMALL), *FCLIB]:
        yield file.stem, whole(read(file).problem)


PROBLEMS = dict(problems())


@cache
def prepared(name):
    """Compiled before any clock starts."""
    method = configure(name, KNOWN)
    method.prepare()
    return method


def solve(name, problem, tolerance=1e-8, iterations=20_000, seconds=60.0, start=None):
    method = prepared(name)
    return method.solve(block_system(problem), Task(tolerance, problem.b_ref, iterations, seconds, start))


def dense(problem):
    return problem.W.toarray()


# What they claim


def test_the_built_in_methods_are_one_a_file():
    files = {f.stem.replace("_", "-") for f in Path(methods.__file__).parent.glob("*.py")} - {"--init--"}
    assert {name for name, entry in KNOWN.items() if is_global(entry)} == files == set(METHODS)
    assert not files & set(local.registered())
    assert all(isinstance(configure(name, KNOWN), ConfiguredMethod) for name in METHODS)


@pytest.mark.parametrize("problem", PROBLEMS)
@pytest.mark.parametrize("name", METHODS)
def test_small_problems_are_solved_and_the_answer_obeys_the_law(name, problem):
    p = PROBLEMS[problem]
    found = solve(name, p)
    own = residual(dense(p), p.b, p.mu, found.r)
    assert found.claimed == (own <= 1e-8)
    assert found.claimed, (own, found.note)
    assert found.residual == pytest.approx(own, rel=1e-3, abs=1e-13)


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("problem", ["stiff", "moving", SMALL[2]])
def test_velocities_are_those_of_the_sweeps(name, problem):
    """Weak friction or few contacts: one velocity solves, however it is found."""
    p = PROBLEMS[problem]
    sweeps = GaussSeidel(local.configure("secular", local.registered()), 1e-12).solve(p).r
    u = p.W @ solve(name, p, 1e-10).r
    np.testing.assert_allclose(u, p.W @ sweeps, atol=1e-8 * p.b_ref)


@given(
    seed=st.integers(0, 10**6),
    mu=st.sampled_from([0.0, 0.1, 0.5, 1.0, 3.0]),
    contacts=st.integers(1, 14),
    dofs=st.integers(4, 12),
    spread=st.sampled_from([1.0, 1e3, 1e8]),
    tolerance=st.sampled_from([1e-2, 1e-6, 1e-12]),
    name=st.sampled_from(METHODS),
)
def test_a_claim_is_true_and_its_absence_too(seed, mu, contacts, dofs, spread, tolerance, name):
    p = strands(seed, rods=3, dofs=dofs, contacts=contacts, mu=mu, spread=spread).condense()
    found = solve(name, p, tolerance, iterations=300)
    assert np.isfinite(found.r).all()
    assert found.iterations <= 300
    assert found.claimed == (residual_from_r(p, found.r) <= tolerance * p.b_ref)
    assert found.claimed == (found.note == "")
    if found.claimed:
        assert residual(dense(p), p.b, p.mu, found.r) <= tolerance + 1e-13


def residual_from_r(problem, r):
    system, u = block_system(problem), np.empty_like(r)
    velocity(system, r, u)
    return residual_from(system, r, u, COULOMB)


@pytest.mark.parametrize("name", METHODS)
def test_the_same_input_gives_the_same_bits_and_is_not_written_to(name):
    p = PROBLEMS["rank deficient"]
    system, start = block_system(p), np.tile([1.0, 0.1, 0.0], p.n)
    kept, first = [a.copy() for a in (*system[:-1], *system.parts)], start.copy()
    method = prepared(name)
    answers = [method.solve(system, Task(1e-6, p.b_ref, 500, 20.0, start)) for _ in range(2)]
    np.testing.assert_array_equal(answers[0].r, answers[1].r)
    assert answers[0].iterations == answers[1].iterations
    np.testing.assert_array_equal(start, first)
    for before, after in zip(kept, (*system[:-1], *system.parts), strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("name", METHODS)
def test_units_do_not_matter(name):
    """`W → 4ᵏ W`, `b → 2ᵐ b` changes no bit but the exponents, and no count."""
    p = PROBLEMS["mixed mu"]
    scale_W, scale_b = 2.0**20, 2.0**-13
    other = IncrementalProblem(bsr_array(scale_W * p.W), scale_b * p.b, p.mu)
    first, second = solve(name, p, iterations=200), solve(name, other, iterations=200)
    assert first.iterations == second.iterations
    np.testing.assert_array_equal(second.r * (scale_W / scale_b), first.r)


@pytest.mark.parametrize("name", METHODS)
def test_turned_tangents_turn_the_answer(name):
    p = PROBLEMS["moving"]
    rng = np.random.default_rng(0)
    Q = block_diag([turned(angle) for angle in rng.uniform(0, 6, p.n)], format="bsr")
    W = (Q.T @ p.W @ Q).toarray()
    other = IncrementalProblem.from_sparse(csr_array(0.5 * (W + W.T)), Q.T @ p.b, p.mu)
    found, back = solve(name, p, 1e-10), solve(name, other, 1e-10)
    np.testing.assert_allclose(Q @ (W @ back.r), p.W @ found.r, atol=1e-8 * p.b_ref)


# Finding them

PLUGIN = '''"""Leave everything as it is."""
import numpy as np
from fibercontact.global_methods.contract import Answer, GlobalMethod
from fibercontact.local.contract import Option

def solve(system, task, options):
    return Answer(np.full(len(system.b), options[0]), False, 0)

solver = GlobalMethod(solve, options={"size": Option(0.0, "of the impulses")})
'''


def plugin(folder, name="still.py"):
    file = folder / name
    file.write_text(PLUGIN, encoding="utf-8")
    return file


def test_a_plugin_holds_a_solver_of_either_kind(tmp_path):
    local_file = tmp_path / "mine.py"
    local_file.write_text(Path(local_template.__file__).read_text(encoding="utf-8"), encoding="utf-8")
    known = registered([plugin(tmp_path), local_file])
    assert (is_global(known["still"]), is_global(known["mine"])) == (True, False)
    assert known["still"].summary == "Leave everything as it is."
    method = configure("still:size=2", known)
    system = block_system(PROBLEMS["stiff"])
    np.testing.assert_array_equal(method.solve(system, Task(1e-4, 1.0, 1, 1.0)).r, np.full(24, 2.0))
    assert isinstance(configure("mine", known), local.Configured)


def test_what_takes_local_solvers_says_that_this_is_none(tmp_path):
    file = plugin(tmp_path)
    with pytest.raises(local.SolverError, match="no LocalSolver named 'solver' in it but a GlobalMethod"):
        local.registered([file])


@pytest.mark.parametrize(
    ("specification", "message"),
    [
        ("newton", r"unknown solver 'newton' \(known: admm, apgd, .*secular, spg\)"),
        ("admm:speed=3", r"unknown option 'speed' \(known: rho, unbalanced, patience\)"),
        ("spg:rho=1", r"unknown option 'rho' \(known: none\)"),
    ],
)
def test_a_wrong_specification_is_refused(specification, message):
    with pytest.raises(local.SolverError, match=message):
        configure(specification, KNOWN)


def test_an_installed_package_adds_a_method(monkeypatch):
    point = SimpleNamespace(
        name="theirs", load=lambda: apgd.solver, module=apgd.__name__, dist=SimpleNamespace(name="somewhere")
    )
    monkeypatch.setattr(
        global_registry,
        "entry_points",
        lambda group: [point] if group == global_registry.ENTRY_POINTS else [],
    )
    entry = registered()["theirs"]
    assert (entry.origin, entry.solver) == ("package somewhere", apgd.solver)
    assert entry.documentation == apgd.__doc__


# Limits and starts


@pytest.mark.parametrize("name", METHODS)
def test_budgets_are_kept(name):
    p = PROBLEMS[SMALL[0]]
    short = solve(name, p, iterations=2)
    assert short.iterations <= 2
    assert not short.claimed
    assert "iterations" in short.note or name == "interior-point"
    late = solve(name, p, seconds=0.0)
    assert late.iterations <= 1
    assert not late.claimed
    assert "time" in late.note or name == "interior-point"


@pytest.mark.parametrize("name", [name for name in METHODS if name != "interior-point"])
def test_a_start_at_the_answer_takes_no_iteration(name):
    p = PROBLEMS["stiff"]
    found = solve(name, p, 1e-10)
    again = solve(name, p, 1e-8, start=found.r)
    assert (again.claimed, again.iterations) == (True, 0)
    np.testing.assert_allclose(again.r, found.r, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("start", [np.zeros(5), np.full(24, np.nan)])
@pytest.mark.parametrize("name", ["spg", "newton-ac"])
def test_a_start_that_does_not_fit_is_refused(name, start):
    with pytest.raises(ValueError, match=r"finite vector of shape \(24,\)"):
        solve(name, PROBLEMS["stiff"], start=start)


@pytest.mark.parametrize("name", METHODS)
def test_a_start_beyond_all_measure_is_no_answer(name):
    with np.errstate(all="ignore"):
        found = solve(name, PROBLEMS["stiff"], iterations=5, start=np.full(24, 1e308))
    assert found.r.shape == (24,)
    assert not found.claimed
    assert "not finite" in found.note or name == "interior-point"


@pytest.mark.parametrize("name", METHODS)
def test_contacts_that_part_and_no_contacts_at_all(name):
    apart = IncrementalProblem.from_sparse(eye_array(6), np.array([1.0, 0, 0, 2.0, 1, 0]), np.full(2, 0.5))
    found = solve(name, apart)
    assert found.claimed
    np.testing.assert_allclose(found.r, 0.0, atol=1e-7)
    still = replace(apart, b=np.zeros(6))
    assert solve(name, still).claimed


@pytest.mark.parametrize("name", FACTORISING)
def test_problems_that_may_not_fit_into_memory_are_refused(name, monkeypatch):
    monkeypatch.setattr(scaled, "LARGEST", 7)
    with pytest.raises(Unsuited, match="at most 7 contacts, not 8"):
        solve(name, PROBLEMS["stiff"])


# What they are made of


def test_the_scaled_problem_is_the_problem():
    p = PROBLEMS["mixed mu"]
    s, rng = scale(block_system(p)), np.random.default_rng(1)
    root = np.repeat(np.sqrt(p.sigma), 3)
    np.testing.assert_allclose(matrix(s.A, s.A.blocks).toarray(), dense(p) / root / root[:, None], rtol=1e-12)
    np.testing.assert_array_equal(matrix(block_system(p), block_system(p).blocks).toarray(), dense(p))
    r = rng.standard_normal(3 * p.n)
    y, Ax = np.empty((2, 3 * p.n))
    velocity(s.A, root * r, y)
    velocity(s.linear, root * r, Ax)
    np.testing.assert_allclose(y, (dense(p) @ r + p.b) / root, rtol=1e-9)
    np.testing.assert_allclose(Ax, dense(p) @ r / root, rtol=1e-9)
    assert cone_residual(s, NO_SLIP, root * r, y) == pytest.approx(residual_from_r(p, r), rel=1e-9)


@pytest.mark.parametrize(
    ("begin", "run", "tolerance"),
    [(begin_spectral, spectral, 1e-9), (begin_accelerated, accelerated, 1e-11)],
    ids=["spg", "apgd"],
)
@pytest.mark.parametrize("problem", ["stiff", "rank deficient", "mixed mu"])
def test_with_a_frozen_slip_term_the_convex_problem_is_solved(begin, run, tolerance, problem):
    """Optimality: `x ∈ K`, `g ∈ K*`, `x·g = 0` at every contact; and no point of the cones is lower.

    Where W lacks rank, the last bit of b decides whether spg gets below 1e-9.
    """
    p = scale(block_system(PROBLEMS[problem]))
    n, rng = len(p.root), np.random.default_rng(2)
    slip = rng.uniform(0, 1, n) * p.A.mu
    m = begin(p, np.zeros(3 * n))
    _, reached = run(p, slip, m, tolerance, 50_000)
    assert reached
    A, load = matrix(p.A, p.A.blocks).toarray(), p.A.b + np.kron(slip, [1.0, 0.0, 0.0])
    x, g = m.best, A @ m.best + load
    for i in range(n):
        at = slice(3 * i, 3 * i + 3)
        np.testing.assert_allclose(project(x[at] - g[at], p.A.mu[i]), x[at], atol=100 * tolerance)

    def q(x):
        return 0.5 * x @ A @ x + load @ x

    for step in 10.0 ** rng.uniform(-4, 1, 100):
        z = x + step * rng.standard_normal(3 * n)
        other = np.concatenate([project(z[3 * i : 3 * i + 3], p.A.mu[i]) for i in range(n)])
        assert q(x) <= q(other) + 100 * tolerance


@pytest.mark.parametrize("momentum", [spectral, accelerated])
def test_without_friction_the_slip_term_does_not_matter(momentum):
    p = scale(block_system(replace(PROBLEMS["stiff"], mu=np.zeros(8))))
    begin = begin_spectral if momentum is spectral else begin_accelerated
    runs = [begin(p, np.zeros(24)) for _ in range(2)]
    for m, slip in zip(runs, (NO_SLIP, np.zeros(8)), strict=True):
        momentum(p, slip, m, 1e-9, 1000)
    np.testing.assert_array_equal(runs[0].best, runs[1].best)


FUNCTIONS = {
    "ac": (newton_ac, np.array([0.1, 1.0, 1.0, 0.0])),
    "ac, other disc and steps": (newton_ac, np.array([0.1, 1.0, 0.3, 1.0])),
    "fb": (newton_fb, np.array([0.1, 1.0])),
}


@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.parametrize("problem", ["dense", "mixed mu"])
def test_the_jacobian_of_all_contacts(function, problem):
    """By finite differences, at a point with contacts of every regime."""
    module, options = FUNCTIONS[function]
    p = scale(block_system(PROBLEMS[problem]))
    n = len(p.root)
    x = np.random.default_rng(3).standard_normal(3 * n)

    def at(x):
        point = Point(x, np.empty(3 * n), np.empty(3 * n), *np.zeros((2, n, 3, 3)))
        velocity(p.A, x, point.y)
        module.evaluate(p, options, point)
        return point

    rows = np.empty_like(p.A.blocks)
    jacobian(p, at(x), 0.0, rows)
    J = matrix(p.A, rows).toarray()
    np.testing.assert_allclose(J, finite_differences(lambda x: at(x).f, x), atol=1e-6)
    jacobian(p, at(x), 0.5, rows)
    shifted = J + 0.5 * block_diag(list(at(x).Q)).toarray()
    np.testing.assert_allclose(matrix(p.A, rows).toarray(), shifted, atol=1e-12)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_the_function_of_all_contacts_vanishes_at_the_answer(function):
    module, options = FUNCTIONS[function]
    problem = PROBLEMS["mixed mu"]
    p = scale(block_system(problem))
    n = len(p.root)
    x = np.repeat(p.root, 3) * solve("apgd", problem, 1e-12).r
    point = Point(x, np.empty(3 * n), np.empty(3 * n), *np.zeros((2, n, 3, 3)))
    velocity(p.A, x, point.y)
    module.evaluate(p, options, point)
    np.testing.assert_allclose(point.f, 0.0, atol=1e-9)


def test_newton_without_the_shift_meets_a_singular_jacobian():
    """Two contacts at one place hold a mass together: how they share the impulse is open."""
    W, b = np.kron(np.ones((2, 2)), np.eye(3)), np.tile([-1.0, 0.1, 0.2], 2)
    p = IncrementalProblem.from_sparse(csr_array(W), b, np.full(2, 0.5))
    found = solve("newton-ac", p)
    assert found.claimed
    np.testing.assert_allclose(found.r[:3] + found.r[3:], -b[:3], atol=1e-6)
    alone = solve("newton-ac:shift=0", p)
    assert (alone.claimed, alone.note) == (False, "the Jacobian is singular")


@pytest.mark.parametrize("name", ["newton-ac", "newton-fb"])
def test_newton_with_a_line_search_solves_what_is_easy(name):
    p = PROBLEMS["stiff"]
    assert solve(f"{name}:line_search=1", p).claimed
    best = [solve(f"{name}:line_search=1", p, iterations=k).residual for k in range(6)]
    assert best == sorted(best, reverse=True)
    assert best[-1] < 0.1 * best[0]


@pytest.mark.parametrize("rho", [1e-3, 1.0])
def test_the_penalty_of_admm_is_balanced(rho):
    p = scale(block_system(PROBLEMS["dense"]))
    A, load = matrix(p.A, p.A.blocks), np.random.default_rng(4).standard_normal(3 * len(p.root))
    penalty = admm._Penalty(A.tocsc(), rho, 5.0, 2)
    for _ in range(2):
        np.testing.assert_allclose((A + rho * eye_array(len(load))) @ penalty.solve(load), load, atol=1e-9)
    penalty.balance(load, load)
    assert penalty.rho == rho
    penalty.balance(100.0 * load, load)  # too far from consensus: a stiffer penalty
    assert penalty.rho == pytest.approx(10.0 * rho)
    penalty.balance(load, 100.0 * load)  # too soon
    assert penalty.rho == pytest.approx(10.0 * rho)


def test_options_of_newton_begin_with_those_they_share():
    for name in ("newton-ac", "newton-fb"):
        assert list(KNOWN[name].solver.options)[: len(NEWTON_OPTIONS)] == list(NEWTON_OPTIONS)


def test_measured_as_the_harness_measures():
    p = PROBLEMS["dense"]
    found = solve("apgd", p, 1e-4)
    assert found.residual == pytest.approx(measure(p, found.r).residual, rel=1e-6)
