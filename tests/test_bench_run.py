"""Runs of the benchmark on small problems: rows, hangs, crashes, resumption, plugins."""

import csv
import hashlib
import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from listeners import Silent
from scipy.sparse import csr_array, eye_array

import fibercontact
from fibercontact.bench import measurement
from fibercontact.bench import plan as plan_module
from fibercontact.bench.passes import Desk, Pass, judge, options_text
from fibercontact.bench.plan import Plan
from fibercontact.bench.problem_set import entry_of, find_set, limited, load_set, origin
from fibercontact.bench.protocol import BenchError, Limits
from fibercontact.bench.rows import Key, RowFile, move_away
from fibercontact.bench.run import run
from fibercontact.bench.worker import cause
from fibercontact.gauss_seidel.solver import Outcome, Run, Visits
from fibercontact.global_methods.registry import configure, registered
from fibercontact.local.contract import Status
from fibercontact.problem.fclib import Solution, write
from fibercontact.problem.measure import Measure
from fibercontact.problem.step import StepProblem

PLUGIN = """
'''A local solver for a test.'''
import math
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Status

@jit
def kernel(W, b, mu, r, options):
    {body}

solver = LocalSolver(kernel)
"""

BODIES = {
    # damped sweeps for frictionless contact: the normal only
    "frictionless": """
    r_N = max(0.0, {damping} * -b[0] / W[0][0])
    return Status.CONVERGED, (r_N, 0.0, 0.0), 1
    """,
    "liar": "return Status.CONVERGED, (123.0, 0.0, 0.0), 1",
    "giving_up": "return Status.NO_ROOT, (0.0, 0.0, 0.0), 7",
    "hangs": """
    x = 0.0
    while x <= 1.0:
        x = 0.5 * (x + 1.0)
    return Status.CONVERGED, (x, 0.0, 0.0), 1
    """,
    "crashes": """
    options[10**15] = 1.0
    return Status.CONVERGED, (0.0, 0.0, 0.0), 1
    """,
}


def plugin(folder, name, **values):
    body = textwrap.indent(textwrap.dedent(BODIES[name].format(**values)).strip(), "    ").strip()
    path = folder / f"{name}.py"
    path.write_text(PLUGIN.format(body=body))
    return path


def chain(contacts, seed, mu=0.3):
    """Unit masses in a row, each touching the next, thrown at random."""
    masses = contacts + 1
    difference = eye_array(contacts, masses, k=1) - eye_array(contacts, masses)
    H = csr_array(np.kron(difference.toarray(), np.eye(3)))
    f = np.random.default_rng(seed).normal(size=3 * masses)
    return StepProblem(
        eye_array(3 * masses, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, mu)
    )


def write_set(folder, problems, mu=0.3, contacts=4):
    folder.mkdir(exist_ok=True)
    for k in range(problems):
        write(folder / f"chain-{k:02}.hdf5", chain(contacts, k, mu))
    return folder


def plan_for(folder, solvers, plugins=(), timed=("mid",), **settings):
    known = registered(plugins)
    return Plan(load_set(folder), [configure(s, known) for s in solvers], timed, plugins=plugins, **settings)


def run_rows(plan, folder, listener=None):
    assert run(plan, RowFile(folder), listener or Silent()) == []
    return RowFile(folder).read()


# What a run leaves


def test_one_row_a_measurement_with_everything_in_it(tmp_path):
    plan = plan_for(write_set(tmp_path / "set", 2), ["hybrid", "pyramid:facets=8"], rates=("high",), jobs=2)
    rows = run_rows(plan, tmp_path / "run")
    assert {Key.of(row) for row in rows} == {unit.key for unit in plan.work()}
    assert {unit.key for unit in plan.units()} < {unit.key for unit in plan.work()}
    assert len(rows) == 2 * 2 * 3  # rates at both accuracies, times at one
    for row in rows:
        assert row["solved"]
        assert row["residual"] <= row["tolerance"]
        assert row["contacts"] == 4
        assert row["dofs"] == 15
        assert row["visits_open"] + row["visits_stick"] + row["visits_slip"] == 4 * row["sweeps"]
        assert sum(row["local_status"].values()) == 4 * row["sweeps"]
        assert row["reason"] == ""
    timed = [row for row in rows if row["mode"] == "timed"]
    assert all(0 < row["time_best"] <= row["time_median"] for row in timed)
    assert all(row["time_best"] is None for row in rows if row["mode"] == "rates")
    eight = [row for row in rows if row["solver"] == "pyramid:facets=8"]
    assert all(row["law_facets"] == 8 and "facets=8" in row["options"] for row in eight)
    assert all(row["coulomb"] > 1e-3 for row in eight)  # its own law is met, Coulomb's is not


