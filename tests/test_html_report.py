"""What a report shows: the numbers of the tables, what is missing, what went wrong, and nothing that a name does."""

import hashlib
import html
import json

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from report_rows import RESULTS, RUNS, SOLVERS, committed, page_of_core306, rods_of_ours, row, rows, write_run
from scipy.sparse import csr_array, eye_array
from typer.testing import CliRunner

from fibercontact.bench.html_report import page as module
from fibercontact.bench.html_report.choice import chosen, locate, named
from fibercontact.bench.html_report.figures import (
    Curve,
    accuracies_figure,
    convergence_figure,
    plain,
    profile_figure,
    reasons_figure,
    rounded,
    styles,
    within_figure,
)
from fibercontact.bench.html_report.limitations import limitations
from fibercontact.bench.html_report.page import LARGEST, Shown, as_json, page, page_data, write_page
from fibercontact.bench.html_report.portraits import strictest
from fibercontact.bench.html_report.rods import rods_of
from fibercontact.bench.html_report.runs import renamed, reported
from fibercontact.bench.html_report.tables import headline_table, side_by_side
from fibercontact.bench.problem_set import entry_of, find_problem, known_sets
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.record import Asked, write_asked
from fibercontact.bench.report import make_report, number
from fibercontact.bench.rows import Key, RowFile
from fibercontact.bench.tables import performance_ratios, rated
from fibercontact.cli import app
from fibercontact.problem.fclib import write
from fibercontact.problem.step import StepProblem


@pytest.fixture
def run(tmp_path):
    return reported(write_run(tmp_path / "run", rows() + rows("mid", "rates")))


# Runs read back


def test_the_tables_are_those_of_a_run(run):
    expected = make_report(rows(), SOLVERS).views[0]
    (timed, mid) = run.views
    found = timed.table.drop(columns="failure_percent_mid")
    pd.testing.assert_frame_equal(found.loc[SOLVERS], expected.table, check_like=True)
    assert (timed.mode, mid.mode, mid.accuracy) == ("timed", "rates", "mid")
    assert run.remarks == []


@pytest.mark.parametrize("name", ["core306", "rods102"])
def test_committed_rows_give_the_committed_table(name):
    table = pd.read_csv(RESULTS / name / "table.csv").set_index("solver")
    view = committed(name).views[0]
    numbers = [column for column in table if table[column].dtype.kind in "if"]
    pd.testing.assert_frame_equal(
        view.table[numbers].loc[table.index], table[numbers], check_dtype=False, rtol=1e-12
    )
    assert list(view.table.index) == list(table.index)
    strata = pd.read_csv(RESULTS / name / "strata.csv").query("accuracy == 'low'").reset_index(drop=True)
    pd.testing.assert_series_equal(view.strata["time_geo_ms"], strata["time_geo_ms"])


def test_the_passes_before_timed_ones_are_not_shown(tmp_path):
    run = reported(write_run(tmp_path / "run", rows("low", "rates") + rows()))
    assert [view.mode for view in run.views] == ["timed"]
    assert len(run.rows) == len(rows())
    assert run.remarks == []


def test_a_run_that_was_not_timed_is_shown_as_such(tmp_path):
    run = reported(write_run(tmp_path / "run", rows("mid", "rates")))
    assert [view.mode for view in run.views] == ["rates"]
    assert any("Nothing was timed" in sentence for sentence in limitations(run))
    assert page_data([Shown(run, [])])["runs"][0]["views"][0]["profile"] is None


@pytest.mark.parametrize(
    "old", [{"code": "0ld"}, {"cpu": "6502"}, {"protocol": 0}, {"start": "guess"}, {"fingerprint": "0ld"},
            {"outer": "robust"}, {"max_sweeps": 10}],
)  # fmt: skip
def test_rows_of_an_older_setting_are_left_aside(tmp_path, old):
    before = rows(stamp="2025-01-01T00:00:00+00:00", sweeps=1, **old)
    run = reported(write_run(tmp_path / "run", rows() + before))
    assert (run.rows["sweeps"] != 1).all()
    assert len(run.rows) == len(rows())
    (remark,) = run.remarks
    assert remark.startswith(f"{len(before)} row(s)")


