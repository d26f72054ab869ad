"""What a run at level 1 leaves in its folder: a table for each kind of contact, strata, a figure, the machine."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from fibercontact.bench import markdown
from fibercontact.bench.contact_verdict import INACCURATE_ANSWER
from fibercontact.bench.environment import cpu_model, versions
from fibercontact.bench.figures import save, style_of
from fibercontact.bench.level1 import Measured
from fibercontact.bench.report import IDLE_LOAD, number
from fibercontact.bench.tables import tally
from fibercontact.files import replace_file

__all__ = ["Grid", "draw_strata", "grids", "notes", "solver_table", "strata", "write_report"]

CONDITION = {"up to 1e2": 1e2, "1e2 to 1e5": 1e5, "1e5 to 1e8": 1e8, "1e8 to 1e10": 1e10, "over 1e10": np.inf}
MU = {"0": 0.0, "0 to 0.3": 0.3, "0.3 to 1": 1.0, "1 to 10": 10.0, "over 10": np.inf}
"""Strata by the upper ends of half-open bins."""

WORDS = {
    "uniform": "visits drawn at random from Gauss–Seidel runs",
    "hard": "visits on which some solver failed or was slow, or two answers differ",
    "known": "synthetic contacts with known answers",
}


@dataclass(frozen=True)
class Grid:
    """A table as people read it: texts, and what stands above it."""

    title: str
    cells: pd.DataFrame


def solver_table(measured: Measured) -> pd.DataFrame:
    """A row a kind of contact and solver, in the order of the run."""
    rows = [
        {"kind": kind, "solver": solver} | _figures(group) | _times(measured.times, str(kind), str(solver))
        for (kind, solver), group in measured.answers.groupby(["kind", "solver"], sort=False)
    ]
    return pd.DataFrame(rows)


def _figures(rows: pd.DataFrame) -> dict[str, Any]:
    """The figures of one solver. Residuals are medians over all answers, and the worst of those claimed."""
    failed = int((rows["reason"] != "").sum())
    claimed = rows[rows["claimed"]]
    return {
        "contacts": len(rows),
        "failed": failed,
        "failure_percent": 100.0 * failed / len(rows),
        "reasons": tally(rows["reason"]),
        "false_successes": int((rows["reason"] == INACCURATE_ANSWER).sum()),
        "residual_median": rows["residual"].median(),
        "residual_worst_claimed": claimed["residual"].max(),
        "coulomb_median": rows["coulomb"].median(),
        "coulomb_worst_claimed": claimed["coulomb"].max(),
        "velocity_error_median": claimed["velocity_error"].median(),
        "iterations_mean": rows["iterations"].mean(),
        "iterations_largest": rows["iterations"].max(),
    }


def _times(times: pd.DataFrame, kind: str, solver: str) -> dict[str, float]:
    ns = times[(times["kind"] == kind) & (times["solver"] == solver)]["ns"]
    return {"ns_best": ns.min(), "ns_median": ns.median()}


def strata(measured: Measured) -> pd.DataFrame:
    """Failures by family, condition number and mu within each kind, one row each a solver.

    The families of the random sample are the runs it is from; they are strata too.
    """
    rows = measured.answers
    kinds = {
        "family": rows["family"].str.partition(":")[2].str.strip(),
        "condition": _binned(rows["condition"], CONDITION),
        "mu": _binned(rows["mu"], MU),
    }
    parts = []
    for by, labels in kinds.items():
        groups = rows.assign(stratum=labels, failure=rows["reason"] != "").groupby(
            ["kind", "stratum", "solver"], sort=False
        )
        part = groups["failure"].agg(contacts="size", failed="sum").reset_index()
        part.insert(0, "by", by)
        parts.append(part)
    found = pd.concat(parts, ignore_index=True)
    return found.assign(failure_percent=100.0 * found["failed"] / found["contacts"])


def _binned(values: pd.Series, bins: Mapping[str, float]) -> pd.Series:
    return pd.cut(values, [-1.0, *bins.values()], labels=list(bins)).astype(str)


def grids(measured: Measured) -> list[Grid]:
    """The tables as people read them: the solvers on each kind, then failures (%) by stratum."""
    table, by_stratum = solver_table(measured), strata(measured)
    found = []
    for kind in table["kind"].unique():
        own = table[table["kind"] == kind]
        cells = pd.DataFrame([_cells(line) for line in own.to_dict("records")])
        found.append(Grid(f"{own['contacts'].iloc[0]} contacts, {kind}: {WORDS.get(kind, kind)}", cells))
    found += [
        Grid(f"failures (%) by {by}, {kind}", _rates(group))
        for (kind, by), group in by_stratum.groupby(["kind", "by"], sort=False)
        if group["stratum"].nunique() > 1 and not (kind == "hard" and by == "family")
    ]
    return found


def _cells(line: Mapping[Any, Any]) -> dict[str, str]:
    """One solver's line in words."""
    cells = {
        "solver": line["solver"],
        "failures": f"{number(line['failure_percent'])} % ({line['failed']})",
        "false": str(line["false_successes"]),
        "reasons": line["reasons"],
        "residual median / worst claimed": _pair(line, "residual_median", "residual_worst_claimed"),
        "Coulomb residual": _pair(line, "coulomb_median", "coulomb_worst_claimed"),
        "ns best / median": _pair(line, "ns_best", "ns_median"),
        "iterations mean / largest": _pair(line, "iterations_mean", "iterations_largest"),
    }
    if not np.isnan(line["velocity_error_median"]):
        cells["error of u, median"] = number(line["velocity_error_median"])
    return cells


