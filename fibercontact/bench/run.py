"""Replay a set of problems through solvers by level 3 of the protocol, one row a measurement."""

import math
import queue
import statistics
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import fibercontact
from fibercontact.bench.environment import cpu_model, load, one_thread, usable_cores, versions
from fibercontact.bench.passes import LogOrder, Pass, options_text
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import ACCURACIES, GLOBAL, PROTOCOL, Limits
from fibercontact.bench.rows import RATES, TIMED, Key, Row, RowFile
from fibercontact.bench.visits import about, log_file
from fibercontact.bench.worker import Crashed, Ended, Hung, Refused, Worker
from fibercontact.global_methods.registry import AnyConfigured
from fibercontact.jit import content_key
from fibercontact.local.registry import Configured

__all__ = ["Listener", "Plan", "Unit", "run", "single"]

VISITS = "visits"
"""Folder of the visit logs in a run's folder."""
GRACE_SECONDS = 5.0
"""Beyond its own time limit a solver is taken to hang, and killed."""


class Listener(Protocol):
    """Who wants to know how a run goes."""

    def now(self, problem: str, solver: str) -> None:
        """A pass begins."""

    def row(self, unit: "Unit", row: Row) -> None:
        """A row was written."""

    def note(self, text: str) -> None:
        """Something is worth a line."""


@dataclass(frozen=True)
class Unit:
    """One row to be measured."""

    entry: Entry
    key: Key
    facets: int

    def about(self) -> dict[str, Any]:
        """What a visit log says of its run before it is made."""
        return about(self.entry, self.key, self.facets, ACCURACIES[self.key.accuracy])


@dataclass(frozen=True)
class Plan:
    """What a run is asked to do; `visits` asks for a visit log of every pass of sweeps that is not timed."""

    entries: Sequence[Entry]
    solvers: Sequence[AnyConfigured]
    timed: Sequence[str]
    rates: Sequence[str] = ()
    start: str = "cold"
    outer: str = "plain"
    repetitions: int = 3
    jobs: int = 1
    limits: Limits = field(default_factory=Limits)
    plugins: Sequence[Path] = ()
    visits: bool = False

    def units(self) -> list[Unit]:
        """The rows that were asked for: the timed accuracies first, problem by problem."""
        return self._units(TIMED, self.timed) + self._units(RATES, self.rates)

    def work(self) -> list[Unit]:
        """All rows to be measured: a timed row needs the row of its pass that is not timed."""
        return self._units(RATES, [*self.timed, *self.rates]) + self._units(TIMED, self.timed)

    def _units(self, mode: str, accuracies: Sequence[str]) -> list[Unit]:
        return [
            Unit(entry, self._key(entry, solver, accuracy, mode), solver.facets)
            for entry in self.entries
            for accuracy in accuracies
            for solver in self.solvers
        ]

    def _key(self, entry: Entry, solver: AnyConfigured, accuracy: str, mode: str) -> Key:
        return Key(
            problem_hash=entry.hash,
            solver=solver.label,
            fingerprint=solver.registered.fingerprint,
            options=options_text(solver),
            accuracy=accuracy,
            start=self.start,
            outer=self.outer if isinstance(solver, Configured) else GLOBAL,
            mode=mode,
            repetitions=self.repetitions if mode == TIMED else 0,
            max_sweeps=self.limits.sweeps,
            max_seconds=self.limits.seconds,
            protocol=PROTOCOL,
            code=_code(),
            cpu=cpu_model(),
        )

    def fingerprints(self) -> dict[str, str]:
        """The sources of the solvers."""
        return {solver.label: solver.registered.fingerprint for solver in self.solvers}


def single(entry: Entry, solver: Configured, accuracy: str, start: str, outer: str, limits: Limits) -> Unit:
    """The row of one solver on one problem, as a table's run would have it."""
    return Plan([entry], [solver], (), (accuracy,), start, outer, limits=limits).work()[0]


def _code() -> str:
    """Key of the sources that decide the numbers, the local solvers aside."""
    package = Path(fibercontact.__file__).parent
    rooms = [file for room in ("problem", "gauss_seidel") for file in (package / room).rglob("*.py")]
    return content_key([package / "jit.py", package / "bench" / "passes.py", *rooms])


def run(plan: Plan, rows: RowFile, listener: Listener) -> list[str]:
    """Measure every row of the plan that is not in the file yet; returns what could not be measured and why.

    Raises `BenchError` when the workers cannot load the solvers, `KeyboardInterrupt` after stopping them.
    """
    done = {Key.of(row): row for row in rows.read()}
    units = plan.work()
    logs = rows.path.parent / VISITS if plan.visits else None
    missing = [unit for unit in units if unit.key not in done or _lacks_log(unit, done[unit.key], logs)]
    for note in [*rows.notes, *_strangers(set(done), units, rows.path), *_without_visits(plan)]:
        listener.note(note)
    faults: list[str] = []
    with one_thread(), rows.appending():
        for mode, jobs in ((RATES, plan.jobs), (TIMED, 1)):
            problems = list(_by_problem(unit for unit in missing if unit.key.mode == mode))
            first = {key: row for row in rows.read() if (key := Key.of(row)) is not None}
            faults += _measure(plan, problems, min(jobs, len(problems)), mode, rows, listener, first, logs)
    return list(dict.fromkeys(faults))


