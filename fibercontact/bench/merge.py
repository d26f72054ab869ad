"""Several runs made into one: parts of a set, or of its solvers, that were measured apart."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fibercontact.bench.protocol import GLOBAL, BenchError
from fibercontact.bench.record import Asked, Record, write_asked
from fibercontact.bench.rows import ROWS, SETTING, TIMED, Key, Row, but_for_clocks, lines
from fibercontact.files import replace_file

__all__ = ["merge"]


def merge(runs: Sequence[Record], folder: Path) -> int:
    """Write the rows that were asked of several runs into a new folder, each once; returns how many.

    Raises `BenchError` when the protocols differ, with what differs; when two rows of the same measurement differ in
    more than clocks; when there is something in the folder.
    """
    if folder.exists() and any(folder.iterdir()):
        raise BenchError(f"{folder}: not empty; a merge goes to a new folder")
    _check_protocols(runs)
    rows = _union(runs)
    asked: list[Asked] = [one for run in runs for one in run.asked]
    folder.mkdir(parents=True, exist_ok=True)
    if all(run.asked for run in runs):
        write_asked(folder, asked)
    replace_file(folder / ROWS, lines(rows))
    return len(rows)


def _check_protocols(runs: Sequence[Record]) -> None:
    faults = []
    for name, values in _protocol(runs).items():
        if len(set(map(str, values.values()))) > 1:
            faults.append(f"{name}: " + ", ".join(f"{value} in {folder}" for folder, value in values.items()))
    if faults:
        raise BenchError("different protocols are not merged: " + "; ".join(faults))


def _protocol(runs: Sequence[Record]) -> dict[str, dict[Path, Any]]:
    """What the protocol consists of, with the value that each run has, where it has one."""
    found: dict[str, dict[Path, Any]] = {}
    for run in runs:
        for name, value in sorted({item for row in run.rows for item in _fields(row)}):
            told = found.setdefault(name, {})
            told[run.folder] = f"{told[run.folder]} and {value}" if run.folder in told else value
    return found


def _fields(row: Row) -> list[tuple[str, str]]:
    """What a row says of its protocol."""
    said = {name: row[name] for name in SETTING}
    said[f"sources of {row['solver']}"] = row["fingerprint"]
    if row["outer"] != GLOBAL:
        said["outer"] = row["outer"]
    if row["mode"] == TIMED:
        said |= {"repetitions": row["repetitions"], "cpu of the times": row["cpu"]}
    return [(name, str(value)) for name, value in said.items()]


def _union(runs: Sequence[Record]) -> list[Row]:
    """Every row once; raises `BenchError` when two of one measurement differ in more than clocks."""
    found: dict[Key | None, tuple[Path, Row]] = {}
    for run in runs:
        for row in run.rows:
            folder, before = found.setdefault(Key.of(row), (run.folder, row))
            one, other = but_for_clocks(before), but_for_clocks(row)
            if one != other:
                names = sorted(name for name in one.keys() | other.keys() if one.get(name) != other.get(name))
                raise BenchError(
                    f"{row['problem']} {row['solver']} at {row['accuracy']} ({row['mode']}) is in {folder} and in "
                    f"{run.folder}, and differs in {', '.join(names)}"
                )
    return [row for _, row in found.values()]