def _pair(line: Mapping[Any, Any], first: str, second: str) -> str:
    return f"{number(line[first])} / {number(line[second])}"


def _rates(group: pd.DataFrame) -> pd.DataFrame:
    """Strata down, solvers across."""
    solvers, order = group["solver"].unique(), _in_order(group["stratum"].unique())
    percent = group.pivot(index="stratum", columns="solver", values="failure_percent").loc[order, solvers]
    cells = percent.map(number)
    cells.insert(0, "contacts", group.groupby("stratum")["contacts"].first()[order].astype(str))
    return cells.reset_index()


def _in_order(labels: Iterable[str]) -> list[str]:
    """Labels of bins in their order; others as they come."""
    known = [*CONDITION, *MU]
    return sorted(labels, key=lambda label: known.index(label) if label in known else -1)


def notes(measured: Measured, counts: Mapping[str, int]) -> list[str]:
    """What a reader must know of the verdict, the sample, the laws and the machine."""
    said = [
        "right: natural map of the solver's own law <= 1e-6 |b| + 6 (1 + mu) eps sigma |r|, sigma |r| counted up to "
        "1e10 |b| or the known answer; any other answer, claimed, is a false success",
        "ns: batched, warm, one thread, a whole replay over its contacts; residuals: median of all answers / worst "
        "of those claimed",
    ]
    if "hard" in set(measured.answers["kind"]):
        said.append(
            "the hard visits were chosen because these solvers failed or were slow on them: their rates say what "
            "else fails there, not how often"
        )
    if counts.get("visits"):
        said.append(_counted(counts))
    linearised = measured.answers[measured.answers["facets"] != 0]["solver"].unique()
    said += [
        f"{name} is judged by its own, linearised law; its Coulomb residual is its model error"
        for name in linearised
    ]
    if measured.load > IDLE_LOAD:
        said.append(
            f"the machine was not idle ({measured.load:.0f} other processes at work): times are too long"
        )
    return said


def _counted(counts: Mapping[str, int]) -> str:
    """How many visits there were, and how many had each reason to be hard."""
    reasons = sorted(((n, name) for name, n in counts.items() if not name.startswith("visits")), reverse=True)
    return (
        f"of {counts['visits']} visits of the runs, {counts['visits looked at']} were looked at, among them: "
        + ", ".join(f"{name} {n}" for n, name in reasons)
    )


def write_report(measured: Measured, counts: Mapping[str, int], folder: Path) -> list[Path]:
    """Write the files of a run; returns them."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [
        *(line for grid in grids(measured) for line in _markdown(grid)),
        *_bullets(notes(measured, counts)),
    ]
    machine = {"cpu": cpu_model(), "threads": 1, "load_at_start": measured.load} | dict(versions())
    texts = {
        "table.csv": solver_table(measured).to_csv(index=False),
        "strata.csv": strata(measured).to_csv(index=False),
        "table.md": "\n".join(lines) + "\n",
        "environment.json": json.dumps(machine, indent=2) + "\n",
    }
    for name, text in texts.items():
        replace_file(folder / name, text.encode())
    save(draw_strata(measured), folder, "failures")
    return [folder / name for name in (*texts, "failures.svg", "failures.png")]


def _markdown(grid: Grid) -> Iterator[str]:
    yield from (
        f"**{grid.title}**",
        "",
        *markdown.grid(grid.cells.columns, grid.cells.itertuples(index=False)),
        "",
    )


def _bullets(sentences: Sequence[str]) -> Iterator[str]:
    return (f"* {sentence}" for sentence in sentences)


def draw_strata(measured: Measured) -> Figure:
    """Failure share against condition number and against mu, a row of axes a kind but the hard visits."""
    found = strata(measured)
    kinds = [kind for kind in found["kind"].unique() if kind != "hard"] or list(found["kind"].unique())
    figure = Figure(figsize=(9.0, 0.6 + 3.2 * len(kinds)), dpi=100, layout="constrained")
    axes = figure.subplots(len(kinds), 2, squeeze=False)
    for row, kind in zip(axes, kinds, strict=True):
        for panel, by, name in zip(row, ("condition", "mu"), ("condition number of W", "mu"), strict=True):
            _draw_rates(panel, found[(found["kind"] == kind) & (found["by"] == by)])
            panel.set_xlabel(name)
        row[0].set_ylabel(f"failures (%), {kind}")
    figure.legend(handles=axes[0][0].get_lines(), loc="outside upper center", ncols=4, fontsize=9)
    return figure


def _draw_rates(axes: Any, rows: pd.DataFrame) -> None:
    """A line a solver, side by side where they coincide."""
    order = _in_order(rows["stratum"].unique())
    solvers = rows["solver"].unique()
    for k, solver in enumerate(solvers):
        percent = rows[rows["solver"] == solver].set_index("stratum")["failure_percent"].reindex(order)
        aside = 0.07 * (k - (len(solvers) - 1) / 2)
        colour, _, marker = style_of(k)
        x = np.arange(len(order)) + aside
        axes.plot(x, percent, label=solver, linewidth=1.0, markersize=5, color=colour, marker=marker)
    axes.set_xticks(range(len(order)), order, fontsize=8)
    axes.set_yscale("symlog", linthresh=0.01)
    axes.set_ylim(-0.003, 150.0)
    ticks = [0.0, 0.01, 0.1, 1.0, 10.0, 100.0]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.grid(axis="y", color="0.9")
    axes.set_axisbelow(True)
