"""Runs as things: their rows survive anything, and they are listed, shown, compared and merged."""

import fcntl
import json
import math
import multiprocessing
import os
import random
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import quick_desk
from hypothesis import given, settings
from hypothesis import strategies as st
from test_bench_run import plan_for, write_set
from typer.testing import CliRunner

from fibercontact.bench import rows as rows_module
from fibercontact.bench.compare import Margins, bootstrap, compare
from fibercontact.bench.merge import merge
from fibercontact.bench.plan import Plan
from fibercontact.bench.protocol import BenchError, Limits
from fibercontact.bench.record import Asked, Record, find_runs, read_run
from fibercontact.bench.report import make_report
from fibercontact.bench.rows import (
    CLOCKS,
    RATES,
    TIMED,
    Key,
    RowFile,
    but_for_clocks,
    lines,
    move_away,
    writer,
)
from fibercontact.bench.run_views import listing, progress
from fibercontact.cli import app

# The file of rows

VALUES = st.one_of(st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text(), st.booleans())
ROWS = st.lists(st.dictionaries(st.text(), VALUES, min_size=1), min_size=1, max_size=4)


@given(rows=ROWS, data=st.data())
def test_rows_before_a_torn_line_survive_and_others_can_follow(rows, data, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    file, whole = RowFile(folder), lines(rows)
    cut = data.draw(st.integers(0, len(whole)))
    file.path.write_bytes(whole[:cut])
    ends = np.cumsum([len(lines([row])) for row in rows])
    kept = int((ends - 1 <= cut).sum())  # a line is whole without its end, too
    torn = cut > ([0, *ends])[kept]
    assert file.read() == rows[:kept]
    assert len(file.notes()) == torn
    with file.appending():
        file.append({"next": 1})
    assert file.read() == [*rows[:kept], {"next": 1}]
    assert len(file.notes()) == torn


def test_a_second_run_in_a_folder_is_refused_with_the_process_that_has_it(tmp_path):
    said = rf"{tmp_path}: another run is writing to it \(process {os.getpid()} on .+\)"
    with RowFile(tmp_path).appending():
        with pytest.raises(BenchError, match=said), RowFile(tmp_path).appending():
            pass
        with pytest.raises(BenchError, match=said):
            move_away(tmp_path)
    with RowFile(tmp_path).appending():
        pass


def test_whether_a_run_goes_on_is_told_by_its_lock(tmp_path):
    folder = write_run(tmp_path / "run", [row()])
    assert writer(folder) == ""  # without a lock
    with RowFile(folder).appending():
        assert writer(folder).startswith(f"process {os.getpid()} on ")
        assert listing(find_runs(tmp_path), tmp_path)["now"][0] == f"measuring: {writer(folder)}"
    assert writer(folder) == ""  # its file stays
    assert listing(find_runs(tmp_path), tmp_path)["now"][0] == "–"


def test_a_run_can_begin_while_somebody_asks_whether_one_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(rows_module, "ASKED_SECONDS", 0.5)
    with RowFile(tmp_path).appending():
        pass
    with (tmp_path / "run.lock").open() as asking:
        fcntl.flock(asking, fcntl.LOCK_SH)
        answered = threading.Timer(0.1, fcntl.flock, (asking, fcntl.LOCK_UN))
        answered.start()
        with RowFile(tmp_path).appending():
            pass
        answered.join()


FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(["fibercontact.bench.run"])


def small_plan(folder):
    """48 rows."""
    return plan_for(
        write_set(folder, 3),
        ["secular", "hybrid"],
        timed=("low", "mid", "high", "full"),
        limits=Limits(10, 1.0),
    )


def measured_apart(plan, folder):
    process = FORKS.Process(target=quick_desk.measure, args=(plan, folder))
    process.start()
    return process


def told(rows):
    return sorted(json.dumps(but_for_clocks(row), sort_keys=True) for row in rows)


def test_a_run_that_is_killed_at_twenty_random_instants_has_the_rows_of_one_that_is_not(tmp_path):
    """Instants between the start and some time after the third of the new rows."""
    plan, instants = small_plan(tmp_path / "set"), random.Random(1)
    undisturbed, killed = RowFile(tmp_path / "undisturbed"), RowFile(tmp_path / "killed")
    measured_apart(plan, undisturbed.path.parent).join()

    def written():
        return killed.path.read_bytes() if killed.path.exists() else b""

    cut_short, before = 0, b""
    for _ in range(20):
        more, later = instants.randrange(4), instants.random()
        process = measured_apart(plan, killed.path.parent)
        while more and process.is_alive() and written().count(b"\n") < before.count(b"\n") + more:
            time.sleep(0.001)
        process.join(later * (0.02 if more else 0.3))
        process.kill()
        process.join()
        cut_short += process.exitcode == -signal.SIGKILL
        assert written().startswith(before)  # what was written stays
        before = written()
    last = measured_apart(plan, killed.path.parent)
    last.join()
    assert last.exitcode == 0
    assert cut_short >= 5
    assert len(undisturbed.read()) == 48
    assert told(killed.read()) == told(undisturbed.read())


# Runs


def key(problem="p0", solver="secular", **changes):
    fields = {
        "problem_hash": problem, "solver": solver, "fingerprint": "f", "options": "", "accuracy": "low",
        "start": "cold", "outer": "plain", "mode": TIMED, "repetitions": 5, "max_sweeps": 5000, "max_seconds": 30.0,
        "protocol": 1, "code": "c", "cpu": "a machine",
    }  # fmt: skip
    return Key(**fields | changes)


def row(problem="p0", solver="secular", seconds=1.0, sweeps=40, solved=True, noise=0.0, **changes):
    times = [seconds * (1.0 + noise * k) for k in range(-2, 3)]
    known = key(problem, solver, **changes)
    timed = {"time_best": times[0], "time_median": times[2], "times": times} if known.mode == TIMED else {}
    return known.fields() | timed | {
        "problem": problem, "scene": "a scene", "existence": "", "law_facets": 0, "solved": solved, "sweeps": sweeps,
        "reason": "" if solved else "outer", "load": 0.0, "threads": 1, "stamp": "2026-01-01T00:00:00+00:00",
        "cpu": changes.get("cpu", "a machine"), "setup_seconds": 0.1, "coulomb": 1e-3, "contacts": 9, "mu_max": 0.5,
        "tolerance": 1e-2, "false_success": False,
    }  # fmt: skip


def a_run(rows, name="A", asked=()):
    return Record(Path(name), asked, list(rows))


def write_run(folder, rows, asked=()):
    folder.mkdir(parents=True)
    (folder / "rows.jsonl").write_bytes(lines(rows))
    return folder


PROBLEMS = [f"p{k}" for k in range(12)]


def run_with(factors, name, **values):
    """A run whose times are 1 ms times a factor, problem by problem."""
    return a_run([row(p, seconds=1e-3 * f, **values) for p, f in zip(PROBLEMS, factors, strict=True)], name)


@settings(max_examples=20)
@given(
    factors=st.lists(st.floats(0.1, 10.0), min_size=12, max_size=12),
    scale=st.floats(0.01, 100.0),
)
def test_ratios_scale_and_turn_round_with_the_runs(factors, scale):
    plain, scaled = run_with(np.ones(12), "A"), run_with(factors, "B")
    larger = run_with(scale * np.array(factors), "C")
    line = compare(plain, scaled).overall.iloc[0]
    for other, of in (
        (compare(plain, larger).overall.iloc[0], lambda i: (i.value / scale, i.low / scale, i.high / scale)),
        (compare(scaled, plain).overall.iloc[0], lambda i: (1 / i.value, None, None)),
    ):
        for column in ("time geo", "time median"):
            for found, expected in zip(of(other[column]), vars(line[column]).values(), strict=True):
                assert found is None or found == pytest.approx(expected, rel=1e-9)
    assert line["time geo"].value == pytest.approx(math.exp(np.mean(np.log(factors))))
    assert line["time median"].value == pytest.approx(math.exp(np.median(np.log(factors))))
    assert line["time geo"].low <= line["time geo"].value * (1 + 1e-12)
    assert line["time geo"].value <= line["time geo"].high * (1 + 1e-12)


def test_an_interval_holds_the_truth_as_often_as_it_says():
    """Of 200 samples of 40 ratios with a geometric mean of 1.3."""
    rng = np.random.default_rng(0)
    intervals = [bootstrap(1.3 * np.exp(0.2 * rng.normal(size=40)), np.mean) for _ in range(200)]
    held = sum(interval.low <= 1.3 <= interval.high for interval in intervals)
    assert 180 <= held <= 198  # 95 %, a little less for the percentile's bias, give or take three sigma


def test_one_figure_has_no_interval_and_none_has_no_value():
    one, none = bootstrap(np.array([2.0]), np.mean), bootstrap(np.array([]), np.mean)
    assert (one.value, str(one)) == (pytest.approx(2.0), "2")
    assert math.isnan(one.low)
    assert str(none) == "–"


CALM = np.ones(12)
ONE_SLOW = np.array([1.0] * 11 + [2.0])


@pytest.mark.parametrize(
    ("b", "named"),
    [
        (run_with(CALM, "B"), []),
        (run_with(0.5 * CALM, "B", sweeps=20), []),
        (run_with(1.04 * CALM, "B"), []),
        (run_with(1.06 * CALM, "B"), ["secular at low: slower, geometric mean ratio 1.06 [1.06, 1.06]"]),
        (run_with(ONE_SLOW, "B"), ["p11 secular at low: slower, ratio 2 [2, 2]"]),
        (run_with(ONE_SLOW, "B", noise=0.4), []),  # such repetitions tell nothing
        (run_with(CALM, "B", sweeps=42), []),
        (
            run_with(CALM, "B", sweeps=43),
            ["secular at low: more sweeps, geometric mean ratio 1.07 [1.07, 1.07]"],
        ),
        (
            a_run([row(p, seconds=1e-3, solved=p != "p3") for p in PROBLEMS], "B"),
            ["p3 secular at low: solved before, failed now (outer)"],
        ),
        (
            a_run([row(p, seconds=1e-3, sweeps=60 if p == "p3" else 40) for p in PROBLEMS], "B"),
            ["p3 secular at low: 40 sweeps before, 60 now"],
        ),
    ],
)
def test_regressions_are_named_by_the_rule(b, named):
    assert list(compare(run_with(CALM, "A"), b).regressions) == named


def test_margins_are_the_callers():
    a, b = run_with(CALM, "A"), run_with(1.06 * CALM, "B")
    assert compare(a, b, Margins(0.07)).regressions == []
    assert len(compare(a, b, Margins(0.07, 0.05)).regressions) == 12


def test_flips_are_counted_once_and_do_not_enter_the_ratios():
    """A timed row and the one that it came of are one measurement."""
    both = [
        row(p, seconds=1e-3, solved=p != "p0", **mode)
        for p in PROBLEMS
        for mode in ({}, {"mode": RATES, "repetitions": 0})
    ]
    found = compare(run_with(CALM, "A"), a_run(both, "B"))
    line = found.overall.iloc[0]
    assert (line["pairs"], line["newly failed"], line["newly solved"], line["timed"]) == (12, 1, 0, 11)
    assert compare(a_run(both, "B"), run_with(CALM, "A")).overall.iloc[0]["newly solved"] == 1


def test_problems_that_are_proved_unsolvable_are_left_out():
    a, b = ([row(p) | {"existence": "unsolvable" if p == "p1" else ""} for p in PROBLEMS] for _ in "ab")
    assert "p1" not in set(compare(a_run(a), a_run(b)).pairs["problem"])


def test_runs_of_different_protocols_are_not_compared():
    a = run_with(CALM, "A")
    with pytest.raises(
        BenchError, match=r"A and B have different protocols: protocol 1 and 2; max_sweeps 5000 and 9"
    ):
        compare(a, run_with(CALM, "B", protocol=2, max_sweeps=9))
    with pytest.raises(BenchError, match=r"no measurement in common: they differ in start"):
        compare(a, run_with(CALM, "B", start="guess"))


def test_runs_without_rows_and_without_answers_have_no_ratios():
    with pytest.raises(BenchError, match="B: no rows to compare"):
        compare(run_with(CALM, "A"), a_run([], "B"))
    crashed = [
        {n: v for n, v in row(p, solved=False).items() if n not in ("sweeps", "times")} for p in PROBLEMS
    ]
    line = compare(a_run(crashed), a_run(crashed)).overall.iloc[0]
    assert (str(line["time geo"]), str(line["sweeps geo"]), line["newly failed"]) == ("–", "–", 0)


def test_of_rows_of_older_code_and_newer_the_newer_is_compared():
    mixed = a_run([row("p0", sweeps=sweeps, code=code) for sweeps, code in ((99, "old"), (40, "new"))], "B")
    assert compare(a_run([row("p0")], "A"), mixed).pairs["sweeps_b"].tolist() == [40]


def test_what_else_differs_is_told():
    found = compare(run_with(CALM, "A"), run_with(CALM, "B", cpu="another", code="d"))
    assert "code: c | d" in found.notes
    assert any("times of two machines" in note for note in found.notes)
    busy = a_run([r | {"load": 2.0} for r in run_with(CALM, "B").rows], "B")
    assert list(compare(run_with(CALM, "A"), busy).notes) == [
        "B: the machine was not idle (2.0 other processes at work)"
    ]
    fewer = a_run(run_with(CALM, "B").rows[:5], "B")
    assert list(compare(run_with(CALM, "A"), fewer).notes) == ["7 measurement(s) only in A"]


# Merges


def test_parts_make_a_whole(tmp_path):
    rows = [row(p, solver) for p in PROBLEMS for solver in ("secular", "hybrid")]
    parts = [read_run(write_run(tmp_path / str(k), rows[k::3])) for k in range(3)]
    assert merge(parts, tmp_path / "whole") == len(rows)
    assert told(read_run(tmp_path / "whole").rows) == told(rows)


def test_a_measurement_made_twice_is_kept_once_unless_it_differs(tmp_path):
    one = read_run(write_run(tmp_path / "one", [row("p0"), row("p1")]))
    later = [row("p1", seconds=2.0) | {"stamp": "2027-01-01T00:00:00+00:00", "load": 3.0}, row("p2")]
    other = read_run(write_run(tmp_path / "other", later))
    assert merge([one, other], tmp_path / "whole") == 3
    assert read_run(tmp_path / "whole").rows[1]["time_median"] == 1.0  # the first
    differs = read_run(write_run(tmp_path / "differs", [row("p1", sweeps=41)]))
    said = rf"p1 secular at low \(timed\) is in {one.folder} and in {differs.folder}, and differs in sweeps"
    with pytest.raises(BenchError, match=said):
        merge([one, differs], tmp_path / "no")
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"protocol": 2}, "protocol: 1 in {a}, 2 in {b}"),
        ({"code": "d"}, "code: c in {a}, d in {b}"),
        ({"start": "guess"}, "start: cold in {a}, guess in {b}"),
        ({"outer": "robust"}, "outer: plain in {a}, robust in {b}"),
        ({"max_seconds": 60.0}, "max_seconds: 30.0 in {a}, 60.0 in {b}"),
        ({"repetitions": 9}, "repetitions: 5 in {a}, 9 in {b}"),
        ({"fingerprint": "g"}, "sources of secular: f in {a}, g in {b}"),
        ({"cpu": "another"}, "cpu of the times: a machine in {a}, another in {b}"),
    ],
)
def test_different_protocols_are_not_merged_and_what_differs_is_said(tmp_path, changes, said):
    a = write_run(tmp_path / "a", [row("p0")])
    b = write_run(tmp_path / "b", [row("p1", **changes)])
    with pytest.raises(BenchError) as refusal:
        merge([read_run(a), read_run(b)], tmp_path / "c")
    assert str(refusal.value) == f"different protocols are not merged: {said.format(a=a, b=b)}"


