"""One-contact problems: their file, their replay, the verdict, the table of level 1 and the harvest."""

import dataclasses
import textwrap
from functools import cache

import h5py
import numpy as np
import oracles
import pandas as pd
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse import csr_array, eye_array
from typer.testing import CliRunner

from fibercontact.bench import harvest as harvesting
from fibercontact.bench.contact_verdict import INACCURATE_ANSWER, judge, tolerances
from fibercontact.bench.harvest import harvest
from fibercontact.bench.level1 import Plan, batches, measure
from fibercontact.bench.level1_report import solver_table, strata
from fibercontact.bench.problem_set import load_set
from fibercontact.cli import app
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.local.contract import Status
from fibercontact.local.one_contact import (
    OneContacts,
    Replay,
    read,
    read_counts,
    replay,
    replay_all,
    residuals,
    write,
)
from fibercontact.local.registry import configure, registered
from fibercontact.problem import fclib
from fibercontact.problem.incremental import ProblemError
from fibercontact.problem.step import StepProblem

SOLVERS = ["pyramid", "pac", "dac", "mfb", "enum-quartic", "enum-companion", "hybrid", "secular"]


@cache
def configured(name):
    return configure(name, registered())


def contacts(m=30, seed=0, family="uniform: test"):
    """Random contacts, pressed or not, with starts and some answers."""
    rng = np.random.default_rng(seed)
    W = np.array([oracles.definite(rng, 10.0 ** rng.uniform(0, 4)) for _ in range(m)]).reshape(m, 3, 3)
    answer = np.where(rng.uniform(size=(m, 1)) < 0.5, np.nan, rng.standard_normal((m, 3)))
    return OneContacts(
        W,
        rng.standard_normal((m, 3)),
        rng.uniform(0, 1, m),
        rng.standard_normal((m, 3)),
        np.full(m, family),
        answer,
    )


def same(one, other):
    for f in dataclasses.fields(OneContacts):
        np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name))


# The set


@pytest.mark.parametrize(
    ("name", "value", "fault"),
    [
        ("W", np.zeros((4, 3, 3)), r"W must have shape \(3, 3, 3\) like mu"),
        ("W", np.zeros((3, 3, 3), dtype=np.float32), "W must be a float64 array"),
        ("W", np.zeros((3, 3, 3)), "W has no positive trace at contact 0"),
        ("W", np.arange(27.0).reshape(3, 3, 3), "W is not symmetric at contact 0"),
        ("W", np.full((3, 3, 3), np.nan), "W is not finite"),
        ("b", np.zeros((3, 2)), "b must have shape"),
        ("b", np.array([[0, 0, 0], [0, 0, 0], [0, np.inf, 0.0]]), r"b is not finite \(inf\) at contact 2"),
        ("mu", np.array([0.1, -0.1, 0.1]), "mu is negative"),
        ("start", np.full((3, 3), np.nan), "start is not finite"),
        ("answer", np.array([[np.nan, 0, 0]] * 3), "answer must be finite, or NaN throughout"),
        ("answer", np.full((3, 3), np.inf), "answer must be finite, or NaN throughout"),
        ("family", np.array(["a", "b"]), "family must be 3 strings"),
        ("family", np.array([1, 2, 3]), "family must be 3 strings"),
    ],
)
def test_faults_are_named(name, value, fault):
    with pytest.raises(ProblemError, match=fault):
        dataclasses.replace(contacts(3), **{name: value})


def test_parts_joined_are_the_whole():
    c = contacts(10)
    same(
        OneContacts.join([c.select(c.mu > 0.5), c.select(c.mu <= 0.5)]),
        c.select(np.argsort(c.mu <= 0.5, kind="stable")),
    )
    same(c.select([3, 3]), OneContacts.join([c.select([3])] * 2))


def test_condition_numbers():
    W = np.array([np.diag([1.0, 10.0, 100.0]), np.diag([1.0, 1.0, 0.0]), np.diag([2.0, 2.0, 2.0])])
    c = dataclasses.replace(contacts(3), W=W)
    np.testing.assert_allclose(c.condition, [100, np.inf, 1])


