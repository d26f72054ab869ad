"""Comparison of answers with references: its measures against their definitions, its runs, its command."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
import typer
from oracles import strands, walls
from typer.testing import CliRunner

from fibercontact.bench.problem_set import load_set
from fibercontact.bench.validate import (
    OPEN,
    SLIP,
    STICK,
    associated_model,
    contender,
    regimes,
    validate,
)
from fibercontact.bench.validate_report import reference_table, solver_table, write_report
from fibercontact.cli.validate import validate as command
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference import store
from fibercontact.reference.ground_truth import Search

NAMES = ["pyramid", "pyramid:facets=16", "secular"]


@pytest.fixture
def folder(tmp_path):
    """Three problems with a reference, one that has no solution, one that is too large."""
    folder = tmp_path / "set"
    folder.mkdir()
    for seed in (1, 2):
        write(folder / f"strands{seed}.hdf5", strands(seed))
    write(folder / "strands3.hdf5", strands(3, mu=0.8).condense())
    write(folder / "squeezed.hdf5", walls())
    write(folder / "large.hdf5", strands(4, contacts=20))
    return folder


class Silent:
    """A listener that remembers what it was told."""

    def __init__(self):
        self.notes, self.seen = [], []

    def now(self, problem, what):
        pass

    def done(self, problem):
        self.seen.append(problem)

    def note(self, text):
        self.notes.append(text)


def contenders(accuracy="full", names=NAMES):
    return [*(contender(configure(name, registered()), accuracy) for name in names), associated_model()]


def run(folder, out, who=None, **options):
    references, search = out / "references.hdf5", Search(max_seconds=4.0, starts=0)
    return validate(
        load_set(folder),
        who or contenders(),
        out,
        Silent(),
        references=references,
        search=search,
        max_contacts=15,
        **options,
    )


# Measures


@pytest.mark.parametrize(
    ("u", "regime"),
    [
        ([1.0, 0.0, 0.0], OPEN),
        ([0.5, -3.0, 2.0], OPEN),
        ([0.0, 0.6, -0.8], SLIP),
        ([-1e-6, 0.01, 0.0], SLIP),
        ([0.0, 0.0, 0.0], STICK),
        ([1e-6, -1e-6, 1e-6], STICK),
    ],
)
@pytest.mark.parametrize("scale", [1e-5, 1.0, 1e5])
def test_regimes_come_from_velocities(u, regime, scale):
    problem = IncrementalProblem.from_sparse(np.eye(3), scale * np.array([-1.0, 0.0, 0.0]), np.ones(1))
    assert regimes(problem, scale * np.array(u)) == [regime]


# Runs


def test_a_run_compares_all_that_have_a_reference(folder, tmp_path):
    comparison = run(folder, tmp_path / "out")
    rows = pd.DataFrame(comparison.rows).set_index(["problem", "solver"]).sort_index()
    assert [row["problem"] for row in comparison.references if row["reference"] == "none"] == ["squeezed"]
    assert comparison.skipped == ["large: skipped, 20 contacts are more than 15"]
    assert len(rows) == 4 * 4
    for problem in ("strands1", "strands2", "strands3"):
        error = rows.loc[problem, "velocity_error"]
        assert error["secular"] < 1e-6 < error["pyramid:facets=16"] < error["pyramid"] < error["associated"]
        assert rows.loc[(problem, "secular"), "same_regime"] == 1.0
        assert rows.loc[(problem, "secular"), "friction_work_error"] < 1e-6
    assert rows.loc["squeezed", "velocity_error"].isna().all()
    assert not rows.loc[("squeezed", "secular"), "solved"]


def test_a_second_run_computes_nothing(folder, tmp_path, monkeypatch):
    def forbidden(*_):
        raise AssertionError("computed again")

    first = run(folder, tmp_path / "out")
    monkeypatch.setattr(store, "ground_truth", forbidden)
    idle = [dataclasses.replace(one, solve=forbidden) for one in contenders()]
    again = run(folder, tmp_path / "out", idle)
    pd.testing.assert_frame_equal(solver_table(again), solver_table(first))
    pd.testing.assert_frame_equal(reference_table(again), reference_table(first))


def test_other_options_are_other_rows(folder, tmp_path):
    run(folder, tmp_path / "out")
    low = run(folder, tmp_path / "out", contenders("low"))
    assert {row["residual"] > 1e-8 for row in low.rows if row["solver"] == "secular"} == {True}


def test_an_interrupted_run_loses_nothing(folder, tmp_path):
    seen = []

    def stops(problem):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(problem)
        return true.solve(problem)

    [true, *_] = contenders(names=["secular"])
    with pytest.raises(KeyboardInterrupt):
        run(folder, tmp_path / "out", [dataclasses.replace(true, solve=stops)])
    seen.clear()
    comparison = run(folder, tmp_path / "out", [dataclasses.replace(true, solve=stops)])
    assert len(seen) == 2
    assert len(comparison.rows) == 4


def test_the_report_holds_tables_and_figure(folder, tmp_path):
    files = write_report(run(folder, tmp_path / "out"), tmp_path / "out")
    assert {file.suffix for file in files} == {".csv", ".md", ".svg", ".png"}
    text = (tmp_path / "out" / "validation.md").read_text(encoding="utf-8")
    assert "| squeezed | 2 | unsolvable | none |" in text
    assert "3 of 4 problems have a reference" in text
    assert "large: skipped" in text
    assert len(pd.read_csv(tmp_path / "out" / "rows.csv")) == 16


# The command


@pytest.fixture
def invoke(folder, tmp_path):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(command)

    def invoke(*arguments, where=folder):
        fixed = ("--set", str(where), "--out", str(tmp_path / "out"))
        return CliRunner().invoke(app, [*fixed, *arguments])

    return invoke


def test_the_command_prints_both_tables(invoke):
    result = invoke("--solvers", "secular,associated", "--max-contacts", "15")
    assert result.exit_code == 0, result.output
    for text in ("squeezed", "none", "secular", "associated", "20 contacts are more than 15", "rows.csv"):
        assert text in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--solvers", "newton"), "unknown local solver 'newton'"),
        (("--accuracy", "perfect"), "unknown accuracy 'perfect' (known: low, mid, high, full)"),
    ],
)
def test_unknown_names_are_errors_of_one_line(invoke, arguments, message):
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_damaged_file_is_an_error_of_one_line(invoke, tmp_path):
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "bad.hdf5").write_bytes(b"not HDF5")
    result = invoke("--solvers", "secular", where=tmp_path / "bad")
    assert result.exit_code == 2
    assert "bad.hdf5" in result.stderr
    assert "Traceback" not in result.output