def test_a_measurement_made_twice_counts_once(tmp_path):
    again = row("one", "pac", sweeps=7, stamp="2026-02-01T00:00:00+00:00")
    run = reported(write_run(tmp_path / "run", [*rows(), again]))
    mine = run.rows[(run.rows["problem"] == "one") & (run.rows["solver"] == "pac")]
    assert mine["sweeps"].tolist() == [7]


@pytest.mark.parametrize("gone", [[0], [3, 4, 5], [1, 4, 7], [0, 4, 5, 6, 8, 9], [0, 1, 3, 4, 6, 7]])
def test_missing_rows_are_counted(tmp_path, gone):
    kept = [one for k, one in enumerate(rows()) if k not in gone]
    run = reported(write_run(tmp_path / "run", kept))
    problems, solvers = ({one[name] for one in kept} for name in ("problem", "solver"))
    lacking = len(problems) * len(solvers) - len(kept)
    said = [remark for remark in run.remarks if remark.startswith("incomplete")]
    assert len(said) == (lacking > 0)
    assert all(f" {lacking} of {len(problems) * len(solvers)} rows are missing" in remark for remark in said)


def test_rows_that_were_asked_for_are_missed(tmp_path):
    """Also where no problem has a row of a solver, which the rows cannot tell."""
    whole, folder = rows(), tmp_path / "run"
    kept = [one for one in whole if one["solver"] != whole[0]["solver"]]
    write_run(folder, kept)
    keys = [Key.of(one).fields() for one in whole]
    measurements = [{n: v for n, v in key.items() if n != "problem_hash"} for key in keys]
    unique = list({str(one): one for one in measurements}.values())
    write_asked(folder, [Asked("set", sorted({key["problem_hash"] for key in keys}), unique, {}, "")])
    (said,) = (remark for remark in reported(folder).remarks if remark.startswith("incomplete"))
    assert f" {len(whole) - len(kept)} of {len(whole)} rows that were asked for" in said


def test_rates_of_several_machines_are_one_run(tmp_path):
    """What is not timed is the same anywhere; times of another machine are left aside."""
    run = reported(write_run(tmp_path / "run", [*rows(), *rows("mid", "rates", cpu="another")]))
    assert len(run.views) == 2
    assert not any("left aside" in remark for remark in run.remarks)


def test_a_run_without_its_table_is_incomplete(tmp_path):
    run = reported(write_run(tmp_path / "run", rows(), finished=False))
    assert ["incomplete" in remark for remark in run.remarks] == [True]
    assert "incomplete: the run was interrupted" in page([Shown(run, [])])


def test_a_torn_line_is_told(tmp_path):
    folder = write_run(tmp_path / "run", rows())
    with (folder / "rows.jsonl").open("a") as stream:
        stream.write('{"problem": "on')
    assert any("torn" in remark for remark in reported(folder).remarks)


def broken(folder, text=None, name="rows.jsonl"):
    folder.mkdir()
    if text is not None:
        (folder / name).write_text(text, encoding="utf-8")


