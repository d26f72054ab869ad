"""Rows of a run: what identifies one, and the file that they are appended to as they come."""

import json
import math
import os
import platform
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from fibercontact.bench.protocol import BenchError, Limits
from fibercontact.files import naming

__all__ = [
    "CLOCKS",
    "RATES",
    "ROWS",
    "SETTING",
    "TIMED",
    "Key",
    "Row",
    "RowFile",
    "but_for_clocks",
    "lines",
    "move_away",
    "writer",
]

Row = dict[str, Any]

TIMED, RATES = "timed", "rates"

ROWS, LOCK = "rows.jsonl", "run.lock"
"""Files of a run's folder: its rows, and what keeps a second run out of it."""

ASKED_SECONDS = 0.05
"""After which nobody who asks whether a run goes on holds its lock any more."""

SETTING = ("protocol", "code", "start", "max_sweeps", "max_seconds")
"""What all rows of one table have in common, beside the outer loop, a solver's sources, and how times were taken."""

CLOCKS = ("time_best", "time_median", "times", "setup_seconds", "load", "stamp", "cpu", "memory_limit")
"""What may differ between two rows of the same measurement: clocks, and the machine that they were on."""


@dataclass(frozen=True)
class Key:
    """What a row is about. Two rows with the same key are one measurement made twice.

    `code` stands for the sources of the package that decide the numbers, `fingerprint` for those of the local
    solver. `cpu` keeps the times of two machines apart; it is empty where nothing is timed, for what is measured
    then is the same on any machine.
    """

    problem_hash: str
    solver: str
    fingerprint: str
    options: str
    accuracy: str
    start: str
    outer: str
    mode: str
    repetitions: int
    max_sweeps: int
    max_seconds: float
    protocol: int
    code: str
    cpu: str

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> "Key | None":
        """The key of a row, None when the row is of another shape."""
        given: Row = {name: row.get(name) for name in cls.__dataclass_fields__}
        if not all(isinstance(value, str | int | float) for value in given.values()):
            return None
        return cls(**given if row["mode"] == TIMED else given | {"cpu": ""})

    @property
    def limits(self) -> Limits:
        """What the solver may spend."""
        return Limits(self.max_sweeps, self.max_seconds)

    def fields(self) -> Row:
        """The key's part of a row."""
        return asdict(self)


class RowFile:
    """The rows of a run folder, one JSON object a line, each on disk before the next is measured.

    A process that is killed while it writes leaves a line that is not whole, and nothing else amiss.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / ROWS
        self._stream: BinaryIO | None = None

    def read(self) -> list[Row]:
        """The rows that are there; lines that are not whole are left out."""
        return self._read()[0]

    def notes(self) -> list[str]:
        """What must be said of the file: how many lines are not whole."""
        torn = self._read()[1]
        return [f"{self.path}: {torn} torn line(s) left out, to be measured again"] if torn else []

    def _read(self) -> tuple[list[Row], int]:
        if not self.path.is_file():
            return [], 0
        found = [_parsed(line) for line in self.path.read_bytes().splitlines() if line.strip()]
        rows = [row for row in found if row is not None]
        return rows, len(found) - len(rows)

    @contextmanager
    def appending(self) -> Iterator[None]:
        """Open for `append`; raises `BenchError` while another run has the folder."""
        folder = self.path.parent
        folder.mkdir(parents=True, exist_ok=True)
        with naming(self.path), _locked(folder), self.path.open("ab") as stream:
            if not _ends_with_newline(self.path):
                stream.write(b"\n")  # a torn line stays a line of its own
            self._stream = stream
            try:
                yield
            finally:
                self._stream = None

    def append(self, row: Row) -> None:
        """Write one row and make sure that it is on the disk."""
        assert self._stream is not None, "append outside of appending()"
        self._stream.write(lines([row]))
        self._stream.flush()
        os.fsync(self._stream.fileno())


def lines(rows: Iterable[Row]) -> bytes:
    """Rows as a file of rows has them."""
    texts = (json.dumps({name: _plain(value) for name, value in row.items()}) for row in rows)
    return "".join(f"{text}\n" for text in texts).encode()


def but_for_clocks(row: Row) -> Row:
    """The part of a row that is the same whenever and wherever it is measured."""
    return {name: value for name, value in row.items() if name not in CLOCKS}


def _parsed(line: bytes) -> Row | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def _plain(value: Any) -> Any:
    """JSON has no infinities: what is not finite is left empty."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as stream:
        if stream.seek(0, os.SEEK_END) == 0:
            return True
        stream.seek(-1, os.SEEK_END)
        return stream.read(1) == b"\n"


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder until this one ends, however it ends; raises `BenchError` when one is there.

    The system takes the lock off a process that dies. What the file says is for the refusal alone.
    """
    with (folder / LOCK).open("a+", encoding="utf-8") as stream:
        if not _lock(stream.fileno()):
            stream.seek(0)
            raise BenchError(f"{folder}: another run is writing to it ({stream.read().strip()})")
        stream.truncate(0)
        stream.write(f"process {os.getpid()} on {platform.node()}\n")
        stream.flush()
        yield


def writer(folder: Path) -> str:
    """The process that is writing to a run's folder now, empty when none is."""
    try:
        with (folder / LOCK).open(encoding="utf-8") as stream:
            return "" if _lock(stream.fileno(), shared=True) else stream.read().strip()
    except FileNotFoundError:
        return ""


def _lock(descriptor: int, shared: bool = False) -> bool:
    """Whether the lock on an open file is ours now: alone, or with others who only ask."""
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing to lock with
        return True
    how = fcntl.LOCK_SH if shared else fcntl.LOCK_EX
    for left in (True, False):
        try:
            fcntl.flock(descriptor, how | fcntl.LOCK_NB)
        except OSError:
            time.sleep(ASKED_SECONDS * left)  # somebody may only have asked
        else:
            return True
    return False


def move_away(folder: Path) -> Path | None:
    """Rename a run folder to the first free `FOLDER.1`, `FOLDER.2`, …; None when there is nothing to move.

    Raises `BenchError` while a run is writing to it.
    """
    if not folder.exists():
        return None
    number = 1
    while (target := folder.with_name(f"{folder.name}.{number}")).exists():
        number += 1
    with _locked(folder):
        return folder.rename(target)