def test_sweeps_are_the_first_that_meet_the_tolerance(tmp_path):
    folder = write_set(tmp_path / "set", 1)
    desk = Desk([], ["secular"])
    desk.load(folder / "chain-00.hdf5", "cold")
    found = desk.solve(Pass("secular", "mid", "plain", Limits(), timed=False))
    short = desk.solve(Pass("secular", "mid", "plain", Limits(found["sweeps"] - 1), timed=False))
    assert found["solved"]
    assert not short["solved"]
    assert short["reason"] == "outer"


def test_hanging_crashing_and_lying_plugins_have_rows_and_harm_no_other(tmp_path, monkeypatch):
    monkeypatch.setattr(measurement, "GRACE_SECONDS", 1.5)
    names = ["hangs", "crashes", "liar", "giving_up"]
    plugins = [plugin(tmp_path, name) for name in names]
    solvers = ["hangs", "secular", "crashes", "liar", "giving-up", "hybrid"]
    plan = plan_for(write_set(tmp_path / "set", 1), solvers, plugins, limits=Limits(200, 0.5))
    rows = {row["solver"]: row for row in run_rows(plan, tmp_path / "run")}
    reasons = {name: row["reason"] for name, row in rows.items()}
    failures = {"hangs": "time", "crashes": "crash", "liar": "outer", "giving-up": "local"}
    assert reasons == failures | {"secular": "", "hybrid": ""}
    assert rows["giving-up"]["detail"] == f"no_root {4 * 200}"
    assert rows["giving-up"]["local_iterations"] == 7 * 4 * 200
    assert not any(rows[name]["solved"] or rows[name]["time_best"] for name in reasons if reasons[name])
    assert all(rows[name]["time_median"] > 0 for name in ("secular", "hybrid"))


