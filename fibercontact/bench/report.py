"""What a run leaves in its folder: rows, tables in three forms, strata, figures, and the machine that ran."""

import json
import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fibercontact.bench.figures import draw_failures, draw_profile, save
from fibercontact.bench.markdown import grid
from fibercontact.bench.protocol import ACCURACIES, GLOBAL, BenchError
from fibercontact.bench.rows import TIMED, Row
from fibercontact.bench.tables import (
    common_problems,
    compared,
    contrary,
    headline,
    performance_ratios,
    rated,
    strata,
    to_frame,
)
from fibercontact.files import replace_file
from fibercontact.reference.existence import UNSOLVABLE

__all__ = ["Report", "View", "make_report", "number", "shown_rows", "write_report"]

IDLE_LOAD = 0.5
"""Mean number of other running processes above which something ran beside the measurement."""

MACHINE = ("cpu", "threads", "python", "numpy", "numba", "scipy", "fibercontact", "protocol", "code")


@dataclass(frozen=True)
class View:
    """The table of one accuracy: figures, figures by stratum, and what must be said beside them."""

    accuracy: str
    mode: str
    rows: pd.DataFrame
    table: pd.DataFrame
    strata: pd.DataFrame
    notes: Sequence[str]

    @property
    def title(self) -> str:
        """Heading: how many problems, at which accuracy, from which start."""
        row = self.rows.iloc[0]
        tolerance, problems = row["tolerance"], rated(self.rows)["problem_hash"].nunique()
        loops = [outer for outer in self.rows["outer"].unique() if outer not in ("plain", GLOBAL)]
        loop = f", {', '.join(loops)} outer loop" if loops else ""
        return f"{problems} problems, accuracy {self.accuracy} ({tolerance:.0e}), {row['start']} start{loop}"


@dataclass(frozen=True)
class Report:
    """All rows of a run and a view for each of its accuracies."""

    rows: pd.DataFrame
    views: Sequence[View]


def make_report(rows: Sequence[Row], solvers: Sequence[str]) -> Report:
    """Aggregate the rows that are shown: a view for each timed accuracy, or for each one when nothing was timed.

    Raises `BenchError` when all problems are proved unsolvable.
    """
    frame = to_frame(shown_rows(rows))
    if rated(frame).empty:
        raise BenchError("nothing to rate: every problem is proved unsolvable")
    rank = {
        "solver": {name: k for k, name in enumerate(solvers)},
        "accuracy": {name: k for k, name in enumerate(ACCURACIES)},
    }
    frame = frame.sort_values(
        ["mode", "accuracy", "scene", "problem", "solver"],
        key=lambda column: column.map(rank[str(column.name)]) if column.name in rank else column,
        kind="stable",
        ignore_index=True,
    )
    timed = frame[frame["mode"] == TIMED]
    shown = timed if len(timed) else frame
    views = [_view(group, solvers, frame) for _, group in shown.groupby("accuracy", sort=False)]
    return Report(frame, views)


def shown_rows(rows: Sequence[Row]) -> list[Row]:
    """The rows without those of the passes that came before timed ones."""
    timed = {row["accuracy"] for row in rows if row["mode"] == TIMED}
    return [row for row in rows if row["mode"] == TIMED or row["accuracy"] not in timed]


def _view(rows: pd.DataFrame, solvers: Sequence[str], every: pd.DataFrame) -> View:
    accuracy, mode = rows["accuracy"].iloc[0], rows["mode"].iloc[0]
    table = headline(rows, solvers)
    others = [level for level in ACCURACIES if level != accuracy and (every["accuracy"] == level).any()]
    for level in others:
        table[f"failure_percent_{level}"] = headline(every[every["accuracy"] == level], solvers)[
            "failure_percent"
        ]
    by_stratum = strata(rows, solvers)
    notes = [*_remarks(rows, table), *contrary(table, by_stratum)]
    return View(accuracy, mode, rows, table, by_stratum, notes)


def _remarks(rows: pd.DataFrame, table: pd.DataFrame) -> list[str]:
    """What a reader must know of the means, of the laws, of the problems left out and of the machine."""
    counted = rated(rows)
    names, common = compared(counted), len(common_problems(counted))
    linearised = set(counted[counted["law_facets"] != 0]["solver"])
    remarks = [f"means are over the {common} problems solved by all of {', '.join(names) or '(none)'}"]
    for solver in table.index:
        if solver in linearised:
            solved = table.loc[solver, "common"]
            remarks.append(
                f"{solver} is judged by its own, linearised law; it solved {solved} of the {common}"
            )
        elif solver not in names:
            remarks.append(f"{solver} solved nothing and is left out of the comparison")
    methods = set(rows[rows["outer"] == GLOBAL]["solver"])
    if methods:
        named = ", ".join(solver for solver in table.index if solver in methods)
        remarks.append(f"global methods, whose sweeps are iterations, each of a cost of its own: {named}")
    unsolvable = sorted(rows[rows["existence"] == UNSOLVABLE]["problem"].unique())
    if unsolvable:
        remarks.append(f"proved unsolvable and left out of the rates: {', '.join(unsolvable)}")
    load = rows["load"].mean()
    if rows["mode"].iloc[0] == TIMED and load > IDLE_LOAD:
        remarks.append(f"the machine was not idle ({load:.1f} other processes at work): times are too long")
    return remarks


