"""What one might use instead of a local solver in sweeps: all global methods, and Gauss–Seidel with `secular`.

Every problem of a set (and of other folders of FCLIB files) is solved by every method to 1e-2, 1e-4 and 1e-8, one
after the other on the same problem, within 30 s and 20 000 sweeps or iterations. Writes one row a run, a table and
performance profiles, and prints the table. Medians and means of processor time, and the median of sweeps or
iterations, are over the problems that all methods solved which solve at least nine of ten.

    python experiments/global_methods.py [--set core306] [--also FOLDER] [--limit N] [--out results/global_methods]
"""

import argparse
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import add_sets, entries, options, write_table
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fibercontact.bench.environment import one_thread
from fibercontact.bench.figures import COLOURS, DASHES, save
from fibercontact.bench.passes import Laid, gauss_seidel, lay_out
from fibercontact.bench.protocol import OUTERS, Limits
from fibercontact.bench.tables import performance_ratios
from fibercontact.cli.options import split_solvers
from fibercontact.global_methods.contract import Task, Unsuited
from fibercontact.global_methods.registry import (
    AnyConfigured,
    ConfiguredMethod,
    configure,
    is_global,
    registered,
)
from fibercontact.local.registry import Configured
from fibercontact.problem.fclib import read
from fibercontact.problem.measure import measure

Array = NDArray[np.float64]

TOLERANCES = (1e-2, 1e-4, 1e-8)
LIMITS = Limits(20_000, 30.0)
USUAL = 0.9
"""Share of the problems that a method must solve for its failures to count among the common ones."""


def problems(given: argparse.Namespace) -> Iterator[tuple[str, str, Laid]]:
    """Set, name and problem."""
    for source, entry in entries(given):
        yield source, entry.name, lay_out(read(entry.file).problem)


def contenders(names: str | None) -> dict[str, AnyConfigured]:
    """Gauss–Seidel by its loops, then the global methods, by default all and Newton's without its shift."""
    known = registered()
    every = [*(name for name in known if is_global(known[name])), "newton-ac:shift=0,line_search=1"]
    methods = split_solvers(names) if names else every
    sweeps = {f"secular, {outer}": configure("secular", known) for outer in OUTERS}
    return sweeps | {name: configure(name, known) for name in methods}


def attempt(name: str, solver: AnyConfigured, laid: Laid, tolerance: float) -> tuple[Array, int, str]:
    """The impulses, sweeps or iterations, and how the method says that it ended."""
    if isinstance(solver, Configured):
        loop = gauss_seidel(solver, tolerance, name.partition(", ")[2], LIMITS)
        run = loop.solve_system(laid.system, laid.problem.b_ref)
        return run.r, run.sweeps, run.outcome.sentence
    try:
        said = solver.solve(laid.system, Task(tolerance, laid.problem.b_ref, LIMITS.sweeps, LIMITS.seconds))
    except Unsuited as fault:
        return np.zeros_like(laid.system.b), 0, str(fault)
    return said.r, said.iterations, said.note


def solve(name: str, solver: AnyConfigured, laid: Laid, tolerance: float) -> dict[str, object]:
    """One run, timed, judged by the measure."""
    began = time.process_time()
    r, iterations, why = attempt(name, solver, laid, tolerance)
    seconds = time.process_time() - began
    residual = measure(laid.problem, r).residual
    solved = residual <= tolerance
    return {
        "method": name, "tolerance": tolerance, "solved": solved, "residual": residual,
        "iterations": iterations, "seconds": seconds, "why": "" if solved else why,
    }  # fmt: skip


def measured(given: argparse.Namespace, solvers: Mapping[str, AnyConfigured]) -> Iterator[dict[str, object]]:
    """All runs, everything compiled before the first."""
    for solver in solvers.values():
        solver.prepare() if isinstance(solver, ConfiguredMethod) else solver.kernel()
    for k, (source, problem, laid) in enumerate(problems(given)):
        if k == 0:
            for name, solver in solvers.items():
                solve(name, solver, laid, 1e-1)
        for tolerance in TOLERANCES:
            for name, solver in solvers.items():
                run = solve(name, solver, laid, tolerance)
                yield {"set": source, "problem": problem, "contacts": laid.problem.n} | run


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """One line a set, tolerance and method."""
    lines = []
    for (source, tolerance), group in rows.groupby(["set", "tolerance"], sort=False):
        solved = group.pivot(index="problem", columns="method", values="solved")
        usual = solved.columns[solved.mean() >= USUAL]
        common = set(solved.index[solved[usual].all(axis=1)])
        for method, runs in group.groupby("method", sort=False):
            lines.append({"set": source, "tolerance": tolerance, "method": method} | _line(runs, common))
    return pd.DataFrame(lines)


def _line(runs: pd.DataFrame, common: set[str]) -> dict[str, object]:
    """The figures of one method; its means only if it solved all the common problems."""
    shared = runs[runs.problem.isin(common) & runs.solved]
    complete = len(shared) == len(common)
    return {
        "problems": len(runs),
        "solved": int(runs.solved.sum()),
        "common": len(common),
        "iterations": shared.iterations.median() if complete else np.nan,
        "median_ms": 1e3 * shared.seconds.median() if complete else np.nan,
        "mean_ms": 1e3 * shared.seconds.mean() if complete else np.nan,
        "total_s": runs.seconds.sum(),
    }


def draw(rows: pd.DataFrame, methods: list[str]) -> Figure:
    """Dolan–Moré profiles, one a tolerance: share of the problems solved within a factor of the best time."""
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    for axes, tolerance in zip(figure.subplots(1, len(TOLERANCES), sharey=True), TOLERANCES, strict=True):
        here = rows[rows.tolerance == tolerance]
        here = here.assign(problem_hash=here.set + here.problem, existence="", time_median=here.seconds)
        ratios = performance_ratios(here.assign(solver=here.method), methods)
        for k, method in enumerate(methods):
            at = np.sort(ratios[method][np.isfinite(ratios[method])])
            style = DASHES[(k + k // len(COLOURS)) % len(DASHES)]
            share = np.arange(1, len(at) + 1) / len(ratios)
            axes.step([*at, 1e4], [*share, share[-1] if len(share) else 0.0], where="post",
                      color=COLOURS[k % len(COLOURS)], linestyle=style, label=method)  # fmt: skip
        axes.set(xscale="log", xlim=(1.0, 1e4), ylim=(0.0, 1.02), xlabel="time / best time on the problem")
        axes.set_title(f"to {tolerance:.0e}, {len(ratios)} problems", fontsize=10)
        axes.grid(which="major", color="0.9")
    figure.axes[0].set_ylabel("share of the problems solved")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=8)
    return figure


def main() -> None:
    parser = options(__doc__)
    add_sets(parser)
    parser.add_argument("--methods", metavar="A,B,...", help="global methods; all by default")
    parser.add_argument("--out", type=Path, default=Path("results/global_methods"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    solvers = contenders(given.methods)
    with one_thread():
        rows = pd.DataFrame(list(measured(given, solvers)))
    rows.to_csv(given.out / "rows.csv", index=False, float_format="%.4g")
    write_table(table(rows), given.out / "table.csv")
    save(draw(rows, list(solvers)), given.out, "time")


if __name__ == "__main__":
    main()
