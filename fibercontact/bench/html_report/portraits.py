"""A few problems of a run looked at closely: how each solver converges, rods and contacts where they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from fibercontact.bench.html_report.choice import locate
from fibercontact.bench.html_report.curves import Again, solving_again
from fibercontact.bench.html_report.figures import Curve
from fibercontact.bench.html_report.rods import Rods, rods_of
from fibercontact.bench.html_report.runs import RunRead
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import ACCURACIES
from fibercontact.bench.report import View

__all__ = ["Portrait", "portraits", "strictest"]

Tick = Callable[[str], None]

NO_RODS = Rods(None, "Not drawn: --rods says of how many problems they are.")


@dataclass(frozen=True)
class Portrait:
    """One problem of a run at one accuracy: its curves, its rods, and what must be said of the curves."""

    problem: str
    problem_hash: str
    scene: str
    contacts: int
    accuracy: str
    curves: Sequence[Curve]
    notes: Sequence[str]
    rods: Rods = NO_RODS


def strictest(views: Sequence[View]) -> View:
    """The view of the highest accuracy."""
    return min(views, key=lambda view: ACCURACIES[view.accuracy])


def portraits(
    run: RunRead,
    hashes: Sequence[str],
    folders: Sequence[Path],
    plugins: Sequence[Path],
    rods: int,
    tick: Tick,
) -> list[Portrait]:
    """Solve the problems again, draw the rods of the first `rods` of them; `tick` is told what is being done."""
    rows = strictest(run.views).rows
    found: list[Portrait] = []
    with solving_again(run, plugins) as again:
        for k, digest in enumerate(hashes):
            mine = rows[rows["problem_hash"] == digest]
            entry = locate(mine["problem"].iloc[0], digest, folders)
            portrait = _portrait(mine, entry, again, tick)
            if entry is not None and k < rods:
                tick(f"{portrait.problem} rods")
                portrait = replace(portrait, rods=rods_of(entry))
            found.append(portrait)
    return found


def _portrait(rows: pd.DataFrame, entry: Entry | None, again: Again, tick: Tick) -> Portrait:
    row, curves, notes = rows.iloc[0], [], list(again.remarks)
    if entry is None:
        notes.append(
            "not solved again: no file of this name and hash was found; --set names a folder to look in"
        )
    else:
        for measured in rows.to_dict("records"):
            if measured["solver"] in again.solvers:
                tick(f"{entry.name} {measured['solver']}")
                curve, words = again.curve(entry, {str(name): value for name, value in measured.items()})
                curves += [curve] if curve else []
                notes += words
    return Portrait(
        row["problem"],
        row["problem_hash"],
        row["scene"],
        int(row["contacts"]),
        row["accuracy"],
        curves,
        notes,
    )