@pytest.mark.parametrize(
    ("make", "fault"),
    [
        (lambda run: None, "no such folder"),
        (lambda run: broken(run), "no run there"),
        (lambda run: broken(run, ""), "no rows"),
        (lambda run: broken(run, '{"torn'), "no rows"),
        (lambda run: broken(run, "[1]\n{}"), "not those of a run"),
        (lambda run: broken(run, 'problem\n"one', "rows.csv"), "not readable"),
        (lambda run: broken(run, "", "rows.csv"), "not readable"),
        (lambda run: broken(run, "no gzip", "rows.csv.gz"), "not readable"),
        (lambda run: write_run(run, rows(sweeps="many")), "row 1: sweeps is 'many', not a number"),
        (lambda run: write_run(run, rows(solved="yes")), "row 1: solved is 'yes', not true or false"),
        (lambda run: write_run(run, rows(contacts=None)), "row 1: contacts is None, not a number"),
        (lambda run: write_run(run, [row("one", "pac") | {"solver": 3}]), "row 1: solver is 3, not a text"),
        (lambda run: write_run(run, rows(time_median=True)), "row 1: time_median is True, not a number"),
        (lambda run: write_run(run, [row("one", "pac") | {"accuracy": "best"}]), "accuracy is 'best'"),
        (lambda run: write_run(run, [row("one", "pac") | {"mode": "fast"}]), "mode is 'fast'"),
        (lambda run: write_run(run, rows(existence="unsolvable")), "nothing to rate"),
    ],
)  # fmt: skip
def test_a_broken_run_is_an_error_that_names_the_folder_and_the_fault(tmp_path, make, fault):
    make(tmp_path / "broken")
    with pytest.raises(BenchError, match="broken") as error:
        reported(tmp_path / "broken")
    assert fault in str(error.value)


def test_runs_of_one_name_go_by_their_paths(tmp_path):
    (tmp_path / "a").mkdir()
    first, second = (write_run(folder / "run", rows()) for folder in (tmp_path, tmp_path / "a"))
    assert [run.name for run in renamed([reported(first), reported(second)])] == [str(first), str(second)]


# Figures


def shares(trace):
    return dict(zip(trace.x, trace.y, strict=True))


def test_the_profile_is_the_distribution_of_the_ratios(run):
    view = run.views[0]
    ratios = performance_ratios(view.rows, SOLVERS)
    figure = profile_figure(view, styles(run.solvers))
    assert [trace.name for trace in figure.data] == run.solvers
    for trace in figure.data:
        for x, y in list(shares(trace).items())[1:]:
            assert y == pytest.approx((ratios[trace.name] <= x * (1 + 1e-3)).mean(), abs=1e-3)


def test_all_that_is_solved_arrives_in_time(run):
    for view in run.views:
        for trace in within_figure(view, styles(run.solvers)).data:
            assert np.all(np.diff(trace.y) >= 0.0)
            assert trace.y[-1] == pytest.approx(1.0 - view.table.loc[trace.name, "failure_percent"] / 100.0)
            costs = [ms if view.mode == "timed" else n for n, ms, reason in RUNS[trace.name] if not reason]
            assert list(trace.x[1:-1]) == pytest.approx(sorted(costs))


def test_failures_by_reason_add_up_to_the_table(run):
    figure = reasons_figure(run.views[0], styles(run.solvers))
    counts = pd.DataFrame({trace.name: list(trace.x) for trace in figure.data}, index=figure.data[0].y)
    assert counts.sum(axis=1).to_dict() == run.views[0].table["failed"].to_dict()
    assert counts.loc["hybrid"].to_dict() == {"outer": 0, "local": 0, "false success": 1}


def test_without_failures_there_is_no_figure_of_them(tmp_path):
    found = [one for one in rows() if one["solver"] == "secular"]
    view = reported(write_run(tmp_path / "run", found)).views[0]
    assert reasons_figure(view, styles(["secular"])) is None


def test_times_are_drawn_against_accuracy_where_several_were_timed(run, tmp_path):
    assert accuracies_figure(run.views, styles(run.solvers)) is None
    two = reported(write_run(tmp_path / "two", rows() + rows("mid")))
    figure = accuracies_figure(two.views, styles(two.solvers))
    for trace in figure.data:
        assert list(trace.x) == [1e-2, 1e-4]
        assert list(trace.y) == pytest.approx(
            [v.table.loc[trace.name, "time_geo_ms"] for v in two.views], rel=1e-3
        )


