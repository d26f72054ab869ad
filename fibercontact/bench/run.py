"""Replay a set of problems through solvers by level 3 of the protocol, one row a measurement."""

import threading
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from fibercontact.bench.crew import share_out
from fibercontact.bench.environment import memory_share, usable_cores
from fibercontact.bench.measurement import Listener, Measurement
from fibercontact.bench.plan import Plan, Unit
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import GLOBAL
from fibercontact.bench.record import write_plan
from fibercontact.bench.rows import RATES, TIMED, Key, Row, RowFile
from fibercontact.bench.visits import log_file
from fibercontact.bench.worker import Setting, Worker
from fibercontact.local.registry import Configured

__all__ = ["VISITS", "Found", "measure_units", "run"]

VISITS = "visits"
"""Folder of the visit logs in a run's folder."""


def run(plan: Plan, rows: RowFile, listener: Listener, cluster: str | None = None) -> list[str]:
    """Measure every row of the plan that is not in the file yet; returns what could not be measured and why.

    `cluster` is the address of a Dask scheduler whose workers measure what is not timed. Raises `BenchError` when
    the folder has another run in it, or the workers cannot load the solvers, `KeyboardInterrupt` after stopping them.
    """
    units = plan.work()
    logs = rows.path.parent / VISITS if plan.visits else None
    faults: list[str] = []
    with rows.appending():
        write_plan(rows.path.parent, plan)
        done = {Key.of(row): row for row in rows.read()}
        missing = [unit for unit in units if unit.key not in done or _lacks_log(unit, done[unit.key], logs)]
        for note in [*rows.notes(), *_strangers(set(done), units, rows.path), *_without_visits(plan)]:
            listener.note(note)
        for mode in (RATES, TIMED):
            problems = list(_by_problem(unit for unit in missing if unit.key.mode == mode))
            if mode == RATES and cluster is not None:
                faults += _on_cluster(plan, problems, rows, listener, cluster)
            else:
                faults += _here(plan, problems, mode, rows, listener, logs)
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


def _here(
    plan: Plan, problems: list[list[Unit]], mode: str, rows: RowFile, listener: Listener, logs: Path | None
) -> list[str]:
    """Measure problems in processes of this machine, one of them, and pinned, where they are timed."""
    jobs = 1 if mode == TIMED else min(plan.jobs, len(problems))
    setting = Setting(
        plan.plugins,
        plan.fingerprints(),
        core=usable_cores()[-1] if mode == TIMED else None,
        memory=plan.memory or memory_share(max(1, jobs)),
    )
    first: Mapping[Key, Row] = {key: row for row in rows.read() if (key := Key.of(row)) is not None}
    faults: list[str] = []
    writing = threading.Lock()

    def record(unit: Unit, row: Row) -> None:
        with writing:
            rows.append(row)
            listener.row(unit, row)

    def measure(worker: Worker, units: list[Unit]) -> None:
        faults.extend(Measurement(worker, units, units[0].entry.file, record, listener, first, logs).run())

    share_out(problems, [Worker(setting) for _ in range(jobs)], measure)
    return faults


class Found(NamedTuple):
    """What measuring a problem elsewhere gives."""

    rows: list[tuple[Unit, Row]]
    faults: list[str]
    notes: list[str]


def measure_units(worker: Worker, file: Path, units: list[Unit]) -> Found:
    """Measure a problem whose file is another one here; what is told of it names the file that it is of."""
    found = Found([], [], [])

    def at_home(text: str) -> str:
        return text.replace(str(file), str(units[0].entry.file))

    def record(unit: Unit, row: Row) -> None:
        found.rows.append((unit, row))

    faults = Measurement(worker, units, file, record, _Notes(found.notes), {}, None).run()
    return found._replace(faults=list(map(at_home, faults)), notes=list(map(at_home, found.notes)))


class _Notes:
    """Listens to nothing but notes."""

    def __init__(self, notes: list[str]) -> None:
        self._notes = notes

    def now(self, problem: str, solver: str) -> None:
        pass

    def row(self, unit: Unit, row: Row) -> None:
        pass

    def note(self, text: str) -> None:
        self._notes.append(text)


def _on_cluster(
    plan: Plan, problems: list[list[Unit]], rows: RowFile, listener: Listener, address: str
) -> list[str]:
    """Measure problems on a cluster; their rows are written here, a problem's at a time."""
    from fibercontact.bench.cluster import Cluster

    faults: list[str] = []

    def take(entry: Entry, found: Found) -> None:
        listener.now(entry.name, "on the cluster")
        for unit, row in found.rows:
            rows.append(row)
            listener.row(unit, row)
        for note in found.notes:
            listener.note(note)
        faults.extend(found.faults)

    parcels = {units[0].entry: units for units in problems}
    setting = Setting(plan.plugins, plan.fingerprints(), memory=plan.memory)
    with Cluster(address, setting, listener.note) as cluster:
        return cluster.share_out(parcels, measure_units, take) + faults
