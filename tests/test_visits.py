"""Visit logs on disk: what they hold, how long they may be, what a run of the table does with them."""

import dataclasses
import json

import h5py
import numpy as np
import pytest
from listeners import Silent
from scipy.sparse import csr_array, eye_array
from typer.testing import CliRunner

from fibercontact.bench import run as run_module
from fibercontact.bench.passes import lay_out, logged
from fibercontact.bench.plan import Plan, single
from fibercontact.bench.problem_set import load_set
from fibercontact.bench.protocol import BenchError, Limits
from fibercontact.bench.rows import RowFile
from fibercontact.bench.run import run
from fibercontact.bench.visits import (
    FIXED_BYTES,
    MOVING,
    PER_CONTACT_BYTES,
    ROWS,
    SAMPLE,
    SHAPES,
    STORED_VISIT,
    VisitRecord,
    log_file,
    read_log,
    record_of,
    write_log,
)
from fibercontact.cli import app
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel, Outcome, Run, Visits
from fibercontact.gauss_seidel.visit_log import RECENT, new_log
from fibercontact.local.contract import Status
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import write
from fibercontact.problem.step import StepProblem

FAILING = "mfb:max_iterations=2"


def chain(contacts, seed, mu=0.6):
    """Unit masses in a row, each touching the next, thrown at random."""
    masses = contacts + 1
    difference = eye_array(contacts, masses, k=1) - eye_array(contacts, masses)
    H = csr_array(np.kron(difference.toarray(), np.eye(3)))
    f = np.random.default_rng(seed).normal(size=3 * masses)
    return StepProblem(
        eye_array(3 * masses, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, mu)
    )


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "set").mkdir()
    for k in range(2):
        write(tmp_path / "set" / f"chain-{k}.hdf5", chain(6, k))
    return tmp_path / "set"


def unit(folder, solver=FAILING):
    local = configure(solver, registered())
    return single(load_set(folder)[0], local, "mid", "cold", "plain", Limits(50, 10.0))


def recorded(folder, solver=FAILING):
    """A record of a real run."""
    laid = lay_out(chain(6, 0))
    loop = GaussSeidel(configure(solver, registered()), tolerance=1e-12, max_sweeps=50, **LOOPS["plain"])
    return logged(loop, laid, None, unit(folder, solver).about())


def assert_equal_records(one, two):
    assert dict(one.about) == dict(two.about)
    for name in SHAPES:
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name), err_msg=name)


# The file


def test_a_record_comes_back_as_it_was_written(folder, tmp_path):
    found, measured, record = recorded(folder)
    path = tmp_path / "new" / "log.hdf5"
    write_log(path, record)
    again = read_log(path)
    assert_equal_records(again, record)
    assert again.n == 6
    assert again.about["problem"] == "chain-0"
    assert again.about["solver"] == FAILING
    assert again.about["outcome"] == "sweeps"
    assert again.about["residual"] == measured.residual
    assert again.about["solved"] is False
    assert again.counts[:, 3].sum() == found.visits.failures > 0
    assert {s: again.statuses[:, s].sum() for s in Status} == found.visits.by_status
    np.testing.assert_array_equal(again.sweeps, np.arange(51))
    np.testing.assert_array_equal(again.residual, found.history)
    np.testing.assert_array_equal(again.answer, found.r)
    assert not list(tmp_path.rglob("*.part"))


def test_a_logged_run_is_the_run(folder):
    laid, local = lay_out(chain(6, 0)), configure(FAILING, registered())
    loop = GaussSeidel(local, tolerance=1e-12, max_sweeps=50, check_every=1, **LOOPS["plain"])
    bare = loop.solve_system(laid.system, laid.problem.b_ref)
    found, _, _ = logged(loop, laid, None, {})
    np.testing.assert_array_equal(found.r, bare.r)
    assert (found.sweeps, found.residual, found.visits) == (bare.sweeps, bare.residual, bare.visits)