def test_a_solver_has_one_colour_everywhere(run):
    known = styles(run.solvers)
    figures = [profile_figure(run.views[0], known), within_figure(run.views[1], known)]
    figures.append(convergence_figure([Curve(name, [1], [0.5]) for name in run.solvers], 1e-2, known))
    for figure in figures:
        found = {trace.name: (trace.line.color, trace.meta["solver"]) for trace in figure.data}
        assert found == {name: (style.colour, style.number) for name, style in known.items()}
    assert len({style[1:3] for style in styles([str(k) for k in range(24)]).values()}) == 24


@given(st.floats(-1e300, 1e300) | st.sampled_from([np.nan, np.inf, -np.inf]))
def test_what_is_drawn_is_close_to_what_was_measured(x):
    (found,) = rounded([x])
    assert found is None if not np.isfinite(x) else found == pytest.approx(x, rel=1e-3)


# Tables and data


def test_the_headline_has_the_numbers_of_the_table_and_of_the_talk(run):
    table = headline_table(run.views[0], run.solvers)
    headings = [(group.heading, column) for group in table.groups for column in group.columns]
    cells = {name: dict(zip(headings, line, strict=True)) for name, line in table.lines}
    assert cells["pac"]["all 4 problems", "failures (%)"] == "50"
    assert cells["pac"]["all 4 problems", "failed / run"] == "2 / 4"
    assert cells["hybrid"]["all 4 problems", "false successes"] == "1"
    common = "the 2 problems that all compared solvers solve"
    assert cells["secular"][common, "sweeps, mean"] == number((11 + 21) / 2)
    assert cells["secular"][common, "time, mean (ms)"] == number((2.0 + 4.0) / 2)
    assert cells["pac"]["the 2014 talk", "GS iterations"] == "163"
    assert cells["secular"]["the 2014 talk", "time (ms)"] == "–"


def test_the_problems_add_up_to_the_table(run):
    data = json.loads(as_json(page_data([Shown(run, [])])))
    assert [one["name"] for one in data["solvers"]] == run.solvers
    for view, drawn in zip(run.views, data["runs"][0]["views"], strict=True):
        assert len(drawn["problems"]) == rated(view.rows)["problem_hash"].nunique()
        for k, solver in enumerate(run.solvers):
            outcomes = [line["runs"][str(k)] for line in drawn["problems"]]
            assert sum(bool(outcome[0]) for outcome in outcomes) == view.table.loc[solver, "failed"]
            assert sum(outcome[5] for outcome in outcomes) == view.table.loc[solver, "false_successes"]
            times = [outcome[1] for outcome in outcomes if not outcome[0] and view.mode == "timed"]
            assert sorted(times) == sorted(ms for _, ms, _ in RUNS[solver] if ms and view.mode == "timed")


def test_runs_side_by_side(run, tmp_path):
    other = reported(write_run(tmp_path / "other", rows(code="0ther")[:-1]))
    table = side_by_side([run, other])
    assert [name for name, _ in table.lines] == run.solvers
    assert dict(table.lines)["pac"][:2] == ["50", number(30)]
    text = page([Shown(run, []), Shown(other, [])])
    assert "The runs differ in code" in text
    assert "other: incomplete" in text


def test_runs_of_different_protocols_share_no_table(run, tmp_path):
    other = reported(write_run(tmp_path / "other", rows(protocol=2)))
    assert side_by_side([run, other]) is None
    assert "The runs differ in protocol" in page([Shown(run, []), Shown(other, [])])


def test_limitations_speak_of_the_run(run, tmp_path):
    text = " ".join(limitations(run))
    assert "4 problems of 7 to 900 contacts, from 2 scene(s)" in text
    assert "Z80" in text
    assert "5000 sweeps and 30 s" in text
    assert "other processes" not in text
    busy = reported(write_run(tmp_path / "busy", rows(load=2.0, law_facets=4, outer="global")))
    text = " ".join(limitations(busy))
    for words in ("2.0 other processes", "linearised law", "Iterations, not sweeps"):
        assert words in text


# Strangers' texts


LEAVES = st.text(max_size=9) | st.floats() | st.none()