def write_report(report: Report, folder: Path) -> list[Path]:
    """Write the files of a run; returns what is in its folder beside the rows."""
    texts = {
        "rows.csv": report.rows.to_csv(index=False),
        "table.csv": _stacked(report.views, "table").to_csv(index=False),
        "strata.csv": _stacked(report.views, "strata").to_csv(index=False),
        "table.md": "\n".join(map(markdown, report.views)),
        "table.tex": "\n".join(map(latex, report.views)),
        "environment.json": json.dumps(environment(report.rows), indent=2) + "\n",
    }
    for name, text in texts.items():
        replace_file(folder / name, text.encode())
    for view in report.views:
        _write_figures(view, folder, "" if view is report.views[0] else f"-{view.accuracy}")
    return sorted(file for file in folder.iterdir() if file.suffix not in (".jsonl", ".lock"))


def _write_figures(view: View, folder: Path, suffix: str) -> None:
    if view.mode != TIMED:
        return
    ratios = performance_ratios(view.rows, list(view.table.index))
    save(draw_profile(ratios, view.title), folder, f"profile{suffix}")
    save(draw_failures(view.table, view.title), folder, f"failures{suffix}")


def _stacked(views: Iterable[View], part: str) -> pd.DataFrame:
    """The same part of all views in one frame."""
    frames = []
    for view in views:
        frame: pd.DataFrame = getattr(view, part)
        frame = frame.reset_index() if frame.index.name == "solver" else frame.copy()
        frame.insert(0, "mode", view.mode)
        frame.insert(0, "accuracy", view.accuracy)
        frames.append(frame)
    return pd.concat(frames)


def environment(rows: pd.DataFrame) -> dict[str, Any]:
    """The machine and versions that the rows were measured with, from the rows themselves."""
    found: dict[str, Any] = {
        name: _only(rows[name].dropna().unique().tolist()) for name in MACHINE if name in rows
    }
    found["load_at_start"] = {"mean": float(rows["load"].mean()), "largest": float(rows["load"].max())}
    found["measured"] = {"first": rows["stamp"].min(), "last": rows["stamp"].max()}
    return found


def _only(values: list[Any]) -> Any:
    return values[0] if len(values) == 1 else values


BY_RODS = "by rod model: failures (%) / mean sweeps / mean time (ms, where timed)"


def display(view: View) -> pd.DataFrame:
    """The table as people read it: text cells, headings with units."""
    lines = [_cells(line, view.mode == TIMED) for line in view.table.to_dict("records")]
    return pd.DataFrame(lines, index=view.table.index)


def by_rods(view: View) -> pd.DataFrame:
    """The table by rod model as people read it, empty for one model: failures (%) / mean sweeps / mean ms."""
    strata = view.strata[view.strata["by"] == "rods"]
    shown = ["failure_percent", "sweeps_mean", *(["time_mean_ms"] if view.mode == TIMED else [])]
    cells = strata[shown].map(number).agg(" / ".join, axis=1) if len(strata) else strata["stratum"]
    by_model = strata.assign(cell=cells).pivot(index="solver", columns="stratum", values="cell")
    return by_model.reindex([name for name in view.table.index if name in by_model.index])


def _cells(line: dict[Hashable, Any], timed: bool) -> dict[str, str]:
    """One solver's line in words."""

    def pair(first: str, second: str) -> str:
        return f"{number(line[first])} / {number(line[second])}"

    cells = {
        "failures": f"{number(line['failure_percent'])} % ({line['failed']}/{line['problems']})",
        "false": str(line["false_successes"]),
        "reasons": line["reasons"],
        "sweeps mean / median": pair("sweeps_mean", "sweeps_median"),
        "own set: n, mean / median": f"{line['own']}, {pair('own_sweeps_mean', 'own_sweeps_median')}",
    }
    if timed:
        cells["time mean / geo (ms)"] = pair("time_mean_ms", "time_geo_ms")
        cells["set-up (ms)"] = number(line["setup_mean_ms"])
    cells["Coulomb residual median / worst"] = pair("coulomb_median", "coulomb_worst")
    published = [line[f"published_{name}"] for name in ("failure_percent", "iterations", "ms")]
    known = isinstance(line["published"], str)
    cells["talk: failures (%), iterations, ms"] = ", ".join(map(number, published)) if known else "–"
    for level in ACCURACIES:
        if f"failure_percent_{level}" in line:
            cells[f"failures at {level} (%)"] = number(line[f"failure_percent_{level}"])
    return cells


def number(value: float) -> str:
    """Three significant digits; `–` for what is not known."""
    if value is None or math.isnan(value):
        return "–"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{value:.1e}"


def markdown(view: View) -> str:
    """The table in Markdown, its notes below."""
    lines = [f"**{view.title}**", "", *_grid(display(view)), "", *(f"* {note}" for note in view.notes), ""]
    if len(models := by_rods(view)):
        lines += [f"**{BY_RODS}**", "", *_grid(models), ""]
    return "\n".join(lines)


def _grid(table: pd.DataFrame) -> list[str]:
    cells = table.reset_index()
    return grid(cells.columns, cells.itertuples(index=False))


def latex(view: View) -> str:
    """The table in LaTeX (package booktabs), its notes as comments."""
    cells = display(view).reset_index()
    cells.columns = pd.Index([name.replace("%", r"\%") for name in cells.columns])
    for name in cells:
        cells[name] = cells[name].str.replace("%", r"\%").str.replace("_", r"\_").str.replace("–", "--")
    body = cells.to_latex(index=False, column_format="l" + "r" * (cells.shape[1] - 1))
    return "\n".join([f"% {view.title}", *(f"% {note}" for note in view.notes), body])