def _lacks_log(unit: Unit, row: Row, logs: Path | None) -> bool:
    """Whether a row that is there came of a pass whose log is asked for and not there."""
    if logs is None or unit.key.mode == TIMED or unit.key.outer == GLOBAL:
        return False
    if "outcome" not in row:  # killed or crashed: nothing to log
        return False
    return not log_file(logs, unit.entry, unit.key).is_file()


def _strangers(done: set[Key | None], units: list[Unit], path: Path) -> Iterator[str]:
    """A note on rows that were measured by another protocol, other code or another machine."""
    ours = {(unit.key.protocol, unit.key.code, unit.key.cpu) for unit in units}
    others = sum(key is None or (key.protocol, key.code, key.cpu) not in ours for key in done)
    if others:
        yield f"{path}: {others} row(s) of another protocol, other code or another machine are left aside"


def _without_visits(plan: Plan) -> Iterator[str]:
    """A note on the solvers that have no visits to log."""
    methods = [solver.label for solver in plan.solvers if not isinstance(solver, Configured)]
    if plan.visits and methods:
        yield f"no visits to log, for there are no sweeps: {', '.join(methods)}"


def _by_problem(units: Iterable[Unit]) -> Iterator[list[Unit]]:
    """Units of the same problem together, in order."""
    groups: dict[Path, list[Unit]] = {}
    for unit in units:
        groups.setdefault(unit.entry.file, []).append(unit)
    yield from groups.values()


def _measure(
    plan: Plan,
    problems: list[list[Unit]],
    jobs: int,
    mode: str,
    rows: RowFile,
    listener: Listener,
    first: Mapping[Key, Row],
    logs: Path | None,
) -> list[str]:
    """Measure problems with `jobs` workers at once; a timed run pins its only one, and finds `first` passes."""
    todo: queue.SimpleQueue[list[Unit]] = queue.SimpleQueue()
    for units in problems:
        todo.put(units)
    core = usable_cores()[-1] if mode == TIMED else None
    crew = [Worker(plan.plugins, plan.fingerprints(), core) for _ in range(jobs)]
    faults: list[str] = []
    errors: list[BaseException] = []
    writing = threading.Lock()

    def record(unit: Unit, row: Row) -> None:
        with writing:
            rows.append(row)
            listener.row(unit, row)

    def serve(worker: Worker) -> None:
        try:
            while not errors:
                faults.extend(_Measurement(worker, todo.get_nowait(), record, listener, first, logs).run())
        except (queue.Empty, Ended):
            pass
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=serve, args=(worker,)) for worker in crew]
    try:
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads) and not errors:
            time.sleep(0.05)
    finally:
        for worker in crew:
            worker.end()
        for thread in threads:
            thread.join()
        for worker in crew:
            worker.end()  # a process that was being started meanwhile
    if errors:
        raise errors[0]
    return faults


class _Measurement:
    """All passes of a run over one problem."""

    def __init__(
        self,
        worker: Worker,
        units: list[Unit],
        record: Callable[[Unit, Row], None],
        listener: Listener,
        first: Mapping[Key, Row],
        logs: Path | None,
    ) -> None:
        self.first, self.logs = first, logs
        self.faults: list[str] = []
        self.worker, self.units, self.record, self.listener = worker, units, record, listener
        self.file, self.start = units[0].entry.file, units[0].key.start
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
        self.common = sizes | {"load": load_before, "threads": 1} | dict(versions())
        timed = [(unit, first) for unit in self.units if (first := self._first(unit)) is not None]
        self._time(timed)
        return self.faults

    def _first(self, unit: Unit) -> Row | None:
        """The pass that is not timed; returned when timed ones are to follow, recorded when not."""
        if unit.key.mode == TIMED:
            first = dict(self.first[replace(unit.key, mode=RATES, repetitions=0)])
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
        try:
            found = self.worker.solve(self.file, self.start, task, key.max_seconds + GRACE_SECONDS)
        except Hung as fault:
            return _lost("time", fault)
        except (Crashed, Refused) as fault:
            return _lost("crash", fault)
        if fault_of_log := found.pop("log_fault", ""):
            self.faults.append(fault_of_log)
        return found

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
        }
        stamp = {"stamp": datetime.now(UTC).isoformat(timespec="seconds")}
        self.record(unit, outcome | unit.key.fields() | identity | self.common | times | stamp)


def _lost(reason: str, fault: Exception) -> Row:
    """The outcome of a pass that did not come back."""
    verdict = {"claimed": False, "solved": False, "false_success": False}
    return verdict | {"reason": reason, "detail": str(fault)}


def _only_verdict(timed: Row) -> Row:
    """What a failed timed pass changes: solved means solved every time."""
    names = ("claimed", "solved", "false_success", "reason")
    return {name: timed[name] for name in names} | {"detail": f"a timed pass: {timed['detail']}".rstrip(": ")}