# The file


@given(st.integers(0, 12), st.integers(0, 99))
def test_a_file_gives_back_what_it_was_given(tmp_path_factory, m, seed):
    path = tmp_path_factory.mktemp("set") / "set.h5"
    c = contacts(m, seed)
    c = dataclasses.replace(c, family=np.array([f"wärm: {k % 3}" for k in range(m)], dtype=str))
    write(path, c, {"visits": 10**12, "hard: pac": 0})
    same(read(path), c)
    assert read_counts(path) == {"visits": 10**12, "hard: pac": 0}


def test_there_may_be_as_many_families_as_contacts(tmp_path):
    c = contacts(1).select(np.zeros(33_000, dtype=int))
    c = dataclasses.replace(c, family=np.arange(c.m).astype(str))
    write(tmp_path / "set.h5", c)
    same(read(tmp_path / "set.h5"), c)


def test_the_same_set_gives_the_same_bytes(tmp_path):
    write(tmp_path / "a.h5", contacts())
    write(tmp_path / "b.h5", contacts())
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    assert read_counts(tmp_path / "a.h5") == {}


def spoil(path, change):
    write(path, contacts(4))
    with h5py.File(path, "r+") as file:
        change(file)


def swap(name, value):
    def change(file):
        del file[name]
        if value is not None:
            file[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        *[(swap(name, None), f"{name} is missing") for name in ("W", "b", "mu", "start", "answer")],
        *[(swap(name, None), f"{name} is missing") for name in ("family", "families")],
        (swap("W", np.zeros((4, 9))), r"W has shape \(4, 9\), not \(4, 6\)"),
        (swap("b", np.zeros((3, 3))), r"b has shape \(3, 3\), not \(4, 3\)"),
        (swap("mu", 0.3), r"mu has shape \(\)"),
        (swap("mu", np.array([1, 2, 3, 4])), "mu holds int64, not floating-point numbers"),
        (swap("b", np.full((4, 3), np.nan)), "b is not finite"),
        (swap("family", np.array([0, 0, 0, 7])), "family 7 of contact 3 has no name"),
        (swap("families", np.array([b"\\xff".decode("unicode_escape").encode("latin1")])), "not UTF-8"),
        (swap("family", np.array([0, 0])), "families and family have shapes"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_refused_by_its_name_and_its_fault(tmp_path, change, fault):
    path = tmp_path / "set.h5"
    spoil(path, change)
    with pytest.raises(ProblemError, match=fault) as raised:
        read(path)
    assert str(raised.value).startswith(f"{path}: ")


def test_files_that_are_none(tmp_path):
    (tmp_path / "text.h5").write_text("W b mu")
    for name, fault in (
        ("text.h5", "not a readable HDF5 file"),
        ("none.h5", "no such file"),
        ("", "directory"),
    ):
        for reading in (read, read_counts):
            with pytest.raises(ProblemError, match=fault):
                reading(tmp_path / name)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path):
    path = tmp_path / "set.h5"
    write(path, contacts())
    whole = path.read_bytes()
    for share in np.linspace(0, 0.999, 25):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ProblemError, match=str(path)):
            read(path)


# Replay


def as_tuples(c, k):
    W, b, start = c.W[k], c.b[k], c.start[k]
    return tuple(map(tuple, W.tolist())), tuple(b.tolist()), float(c.mu[k]), tuple(start.tolist())


@pytest.mark.parametrize("name", SOLVERS)
def test_a_replay_is_the_kernel_called_contact_by_contact(name):
    c, local = contacts(20), configured(name)
    with np.errstate(all="ignore"):  # when interpreted, numpy speaks of NaN
        found = replay(local, c)
        for k in range(c.m):
            status, r, iterations = local.kernel()(*as_tuples(c, k), local.options)
            assert (status, iterations) == (found.status[k], found.iterations[k])
            np.testing.assert_array_equal(r, found.r[k])
    assert found.seconds > 0


def test_the_replay_is_compiled_once_for_all_solvers():
    for name in SOLVERS[:3]:
        replay(configured(name), contacts(2))
    if hasattr(replay_all, "signatures"):
        assert len(replay_all.signatures) == 1


