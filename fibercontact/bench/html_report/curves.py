"""How each solver converges on a problem.

Rows hold no histories, so a problem is solved once more, in a worker process and off the clock, by the solvers that
are here.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fibercontact.bench.environment import one_thread
from fibercontact.bench.html_report.figures import Curve
from fibercontact.bench.html_report.runs import RunRead
from fibercontact.bench.measurement import GRACE_SECONDS
from fibercontact.bench.passes import LogOrder, Pass
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import GLOBAL, Limits
from fibercontact.bench.rows import Key, Row
from fibercontact.bench.visits import MOST_SWEEPS, about, read_log
from fibercontact.bench.worker import Crashed, Hung, Refused, Setting, Worker
from fibercontact.errors import UserError
from fibercontact.peers.registry import configure, registered

__all__ = ["CURVE_SECONDS", "Again", "solving_again"]

CURVE_SECONDS = 5.0
"""What a curve may take, if the run's own limit is not shorter."""
POINTS = 150
"""Of a curve, about: evenly spaced along the logarithm of the sweeps."""


@dataclass(frozen=True)
class Again:
    """The solvers of a run that sweep and are here, in a worker, and a remark on each of the others."""

    solvers: Sequence[str]
    remarks: Sequence[str]
    worker: Worker
    scratch: Path

    def curve(self, entry: Entry, row: Row) -> tuple[Curve | None, list[str]]:
        """The history of a solve of the row's kind, if there is one, and what must be said of it."""
        label, limits = row["solver"], _limits(row)
        key = Key(**{name: row[name] for name in Key.__dataclass_fields__})
        said = about(entry, key, int(row["law_facets"]), float(row["tolerance"]))
        order = LogOrder(self.scratch / "log.hdf5", said)
        task = Pass(label, row["accuracy"], row["outer"], limits, False, order)
        try:
            again = self.worker.solve(entry.file, row["start"], task, limits.seconds + GRACE_SECONDS)
        except (Hung, Crashed, Refused) as fault:
            return None, [f"{label}: no curve: {fault}"]
        if fault_of_log := again.get("log_fault"):
            return None, [f"{label}: no curve: {fault_of_log}"]
        record = read_log(order.file)
        keep = _thinned(record.sweeps)
        curve = Curve(label, record.sweeps[keep].tolist(), record.residual[keep].tolist())
        return curve, list(_differences(row, again))


@contextmanager
def solving_again(run: RunRead, plugins: Sequence[Path]) -> Iterator[Again]:
    """A worker with the solvers of a run, on one thread, ended afterwards."""
    known, remarks, fingerprints = registered(plugins), [], {}
    changed = []
    for label in run.solvers:
        row = run.rows[run.rows["solver"] == label].iloc[0]
        if row["outer"] == GLOBAL:
            remarks.append(f"{label}: no curve, for it does not sweep")
            continue
        try:
            fingerprints[label] = configure(label, known).registered.fingerprint
        except UserError as fault:
            remarks.append(f"{label}: no curve: {fault}")
            continue
        if fingerprints[label] != row["fingerprint"]:
            changed.append(label)
    if changed:
        remarks.append(f"solved here by other sources than the run's: {', '.join(changed)}")
    worker = Worker(Setting(plugins, fingerprints))
    with one_thread(), tempfile.TemporaryDirectory() as scratch:
        try:
            yield Again(list(fingerprints), remarks, worker, Path(scratch))
        finally:
            worker.end()


def _limits(row: Row) -> Limits:
    return Limits(min(int(row["max_sweeps"]), MOST_SWEEPS), min(float(row["max_seconds"]), CURVE_SECONDS))


def _differences(row: Row, again: Mapping[str, Any]) -> Iterator[str]:
    """Where the solve did not go as the row says."""
    if again["outcome"] == "time" and row["reason"] != "time":
        yield f"{row['solver']}: its curve ends after {CURVE_SECONDS:g} s"
    elif bool(row["solved"]) != again["solved"] or row["sweeps"] != again["sweeps"]:
        yield f"{row['solver']}: {_ending(row)} in the run, {_ending(again)} here"


def _ending(said: Mapping[str, Any]) -> str:
    ending = "solved" if said["solved"] else said["reason"]
    return f"{ending} after {said['sweeps']:.0f} sweeps" if np.isfinite(said["sweeps"]) else ending


def _thinned(sweeps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows to keep, the first and the last among them."""
    if len(sweeps) <= POINTS:
        return np.arange(len(sweeps))
    return np.unique(np.round(np.geomspace(1.0, len(sweeps), POINTS)).astype(np.int64)) - 1