def test_a_claim_that_the_measure_denies_is_a_false_success():
    visits = Visits.from_counts(np.zeros(len(Status) + 4, dtype=np.int64))
    claimed = Run(np.zeros(3), Outcome.CONVERGED, 1e-9, 1, 0.0, visits)
    bad = Measure(0.5, 0.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    verdict = judge(claimed, bad, 1e-4)
    assert (verdict["claimed"], verdict["solved"], verdict["false_success"]) == (True, False, True)
    assert verdict["reason"] == "false success"


@pytest.mark.parametrize(
    ("outcome", "failures", "reason"),
    [
        (Outcome.SWEEPS, 0, "outer"),
        (Outcome.SWEEPS, 3, "local"),
        (Outcome.TIME, 3, "time"),
        (Outcome.NOT_FINITE, 0, "not finite"),
    ],
)
def test_reasons_of_failures(outcome, failures, reason):
    counts = np.zeros(len(Status) + 4, dtype=np.int64)
    counts[Status.STALLED] = failures
    failed = Run(np.zeros(3), outcome, 0.5, 1, 0.0, Visits.from_counts(counts))
    verdict = judge(failed, Measure(0.5, *[0.0] * 7), 1e-4)
    assert (verdict["reason"], verdict["solved"]) == (reason, False)


def test_an_unreadable_problem_is_reported_and_the_others_measured(tmp_path):
    folder = write_set(tmp_path / "set", 2)
    (folder / "chain-00.hdf5").write_bytes(b"not HDF5")
    faults = run(plan_for(folder, ["secular"]), RowFile(tmp_path / "run"), Silent())
    assert len(faults) == 1
    assert str(folder / "chain-00.hdf5") in faults[0]
    assert {row["problem"] for row in RowFile(tmp_path / "run").read()} == {"chain-01"}


def test_start_from_the_guess(tmp_path):
    (tmp_path / "set").mkdir()
    problem = chain(4, 0)
    write(tmp_path / "set" / "without.hdf5", chain(4, 1))
    desk = Desk([], ["secular"])
    answer = desk_answer(problem)
    write(tmp_path / "set" / "with.hdf5", problem, guesses=[Solution(r=answer)])
    with pytest.raises(BenchError, match=r"without.hdf5: no guess"):
        desk.load(tmp_path / "set" / "without.hdf5", "guess")
    desk.load(tmp_path / "set" / "with.hdf5", "guess")
    assert desk.solve(Pass("secular", "high", "plain", Limits(), timed=True))["sweeps"] == 0


def desk_answer(problem):
    from fibercontact.gauss_seidel.solver import GaussSeidel

    return GaussSeidel(configure("secular", registered()), tolerance=1e-8).solve(problem.condense()).r


def test_a_plugin_that_does_not_compile_stops_the_run_with_one_error(tmp_path):
    path = plugin(tmp_path, "liar")
    path.write_text(path.read_text().replace("(123.0, 0.0, 0.0)", "'nonsense'"))
    plan = plan_for(write_set(tmp_path / "set", 1), ["liar"], [path])
    if os.environ.get("NUMBA_DISABLE_JIT") == "1":
        pytest.skip("nothing is compiled")
    with pytest.raises(BenchError, match=r"liar.py: the kernel of 'liar' does not compile"):
        run(plan, RowFile(tmp_path / "run"), Silent())


def test_editing_a_plugin_takes_effect_at_the_next_run(tmp_path):
    folder = write_set(tmp_path / "set", 1, mu=0.0)
    found = []
    for damping in (1.0, 0.5, 1.0):
        path = plugin(tmp_path, "frictionless", damping=damping)
        run_rows(plan_for(folder, ["frictionless"], [path]), tmp_path / "run")
        rows = RowFile(tmp_path / "run").read()
        found.append([row["sweeps"] for row in rows if row["mode"] == "timed"])
    undamped = found[0][0]
    assert len(found[1]) == 2
    assert found[1][1] > 1.2 * undamped  # the edit was compiled, and measured beside the rows of the old one
    assert found[2] == found[1]  # the first text again: known already, nothing to measure


HOARDER = """
'''A global method that keeps megabytes.'''
import numpy as np
from fibercontact.global_methods.contract import Answer, GlobalMethod
from fibercontact.local.contract import Option

kept = []

def solve(system, task, options):
    kept.extend(np.empty(125_000) for _ in range(int(options[0])))
    return Answer(np.zeros_like(system.b), False, 1)

solver = GlobalMethod(solve, options={"megabytes": Option(1.0, "what each pass keeps")})
"""

needs_bound = pytest.mark.skipif(sys.platform != "linux", reason="memory is bounded on Linux")


@needs_bound
def test_memory_is_bounded_and_what_one_leaves_is_no_fault_of_the_next(tmp_path):
    """A pass of 800 MB fits beside the libraries, two do not; the second is made again in a new process."""
    (tmp_path / "hoarder.py").write_text(HOARDER)
    solvers = ["hoarder:megabytes=800", "hoarder:megabytes=801", "hoarder:megabytes=8000", "secular"]
    plan = plan_for(
        write_set(tmp_path / "set", 1), solvers, [tmp_path / "hoarder.py"], timed=(), rates=("low",),
        memory=1_800_000_000,
    )  # fmt: skip
    rows = run_rows(plan, tmp_path / "run")
    assert [row["solver"] for row in rows] == solvers
    assert [row["reason"] for row in rows] == ["stalled", "stalled", "memory", ""]
    assert "MemoryError" in rows[2]["detail"]
    assert {row["memory_limit"] for row in rows} == {1_800_000_000}


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (3, "the process ended with code 3"),
        (-signal.SIGSEGV, "the process died of SIGSEGV"),
        (-signal.SIGKILL, "the process died of SIGKILL, as when the system runs out of memory"),
        (-63, "the process died of signal 63"),
    ],
)
def test_how_a_process_ended_in_words(code, said):
    assert cause(code) == said


