"""Existence with its certificates, other solutions, distances, and ground truth on disk."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracles import coulomb_solutions, residual, strands, walls
from scipy.linalg import null_space

from fibercontact.files import replace_file
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference import store
from fibercontact.reference.distance import friction_work, velocity_error
from fibercontact.reference.existence import SOLVABLE, UNDECIDED, UNSOLVABLE, existence, recheck
from fibercontact.reference.ground_truth import Search, ground_truth
from fibercontact.reference.store import Store, StoreError
from fibercontact.reference.truth import NONE, reference
from fibercontact.reference.uniqueness import DIFFERENT, random_impulse, uniqueness

TWO_SOLUTIONS = Path(__file__).parents[2] / "shared" / "fclib" / "OneObject-i100000-316.hdf5"
QUICK = Search(max_seconds=10.0, starts=1)


def in_both_forms(seed):
    step = strands(seed, mu=0.6)
    return step, step.condense()


# Existence


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("form", [0, 1], ids=["velocities", "impulses"])
def test_a_solvable_problem_has_a_velocity_inside_all_dual_cones(seed, form):
    """`u = b + W z ∈ int K_mu*`; with `w = 0` there is one, for `b` is in the range of `W`."""
    problem = in_both_forms(seed)[form]
    found, (_, incremental) = existence(problem), in_both_forms(seed)
    assert found.verdict == SOLVABLE
    u = (incremental.W @ found.certificate + incremental.b).reshape(-1, 3)
    slack = (u[:, 0] - incremental.mu * np.hypot(u[:, 1], u[:, 2])).min() / incremental.b_ref
    assert 0.0 < found.margin <= slack


@pytest.mark.parametrize("closing", [1e-3, 1.0, 1e3])
def test_walls_that_close_in_have_a_farkas_certificate(closing):
    problem = walls(closing)
    found = existence(problem)
    assert found.verdict == UNSOLVABLE
    r = found.certificate.reshape(-1, 3)
    assert (r[:, 0] >= 0).all()
    assert (r[:, 1:] == 0).all()
    assert problem.b @ found.certificate < 0
    assert found.margin > 1e3


@pytest.mark.parametrize(("closing", "verdict"), [(0.0, UNDECIDED), (-1.0, SOLVABLE)])
def test_walls_at_rest_decide_nothing(closing, verdict):
    """`u_N1 + u_N2 = 0`: no velocity is strictly inside, and none need penetrate."""
    assert existence(walls(closing)).verdict == verdict


def test_a_certificate_of_one_verdict_proves_no_other():
    solvable, unsolvable = strands(1).condense(), walls()
    z, r = existence(solvable).certificate, existence(unsolvable).certificate
    assert recheck(solvable, UNSOLVABLE, z) == 0.0
    assert recheck(unsolvable, SOLVABLE, r) <= 0.0
    assert recheck(solvable, UNDECIDED, z) == 0.0
    assert recheck(solvable, SOLVABLE, np.full_like(z, np.nan)) == 0.0


@given(seed=st.integers(0, 200), noise=st.floats(0, 2))
def test_a_margin_is_never_more_than_the_exact_slack(seed, noise):
    """In exact arithmetic, by fractions, for certificates good and bad; ‖u_T‖ compared by squares."""
    problem = strands(seed % 5, contacts=4).condense()
    z = existence(problem).certificate
    z = z + noise * np.abs(z).max() * np.random.default_rng(seed).standard_normal(z.size)
    margin = recheck(problem, SOLVABLE, z)
    W, exact = problem.W.toarray(), [Fraction(float(x)) for x in z]
    u = [sum(Fraction(float(w)) * x for w, x in zip(row, exact, strict=True)) + Fraction(float(c))
         for row, c in zip(W, problem.b, strict=True)]  # fmt: skip
    for i in range(problem.n):
        beyond = u[3 * i] - Fraction(margin) * Fraction(problem.b_ref) * (1 - Fraction(1, 10**9))
        if margin > 0:
            mu = Fraction(float(problem.mu[i]))
            assert beyond >= 0
            assert beyond**2 >= mu**2 * (u[3 * i + 1] ** 2 + u[3 * i + 2] ** 2)


# Other solutions


def painleve():
    """One contact whose law has several solutions: take-off, and stick with an impulse."""
    W = np.array([[1.0, -0.9, 0.0], [-0.9, 1.0, 0.0], [0.0, 0.0, 1.0]])
    r = np.array([1.0, 1.5, 0.0])
    return IncrementalProblem.from_sparse(W, -W @ r, np.array([2.0]))


def test_a_contact_with_several_solutions_shows_them():
    problem = painleve()
    known = coulomb_solutions(problem.W.toarray(), problem.b, 2.0)
    assert len(known) > 1
    found = uniqueness(problem, reference(problem), np.array([1.0, 1.5, 0.0]), 1e-10, 5.0, 1)
    assert (found.tried, found.reached, len(found.others)) == (1, 1, 1)
    assert found.distance > DIFFERENT
    assert min(np.abs(found.others[0] - r).max() for r in known) <= 1e-8


@pytest.mark.parametrize(
    "path", [path for path in [TWO_SOLUTIONS] if path.exists()], ids=lambda path: path.stem
)
@pytest.mark.filterwarnings("ignore::fibercontact.problem.incremental.ProblemWarning")
def test_a_known_problem_with_two_solutions_shows_them(path):
    problem = read(path).problem
    truth = ground_truth(problem, Search(starts=4))
    W = problem.W.toarray()
    assert len(truth.uniqueness.others) >= 1
    for r in (truth.reference.r, *truth.uniqueness.others):
        assert residual(W, problem.b, problem.mu, r) <= 1.01e-10


@pytest.mark.parametrize("seed", range(2))
def test_strands_with_little_friction_have_one_solution(seed):
    step = strands(seed, mu=0.1)
    found = uniqueness(step, reference(step), np.zeros(3 * step.n), 1e-10, 5.0, 3)
    assert (found.reached, found.others) == (3, ())
    assert found.distance <= 1e-6


def test_without_friction_no_start_is_tried():
    step = strands(1, mu=0.0)
    assert uniqueness(step, reference(step), np.zeros(3 * step.n), 1e-10, 5.0, 3).tried == 0


def test_a_random_start_is_in_the_cones_and_the_same_every_time():
    problem = strands(2).condense()
    r = random_impulse(problem, np.ones(3 * problem.n), 1)
    assert (r == random_impulse(problem, np.ones(3 * problem.n), 1)).all()
    assert (r != random_impulse(problem, np.ones(3 * problem.n), 2)).any()
    np.testing.assert_allclose(np.hypot(r[1::3], r[2::3]), problem.mu * r[::3])
    assert (r[::3] > 0).all()


# Distances


@given(seed=st.integers(0, 1000))
def test_both_norms_of_velocities_agree(seed):
    """`‖v − v'‖_M` from the step and `‖r − r'‖_W` from its condensation; only what they are relative to differs."""
    step = strands(seed)
    problem = step.condense()
    r, r_ref = np.random.default_rng(seed).standard_normal((2, 3 * step.n))
    v, v_ref = step.velocities(r), step.velocities(r_ref)
    expected = np.sqrt((v - v_ref) @ step.M @ (v - v_ref))
    in_velocities = velocity_error(step, r, r_ref) * np.sqrt(v_ref @ step.M @ v_ref)
    in_impulses = velocity_error(problem, r, r_ref) * np.sqrt(r_ref @ (problem.W @ r_ref))
    assert in_velocities == pytest.approx(expected, rel=1e-9)
    assert in_impulses == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("as_step", [True, False])
def test_impulses_that_move_nothing_are_no_error(as_step):
    step = strands(6, rods=2, dofs=9, contacts=10)
    problem = step.condense()
    r = np.random.default_rng(6).standard_normal(3 * step.n)
    nothing = null_space(step.H.toarray().T, rcond=1e-9)[:, 0]
    assert velocity_error(step if as_step else problem, r + nothing, r) <= 1e-6


def test_the_work_of_friction_does_not_cancel():
    """Dissipation counts, creation does not."""
    u = np.array([0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 5.0, 0.0, 2.0])
    r = np.array([1.0, -0.5, 0.0, 1.0, 0.5, 0.0, 1.0, 0.0, -1.0])
    assert friction_work(u, r) == pytest.approx(0.5 + 2.0)


# The store


def forbidden(*_):
    raise AssertionError("computed again")


@pytest.fixture
def shelf(tmp_path):
    """A store with one step, and what was found of it."""
    step, place = strands(4, mu=0.3), Store(tmp_path / "set.references.hdf5")
    return step, place, place.find("one", "the first", step, QUICK)


def same(a, b):
    return (
        (a.reference.r == b.reference.r).all()
        and replace(a.reference, r=None) == replace(b.reference, r=None)
        and (a.existence.certificate == b.existence.certificate).all()
        and (a.existence.verdict, a.existence.margin) == (b.existence.verdict, b.existence.margin)
        and (a.associated == b.associated).all()
        and (a.gap, a.seconds) == (b.gap, b.seconds)
        and (a.uniqueness.tried, a.uniqueness.reached) == (b.uniqueness.tried, b.uniqueness.reached)
        and all((x == y).all() for x, y in zip(a.uniqueness.others, b.uniqueness.others, strict=True))
    )


@pytest.mark.parametrize("packed", [False, True])
def test_what_is_stored_is_not_computed_again(shelf, monkeypatch, packed):
    step, place, first = shelf
    if packed:
        place.pack()
        assert not place.parts.exists()
    monkeypatch.setattr(store, "ground_truth", forbidden)
    assert same(place.find("one", "the first", step, QUICK), first)


def test_other_solutions_are_stored(tmp_path):
    problem, place = painleve(), Store(tmp_path / "set.hdf5")
    found = ground_truth(problem, Search(starts=0))
    other = replace(found, uniqueness=replace(found.uniqueness, others=(np.array([1.0, 1.5, 0.0]),)))
    place.put("key", "name", problem, other, Search(starts=0))
    assert same(place.get("key", problem, Search(starts=0)), other)


def test_another_solution_that_is_none_is_not_given_back(shelf):
    step, place, _ = shelf
    with h5py.File(place.parts / "one.hdf5", "r+") as file:
        file["one/others/0/r"] = np.ones(3 * step.n)
    assert place.get("one", step, QUICK).uniqueness.others == ()


def test_the_solution_is_a_group_of_fclib(shelf):
    step, place, first = shelf
    place.pack()
    with h5py.File(place.file) as file:
        solution = {name: values[()] for name, values in file["one/solution"].items()}
        assert file["one"].attrs["name"] == "the first"
    assert set(solution) == {"v", "u", "r"}
    np.testing.assert_allclose(solution["u"], step.H @ solution["v"] + step.w, atol=1e-12)
    np.testing.assert_allclose(step.M @ solution["v"] + step.f, step.H.T @ solution["r"], atol=1e-9)
    assert (solution["r"] == first.reference.r).all()


def test_packing_keeps_what_was_packed_and_prefers_what_is_new(shelf):
    step, place, first = shelf
    place.pack()
    other = strands(5, mu=0.3)
    place.find("two", "the second", other, QUICK)
    place.put("one", "renamed", step, first, QUICK)
    place.pack()
    with h5py.File(place.file) as file:
        assert {key: group.attrs["name"] for key, group in file.items()} == {
            "one": "renamed",
            "two": "the second",
        }


def test_what_a_killed_run_left_half_written_is_no_part(shelf):
    _, place, _ = shelf
    (place.parts / ".two.abcd1234.hdf5").write_bytes(b"")
    assert place.keys() == {"one"}
    place.pack()
    assert place.keys() == {"one"}


def test_what_another_run_stores_during_the_packing_is_kept(shelf, monkeypatch):
    step, place, found = shelf

    def slow(path, content):
        replace_file(path, content)
        if path == place.file:
            place.put("two", "the second", step, found, QUICK)

    monkeypatch.setattr(store, "replace_file", slow)
    place.pack()
    assert place.keys() == {"one", "two"}


@pytest.mark.parametrize(
    "search", [replace(QUICK, bar=1e-20), replace(QUICK, starts=2)], ids=["bar", "starts"]
)
def test_a_search_that_asks_for_more_is_made(shelf, monkeypatch, search):
    step, place, _ = shelf
    monkeypatch.setattr(store, "ground_truth", forbidden)
    with pytest.raises(AssertionError, match="computed again"):
        place.find("one", "the first", step, search)


@pytest.mark.parametrize("name", ["solution/r", "certificate"])
def test_what_a_file_claims_is_measured(shelf, name):
    step, place, _ = shelf
    with h5py.File(place.parts / "one.hdf5", "r+") as file:
        file["one"][name][:] *= -1.0
    found = place.get("one", step, QUICK)
    assert found is None if name == "solution/r" else found.existence.verdict == UNDECIDED


def test_a_best_known_answer_is_never_the_truth_and_not_sought_again_alike(tmp_path, monkeypatch):
    problem, place, search = walls(), Store(tmp_path / "set.hdf5"), Search(max_seconds=0.5)
    first = place.find("key", "walls", problem, search)
    assert (first.reference.method, first.reference.accepted) == (NONE, False)
    assert first.existence.verdict == UNSOLVABLE
    with h5py.File(place.parts / "key.hdf5") as file:
        assert "solution" not in file["key"]
        assert "best_known" in file["key"]
    monkeypatch.setattr(store, "ground_truth", forbidden)
    assert same(place.find("key", "walls", problem, search), first)
    with pytest.raises(AssertionError, match="computed again"):
        place.find("key", "walls", problem, Search(max_seconds=0.6))


def test_a_best_known_answer_is_the_truth_where_less_is_asked(tmp_path):
    step, place = strands(4, mu=0.3), Store(tmp_path / "set.hdf5")
    strict = Search(bar=1e-20, max_seconds=0.5, starts=0)
    assert not place.find("key", "name", step, strict).reference.accepted
    found = place.get("key", step, replace(strict, bar=1e-8)).reference
    assert found.accepted
    assert found.method == min(found.attempts, key=lambda attempt: attempt.residual).method


@pytest.mark.parametrize("damage", ["not HDF5", "no residual", "shape"])
def test_a_damaged_store_is_an_error_that_names_it(shelf, damage):
    step, place, _ = shelf
    part = place.parts / "one.hdf5"
    if damage == "not HDF5":
        part.write_bytes(b"not HDF5")
    else:
        with h5py.File(part, "r+") as file:
            if damage == "shape":
                del file["one/solution/r"]
                file["one/solution/r"] = np.zeros(2)
            else:
                del file["one/certificate"]
    with pytest.raises(StoreError, match=r"one\.hdf5"):
        place.get("one", step, QUICK)