def long_run(sweeps, contacts=3):
    """A log and a run as if of many sweeps."""
    rng = np.random.default_rng(0)
    log = new_log(contacts, sweeps, 5)
    log.by_sweep[:] = rng.integers(0, 9, size=log.by_sweep.shape)
    log.size[:] = rng.random(sweeps)
    log.recent[:] = rng.normal(size=log.recent.shape)
    log.state[0] = sweeps
    counts = np.zeros(len(Status) + 4, dtype=np.int64)
    found = Run(
        np.ones(3 * contacts),
        Outcome.SWEEPS,
        0.5,
        sweeps,
        1.0,
        Visits.from_counts(counts),
        rng.random(sweeps + 1),
    )
    return log, found


@pytest.mark.parametrize("sweeps", [0, 1, ROWS, ROWS + 1, 2 * ROWS + 17])
def test_long_runs_are_stored_in_groups_of_sweeps(sweeps):
    log, found = long_run(sweeps)
    record = record_of(log, found, np.ones(3), 2.0, {})
    group = max(1, int(np.ceil(sweeps / ROWS)))
    assert len(record.sweeps) <= ROWS + 1
    assert record.sweeps[0] == 0
    assert record.sweeps[-1] == sweeps
    assert (np.diff(record.sweeps)[:-1] == group).all()
    np.testing.assert_array_equal(record.residual, found.history[record.sweeps])
    np.testing.assert_array_equal(record.size[1:], log.size[record.sweeps[1:] - 1] / 2.0)
    np.testing.assert_array_equal(record.counts.sum(axis=0), log.by_sweep.sum(axis=0))
    for row in (1, len(record.sweeps) - 1) if sweeps else ():
        at = slice(record.sweeps[row - 1], record.sweeps[row])
        np.testing.assert_array_equal(record.counts[row], log.by_sweep[at].sum(axis=0))


def test_the_impulses_of_the_contacts_that_moved_most_are_kept():
    log, found = long_run(RECENT, contacts=MOVING + 20)
    still = np.arange(5, 25)  # by number, all in the middle
    log.recent.reshape(RECENT, -1, 3)[:, still] = 1.0
    record = record_of(log, found, np.ones(MOVING + 20), 2.0, {})
    assert len(record.moving) == MOVING
    assert not set(record.moving) & set(still)
    assert (record.amplitude[still] == 0).all()
    np.testing.assert_array_equal(record.recent, log.recent.reshape(RECENT, -1, 3)[:, record.moving])
    impulses = log.recent.reshape(RECENT, -1, 3)
    farthest = np.linalg.norm(impulses - impulses[-1], axis=2).max(axis=0)
    np.testing.assert_allclose(record.amplitude, farthest / 2.0)


@pytest.mark.parametrize("contacts", [1, 600, 3000])
def test_a_file_is_never_longer_than_said(tmp_path, contacts):
    """Everything at its longest, filled with numbers that do not compress."""
    rng = np.random.default_rng(1)
    lengths = {"rows": ROWS + 1, "n": contacts, "3n": 3 * contacts, "visits": SAMPLE, "failures": SAMPLE,
               "moving": min(MOVING, contacts), "recent": RECENT}  # fmt: skip
    values = {}
    for name, shape in SHAPES.items():
        size = [lengths.get(part, part) for part in shape]
        if name in ("visits", "failures"):
            values[name] = np.frombuffer(rng.bytes(STORED_VISIT.itemsize * SAMPLE), dtype=STORED_VISIT)
        elif name in ("residual", "size", "amplitude", "recent", "answer"):
            values[name] = rng.normal(size=size)
        else:
            values[name] = rng.integers(0, 2**40 if name == "counts" else 2**24, size=size)
    write_log(tmp_path / "log.hdf5", VisitRecord({"detail": "x" * 5000}, **values))
    length = (tmp_path / "log.hdf5").stat().st_size
    assert length > 0.5 * FIXED_BYTES or contacts == 1
    assert length <= FIXED_BYTES + PER_CONTACT_BYTES * contacts <= 2_000_000


def damage(path, how):
    with h5py.File(path, "r+") as file:
        how(file)


