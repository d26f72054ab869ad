"""Aggregation: hand-made rows with known answers, and what must not depend on anything else."""

import json
import math

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fibercontact.bench.protocol import ACCURACIES, PUBLISHED, BenchError
from fibercontact.bench.report import BY_RODS, by_rods, display, make_report, write_report
from fibercontact.bench.tables import (
    common_problems,
    contrary,
    geometric_mean,
    headline,
    performance_ratios,
    strata,
    to_frame,
)

SOLVERS = ["pyramid", "pac", "hybrid"]

# scene, contacts, mu, existence of each problem
PROBLEMS = {
    "p1": ("wisp", 40, 0.0, ""),
    "p2": ("wisp", 60, 0.3, ""),
    "p3": ("comb", 900, 0.9, ""),
    "p4": ("comb", 10, 0.5, "unsolvable"),
}

# sweeps, milliseconds, reason of each run
RUNS = {
    ("p1", "hybrid"): (10, 1.0, ""),
    ("p1", "pac"): (20, 4.0, ""),
    ("p1", "pyramid"): (5, 2.0, ""),
    ("p2", "hybrid"): (30, 9.0, ""),
    ("p2", "pac"): (99, None, "local"),
    ("p2", "pyramid"): (7, 3.0, ""),
    ("p3", "hybrid"): (20, 4.0, ""),
    ("p3", "pac"): (40, 1.0, ""),
    ("p3", "pyramid"): (9, None, "outer"),
    ("p4", "hybrid"): (5000, None, "outer"),
    ("p4", "pac"): (5000, None, "outer"),
    ("p4", "pyramid"): (5000, None, "outer"),
}

MACHINE = {"cpu": "Z80", "threads": 1, "python": "3", "load": 0.5, "stamp": "2026-01-01T00:00:00+00:00"}


def row(problem, solver, accuracy="low", mode="timed"):
    scene, contacts, mu, existence = PROBLEMS[problem]
    sweeps, ms, reason = RUNS[problem, solver]
    identity = {
        "problem_hash": f"hash of {problem}",
        "problem": problem,
        "scene": scene,
        "contacts": contacts,
        "mu_max": mu,
        "existence": existence,
        "solver": solver,
        "law_facets": 4 if solver == "pyramid" else 0,
        "accuracy": accuracy,
        "tolerance": ACCURACIES[accuracy],
        "start": "cold",
        "outer": "plain",
        "mode": mode,
    }
    outcome = {
        "solved": reason == "",
        "false_success": False,
        "reason": reason,
        "sweeps": sweeps,
        "coulomb": 0.5 if solver == "pyramid" else 1e-3 * sweeps,
        "time_median": ms and 1e-3 * ms,
        "setup_seconds": 2e-3,
    }
    return identity | outcome | MACHINE


def all_rows(**changes):
    return [row(problem, solver, **changes) for problem, solver in RUNS]


ROWS = to_frame(all_rows())


def test_common_problems_are_those_that_all_exact_solvers_solved():
    assert set(common_problems(ROWS)) == {"hash of p1", "hash of p3"}


EXPECTED = {
    "problems": (3, 3, 3),
    "failed": (1, 1, 0),
    "failure_percent": (100 / 3, 100 / 3, 0.0),
    "false_successes": (0, 0, 0),
    "reasons": ("outer 1", "local 1", ""),
    "common": (1, 2, 2),
    "sweeps_mean": (5, 30, 15),
    "sweeps_median": (5, 30, 15),
    "time_mean_ms": (2.0, 2.5, 2.5),
    "time_geo_ms": (2.0, 2.0, 2.0),
    "own": (2, 2, 3),
    "own_sweeps_mean": (6, 30, 20),
    "own_sweeps_median": (6, 30, 20),
    "setup_mean_ms": (2.0, 2.0, 2.0),
    "coulomb_median": (0.5, 0.03, 0.02),
    "coulomb_worst": (0.5, 0.04, 0.03),
    "published_failure_percent": (0.0, 19.3, 0.0),
    "published_iterations": (575, 163, 41),
    "published_ms": (6497, 1265, 312),
}


@pytest.mark.parametrize("column", EXPECTED)
def test_headline_of_hand_made_rows(column):
    found = headline(ROWS, SOLVERS)[column].tolist()
    expected = list(EXPECTED[column])
    assert found == (expected if column == "reasons" else pytest.approx(expected))


def test_headline_keeps_the_order_asked_for_and_the_published_names():
    table = headline(ROWS, ["hybrid", "pac"])
    assert list(table.index) == ["hybrid", "pac"]
    assert list(table["published"]) == [PUBLISHED["hybrid"].name, "PAC"]