def test_rates_of_two_machines_are_merged_and_both_are_kept(tmp_path):
    modes = {"mode": RATES, "repetitions": 0}
    rows = [row(p, cpu=cpu, **modes) for p, cpu in (("p0", "one"), ("p1", "another"))]
    runs = [read_run(write_run(tmp_path / r["problem"], [r])) for r in rows]
    merge(runs, tmp_path / "whole")
    assert [r["cpu"] for r in read_run(tmp_path / "whole").rows] == ["one", "another"]


def test_a_merge_goes_to_a_new_folder(tmp_path):
    part = write_run(tmp_path / "part", [row()])
    with pytest.raises(BenchError, match="not empty"):
        merge([read_run(part)], part)


# Records


def asked(problems, *keys):
    fields = [{name: value for name, value in k.fields().items() if name != "problem_hash"} for k in keys]
    return Asked("a set", problems, fields, {"machine": "here"}, "2026-01-01T00:00:00+00:00")


def test_progress_is_of_what_was_asked():
    mine, others = [row("p0"), row("p1")], [row("p2"), row("p0", code="older")]
    record = a_run(mine + others, asked=[asked(["p0", "p1", "p9"], key())])
    assert record.rows == mine
    assert progress(record) == "2/3"
    assert progress(a_run(mine)) == "2/?"
    twice = a_run(mine, asked=[asked(["p0"], key()), asked(["p0", "p1"], key(), key(solver="hybrid"))])
    assert progress(twice) == "2/4"


