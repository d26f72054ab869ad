"""A run's folder read back for its report: its rows, checked, its tables, and what is missing or left aside."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd

from fibercontact.bench.protocol import ACCURACIES, DEFAULT_SOLVERS, GLOBAL, BenchError
from fibercontact.bench.record import TEXTS, Record, read_run
from fibercontact.bench.report import View, make_report, shown_rows
from fibercontact.bench.rows import RATES, SETTING, TIMED, Key, Row, RowFile, writer

__all__ = ["RunRead", "renamed", "reported"]

NUMBERS = ("tolerance", "law_facets", "repetitions", "max_sweeps", "max_seconds", "protocol", "contacts")
UNKNOWN = (
    "mu_max",
    "load",
    "sweeps",
    "residual",
    "coulomb",
    "time_median",
    "time_best",
    "setup_seconds",
    "threads",
)
"""Numbers that may be missing."""
FLAGS = ("claimed", "solved", "false_success")

NAMED = 3
"""Solvers whose missing rows are told."""


@dataclass(frozen=True)
class RunRead:
    """A run as it is reported: one view an accuracy, timed ones first."""

    name: str
    folder: Path
    solvers: Sequence[str]
    rows: pd.DataFrame
    views: Sequence[View]
    remarks: Sequence[str]


def reported(folder: Path) -> RunRead:
    """Read the folder that `fibercontact table --out` writes, finished or not; `rows.csv.gz` alone will do.

    Where it holds rows of several settings (protocol, code, machine, start, limits), those of the newest row's are
    taken. Raises `BenchError` naming the folder and the fault.
    """
    record, remarks = read_run(folder), RowFile(folder).notes()
    if not record.every:
        raise BenchError(f"{folder}: no rows yet")
    rows = [_checked(row, number, folder) for number, row in enumerate(record.every, start=1)]
    newest = list(_newest(rows))
    if aside := len(rows) - len(newest):
        remarks.append(f"{aside} row(s) of other code, solvers, settings or another machine are left aside")
    mine = shown_rows(newest)
    solvers = _ordered([row["solver"] for row in mine])
    try:
        views = _views(mine, solvers)
    except BenchError as fault:
        raise BenchError(f"{folder}: {fault}") from None
    frame = pd.concat([view.rows for view in views], ignore_index=True)
    remarks += [*_missing(record, views, solvers), *_unfinished(folder)]
    return RunRead(folder.resolve().name, folder, solvers, frame, views, remarks)


def renamed(runs: Sequence[RunRead]) -> list[RunRead]:
    """The same runs; those that share a folder's name go by their path."""
    names = [run.name for run in runs]
    return [replace(run, name=str(run.folder)) if names.count(run.name) > 1 else run for run in runs]


def _checked(row: Row, number: int, folder: Path) -> Row:
    """The row, what is not known NaN; raises `BenchError` on a value of the wrong kind."""
    clean = row | {name: math.nan for name in UNKNOWN if row.get(name) is None}
    clean |= {name: "" for name in ("detail", "existence", "warning") if name not in row}
    kinds = (
        [(name, str, "a text") for name in TEXTS]
        + [(name, (int, float), "a number") for name in (*NUMBERS, *UNKNOWN)]
        + [(name, bool, "true or false") for name in FLAGS]
    )
    for name, kind, words in kinds:
        value = clean.get(name)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise BenchError(f"{folder}: row {number}: {name} is {value!r}, not {words}")
    if any(math.isnan(clean[name]) for name in NUMBERS):
        raise BenchError(f"{folder}: row {number}: a number is missing ({', '.join(NUMBERS)})")
    for name, known in (("accuracy", tuple(ACCURACIES)), ("mode", (TIMED, RATES))):
        if clean[name] not in known:
            raise BenchError(
                f"{folder}: row {number}: {name} is {clean[name]!r}, not one of {', '.join(known)}"
            )
    return clean


def _newest(rows: Sequence[Row]) -> Iterator[Row]:
    """The rows of the newest setting and, of each solver, of its newest source; each measurement once."""
    by_age = sorted(rows, key=lambda row: row["stamp"])
    setting = [by_age[-1][name] for name in SETTING]
    alike = [row for row in by_age if [row[name] for name in SETTING] == setting]
    machine = next((row["cpu"] for row in reversed(alike) if row["mode"] == TIMED), "")
    mine = [row for row in alike if row["mode"] == RATES or row["cpu"] == machine]
    loop = {row["outer"] for row in [row for row in mine if row["outer"] != GLOBAL][-1:]}
    source = {row["solver"]: (row["fingerprint"], row["options"]) for row in mine}
    kept = {
        tuple(row[name] for name in ("problem_hash", "solver", "accuracy", "mode")): row
        for row in mine
        if row["outer"] in {GLOBAL, *loop} and source[row["solver"]] == (row["fingerprint"], row["options"])
    }
    yield from kept.values()


def _ordered(solvers: Sequence[str]) -> list[str]:
    """Each solver once, those of the talk in its order before the others."""
    return sorted(
        dict.fromkeys(solvers),
        key=lambda name: DEFAULT_SOLVERS.index(name) if name in DEFAULT_SOLVERS else len(DEFAULT_SOLVERS),
    )


def _views(rows: Sequence[Row], solvers: Sequence[str]) -> list[View]:
    """A view an accuracy, those that were timed first."""
    views = list(make_report(rows, solvers).views)
    shown = {view.accuracy for view in views}
    for accuracy in (name for name in ACCURACIES if name not in shown):
        if others := [row for row in rows if row["accuracy"] == accuracy]:
            views += make_report(others, solvers).views
    return views


def _missing(record: Record, views: Sequence[View], solvers: Sequence[str]) -> Iterator[str]:
    """Sentences on rows that were asked for and are not there; or that some solver has not on some problem."""
    if record.asked:
        if gone := record.wanted - {Key.of(row) for row in record.rows}:
            yield f"incomplete: {len(gone)} of {len(record.wanted)} rows that were asked for are missing"
        return
    problems = set().union(*(view.rows["problem_hash"] for view in views))
    for view in views:
        counts = view.rows.groupby("solver")["problem_hash"].nunique().reindex(list(solvers), fill_value=0)
        lacking = (len(problems) - counts)[counts < len(problems)]
        if len(lacking):
            named = ", ".join(f"{name} {count}" for name, count in lacking.iloc[:NAMED].items())
            more = f" and {len(lacking) - NAMED} more solvers" if len(lacking) > NAMED else ""
            yield (
                f"incomplete: at accuracy {view.accuracy}, {lacking.sum()} of {len(problems) * len(solvers)} "
                f"rows are missing ({named}{more})"
            )


def _unfinished(folder: Path) -> Iterator[str]:
    """A sentence on a run whose table is not that of its rows."""
    rows, table = RowFile(folder).path, folder / "table.csv"
    if not rows.is_file():
        return
    if who := writer(folder):
        yield f"incomplete: the run goes on ({who})"
    elif not table.is_file():
        yield "incomplete: the run was interrupted, or goes on elsewhere, for its table has not been written"
    elif rows.stat().st_mtime > table.stat().st_mtime:
        yield "incomplete: rows were added since its table was written"