def test_false_successes_are_counted():
    rows = ROWS.copy()
    rows.loc[(rows["problem"] == "p2") & (rows["solver"] == "pac"), "false_success"] = True
    assert list(headline(rows, SOLVERS)["false_successes"]) == [0, 1, 0]


def test_a_solver_that_solves_nothing_is_charged_and_leaves_the_others_alone():
    hopeless = ROWS[ROWS["solver"] == "pac"].assign(
        solver="hopeless", solved=False, reason="crash", time_median=np.nan
    )
    before, after = headline(ROWS, SOLVERS), headline(pd.concat([ROWS, hopeless]), [*SOLVERS, "hopeless"])
    pd.testing.assert_frame_equal(before, after.loc[SOLVERS], check_dtype=False)
    assert after.loc["hopeless", "failure_percent"] == 100.0
    assert after.loc["hopeless", "common"] == 0


def test_solvers_of_linearised_laws_alone_are_compared_with_each_other():
    table = headline(ROWS[ROWS["solver"] == "pyramid"], SOLVERS)
    assert (table.loc["pyramid", "common"], table.loc["pyramid", "sweeps_mean"]) == (2, 6)


@given(order=st.permutations(range(len(ROWS))))
@settings(max_examples=6, deadline=None)
def test_figures_do_not_depend_on_the_order_of_the_rows(order):
    pd.testing.assert_frame_equal(headline(ROWS, SOLVERS), headline(ROWS.iloc[order], SOLVERS))
    pd.testing.assert_frame_equal(strata(ROWS, SOLVERS), strata(ROWS.iloc[order], SOLVERS))


def test_performance_ratios_of_hand_made_rows():
    ratios = performance_ratios(ROWS, SOLVERS)
    expected = {
        "hash of p1": [2.0, 4.0, 1.0],
        "hash of p2": [1.0, math.inf, 3.0],
        "hash of p3": [math.inf, 1.0, 4.0],
    }
    assert list(ratios.columns) == SOLVERS
    assert set(ratios.index) == set(expected)
    for problem, values in expected.items():
        assert ratios.loc[problem].tolist() == pytest.approx(values)


@given(scale=st.floats(1e-3, 1e3))
@settings(max_examples=20, deadline=None)
def test_performance_ratios_do_not_depend_on_the_unit_of_time(scale):
    scaled = ROWS.assign(time_median=scale * ROWS["time_median"])
    np.testing.assert_allclose(
        performance_ratios(scaled, SOLVERS), performance_ratios(ROWS, SOLVERS), rtol=1e-12
    )


def test_performance_ratios_when_everybody_fails_on_a_problem():
    rows = ROWS[ROWS["problem"].isin(["p1", "p4"])].assign(existence="")
    assert performance_ratios(rows, SOLVERS).loc["hash of p4"].tolist() == [math.inf] * 3


@given(values=st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=20))
def test_geometric_mean_is_the_root_of_the_product(values):
    slow = math.prod(value ** (1 / len(values)) for value in values)
    assert geometric_mean(pd.Series(values)) == pytest.approx(slow)


def test_strata_split_the_rated_rows_by_scene_size_and_mu():
    found = strata(ROWS, SOLVERS)
    hybrid = found[found["solver"] == "hybrid"].set_index(["by", "stratum"])["problems"]
    assert hybrid.to_dict() == {
        ("scene", "comb"): 1, ("scene", "wisp"): 2,
        ("contacts", "0 to 50"): 1, ("contacts", "50 to 100"): 1, ("contacts", "500 to 1000"): 1,
        ("mu", "0"): 1, ("mu", "0.2 to 0.5"): 1, ("mu", "over 0.8"): 1,
    }  # fmt: skip
    assert found.groupby(["by", "solver"])["failed"].sum().to_dict() == {
        (by, solver): failed for by in ("scene", "contacts", "mu") for solver, failed in
        (("hybrid", 0), ("pac", 1), ("pyramid", 1))
    }  # fmt: skip


def test_a_set_with_several_rod_models_is_read_by_model(tmp_path):
    models = {"p1": "", "p2": "@discrete", "p3": "@clothoid", "p4": "@clothoid"}
    rows = [row | {"scene": row["scene"] + models[row["problem"]]} for row in all_rows()]
    report = make_report(rows, SOLVERS)
    found = by_rods(report.views[0])
    assert found.index.tolist() == SOLVERS
    assert found.loc["hybrid"].to_dict() == {
        "clothoid": "0 / 20 / 4",
        "discrete": "0 / 30 / 9",
        "helix": "0 / 10 / 1",
    }
    assert found.loc["pac", "discrete"] == "100 / – / –"
    write_report(report, tmp_path)
    assert BY_RODS in (tmp_path / "table.md").read_text(encoding="utf-8")