@given(st.recursive(LEAVES, lambda x: st.lists(x) | st.dictionaries(st.text(max_size=9), x), max_leaves=9))
@settings(max_examples=50)
def test_no_parser_sees_anything_but_text_in_the_data(value):
    text = as_json(value)
    assert not set(text) & set("<>&\u2028\u2029")
    assert text.isascii()
    json.loads(text, parse_constant=lambda name: pytest.fail(name))


@given(st.text())
def test_the_data_come_back(text):
    assert json.loads(as_json({text: [text]})) == {text: [text]}


@given(st.text() | st.text("%{}<>&;"))
def test_plotly_is_told_that_a_text_is_plain(text):
    assert "<" not in plain(text)
    assert "%{" not in plain(text)
    assert html.unescape(plain(text)) == text


def test_the_policy_allows_the_two_scripts_of_the_page_and_no_other(run):
    text = page([Shown(run, [])])
    policy = html.unescape(text.split('Content-Security-Policy" content="')[1].split('"')[0])
    assert "'unsafe-inline'" not in policy.split("style-src")[0]
    assert policy.startswith("default-src 'none'")
    scripts = [part.split("</script>")[0] for part in text.split("<script>")[1:]]
    assert len(scripts) == 2
    assert policy == module.policy(*scripts)


# Problems looked at closely


def test_the_problems_that_divide_the_solvers_come_first(run):
    assert chosen(strictest(run.views).rows, 3) == ["hash-four", "hash-two", "hash-three"]
    assert chosen(strictest(run.views).rows, 9) == ["hash-four", "hash-two", "hash-three", "hash-one"]
    assert chosen(strictest(run.views).rows, 0) == []
    assert named(run.rows, ["two", "nobody", "two"]) == ["hash-two"]


def test_a_file_is_found_by_its_name_and_hash_alone(tmp_path):
    problem = tmp_path / "set" / "one.hdf5"
    problem.parent.mkdir()
    problem.write_bytes(b"content")
    digest = hashlib.sha256(b"content").hexdigest()[:16]
    assert locate("one", digest, [problem.parent]).file == problem
    assert locate("one", "0" * 16, [problem.parent]) is None
    for name in ("../set/one", str(problem.with_suffix("")), "", "on*", "one\0"):
        assert locate(name, digest, [problem.parent]) is None


def test_the_sets_of_the_checkout_are_searched():
    assert find_problem("comb-curly-91-mu1-001").file.parent in known_sets()


def test_the_rods_of_a_problem_of_ours_are_drawn():
    figure, words = rods_of_ours()
    assert words.startswith("comb-curly-91-mu1, step 1, ")
    drawn = sum(len(t.x) for t in figure.data if t.name.split()[-1] in ("stick", "slip", "take-off"))
    assert f"{drawn} contacts" in words
    assert "443 contacts" in words or "does not pose this very problem" in words
    ratio = figure.layout.scene.aspectratio
    assert ratio.z > ratio.x > 0.0


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ("{evil}", "none of the project's own"),
        ("comb-curly-91-mu1", "has no step"),
        (None, "no manifest.csv"),
    ],
)
def test_a_manifest_cannot_make_us_run_anything_else(tmp_path, scene, words):
    evil = tmp_path / "evil.py"
    evil.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    problem = tmp_path / "one.hdf5"
    problem.write_bytes(b"")
    if scene:
        name = scene.format(evil=evil)
        step = 10**9 if "{" not in scene else 1
        (tmp_path / "manifest.csv").write_text(f"file,scene,step\none.hdf5,{name},{step}\n")
    figure, said = rods_of(entry_of(problem))
    assert figure is None
    assert words in said
    assert not (tmp_path / "ran").exists()


# The page


def test_a_page_of_306_problems_and_8_solvers_is_small_enough():
    assert len(page_of_core306().encode()) < LARGEST