def test_a_set_that_cannot_be_written_to_is_replayed_and_measured():
    c = contacts(5)
    W = np.asfortranarray(c.W)
    W.flags.writeable = False
    np.testing.assert_array_equal(residuals(dataclasses.replace(c, W=W), c.start), residuals(c, c.start))
    found = replay(configured("secular"), dataclasses.replace(c, W=W))
    np.testing.assert_array_equal(found.r, replay(configured("secular"), c).r)


@pytest.mark.parametrize("facets", [0, 4])
def test_residuals_are_those_of_the_law(facets):
    c = contacts()
    expected = [
        oracles.local_residual(c.W[k], c.b[k], c.mu[k], c.start[k], facets) / np.linalg.norm(c.b[k])
        for k in range(c.m)
    ]
    np.testing.assert_allclose(residuals(c, c.start, facets), expected, rtol=1e-9)


def test_residuals_of_what_is_not_finite_are_infinite_and_without_load_absolute():
    c = dataclasses.replace(contacts(2), b=np.zeros((2, 3)), W=np.array([np.eye(3)] * 2), mu=np.zeros(2))
    found = residuals(c, np.array([[2.0, 0, 0], [np.nan, 0, 0]]))
    np.testing.assert_array_equal(found, [2.0, np.inf])
    with pytest.raises(ProblemError, match="r must have shape"):
        residuals(c, np.zeros((3, 3)))


# The verdict


def claim(r, status=Status.CONVERGED):
    r = np.asarray(r, dtype=float)
    return Replay(np.full(len(r), int(status)), r, np.zeros(len(r), np.int64), 0.0)


def test_what_is_claimed_is_believed_only_where_the_residual_says_so():
    c = contacts()
    right = replay(configured("secular"), c)
    assert judge(c, right, 0).solved.all()
    wrong = judge(c, claim(right.r + 1e-3), 0)
    assert set(wrong.reasons) <= {"", INACCURATE_ANSWER}
    assert (wrong.reasons == INACCURATE_ANSWER).mean() > 0.9
    assert (judge(c, claim(np.full((c.m, 3), np.nan)), 0).reasons == INACCURATE_ANSWER).all()


def test_a_right_answer_that_is_not_claimed_is_a_failure_with_its_reason():
    c = contacts(3)
    r = replay(configured("secular"), c).r
    assert set(judge(c, claim(r, Status.NO_ROOT), 0).reasons) == {"no root"}
    assert set(judge(c, claim(r, 99), 0).reasons) == {"status 99"}


def test_a_law_is_judged_by_itself():
    c = contacts(200)
    found = replay(configured("pyramid"), c)
    assert judge(c, found, 4).solved.all()
    assert not judge(c, found, 0).solved.all()
    np.testing.assert_array_equal(judge(c, found, 4).coulomb, judge(c, found, 0).residual)


def test_an_impulse_cannot_buy_tolerance_by_being_huge():
    c = dataclasses.replace(contacts(), answer=np.full((30, 3), np.nan), mu=np.full(30, 10.0))
    ones = np.ones((30, 3))
    assert tolerances(c, 1e100 * ones).max() < 2e-4
    assert (tolerances(c, 1e3 * ones) < 1.01e-6).all()
    assert not judge(c, claim(1e15 * ones), 0).solved.any()


@given(st.integers(0, 2**32 - 1), st.floats(0, 9))
def test_exact_sticks_rounded_to_doubles_always_pass(seed, decades):
    """Impulses up to 1e9 times b: what rounding leaves is granted, and little more."""
    rng = np.random.default_rng(seed)
    W = oracles.definite(rng, 10**decades)
    r = np.linalg.eigh(W)[1][:, 0]
    assume(abs(r[0]) > 0.1)
    r = r * np.sign(r[0])
    mu = 1.01 * np.linalg.norm(r[1:]) / abs(r[0])
    exact = np.array(W.astype(np.longdouble) @ -r.astype(np.longdouble), dtype=float)
    c = OneContacts(
        W[None], exact[None], np.array([mu]), np.zeros((1, 3)), np.array(["x"]), np.full((1, 3), np.nan)
    )
    assert judge(c, claim(r[None]), 0).solved.all()
    assert not judge(c, claim(r[None] * (1 + 1e-3)), 0).solved.any()


