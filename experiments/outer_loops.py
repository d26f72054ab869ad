"""Which outer loop solves what to 1e-8, and at what cost: plain, accelerated and robust Gauss–Seidel.

Every problem of a set (and of other folders of FCLIB files) and synthetic strands of 200 to 5000 contacts are solved
by `secular` with each loop, one after the other on the same problem. Plain sweeps to 1e-4 are the measure of cost.
Writes one row a run and a figure, and prints a summary: solved, median and total processor time, and the median over
the problems of the time over that of plain sweeps to 1e-4.

The problems that accelerated sweeps do not solve in a thousand are then tried with other choices of what a user might
want to set: sweeps a map, maps remembered, proximal term. Does one choice solve what another does not?

    python experiments/outer_loops.py [--set core306] [--also FOLDER] [--limit N] [--out results/outer_loops]
"""

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from assemblies import strands
from common.script import add_sets, entries, options, write_table
from matplotlib.figure import Figure

from fibercontact.bench.environment import one_thread
from fibercontact.bench.figures import COLOURS, save
from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

ASKED = (("plain", 1e-4), ("plain", 1e-8), ("accelerated", 1e-8), ("robust", 1e-8))
SWEEPS, SECONDS = 20_000, 120.0
SYNTHETIC = ((200, 0.3, 2), (200, 1.0, 2), (1000, 0.3, 3), (1000, 1.0, 3), (5000, 0.3, 4), (5000, 1.0, 4))
HARD = 1000
"""Sweeps from which a problem counts as hard."""
CHOICES = (
    (1, 4, 0.05),
    (1, 8, 0.05),
    (2, 5, 0.05),
    (3, 8, 0.05),
    (5, 20, 0.05),
    (1, 4, 0.01),
    (1, 4, 0.2),
    (1, 4, 1.0),
)
"""Sweeps a map, maps remembered, proximal term."""


def problems(given: argparse.Namespace) -> Iterator[tuple[str, str, IncrementalProblem]]:
    """Set, name and problem."""
    for source, entry in entries(given):
        problem = read(entry.file).problem
        whole = problem if isinstance(problem, IncrementalProblem) else problem.condense()
        yield source, entry.name, whole
    for n, mu, seed in SYNTHETIC[: given.limit]:
        yield "strands", f"strands-{n}-mu{mu:g}", strands(n, mu, seed)


def solve(problem: IncrementalProblem, loop: str, tolerance: float, **how: Any) -> dict[str, object]:
    """One run, judged by the measure."""
    settings = {"max_sweeps": SWEEPS, "max_seconds": SECONDS} | LOOPS[loop] | how
    solver = GaussSeidel(configure("secular", registered()), tolerance, **settings)
    began = time.process_time()
    run = solver.solve(problem)
    seconds = time.process_time() - began
    residual = measure(problem, run.r).residual
    return {
        "loop": loop, "tolerance": tolerance, "solved": residual <= tolerance, "residual": residual,
        "sweeps": run.sweeps, "rescue": run.rescue, "seconds": seconds,
    }  # fmt: skip


def measured(given: argparse.Namespace) -> Iterator[dict[str, object]]:
    """All runs, everything compiled before the first."""
    solve(strands(60, 0.3, 1), "robust", 1e-1)
    for source, name, problem in problems(given):
        for loop, tolerance in ASKED:
            run = solve(problem, loop, tolerance)
            yield {"set": source, "problem": name, "contacts": problem.n} | run


def choices(rows: pd.DataFrame, given: argparse.Namespace) -> pd.DataFrame:
    """How each choice does on the hard problems."""
    accelerated = rows[rows.loop == "accelerated"]
    hard = set(accelerated[~accelerated.solved | (accelerated.sweeps > HARD)].problem)
    found = []
    tried = ((name, problem) for _, name, problem in problems(given) if name in hard)
    for name, problem in tried:
        for sweeps, window, proximal in CHOICES:
            how = {"acceleration": Acceleration(sweeps, window), "proximal": proximal, "max_sweeps": 3 * HARD}
            about = {"problem": name, "sweeps_a_map": sweeps, "window": window, "c": proximal}
            found.append(about | solve(problem, "accelerated", 1e-8, **how))
    return pd.DataFrame(
        found, columns=None if found else ["problem", "sweeps_a_map", "window", "c", "solved"]
    )


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One line a set, loop and tolerance."""
    unit = rows[(rows.loop == "plain") & (rows.tolerance == 1e-4)].set_index("problem").seconds
    rows = rows.assign(ratio=rows.seconds / rows.problem.map(unit), rescued=rows.rescue > 0)
    groups = rows.groupby(["set", "loop", "tolerance"], sort=False)
    return groups.agg(
        problems=("problem", "size"),
        solved=("solved", "sum"),
        rescued=("rescued", "sum"),
        median_ms=("seconds", lambda s: 1e3 * s.median()),
        total_s=("seconds", "sum"),
        median_ratio=("ratio", "median"),
    ).reset_index()


def draw(rows: pd.DataFrame) -> Figure:
    """Share of the problems solved within a time."""
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    count = rows.problem.nunique()
    for (loop, tolerance), line in rows.groupby(["loop", "tolerance"], sort=False):
        times = np.sort(line.seconds[line.solved])
        colour = COLOURS[1 + ["plain", "accelerated", "robust"].index(loop)]
        style = "--" if tolerance == 1e-4 else "-"
        axes.step(times, 100 * np.arange(1, len(times) + 1) / count, style, where="post", color=colour,
                  label=f"{loop}, to {tolerance:.0e}")  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlabel("processor time (s)")
    axes.set_ylabel("problems solved (%)")
    axes.set_ylim(0, 101)
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=8, loc="lower right")
    return figure


def main() -> None:
    parser = options(__doc__)
    add_sets(parser)
    parser.add_argument("--out", type=Path, default=Path("results/outer_loops"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with one_thread():
        rows = pd.DataFrame(list(measured(given)))
    rows.to_csv(given.out / "rows.csv", index=False, float_format="%.4g")
    write_table(summary(rows), given.out / "summary.csv")
    lost = rows[(rows.loop == "robust") & ~rows.solved]
    print("not solved by the robust loop:", ", ".join(lost.problem) or "none")
    save(draw(rows), given.out, "time")
    tried = choices(rows, given)
    tried.to_csv(given.out / "choices.csv", index=False, float_format="%.4g")
    counts = tried.groupby(["sweeps_a_map", "window", "c"], sort=False).solved.agg(["sum", "size"])
    print(f"\nhard problems by choice, in {3 * HARD} sweeps\n{counts.to_string()}")
    print("by any of them:", int(tried.groupby("problem").solved.any().sum()))


if __name__ == "__main__":
    main()
