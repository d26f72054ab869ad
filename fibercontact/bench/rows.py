"""Rows of a run: what identifies one, and the file that they are appended to as they come."""

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

from fibercontact.bench.protocol import BenchError, Limits

__all__ = ["RATES", "TIMED", "Key", "Row", "RowFile", "move_away"]

Row = dict[str, Any]

TIMED, RATES = "timed", "rates"


@dataclass(frozen=True)
class Key:
    """What a row is about. Two rows with the same key are one measurement made twice.

    `code` stands for the sources of the package that decide the numbers, `fingerprint` for those of the local
    solver; `cpu` keeps the times of two machines apart.
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
        names = cls.__dataclass_fields__
        return cls(**{name: row[name] for name in names}) if all(name in row for name in names) else None

    @property
    def limits(self) -> Limits:
        """What the solver may spend."""
        return Limits(self.max_sweeps, self.max_seconds)

    def fields(self) -> Row:
        """The key's part of a row."""
        return asdict(self)


class RowFile:
    """The rows of a run folder, one JSON object a line, each on disk before the next is measured."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "rows.jsonl"
        self.notes: list[str] = []
        self._stream: TextIO | None = None

    def read(self) -> list[Row]:
        """The rows that are there; a line that is not whole is left out, with a note."""
        if not self.path.is_file():
            return []
        rows, torn = [], 0
        for line in self.path.read_bytes().splitlines():
            row = _parsed(line)
            if row is None:
                torn += 1
            else:
                rows.append(row)
        if torn:
            self.notes.append(f"{self.path}: {torn} torn line(s) left out, to be measured again")
        return rows

    @contextmanager
    def appending(self) -> Iterator[None]:
        """Open for `append`; raises `BenchError` while another process has it open."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("a+", encoding="utf-8") as stream:
            _lock(stream, self.path)
            if not _ends_with_newline(self.path):
                stream.write("\n")  # a torn line stays a line of its own
            self._stream = stream
            try:
                yield
            finally:
                self._stream = None

    def append(self, row: Row) -> None:
        """Write one row and make sure that it is on the disk."""
        assert self._stream is not None, "append outside of appending()"
        self._stream.write(json.dumps({name: _plain(value) for name, value in row.items()}) + "\n")
        self._stream.flush()
        os.fsync(self._stream.fileno())


def _parsed(line: bytes) -> Row | None:
    try:
        row = json.loads(line) if line.strip() else {}
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


def _lock(stream: TextIO, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # not a POSIX system: nothing to lock with
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise BenchError(f"{path}: another run is writing to it") from None


def move_away(folder: Path) -> Path | None:
    """Rename a run folder to the first free `FOLDER.1`, `FOLDER.2`, …; None when there is nothing to move."""
    if not folder.exists():
        return None
    number = 1
    while (target := folder.with_name(f"{folder.name}.{number}")).exists():
        number += 1
    return folder.rename(target)
