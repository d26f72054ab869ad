"""What the README and the pages show is true: their commands run, their code does what it says, their files exist."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import eye_array
from typer.testing import CliRunner

from fibercontact.bench.conformance.reports import REPORTS
from fibercontact.bench.conformance.required import REQUIRED
from fibercontact.bench.conformance.suite import CHECKS, asks, examine
from fibercontact.cli import app
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.global_methods.contract import Task
from fibercontact.global_methods.registry import configure as configure_any
from fibercontact.global_methods.registry import registered as registered_any
from fibercontact.local.registry import configure, registered
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
README = (ROOT / "README.md").read_text(encoding="utf-8")
YOUR_SOLVER = (DOCS / "your_solver.md").read_text(encoding="utf-8")
PANDAS = (DOCS / "results_with_pandas.md").read_text(encoding="utf-8")
EXPERIMENTS = (DOCS / "experiments.md").read_text(encoding="utf-8")

PAGES = [file.read_text(encoding="utf-8") for file in DOCS.glob("*.md")]
COMMAND = re.compile(r"(?:bin/|^|^    |`)fibercontact ([a-z][a-z0-9-]+)", flags=re.MULTILINE)

RUN = ("your_solver", "your_problem_set", "results_with_pandas")
"""Pages whose blocks are run: `sh` and `python`, in order, in one folder and one Python session."""


def blocks(text):
    """Languages and contents of the fenced blocks of a page."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


def run_commands(code):
    """Run lines of `fibercontact`, in this process; a trial of 2 problems stands for one of 20."""
    for line in code.replace("\\\n", " ").replace("--limit 20", "--limit 2").splitlines():
        program, *arguments = shlex.split(line)
        assert program == "fibercontact"
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output


def run_code(code, file, session):
    """Run Python from a file, so that kernels have one; returns what it prints."""
    file.write_text(code, encoding="utf-8")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, file, "exec"), session)
    return printed.getvalue()


@pytest.mark.parametrize("page", RUN)
def test_a_page_runs(page, tmp_path, monkeypatch):
    """Block by block; a `text` block after Python is what that prints."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    session, printed = {"__name__": page}, ""
    for number, (language, code) in enumerate(blocks((DOCS / f"{page}.md").read_text(encoding="utf-8"))):
        if language == "text" and printed:
            assert code.split() == printed.split()
        if language == "sh":
            run_commands(code)
        printed = run_code(code, tmp_path / f"block_{number}.py", session) if language == "python" else ""
    if page == "results_with_pandas":
        assert set(pd.read_csv("runs/sample/rows.csv")) == documented_columns()


def documented_columns():
    """Names in the first cells of the table of columns."""
    cells = re.findall(r"^\| (`.*?) \|", PANDAS.partition("## Columns")[2], flags=re.MULTILINE)
    return {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}


def test_the_page_of_experiments_is_complete():
    """It names every script, and shows every figure of `results/`."""
    scripts = {file.name for file in (ROOT / "experiments").glob("*.py")}
    assert scripts == set(re.findall(r"experiments/(\w+\.py)", EXPERIMENTS))
    figures = {file for suffix in ("png", "gif") for file in (ROOT / "results").rglob(f"*.{suffix}")}
    assert figures == {(DOCS / shown).resolve() for shown in re.findall(r"!\[.*?\]\((.*?)\)", EXPERIMENTS)}


def test_the_example_of_a_local_solver_solves_a_problem(tmp_path):
    code, _ = (code for language, code in blocks(YOUR_SOLVER) if code.startswith('"""'))
    assert len(code.strip().splitlines()) <= 25
    file = tmp_path / "my_solver.py"
    file.write_text(code, encoding="utf-8")
    local = configure("my-solver:steps=20", registered([file]))
    b = np.array([-1.0, 0.2, 0.1, -1.0, 3.0, -1.0, 1.0, 0.0, 0.0])  # stick, slip, take-off
    problem = IncrementalProblem.from_sparse(2.0 * eye_array(9), b, np.full(3, 0.5))
    run = GaussSeidel(local, tolerance=1e-8).solve(problem)
    assert run.claimed
    assert measure(problem, run.r).residual <= 1e-8
    assert {check: examine(local, check).outcome for check in REQUIRED} == dict.fromkeys(REQUIRED, "pass") | {
        "honest": "not asked",
        "several": "not asked",
    }


def test_the_example_of_a_global_method_solves_a_problem(tmp_path):
    _, code = (code for language, code in blocks(YOUR_SOLVER) if code.startswith('"""'))
    file = tmp_path / "my_method.py"
    file.write_text(code, encoding="utf-8")
    method = configure_any("my-method:step=0.8", registered_any([file]))
    b = np.array([-1.0, 0.2, 0.1, -1.0, 3.0, -1.0, 1.0, 0.0, 0.0])  # stick, slip, take-off
    problem = IncrementalProblem.from_sparse(2.0 * eye_array(9), b, np.full(3, 0.5))
    found = method.solve(block_system(problem), Task(1e-8, problem.b_ref, 1000, 10.0))
    assert found.claimed
    assert measure(problem, found.r).residual <= 1e-8


def test_the_card_shown_is_the_card_of_today():
    """Line by line, what is measured and what depends on rounding aside."""
    shown = [
        line.split(" | ")
        for line in YOUR_SOLVER.splitlines()
        if re.match(r"\| [a-z ]+ \| (pass|reported|not asked) ", line)
    ]
    assert [line[0][2:] for line in shown] == list(CHECKS)
    outcomes = dict.fromkeys(REQUIRED, "pass") | dict.fromkeys(REPORTS, "reported")
    assert [line[1] for line in shown] == list((outcomes | {"several": "not asked"}).values())
    assert [line[2] for line in shown] == [asks(check) for check in CHECKS]


@pytest.mark.parametrize("path", sorted(set(re.findall(r"\]\((?!http)([^)]+)\)", README))))
def test_linked_files_exist(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize(
    "command",
    sorted({name for text in (README, *PAGES) for name in COMMAND.findall(text)}),
)
def test_commands_exist(command):
    assert command in {known.name for known in (*app.registered_commands, *app.registered_groups)}