def test_a_page_that_is_too_large_is_refused_and_not_written(run, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 1_000_000)
    with pytest.raises(BenchError, match=r"would have \d\.\d MB, more than 1"):
        write_page([Shown(run, [])], tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_the_same_rows_give_the_same_page(run):
    assert page([Shown(run, [])]) == page([Shown(run, [])])


# The command


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def stack(contacts):
    """Unit masses one on another, pushed down and aside; the lowest on the ground."""
    H = csr_array(np.kron((eye_array(contacts) - eye_array(contacts, k=-1)).toarray(), np.eye(3)))
    f = np.tile([1.0, 0.1, -0.2], contacts)
    return StepProblem(
        eye_array(3 * contacts, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, 0.4)
    )


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A run over two small problems, and their folder."""
    folder = tmp_path_factory.mktemp("measured")
    (folder / "stacks").mkdir()
    for contacts in (3, 6):
        write(folder / "stacks" / f"stack-{contacts}.hdf5", stack(contacts))
    result = call("table", "--set", folder / "stacks", "--solvers", "hybrid,secular", "--rates", "mid", "--jobs", 1,
                  "--out", folder / "run")  # fmt: skip
    assert result.exit_code == 0, result.output
    return folder


def curves_of(file):
    text = file.read_text(encoding="utf-8")
    data = json.loads(text.split('id="data">')[1].split("</script>")[0])
    return data["runs"][0]["portraits"]


def test_problems_are_solved_again_to_draw_how_they_converge(measured, tmp_path):
    file = tmp_path / "page.html"
    result = call("report", measured / "run", "--set", measured / "stacks", "--out", file)
    assert result.exit_code == 0, result.output
    assert f"wrote {file}: " in result.stdout
    found = {one["problem"]: one for one in curves_of(file)}
    assert sorted(found) == ["stack-3", "stack-6"]
    for measured_row in RowFile(measured / "run").read():
        portrait = found[measured_row["problem"]]
        (trace,) = [t for t in portrait["curves"]["data"] if t["name"] == measured_row["solver"]]
        assert trace["x"][-1] == measured_row["sweeps"]
        assert trace["y"][-1] == pytest.approx(measured_row["residual"], rel=1e-3)
        assert portrait["notes"] == []
        assert "no manifest.csv" in portrait["rods_words"]


def test_problems_whose_files_are_gone_are_told(measured):
    result = call("report", measured / "run", "--problem", "stack-3")
    assert result.exit_code == 0, result.output
    (portrait,) = curves_of(measured / "run" / "report.html")
    assert portrait["curves"] is None
    assert "no file of this name and hash" in portrait["notes"][0]


def test_solvers_that_are_not_here_are_told(measured, tmp_path):
    found = RowFile(measured / "run").read()
    stranger = [
        one | {"solver": "<i>mine</i>", "fingerprint": "f"} for one in found if one["solver"] == "hybrid"
    ]
    changed = [one | {"fingerprint": "0ld"} for one in found if one["solver"] == "secular"]
    folder = write_run(tmp_path / "run", [*changed, *stranger])
    assert call("report", folder, "--set", measured / "stacks", "--curves", 1).exit_code == 0
    (portrait,) = curves_of(folder / "report.html")
    assert [trace["name"] for trace in portrait["curves"]["data"]] == ["secular"]
    assert any(note.startswith("<i>mine</i>: no curve") for note in portrait["notes"])
    assert "solved here by other sources than the run's: secular" in portrait["notes"]


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        (["{run}", "--out", "{run}"], "a folder"),
        (["{run}", "--out", "{run}/no/page.html"], "no such folder"),
        (["{run}", "--set", "{run}/no"], "no such folder"),
        (["{run}", "--problem", "nobody"], "no problem 'nobody' in run"),
        (["{run}/no"], "no such folder"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line(tmp_path, arguments, fault):
    folder = write_run(tmp_path / "run", rows())
    result = call("report", *(argument.format(run=folder) for argument in arguments))
    assert result.exit_code == 2
    assert result.stderr.count("\n") == 1
    assert fault in result.stderr
