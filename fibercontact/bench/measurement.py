"""All passes of a run over one problem, in a worker process: rows, whatever the solvers do."""

import math
import re
import statistics
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from fibercontact.bench.environment import cpu_model, load, versions
from fibercontact.bench.passes import LogOrder, Pass
from fibercontact.bench.plan import Unit
from fibercontact.bench.protocol import ACCURACIES, GLOBAL
from fibercontact.bench.rows import RATES, TIMED, Key, Row
from fibercontact.bench.visits import log_file
from fibercontact.bench.worker import Crashed, Hung, Refused, Worker

__all__ = ["Listener", "Measurement"]

GRACE_SECONDS = 5.0
"""Beyond its own time limit a solver is taken to hang, and killed."""


class Listener(Protocol):
    """Who wants to know how a run goes."""

    def now(self, problem: str, solver: str) -> None:
        """A pass begins."""

    def row(self, unit: Unit, row: Row) -> None:
        """A row was written."""

    def note(self, text: str) -> None:
        """Something is worth a line."""


class Measurement:
    """All passes of a run over one problem, whose file `file` is."""

    def __init__(
        self,
        worker: Worker,
        units: list[Unit],
        file: Path,
        record: Callable[[Unit, Row], None],
        listener: Listener,
        first: Mapping[Key, Row],
        logs: Path | None,
    ) -> None:
        self.first, self.logs = first, logs
        self.faults: list[str] = []
        self.worker, self.units, self.record, self.listener = worker, units, record, listener
        self.file, self.start = file, units[0].key.start
        self.common: Row = {}

    def run(self) -> list[str]:
        """Measure and record; returns what went wrong: a problem or a log that cannot be read or written."""
        load_before = load()
        try:
            sizes = self.worker.load(self.file, self.start)
        except (Hung, Crashed, Refused) as fault:
            text = str(fault)
            return [text if text.startswith(str(self.file)) else f"{self.file}: {text}"]
        if sizes["warning"]:
            self.listener.note(f"warning: {self.file}: {sizes['warning']}")
        machine = {"cpu": cpu_model(), "memory_limit": self.worker.setting.memory}
        self.common = sizes | {"load": load_before, "threads": 1} | machine | dict(versions())
        timed = [(unit, first) for unit in self.units if (first := self._first(unit)) is not None]
        self._time(timed)
        return self.faults

    def _first(self, unit: Unit) -> Row | None:
        """The pass that is not timed; returned when timed ones are to follow, recorded when not."""
        if unit.key.mode == TIMED:
            first = dict(self.first[replace(unit.key, mode=RATES, repetitions=0, cpu="")])
            if first["solved"]:
                return first
        else:
            first = self._pass(unit, timed=False)
        if unit.key not in self.first:  # else it was the row's log that was missing
            self._write(unit, first, [])
        return None

    def _time(self, solved: list[tuple[Unit, Row]]) -> None:
        """Timed passes, the solvers taking turns."""
        seconds: dict[Key, list[float]] = {unit.key: [] for unit, _ in solved}
        for _ in range(max((unit.key.repetitions for unit, _ in solved), default=0)):
            for unit, first in solved:
                if first["solved"]:
                    again = self._pass(unit, timed=True)
                    seconds[unit.key].append(again.get("seconds", math.nan))
                    first.update({} if again["solved"] else _only_verdict(again))
        for unit, first in solved:
            self._write(unit, first, seconds[unit.key] if first["solved"] else [])

    def _pass(self, unit: Unit, timed: bool) -> Row:
        key = unit.key
        self.listener.now(unit.entry.name, key.solver)
        order = None
        if self.logs is not None and not timed and key.outer != GLOBAL:
            order = LogOrder(log_file(self.logs, unit.entry, key), unit.about())
        task = Pass(key.solver, key.accuracy, key.outer, key.limits, timed, order)
        for _ in range(2):  # what others left in the process is no fault of this solver's
            found = self._outcome(task)
            if found["reason"] != "memory":
                break
            self.worker.renew()
        if fault_of_log := found.pop("log_fault", ""):
            self.faults.append(fault_of_log)
        return found

    def _outcome(self, task: Pass) -> Row:
        """What a pass leaves in its row, even if it does not come back."""
        try:
            return self.worker.solve(self.file, self.start, task, task.limits.seconds + GRACE_SECONDS)
        except Hung as fault:
            return _lost("time", fault)
        except (Crashed, Refused) as fault:
            return _lost("memory" if _ran_out_of_memory(str(fault)) else "crash", fault)

    def _write(self, unit: Unit, outcome: Row, seconds: list[float]) -> None:
        outcome = {name: value for name, value in outcome.items() if name != "seconds"}
        identity = {
            "problem": unit.entry.name,
            "scene": unit.entry.scene,
            "existence": unit.entry.existence,
            "law_facets": unit.facets,
            "tolerance": ACCURACIES[unit.key.accuracy],
        }
        times = {
            "time_best": min(seconds, default=None),
            "time_median": statistics.median(seconds) if seconds else None,
            "times": seconds or None,
        }
        stamp = {"stamp": datetime.now(UTC).isoformat(timespec="seconds")}
        self.record(unit, outcome | unit.key.fields() | identity | self.common | times | stamp)


def _ran_out_of_memory(text: str) -> bool:
    """Whether an allocation failed, by Python's or numpy's word for it, or that of a peer in C++."""
    return re.search(r"MemoryError|bad_alloc", text) is not None


def _lost(reason: str, fault: Exception) -> Row:
    """The outcome of a pass that did not come back."""
    verdict = {"claimed": False, "solved": False, "false_success": False}
    return verdict | {"reason": reason, "detail": str(fault)}


def _only_verdict(timed: Row) -> Row:
    """What a failed timed pass changes: solved means solved every time."""
    names = ("claimed", "solved", "false_success", "reason")
    return {name: timed[name] for name in names} | {"detail": f"a timed pass: {timed['detail']}".rstrip(": ")}
