"""Rows of a run made by hand, for the tests of its report."""

import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from fibercontact.bench.html_report.figures import Curve
from fibercontact.bench.html_report.page import Shown, page
from fibercontact.bench.html_report.portraits import Portrait
from fibercontact.bench.html_report.rods import rods_of
from fibercontact.bench.html_report.runs import reported
from fibercontact.bench.problem_set import find_problem
from fibercontact.bench.protocol import ACCURACIES

RESULTS = Path(__file__).parents[1] / "results"

SOLVERS = ["pac", "hybrid", "secular"]
PROBLEMS = {
    "one": ("comb", 40, 0.0),
    "two": ("comb", 300, 0.3),
    "three": ("wisp", 900, 0.9),
    "four": ("wisp", 7, 0.5),
}
"""Scene, contacts, mu."""

RUNS = {
    "pac": [(20, 4.0, ""), (99, None, "local"), (40, 12.0, ""), (5000, None, "outer")],
    "hybrid": [(10, 1.0, ""), (30, 9.0, ""), (20, 8.0, ""), (5000, None, "false success")],
    "secular": [(11, 2.0, ""), (31, 3.0, ""), (21, 4.0, ""), (60, 16.0, "")],
}
"""Sweeps, milliseconds and reason on each problem."""


def row(problem, solver, accuracy="low", mode="timed", **changes):
    scene, contacts, mu = PROBLEMS[problem]
    sweeps, ms, reason = RUNS[solver][list(PROBLEMS).index(problem)]
    seconds = None if ms is None or mode == "rates" else 1e-3 * ms
    found = {
        "problem": problem, "problem_hash": f"hash-{problem}", "scene": scene, "contacts": contacts, "dofs": 9,
        "mu_min": mu, "mu_max": mu, "existence": "", "solver": solver, "fingerprint": f"f-{solver}", "options": "",
        "accuracy": accuracy, "tolerance": ACCURACIES[accuracy], "start": "cold", "outer": "plain", "mode": mode,
        "repetitions": 3 if mode == "timed" else 0, "max_sweeps": 5000, "max_seconds": 30.0, "protocol": 1,
        "code": "c0de", "cpu": "Z80", "law_facets": 0, "solved": not reason,
        "claimed": reason in ("", "false success"), "false_success": reason == "false success",
        "reason": reason, "detail": "", "outcome": "converged",
        "sweeps": sweeps, "residual": 1e-3 * sweeps, "coulomb": 2e-3 * sweeps, "time_best": seconds,
        "time_median": seconds, "setup_seconds": 0.002, "load": 0.0, "threads": 1, "python": "3", "numpy": "2",
        "stamp": "2026-01-01T00:00:00+00:00",
    }  # fmt: skip
    return found | changes


def rows(accuracy="low", mode="timed", **changes):
    """A row for each problem and solver."""
    return [row(problem, solver, accuracy, mode, **changes) for problem in PROBLEMS for solver in SOLVERS]


def write_run(folder, found, finished=True):
    """The folder of a run; returns it."""
    folder.mkdir()
    clean = [
        {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in one.items()} for one in found
    ]
    (folder / "rows.jsonl").write_text("".join(json.dumps(one) + "\n" for one in clean), encoding="utf-8")
    if finished:
        (folder / "table.csv").touch()
    return folder


@cache
def committed(name):
    """A run of `results/`, read back."""
    return reported(RESULTS / name)


@cache
def page_of_core306():
    """The page of the committed run, six problems of it looked at closely, with invented curves; two with rods."""
    run = committed("core306")
    rng = np.random.default_rng(0)
    curves = [Curve(name, list(range(1, 152)), rng.uniform(size=151).tolist()) for name in run.solvers]
    portraits = [Portrait(f"p{k}", "", "scene", 400, "mid", curves, []) for k in range(6)]
    portraits[:2] = [replace(portrait, rods=rods_of_ours()) for portrait in portraits[:2]]
    return page([Shown(run, portraits)])


@cache
def rods_of_ours():
    """The rods of a problem of core306, whose scene is run for them."""
    return rods_of(find_problem("comb-curly-91-mu1-001"))
