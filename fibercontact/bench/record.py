"""Runs as things to look at: what each was asked, which of its rows are there, where runs lie."""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from fibercontact.bench.environment import cpu_model, versions
from fibercontact.bench.plan import Plan
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.rows import ROWS, Key, Row, RowFile
from fibercontact.files import replace_file

__all__ = ["TEXTS", "Asked", "Record", "find_runs", "read_run", "write_asked", "write_plan"]

ASKED = "run.json"
"""What a run was asked, in its folder: the last command's plan, or the plans of the runs merged in it."""

SHEETS = ("rows.csv", "rows.csv.gz")
"""Rows as a table, which stand for a run whose file of rows was not kept."""


@dataclass(frozen=True)
class Asked:
    """A plan as it is kept: every measurement, a key without its problem, is to be made of every problem."""

    problem_set: str
    problems: Sequence[str]
    """Hashes."""
    measurements: Sequence[Mapping[str, Any]]
    environment: Mapping[str, Any]
    """The machine that the run was started on, and its versions."""
    began: str

    def wanted(self) -> set[Key]:
        """The keys of all its rows."""
        return {
            Key(**measurement, problem_hash=p) for measurement in self.measurements for p in self.problems
        }


@dataclass(frozen=True)
class Record:
    """A run: its folder, what it was asked (nothing where that is not known), its rows."""

    folder: Path
    asked: Sequence[Asked]
    every: Sequence[Row]
    """All rows of its folder, those of earlier commands and other code among them."""

    @cached_property
    def wanted(self) -> set[Key]:
        """What was asked for."""
        return {key for asked in self.asked for key in asked.wanted()}

    @cached_property
    def rows(self) -> list[Row]:
        """The rows that were asked for and are there; all of them where it is not known what was asked."""
        return [row for row in self.every if not self.asked or Key.of(row) in self.wanted]

    def values(self, name: str) -> list[Any]:
        """What the rows have in a column, each value once."""
        return list(dict.fromkeys(row[name] for row in self.rows if row.get(name) is not None))


def write_plan(folder: Path, plan: Plan) -> None:
    """Keep in a run's folder what is asked of it, and since when."""
    asked, before = _asked(plan), _read_asked(folder / ASKED)
    if [replace(one, began=asked.began) for one in before] != [asked]:
        write_asked(folder, [asked])


def write_asked(folder: Path, asked: Sequence[Asked]) -> None:
    """Replace, as a whole, what a run's folder says that was asked."""
    text = json.dumps({"asked": [asdict(one) for one in asked]}, indent=1)
    replace_file(folder / ASKED, f"{text}\n".encode())


def _asked(plan: Plan) -> Asked:
    measurements: dict[tuple[Any, ...], dict[str, Any]] = {}
    for unit in plan.work():
        fields = unit.key.fields()
        del fields["problem_hash"]
        measurements.setdefault(tuple(fields.values()), fields)
    return Asked(
        problem_set=plan.entries[0].file.parent.resolve().name if plan.entries else "",
        problems=[entry.hash for entry in plan.entries],
        measurements=list(measurements.values()),
        environment={"machine": platform.node(), "cpu": cpu_model(), **versions()},
        began=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def read_run(folder: Path) -> Record:
    """The run in a folder; raises `BenchError` when there is none, or what is there cannot be read."""
    rows = _rows(folder)
    if any(Key.of(row) is None for row in rows):
        raise BenchError(f"{folder}: its rows are not those of a run of `fibercontact table`")
    return Record(folder, _read_asked(folder / ASKED), rows)


def _rows(folder: Path) -> list[Row]:
    if (folder / ROWS).is_file():
        return RowFile(folder).read()
    if not folder.is_dir():
        raise BenchError(f"{folder}: no such folder")
    for sheet in (folder / name for name in SHEETS):
        if sheet.is_file():
            return _of_sheet(sheet)
    raise BenchError(f"{folder}: no run there (no {ROWS}, nor {' or '.join(SHEETS)})")


def _of_sheet(sheet: Path) -> list[Row]:
    kinds = dict.fromkeys(TEXTS, str)
    try:
        frame = pd.read_csv(sheet, dtype=kinds, keep_default_na=False, na_values=[""], low_memory=False)
        return [_typed(line) for line in frame.to_dict("records")]
    except (ValueError, EOFError, OSError) as fault:
        raise BenchError(f"{sheet}: not readable as rows ({' '.join(str(fault).split())})") from None


TEXTS = (
    "problem", "problem_hash", "scene", "existence", "solver", "fingerprint", "options", "accuracy", "start", "outer",
    "mode", "code", "cpu", "reason", "detail", "stamp", "warning",
)  # fmt: skip
"""Columns of texts, whose empty cells are empty texts."""
LISTS = ("times",)
"""Columns whose cells are lists."""


def _typed(line: Mapping[Any, Any]) -> Row:
    """A line of a sheet as a row: what is empty is not known, but for texts."""
    row: Row = {str(name): None if pd.isna(value) else value for name, value in line.items()}
    row |= {name: "" for name in TEXTS if row.get(name) is None}
    return row | {name: json.loads(row[name]) for name in LISTS if row.get(name) is not None}


def _read_asked(file: Path) -> list[Asked]:
    if not file.is_file():
        return []
    try:
        found = [Asked(**asked) for asked in json.loads(file.read_text(encoding="utf-8"))["asked"]]
        _ = [asked.wanted() for asked in found]
    except (ValueError, KeyError, TypeError) as fault:
        raise BenchError(f"{file}: not readable ({fault}); `fibercontact table` writes it again") from None
    return found


def find_runs(folder: Path) -> list[Record]:
    """The runs in a folder and the folders in it, by path; raises `BenchError` when there is none."""
    folders = {file.parent for name in (ROWS, *SHEETS) for file in folder.rglob(name)}
    records = []
    for place in sorted(folders):
        try:
            records.append(read_run(place))
        except BenchError:  # rows of another kind: of `validate`, or of another version
            continue
    if not records:
        raise BenchError(f"{folder}: no runs in it")
    return records