@pytest.mark.parametrize(
    ("how", "fault"),
    [
        (lambda f: f.attrs.__setitem__("format", "another"), "not a visit log"),
        (lambda f: f.attrs.__delitem__("format"), "not a visit log"),
        (lambda f: f.attrs.__setitem__("version", 99), "version 99; this program reads version 1"),
        (lambda f: f.attrs.__delitem__("problem_hash"), "without problem_hash"),
        (lambda f: f.__delitem__("recent"), "without recent"),
        (
            lambda f: (f.__delitem__("switches"), f.__setitem__("switches", np.zeros(5))),
            "switches: its shape",
        ),
        (lambda f: (f.__delitem__("answer"), f.__setitem__("answer", np.zeros(6))), "answer: its shape"),
        (lambda f: (f.__delitem__("visits"), f.__setitem__("visits", np.zeros(6))), "visits: its values are"),
        (lambda f: (f.__delitem__("counts"), f.create_group("counts")), "counts is not a dataset"),
        (lambda f: (f.__delitem__("size"), f.__setitem__("size", "text")), "size holds object"),
        (lambda f: f["moving"].__setitem__(0, 6), "contacts beyond the 6"),
        (lambda f: f["moving"].__setitem__(0, -1), "contacts beyond the 6"),
    ],
)
def test_faults_of_a_file_are_named(folder, tmp_path, how, fault):
    path = tmp_path / "log.hdf5"
    write_log(path, recorded(folder)[2])
    damage(path, how)
    with pytest.raises(BenchError, match=fault) as caught:
        read_log(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_files_that_are_no_logs_are_errors(folder, tmp_path):
    path = tmp_path / "log.hdf5"
    with pytest.raises(BenchError, match=r"log.hdf5: no such file"):
        read_log(path)
    path.write_bytes(b"not HDF5")
    with pytest.raises(BenchError, match=r"log.hdf5: not a readable HDF5 file"):
        read_log(path)
    write_log(path, recorded(folder)[2])
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(BenchError, match=r"log.hdf5: not a readable HDF5 file"):
        read_log(path)
    with pytest.raises(BenchError, match=r"chain-0.hdf5: not a visit log"):
        read_log(folder / "chain-0.hdf5")


def test_names_of_logs_tell_runs_apart(folder):
    entry, key = load_set(folder)[0], unit(folder, "pyramid:facets=8").key
    others = [dataclasses.replace(key, outer="accelerated"), dataclasses.replace(key, max_sweeps=7)]
    names = {log_file(folder, entry, k).name for k in [key, *others]}
    assert len(names) == 3
    assert all(name.startswith("chain-0.pyramid-facets=8.mid.") for name in names)


# A run of the table


def plan(folder, solvers=("secular", FAILING), **settings):
    known = registered()
    settings = {"timed": ("mid",), "limits": Limits(50, 10.0), "visits": True} | settings
    return Plan(load_set(folder), [configure(name, known) for name in solvers], **settings)


def logs_of(units, run_folder):
    logs = {u.key: log_file(run_folder / "visits", u.entry, u.key) for u in units if u.key.mode == "rates"}
    assert {file.name for file in (run_folder / "visits").iterdir()} == {file.name for file in logs.values()}
    return logs


def test_a_run_logs_every_pass_that_is_not_timed_and_no_other(folder, tmp_path, monkeypatch):
    orders = []
    solve = run_module.Worker.solve

    def listening(self, path, start, task, limit):
        orders.append((task.timed, task.log is not None))
        return solve(self, path, start, task, limit)

    monkeypatch.setattr(run_module.Worker, "solve", listening)
    with_logs, without = tmp_path / "with", tmp_path / "without"
    assert run(plan(folder), RowFile(with_logs), Silent()) == []
    assert {timed is not log for timed, log in orders} == {True}
    logs = logs_of(plan(folder).work(), with_logs)
    rows = {
        row["problem"] + row["solver"]: row for row in RowFile(with_logs).read() if row["mode"] == "rates"
    }
    assert len(logs) == len(rows) == 4
    for key, path in logs.items():
        record = read_log(path)
        row = rows[record.about["problem"] + key.solver]
        assert record.sweeps[-1] == row["sweeps"]
        assert record.statuses[:, 1:].sum() == row["local_failures"]
        assert record.about["fingerprint"] == row["fingerprint"]
        assert record.about["residual"] == row["residual"]
        assert (record.about["solved"], record.about["detail"]) == (row["solved"], row["detail"])

    orders.clear()
    assert run(plan(folder, visits=False), RowFile(without), Silent()) == []
    assert not any(log for _, log in orders)
    assert not (without / "visits").exists()
    changing = ("stamp", "setup_seconds", "load", "time_best", "time_median", "times")

    def told(run_folder):
        rows = [{k: v for k, v in row.items() if k not in changing} for row in RowFile(run_folder).read()]
        return sorted(json.dumps(row, sort_keys=True) for row in rows)

    assert told(with_logs) == told(without)


def test_a_resumed_run_makes_the_logs_that_are_missing_and_no_row_twice(folder, tmp_path):
    rows, rates = RowFile(tmp_path / "run"), {"timed": (), "rates": ("mid",)}
    assert run(plan(folder, visits=False, **rates), rows, Silent()) == []
    before = rows.path.read_bytes()
    assert run(plan(folder, **rates), rows, Silent()) == []  # the rows are there, the logs are not
    logs = logs_of(plan(folder).work(), tmp_path / "run")
    assert rows.path.read_bytes() == before
    lost, kept = sorted(logs.values())[:2]
    lost.unlink()
    written = kept.stat().st_mtime_ns
    assert run(plan(folder, **rates), rows, Silent()) == []
    assert lost.is_file()
    assert kept.stat().st_mtime_ns == written
    assert rows.path.read_bytes() == before


def test_a_pass_that_was_killed_is_not_made_again_for_its_log(folder, tmp_path):
    """Its row has no outcome, and it would hang again at every start."""
    (first, *_) = plan(folder).work()
    assert run_module._lacks_log(first, {"outcome": "sweeps"}, tmp_path)
    assert not run_module._lacks_log(first, {"reason": "time"}, tmp_path)
    assert not run_module._lacks_log(first, {"outcome": "sweeps"}, None)


def test_a_log_that_cannot_be_written_is_a_fault_of_the_run_and_not_of_the_solver(folder, tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "visits").write_text("in the way")
    faults = run(plan(folder, ["secular"], timed=(), rates=("mid",)), RowFile(tmp_path / "run"), Silent())
    assert len(faults) == 2
    assert all("visits" in fault for fault in faults)
    assert all(row["solved"] for row in RowFile(tmp_path / "run").read())


# The command line


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_table_and_solve_write_logs(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = ["table", "--set", "set", "--solvers", "secular", "--rates", "mid", "--jobs", 1, "--limit", 1]
    assert call(*table, "--log", "visits").exit_code == 0
    (from_table,) = (tmp_path / "runs" / "set" / "visits").iterdir()
    solve = ["solve", "set/chain-0.hdf5", "--solver", "secular"]
    answer = json.loads(call(*solve, "--log", "visits", "--json").stdout)
    (by_default,) = (tmp_path / "visits").iterdir()
    assert (tmp_path / answer["log"]).samefile(by_default)
    assert by_default.name == from_table.name
    assert_equal_records(read_log(by_default), read_log(from_table))
    assert "visits logged" in call(*solve, "--log-file", "mine.hdf5").stdout
    assert_equal_records(read_log(tmp_path / "mine.hdf5"), read_log(from_table))
    assert json.loads(call(*solve, "--json").stdout)["log"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["solve", "set/chain-0.hdf5", "--solver", "secular", "--log", "all"],
            "unknown log 'all' (known: visits)",
        ),
        (["table", "--set", "set", "--log", "all"], "unknown log 'all' (known: visits)"),
        (["table", "--set", "set", "--log", "visits", "--max-sweeps", 2_000_000], "at most 1000000 sweeps"),
        (["solve", "set/chain-0.hdf5", "--solver", "secular", "--log-file", "no/log.hdf5"], "no such folder"),
        (
            ["solve", "set/chain-0.hdf5", "--solver", "secular", "--log-file", "set/chain-0.hdf5"],
            "is the problem",
        ),
    ],
)
def test_errors_of_the_command_line(folder, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    result = call(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