# The table


PLUGIN = """
'''A local solver for a test.'''
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Status

@jit
def kernel(W, b, mu, r, options):
    {body}

solver = LocalSolver(kernel)
"""
BODIES = {
    "hangs": "x = 0.0\nwhile x <= 1.0:\n    x = 0.5 * (x + 1.0)\nreturn Status.CONVERGED, (x, 0.0, 0.0), 1",
    "crashes": "options[10**15] = 1.0\nreturn Status.CONVERGED, (0.0, 0.0, 0.0), 1",
    "liar": "return Status.CONVERGED, (123.0, 0.0, 0.0), 3",
}


def plugin(folder, name):
    path = folder / f"{name}.py"
    path.write_text(PLUGIN.format(body=textwrap.indent(BODIES[name], "    ").strip()))
    return path


def two_kinds():
    known = contacts(8, 1, "known: a")
    answers = replay(configured("secular"), known).r
    unknown = dataclasses.replace(contacts(12), answer=np.full((12, 3), np.nan))
    return OneContacts.join([unknown, dataclasses.replace(known, answer=answers)])


def test_batches_are_the_kinds_in_order():
    c = OneContacts.join([contacts(2, 0, "mine"), contacts(3, 0, "known: a"), contacts(4, 0, "uniform: b")])
    assert {kind: batch.m for kind, batch in batches(c).items()} == {"uniform": 4, "known": 3, "mine": 2}
    assert list(batches(c)) == ["uniform", "known", "mine"]


