"""What a validation leaves in its folder: rows, two tables, a figure of velocity error against residual."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from fibercontact.bench.figures import save, style_of
from fibercontact.bench.markdown import grid
from fibercontact.bench.report import number
from fibercontact.bench.validate import Comparison
from fibercontact.files import replace_file
from fibercontact.reference.truth import NONE

__all__ = ["draw_errors", "notes", "reference_table", "solver_table", "write_report"]

TINY = 1e-16  # what a zero is drawn as

SOLVER_COLUMNS = [
    "solver",
    "law",
    "solved",
    "Coulomb residual: median / largest",
    "velocity error: median / 9 of 10 below / largest",
    "same regime (%)",
    "work of friction off by (median)",
]


def solver_table(comparison: Comparison) -> pd.DataFrame:
    """One line a solver, in text; velocities, regimes and work over the problems that have a reference."""
    by_solver = _frame(comparison).groupby("solver", sort=False)
    lines = [_solver_line(str(name), rows) for name, rows in by_solver]
    return pd.DataFrame(lines, columns=SOLVER_COLUMNS)


def _solver_line(name: str, rows: pd.DataFrame) -> list[str]:
    coulomb, error = rows["coulomb"], rows["velocity_error"]
    return [
        name,
        rows["law"].iloc[0],
        f"{rows['solved'].sum():.0f}/{len(rows)}",
        _numbers(coulomb.median(), coulomb.max()),
        _numbers(error.median(), error.quantile(0.9), error.max()),
        _numbers(100.0 * rows["same_regime"].mean()),
        _numbers(rows["friction_work_error"].median()),
    ]


def _numbers(*values: Any) -> str:
    return " / ".join(number(float(value)) for value in values)


def reference_table(comparison: Comparison) -> pd.DataFrame:
    """One line a problem, in text: its reference, `none` where there is none."""
    lines = [
        [
            row["problem"],
            str(row["contacts"]),
            row["existence"],
            row["reference"],
            number(row["residual"]),
            str(row["solutions"]),
        ]
        for row in comparison.references
    ]
    return pd.DataFrame(
        lines, columns=["problem", "contacts", "existence", "reference", "residual", "solutions"]
    )


def _frame(comparison: Comparison) -> pd.DataFrame:
    """Tidy rows; what is not known is NaN."""
    frame = pd.DataFrame(list(comparison.rows))
    for name in ("coulomb", "velocity_error", "same_regime", "friction_work_error", "solved"):
        frame[name] = pd.to_numeric(frame[name]) if name in frame else np.nan
    return frame


def notes(comparison: Comparison) -> list[str]:
    """What must be said beside the tables."""
    without = [row["problem"] for row in comparison.references if row["reference"] == NONE]
    found = len(comparison.references) - len(without)
    said = [
        f"{found} of {len(comparison.references)} problems have a reference; velocity error, regime and work "
        "are over these",
        "velocity error: kinetic-energy norm of the difference, relative to the reference",
    ]
    if without:
        said.append(f"no reference ({NONE}): {', '.join(without)}")
    return [*said, *comparison.skipped]


def write_report(comparison: Comparison, folder: Path) -> list[Path]:
    """Write rows (CSV), both tables (Markdown) and the figure (SVG, PNG); returns the files."""
    replace_file(folder / "rows.csv", _frame(comparison).to_csv(index=False).encode())
    solvers, references = (
        grid(table.columns, table.itertuples(index=False))
        for table in (solver_table(comparison), reference_table(comparison))
    )
    remarks = [f"* {note}" for note in notes(comparison)]
    lines = [*solvers, "", *remarks, "", *references]
    replace_file(folder / "validation.md", "".join(f"{line}\n" for line in lines).encode())
    save(draw_errors(_frame(comparison)), folder, "velocity_error")
    names = ("rows.csv", "validation.md", "velocity_error.svg", "velocity_error.png")
    return [folder / name for name in names]


def draw_errors(rows: pd.DataFrame) -> Figure:
    """Velocity error against Coulomb residual, a marker a problem and solver; zeros are drawn at 1e-16."""
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.add_subplot()
    for k, (solver, mine) in enumerate(rows.dropna(subset="velocity_error").groupby("solver", sort=False)):
        look = style_of(k)
        axes.plot(
            np.maximum(mine["coulomb"], TINY),
            np.maximum(mine["velocity_error"], TINY),
            look.marker,
            color=look.colour,
            markersize=5,
            markerfacecolor="none",
            label=solver,
        )
    axes.set(xscale="log", yscale="log", xlabel="Coulomb residual", ylabel="relative velocity error")
    axes.grid(which="major", color="0.9")
    if axes.has_data():
        axes.legend(fontsize=9)
    return figure