def test_a_worker_ends_with_its_parent_even_at_work(tmp_path):
    """The parent is killed while its worker hangs in a request of an hour."""
    path = method(tmp_path, "loops")
    script = f"""
from pathlib import Path
from fibercontact.bench.passes import Pass
from fibercontact.bench.protocol import Limits
from fibercontact.bench.worker import Setting, Worker
from fibercontact.global_methods.registry import registered
prints = {{"loops": registered([Path({str(path)!r})])["loops"].fingerprint}}
worker = Worker(Setting([Path({str(path)!r})], prints))
worker.load(Path({str(write_set(tmp_path / "set", 1) / "chain-00.hdf5")!r}), "cold")
print(worker._process.pid, flush=True)
worker.solve(*worker._loaded, Pass("loops", "low", "global", Limits(), timed=False), 3600.0)
"""
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    worker = int(parent.stdout.readline())
    time.sleep(0.5)
    os.kill(worker, 0)  # it lives
    parent.kill()
    parent.communicate()
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            os.kill(worker, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    raise AssertionError("the worker outlived its parent")


# Methods for the whole problem

METHOD = """
'''A global method for a test.'''
import os
import numpy as np
from fibercontact.global_methods.contract import Answer, GlobalMethod, Unsuited
from fibercontact.local.contract import Option

def solve(system, task, options):
    r = np.zeros_like(system.b)
    {body}

solver = GlobalMethod(solve, options={{"size": Option(1.0, "of the impulses")}})
"""

ANSWERS = {
    "stalls": "return Answer(r, False, 3, note='no step decreases anything')",
    "runs_on": "return Answer(r, False, task.max_iterations)",
    "lies": "return Answer(r + options[0], True, 1, residual=0.0)",
    "is_not_a_number": "return Answer(r + np.nan, True, 1)",
    "has_another_shape": "return Answer(r[:-1], True, 1)",
    "returns_nothing": "pass",
    "raises": "raise KeyError('no such contact')",
    "is_unsuited": "raise Unsuited(f'for at most 1 contact, not {len(system.mu)}')",
    "overwrites": "system.blocks[:] = 0.0; system.b[:] = 0.0; return Answer(r, False, 1)",
    "loops": "\n    while True: pass",
    "dies": "os._exit(3)",
}
REASONS = {
    "stalls": ("stalled", "no step decreases anything"),
    "runs_on": ("iterations", ""),
    "lies": ("false success", ""),
    "is_not_a_number": ("not finite", ""),
    "has_another_shape": ("crash", "has-another-shape: gave impulses of shape (11,), not (12,)"),
    "returns_nothing": ("crash", "returns-nothing: gave a NoneType, no Answer"),
    "raises": ("crash", "KeyError: 'no such contact'"),
    "is_unsuited": ("unsuited", "for at most 1 contact, not 4"),
    "overwrites": ("stalled", ""),
    "loops": ("time", "killed after 2 s"),
    "dies": ("crash", "the process ended with code 3"),
}


def method(folder, name):
    path = folder / f"{name}.py"
    path.write_text(METHOD.format(body=ANSWERS[name]))
    return path


def test_global_methods_have_rows_whatever_they_do(tmp_path, monkeypatch):
    monkeypatch.setattr(measurement, "GRACE_SECONDS", 1.5)
    plugins = [method(tmp_path, name) for name in ANSWERS]
    solvers = [*(name.replace("_", "-") for name in ANSWERS), "secular", "apgd"]
    plan = plan_for(write_set(tmp_path / "set", 1), solvers, plugins, limits=Limits(200, 0.5))
    rows = {row["solver"]: row for row in run_rows(plan, tmp_path / "run")}
    for name, (reason, detail) in REASONS.items():
        row = rows[name.replace("_", "-")]
        assert (row["reason"], row["detail"]) == (reason, detail), name
        assert not row["solved"]
        assert row["time_best"] is None
        assert row["options"] == "size=1.0"
    assert rows["lies"]["false_success"]
    assert rows["stalls"]["sweeps"] == 3
    for name in ("secular", "apgd"):  # unharmed
        assert rows[name]["solved"]
        assert rows[name]["time_median"] > 0
        assert rows[name]["residual"] <= 1e-4


def test_a_row_of_a_global_method_counts_its_iterations_and_has_no_visits(tmp_path):
    folder, run_folder = write_set(tmp_path / "set", 1), tmp_path / "run"
    plan = plan_for(folder, ["secular", "spg"], timed=(), rates=("mid",), outer="accelerated", visits=True)
    listener = Silent()
    rows = {row["solver"]: row for row in run_rows(plan, run_folder, listener)}
    assert [rows[name]["outer"] for name in ("secular", "spg")] == ["accelerated", "global"]
    assert rows["spg"]["sweeps"] > 0
    assert "visits_open" not in rows["spg"]
    assert listener.notes == ["no visits to log, for there are no sweeps: spg"]
    assert [file.name.split(".")[1] for file in (run_folder / "visits").iterdir()] == ["secular"]
    assert len(run_rows(plan, run_folder)) == 2  # no log is missing


def test_a_method_s_own_clock_is_believed(tmp_path):
    path = method(tmp_path, "stalls")
    path.write_text(path.read_text().replace("no step decreases anything'", "', seconds=12.5"))
    desk = Desk([path], ["stalls"])
    desk.load(write_set(tmp_path / "set", 1) / "chain-00.hdf5", "cold")
    assert desk.solve(Pass("stalls", "mid", "global", Limits(), timed=True))["seconds"] == 12.5


def test_a_method_is_prepared_before_the_clock_starts(tmp_path):
    path = method(tmp_path, "stalls")
    path.write_text(
        path.read_text().replace("size", "ready") + "\nsolver = GlobalMethod(solve, prepare=lambda: 1 / 0)"
    )
    with pytest.raises(ZeroDivisionError):
        Desk([path], ["stalls"])


# Resumption


def command(*arguments):
    environment = os.environ | {"PYTHONPATH": str(Path(fibercontact.__file__).parents[1])}
    return subprocess.Popen(
        [sys.executable, "-m", "fibercontact", *map(str, arguments)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A shell's background job ignores Ctrl-C, and its children with it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def wait_for_rows(path, count, process):
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline and process.poll() is None:
        if path.is_file() and path.read_bytes().count(b"\n") >= count:
            return
        time.sleep(0.005)
    raise AssertionError(f"no {count} rows: {process.communicate()}")


def test_a_killed_and_an_interrupted_run_resume_where_they_stopped(tmp_path):
    folder = write_set(tmp_path / "set", 40)
    # Many repetitions, so that the run lasts long enough to be killed.
    table = (
        "table",
        "--set",
        folder,
        "--solvers",
        "secular,hybrid",
        "--repetitions",
        200,
        "--out",
        tmp_path / "run",
    )
    path = tmp_path / "run" / "rows.jsonl"

    killed = command(*table)
    wait_for_rows(path, 4, killed)
    killed.kill()
    killed.communicate()
    kept = path.read_bytes().splitlines(keepends=True)
    assert 4 <= len(kept) < 80
    path.write_bytes(b"".join(kept[:-1]) + kept[-1][:100])  # as if killed in the middle of a line

    interrupted = command(*table)
    wait_for_rows(path, len(kept) + 4, interrupted)
    interrupted.send_signal(signal.SIGINT)
    _, errors = interrupted.communicate()
    assert interrupted.returncode == 130, errors
    assert "torn line" in errors
    assert "continues from" in errors
    assert "Traceback" not in errors

    last = command(*table)
    _, errors = last.communicate()
    assert last.returncode == 0, errors
    lines = path.read_bytes().splitlines(keepends=True)
    assert lines[: len(kept) - 1] == kept[:-1]
    rows = RowFile(tmp_path / "run").read()
    assert len(rows) == len({Key.of(row) for row in rows}) == 160


def test_rows_of_other_code_are_not_taken_for_these(tmp_path, monkeypatch):
    plan = plan_for(write_set(tmp_path / "set", 1), ["secular"])
    run_rows(plan, tmp_path / "run")
    monkeypatch.setattr(plan_module, "code", lambda: "another")
    listener = Silent()
    assert [row["code"] == "another" for row in run_rows(plan, tmp_path / "run", listener)] == [
        False,
        False,
        True,
        True,
    ]
    assert len(listener.notes) == 1
    assert "2 row(s) of another protocol, other code" in listener.notes[0]


def test_row_files_hold_what_is_not_finite_as_empty(tmp_path):
    rows = RowFile(tmp_path)
    with rows.appending():
        rows.append({"residual": float("inf"), "n": 3, "text": "a\nb"})
    assert rows.read() == [{"residual": None, "n": 3, "text": "a\nb"}]
    assert json.loads(rows.path.read_text())["residual"] is None


def test_moving_a_run_away_keeps_it(tmp_path):
    folder = tmp_path / "run"
    assert move_away(folder) is None
    for name in ("run.1", "run.2"):
        folder.mkdir()
        (folder / "mark").write_text(name)
        assert move_away(folder) == tmp_path / name
    assert (tmp_path / "run.1" / "mark").read_text() == "run.1"


# Sets of problems


def write_manifest(folder, **columns):
    files = sorted(file.name for file in folder.glob("*.hdf5"))
    with (folder / "manifest.csv").open("w", newline="") as stream:
        lines = csv.writer(stream)
        lines.writerow(["file", *columns])
        lines.writerows([file, *(value(folder / file) for value in columns.values())] for file in files)


HASHES = {
    "file": lambda file: hashlib.sha256(file.read_bytes()).hexdigest(),
    "start of the file's": lambda file: hashlib.sha256(file.read_bytes()).hexdigest()[:12],
    "problem": lambda file: chain(4, int(file.stem[-2:])).condense().content_hash(),
}


@pytest.mark.parametrize("kind", HASHES)
def test_manifest_is_checked_and_obeyed(tmp_path, kind):
    folder = write_set(tmp_path / "set", 3)
    unsolvable = {"chain-01.hdf5": "unsolvable"}
    write_manifest(
        folder, scene=lambda f: "chains", hash=HASHES[kind], existence=lambda f: unsolvable.get(f.name, "")
    )
    entries = load_set(folder)
    assert [entry.name for entry in entries] == ["chain-00", "chain-01", "chain-02"]
    assert {entry.scene for entry in entries} == {"chains"}
    assert [entry.existence for entry in entries] == ["", "unsolvable", ""]
    write(folder / "chain-02.hdf5", chain(4, 77))
    with pytest.raises(BenchError, match=r"chain-02.hdf5: its content is not"):
        load_set(folder)
    (folder / "chain-02.hdf5").unlink()
    with pytest.raises(BenchError, match=r"chain-02.hdf5 is listed but not there"):
        load_set(folder)


@pytest.mark.parametrize("bytes_", [b"file\n\xff.hdf5\n", b"file\n" + b"x" * 200_000])
def test_a_manifest_that_cannot_be_read_is_refused_by_name(tmp_path, bytes_):
    folder = write_set(tmp_path / "set", 1)
    (folder / "manifest.csv").write_bytes(bytes_)
    with pytest.raises(BenchError, match=r"manifest.csv: not readable"):
        load_set(folder)
    with pytest.raises(BenchError, match=r"manifest.csv: not readable"):
        origin(entry_of(folder / "chain-00.hdf5"))


def test_a_folder_without_problems_or_with_one_twice_is_refused(tmp_path):
    with pytest.raises(BenchError, match="no FCLIB files"):
        load_set(tmp_path)
    write(tmp_path / "a.hdf5", chain(2, 0))
    write(tmp_path / "b.h5", chain(2, 0))
    with pytest.raises(BenchError, match=r"a.hdf5 and b.h5 are the same"):
        load_set(tmp_path)


def test_sets_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "problems" / "mine").mkdir(parents=True)
    assert find_set("mine").resolve() == tmp_path / "problems" / "mine"
    with pytest.raises(BenchError, match=r"'yours'.*known sets: .*mine"):
        find_set("yours")


@pytest.mark.parametrize(("limit", "expected"), [(None, 10), (1, 1), (3, 3), (10, 10), (99, 10)])
def test_a_trial_takes_different_problems_in_order(limit, expected):
    found = limited(list(range(10)), limit)
    assert len(found) == len(set(found)) == expected
    assert found == sorted(found)


def test_options_are_written_in_full():
    assert "facets=8.0" in options_text(configure("pyramid:facets=8", registered()))
