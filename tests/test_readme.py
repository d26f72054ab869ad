"""What the README shows is true: its plugin solves problems, its commands and files exist."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import eye_array

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
README = (ROOT / "README.md").read_text(encoding="utf-8")
YOUR_SOLVER = (ROOT / "docs" / "your_solver.md").read_text(encoding="utf-8")


def test_the_example_of_a_local_solver_solves_a_problem(tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
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
        "honest": "not asked"
    }


def test_the_example_of_a_global_method_solves_a_problem(tmp_path):
    (code,) = re.findall(r"```python\n(\"\"\".*?)```", YOUR_SOLVER, flags=re.DOTALL)
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
        if re.match(r"\| [a-z ]+ \| (pass|reported) ", line)
    ]
    assert [line[0][2:] for line in shown] == list(CHECKS)
    assert [line[1] for line in shown] == ["pass"] * len(REQUIRED) + ["reported"] * len(REPORTS)
    assert [line[2] for line in shown] == [asks(check) for check in CHECKS]


@pytest.mark.parametrize("path", sorted(set(re.findall(r"\]\((?!http)([^)]+)\)", README))))
def test_linked_files_exist(path):
    assert (ROOT / path).exists()


@pytest.mark.parametrize(
    "command",
    sorted(set(re.findall(r"(?:bin/|^|`)fibercontact ([a-z-]+) ", README + YOUR_SOLVER, flags=re.MULTILINE))),
)
def test_commands_exist(command):
    assert command in {known.name for known in (*app.registered_commands, *app.registered_groups)}
