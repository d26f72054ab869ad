"""Live progress of a run: a bar on a terminal, a line now and then elsewhere."""

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from fibercontact.bench.measurement import Listener
from fibercontact.bench.plan import Unit
from fibercontact.bench.rows import Key, Row, RowFile

__all__ = ["listening"]

LINE_SECONDS = 10.0


@contextmanager
def listening(units: Sequence[Unit], rows: RowFile) -> Iterator[Listener]:
    """A listener that shows a run; `rows` tells what an earlier run has done already."""
    done = {Key.of(row) for row in rows.read()}
    already = [unit for unit in units if unit.key in done]
    console = Console(stderr=True)
    tally = _Tally(len(units), len(already))
    if not console.is_terminal:
        yield Lines(tally)
        return
    columns = (
        BarColumn(),
        TextColumn("{task.description}", markup=False),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, speed_estimate_period=300.0) as progress:
        yield Bar(progress, units, already, tally)


class _Tally:
    """Counts that both kinds of progress show."""

    def __init__(self, total: int, done: int) -> None:
        self.total, self.done, self.failed = total, done, 0

    def count(self, row: Row) -> None:
        self.done += 1
        self.failed += not row["solved"]

    def __str__(self) -> str:
        return f"{self.done}/{self.total} rows, {self.failed} failures"


class Bar:
    """A bar over the rows, each as long as its problem's file: large problems take longer."""

    def __init__(
        self, progress: Progress, units: Sequence[Unit], already: Sequence[Unit], tally: _Tally
    ) -> None:
        self.progress, self.tally = progress, tally
        total, done = sum(map(_weight, units)), sum(map(_weight, already))
        self.task = progress.add_task(str(tally), total=total, completed=done)

    def now(self, problem: str, solver: str) -> None:
        self.progress.update(self.task, description=f"{self.tally}  {problem} {solver}")

    def row(self, unit: Unit, row: Row) -> None:
        self.tally.count(row)
        self.progress.advance(self.task, _weight(unit))

    def note(self, text: str) -> None:
        self.progress.console.print(text, markup=False, highlight=False)


class Lines:
    """A line every few seconds."""

    def __init__(self, tally: _Tally) -> None:
        self.tally, self.last = tally, time.monotonic()

    def now(self, problem: str, solver: str) -> None:
        if time.monotonic() - self.last > LINE_SECONDS:
            self.last = time.monotonic()
            print(f"{self.tally}  {problem} {solver}", file=sys.stderr, flush=True)

    def row(self, unit: Unit, row: Row) -> None:
        self.tally.count(row)

    def note(self, text: str) -> None:
        print(text, file=sys.stderr, flush=True)


def _weight(unit: Unit) -> int:
    return unit.entry.file.stat().st_size