def test_a_rate_is_the_same_measurement_on_any_machine():
    one, other = (row(mode=RATES, repetitions=0, cpu=cpu) for cpu in ("one", "another"))
    assert Key.of(one) == Key.of(other)
    assert but_for_clocks(one) == but_for_clocks(other)
    assert Key.of(row(cpu="one")) != Key.of(row(cpu="another"))
    assert set(CLOCKS) & set(key().fields()) == {"cpu"}


def test_a_run_is_read_from_its_table_where_its_rows_were_not_kept(tmp_path):
    rows = [row("p0"), row("p1", solved=False), row("p2", mode=RATES, repetitions=0)]
    write_run(tmp_path / "rows", rows)
    (tmp_path / "table").mkdir()
    pd.DataFrame(rows).to_csv(tmp_path / "table" / "rows.csv.gz", index=False)
    one, other = read_run(tmp_path / "rows"), read_run(tmp_path / "table")
    assert [Key.of(r) for r in one.rows] == [Key.of(r) for r in other.rows]
    assert compare(one, other).regressions == []
    assert compare(one, other).overall.iloc[0]["time geo"].value == 1.0


def test_runs_are_found_at_any_depth_and_other_folders_are_not(tmp_path):
    write_run(tmp_path / "b", [row()])
    write_run(tmp_path / "a" / "deep", [row(), row("p1")])
    write_run(tmp_path / "of-another-kind", [{"problem": "p"}])
    write_run(tmp_path / "of-lists", [row() | {"solver": ["secular"]}])
    found = listing(find_runs(tmp_path), tmp_path)
    assert list(found["folder"]) == ["a/deep", "b"]
    assert list(found["problems"]) == ["2", "1"]
    (tmp_path / "none").mkdir()
    with pytest.raises(BenchError, match="no runs in it"):
        find_runs(tmp_path / "none")