def test_a_set_with_one_rod_model_is_not():
    assert by_rods(make_report(all_rows(), SOLVERS).views[0]).empty


def test_contrary_strata_are_named():
    rows = ROWS[ROWS["solver"] != "pyramid"].copy()
    rows.loc[(rows["solver"] == "pac") & (rows["problem"] == "p1"), "time_median"] = (
        8e-3  # hybrid first: 2 < 2.83
    )
    solvers = ["pac", "hybrid"]
    sentences = contrary(headline(rows, solvers), strata(rows, solvers))
    time_sentences = [s for s in sentences if s.startswith("by time")]
    assert [s.partition(":")[0].rpartition("not where ")[2] for s in time_sentences] == [
        "scene is comb", "contacts is 500 to 1000", "mu is over 0.8",
    ]  # fmt: skip
    assert all("4 against 1 ms on 1 problems" in s for s in time_sentences)
    assert sentences == time_sentences  # by failures hybrid is never behind


def test_no_contrary_stratum_when_the_headline_is_a_tie():
    assert not [
        s for s in contrary(headline(ROWS, ["pac", "hybrid"]), strata(ROWS, ["pac", "hybrid"])) if "time" in s
    ]


def test_report_shows_rates_of_other_accuracies_beside_the_timed_table():
    mid = [r | {"mode": "rates", "time_median": None} for r in all_rows(accuracy="mid")]
    report = make_report(all_rows() + mid, SOLVERS)
    assert [(view.accuracy, view.mode) for view in report.views] == [("low", "timed")]
    cells = display(report.views[0])
    assert cells.loc["pac", "failures"] == "33.3 % (1/3)"
    assert cells.loc["pac", "failures at mid (%)"] == "33.3"
    assert cells.loc["hybrid", "talk: failures (%), iterations, ms"] == "0, 41, 312"
    assert any("unsolvable" in note and "p4" in note for note in report.views[0].notes)


def test_report_of_rates_alone_has_no_times():
    report = make_report(all_rows(mode="rates"), SOLVERS)
    assert [view.mode for view in report.views] == ["rates"]
    assert not [name for name in display(report.views[0]) if "ms)" in name]


@pytest.mark.parametrize("lost", [(), ("sweeps", "coulomb", "time_median")])
def test_report_when_everything_failed(tmp_path, lost):
    failed = {"solved": False, "reason": "crash", "time_median": None}
    rows = [{name: value for name, value in (r | failed).items() if name not in lost} for r in all_rows()]
    report = make_report(rows, SOLVERS)
    write_report(report, tmp_path)
    assert display(report.views[0])["failures"].unique().tolist() == ["100 % (3/3)"]
    assert "hybrid solved nothing and is left out of the comparison" in report.views[0].notes


def test_nothing_to_rate_is_an_error():
    with pytest.raises(BenchError, match="nothing to rate"):
        make_report([r | {"existence": "unsolvable"} for r in all_rows()], SOLVERS)


def test_written_report(tmp_path):
    rows = all_rows() + all_rows(accuracy="mid")
    write_report(make_report(rows, SOLVERS), tmp_path)
    names = {file.name for file in tmp_path.iterdir()}
    figures = {f"{f}{s}.{e}" for f in ("profile", "failures") for s in ("", "-mid") for e in ("svg", "png")}
    assert names == figures | {
        "rows.csv",
        "table.csv",
        "table.md",
        "table.tex",
        "strata.csv",
        "environment.json",
    }
    assert len(pd.read_csv(tmp_path / "rows.csv")) == len(rows)
    table = pd.read_csv(tmp_path / "table.csv").set_index(["accuracy", "solver"])
    assert table.loc[("mid", "pac"), "failure_percent"] == pytest.approx(100 / 3)
    assert "| pac | 33.3 % (1/3) |" in (tmp_path / "table.md").read_text()
    assert r"33.3 \% (1/3)" in (tmp_path / "table.tex").read_text()
    environment = json.loads((tmp_path / "environment.json").read_text())
    assert (environment["cpu"], environment["threads"]) == (
        "Z80",
        1,
    )  # of the machine that ran, not of this one


def test_figures_are_the_same_bytes_for_the_same_rows(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_report(make_report(all_rows(), SOLVERS), tmp_path / name)
    for file in ("profile.svg", "failures.svg", "failures.png"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