def test_hanging_crashing_and_lying_plugins_have_their_rows_and_harm_no_other(tmp_path):
    plugins = [plugin(tmp_path, name) for name in BODIES]
    known = registered(plugins)
    solvers = [configure(name, known) for name in ("hangs", "secular", "crashes", "liar", "pyramid")]
    plan = Plan(two_kinds(), solvers, plugins, repetitions=2, seconds=1.0)
    measured = measure(plan, lambda text: None)
    table = solver_table(measured).set_index(["solver", "kind"])
    assert list(table.index.unique("solver")) == [solver.label for solver in solvers]
    for kind, m in (("uniform", 12), ("known", 8)):
        rows = table.xs(kind, level="kind")
        assert (rows["contacts"] == m).all()
        assert rows.loc["hangs", ["failed", "reasons"]].tolist() == [m, f"time {m}"]
        assert rows.loc["crashes", ["failed", "reasons"]].tolist() == [m, f"crash {m}"]
        assert rows.loc["liar", ["failed", "false_successes"]].tolist() == [m, m]
        assert rows.loc[["secular", "pyramid"], "failed"].tolist() == [0, 0]
        assert rows.loc[["hangs", "crashes"], "ns_best"].isna().all()
        assert (rows.loc[["secular", "liar"], "ns_best"] > 0).all()
        assert (rows["ns_best"] <= rows["ns_median"])[["secular", "liar"]].all()
        assert rows.loc["liar", "iterations_mean"] == 3
    assert table.loc[("secular", "known"), "velocity_error_median"] < 1e-12
    assert np.isnan(table.loc[("secular", "uniform"), "velocity_error_median"])
    found = strata(measured)
    assert (found.groupby(["by", "kind", "solver"])["contacts"].sum().unstack("kind") == [8, 12]).all(
        axis=None
    )


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_the_command_writes_its_tables_and_its_figure(tmp_path):
    write(tmp_path / "set.h5", two_kinds(), {"visits": 9, "visits looked at": 7, "pac stalled": 5})
    liar = plugin(tmp_path, "liar")
    result = call("table", "--level", 1, "--set", tmp_path / "set.h5", "--solvers", "secular,pyramid:facets=8",
                  "--plugin", liar, "--limit", 15, "--out", tmp_path / "run")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert "of 9 visits of the runs, 7 were looked at, among them: pac stalled 5" in " ".join(
        result.stdout.split()
    )
    names = {"table.csv", "strata.csv", "table.md", "environment.json", "failures.svg", "failures.png"}
    assert {file.name for file in (tmp_path / "run").iterdir()} == names
    table = pd.read_csv(tmp_path / "run" / "table.csv")
    assert set(table["solver"]) == {"secular", "pyramid:facets=8", "liar"}
    assert table.groupby("solver")["contacts"].sum().tolist() == [15, 15, 15]
    assert (tmp_path / "run" / "table.md").read_text().count("| secular | 0 %") == 2


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["--level", 1, "--set", "nowhere.h5"], "no such file"),
        (["--level", 2], "unknown level '2'"),
        (["--level", 1, "--accuracy", "mid"], "belong to level 3"),
        (["--level", 1, "--solvers", "none"], "unknown local solver"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(arguments, fault):
    result = call("table", *arguments)
    assert result.exit_code == 2
    assert fault in result.stderr
    assert result.stderr.count("\n") == 1


# The harvest


def chain(contacts, seed, mu):
    """Unit masses in a row, each touching the next, thrown at random."""
    difference = eye_array(contacts, contacts + 1, k=1) - eye_array(contacts, contacts + 1)
    H = csr_array(np.kron(difference.toarray(), np.eye(3)))
    f = np.random.default_rng(seed).normal(size=3 * contacts + 3)
    return StepProblem(
        eye_array(3 * contacts + 3, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, mu)
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chains")
    for seed, mu in enumerate((0.3, 0.9)):
        fclib.write(folder / f"{seed}.hdf5", chain(6, seed, mu))
    return folder


@pytest.fixture(autouse=True)
def _little_hard_set(monkeypatch):
    """The true one takes seconds; test_hard_set looks at it."""
    monkeypatch.setattr(harvesting, "hard_set", lambda: contacts(2, 0, "known: a"))


def test_a_harvest_is_visits_of_the_runs_with_the_hard_ones_beside(folder, monkeypatch):
    monkeypatch.setattr(harvesting, "SLOW", 2)
    monkeypatch.setattr(harvesting, "KEPT", 3)
    solvers = [configured("secular"), configured("mfb")]
    heard = []
    found, counts = harvest(load_set(folder), solvers, heard.append)
    assert heard == ["0", "1"]
    sizes = pd.Series(found.family).value_counts()
    assert sizes["uniform: secular"] <= 2 * harvesting.UNIFORM
    assert counts["visits"] == counts["visits looked at"]
    assert counts["mfb slow"] > 12
    assert sizes["hard: mfb slow"] <= 12  # two problems, two runs, three each
    hard = found.select(found.family == "hard: mfb slow")
    assert (replay(configured("mfb"), hard).iterations > 2).all()
    same(harvest(load_set(folder), solvers, heard.append)[0], found)


def test_the_sample_is_of_visits_that_were_made(folder):
    problem = fclib.read(folder / "0.hdf5").problem.condense()
    visits = [
        GaussSeidel(configured(name), 1e-4, 1000, **LOOPS["plain"]).solve(problem).visits.total
        for name in ("secular", "pac")
    ]
    found, counts = harvest(load_set(folder)[:1], [configured("secular")], lambda text: None)
    uniform = found.select(found.family == "uniform: secular")
    assert uniform.m == min(harvesting.UNIFORM, visits[0])
    assert counts["visits"] == sum(visits)
    blocks = {block.tobytes() for block in problem.diagonal}
    assert all(W.tobytes() in blocks for W in uniform.W)


def test_the_harvest_command_writes_a_set(folder, tmp_path):
    result = call("harvest", folder, "--out", tmp_path / "set.h5", "--limit", 1)
    assert result.exit_code == 0, result.stderr
    found = read(tmp_path / "set.h5")
    assert {family.partition(":")[0] for family in found.family} >= {"uniform", "known"}
    same(found.select(found.family == "known: a"), contacts(2, 0, "known: a"))
    assert read_counts(tmp_path / "set.h5")["visits"] > 0
    assert call("harvest", tmp_path / "none", "--out", tmp_path / "set.h5").exit_code == 2