# The commands


def call(*arguments):
    return CliRunner().invoke(app, ["runs", *map(str, arguments)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two runs of a plan, one of them not finished."""
    folder = tmp_path_factory.mktemp("runs")
    plan = small_plan(folder.parent / "a_set")
    for name in ("one", "other"):
        measured_apart(plan, folder / name).join()
    file = RowFile(folder / "other")
    file.path.write_bytes(lines(file.read()[:-5]))
    return folder


def test_list(folder):
    result = call("list", folder)
    assert result.exit_code == 0, result.output
    for text in ("one", "other", "48/48", "43/48", "a_set"):
        assert text in result.output
    assert call("list", folder / "nowhere").exit_code == 2


def test_show(folder):
    result = call("show", folder / "other")
    assert result.exit_code == 0, result.output
    for text in ("43/48", "secular, hybrid", "3 problems, accuracy low"):
        assert text in result.output
    nothing = call("show", folder)
    assert nothing.exit_code == 2
    assert "no run there" in nothing.stderr


def test_show_counts_a_timed_measurement_once(tmp_path):
    """Not its pass before, which was solved where a timed one was not."""
    before, failed = row(accuracy="mid", mode=RATES, repetitions=0), row(accuracy="mid", solved=False)
    view = make_report([row(), before, failed], ["secular"]).views[0]
    assert view.table["failure_percent_mid"].tolist() == [100.0]


def test_compare(folder, tmp_path):
    result = call(
        "compare", folder / "one", folder / "other", "--csv", tmp_path / "pairs.csv", "--margin", 99
    )
    assert result.exit_code == 0, result.output
    pairs = pd.read_csv(tmp_path / "pairs.csv")
    assert len(pairs) == 3 * 2 * 4
    assert (pairs["sweeps_ratio"] == 1.0).all()
    worse = [r | {"sweeps": 2 * r["sweeps"]} for r in read_run(folder / "one").rows]
    write_run(tmp_path / "worse", worse)
    result = call("compare", folder / "one", tmp_path / "worse")
    assert result.exit_code == 1
    assert "regression: all at low: more sweeps, geometric mean ratio 2 [2, 2]" in result.output
    assert "and 16 more" in result.output  # 12 of solvers and of all, 24 of problems
    refused = call("compare", folder / "one", folder)
    assert refused.exit_code == 2


def test_merge(folder, tmp_path):
    rows = read_run(folder / "one").rows
    for name, part in (("a", rows[:20]), ("b", rows[20:])):
        write_run(tmp_path / name, part)
        (tmp_path / name / "run.json").write_bytes((folder / "one" / "run.json").read_bytes())
    result = call("merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "c")
    assert result.exit_code == 0, result.output
    whole = read_run(tmp_path / "c")
    assert progress(whole) == "48/48"
    assert len(whole.asked) == 2
    refused = call("merge", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "c")
    assert refused.exit_code == 2
    assert "not empty" in refused.stderr


def test_a_merged_run_is_one_that_goes_on(folder, tmp_path):
    """Its rows are found by the runner: nothing is measured again."""
    plan = small_plan(folder.parent / "a_set")
    merge([read_run(folder / "one")], tmp_path / "merged")
    before = (tmp_path / "merged" / "rows.jsonl").read_bytes()
    measured_apart(replace(plan), tmp_path / "merged").join()
    assert (tmp_path / "merged" / "rows.jsonl").read_bytes() == before
    assert isinstance(plan, Plan)
