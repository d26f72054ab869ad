"""Level 1 of the protocol: one-contact problems, each solved once by each local solver, in batches.

A batch is the contacts of one kind (`KINDS`). The first replay of a batch is not timed and gives the answers, which
are judged here; the timed ones follow, the solvers taking turns. A replay that hangs or crashes fails on its whole
batch.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from fibercontact.bench import contact_desk
from fibercontact.bench.contact_verdict import judge, velocities
from fibercontact.bench.environment import load, usable_cores
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.worker import Crashed, Hung, Refused, Setting, Worker
from fibercontact.local.contract import Status
from fibercontact.local.one_contact import OneContacts, Replay, write
from fibercontact.local.registry import Configured

__all__ = ["KINDS", "Measured", "Plan", "batches", "measure"]

KINDS = ("uniform", "hard", "known")
"""Kinds of contacts: what stands before the colon of a family; any other kind is a batch of its own after these."""

NOTHING = Replay(np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64), 0.0)


@dataclass(frozen=True)
class Plan:
    """What is asked: the contacts, the solvers, how often to time them and how long a replay may take."""

    contacts: OneContacts
    solvers: Sequence[Configured]
    plugins: Sequence[Path] = ()
    repetitions: int = 5
    seconds: float = 60.0

    @property
    def replays(self) -> int:
        """How many replays there are at most."""
        return len(batches(self.contacts)) * len(self.solvers) * (1 + self.repetitions)


@dataclass(frozen=True)
class Measured:
    """What came out: answers, a row a contact and solver; times, a row a timed replay, in ns a contact.

    `load` is the number of other processes that ran when it began.
    """

    answers: pd.DataFrame
    times: pd.DataFrame
    load: float


def batches(contacts: OneContacts) -> dict[str, OneContacts]:
    """The contacts by kind."""
    kinds = np.array([family.partition(":")[0] for family in contacts.family])
    order = [*KINDS, *sorted(set(kinds) - set(KINDS))]
    return {kind: contacts.select(kinds == kind) for kind in order if (kinds == kind).any()}


def measure(plan: Plan, listener: Callable[[str], None]) -> Measured:
    """Replay every batch through every solver; the listener hears what begins.

    Raises `BenchError` when there is no contact, or the worker cannot load the solvers.
    """
    if plan.contacts.m == 0:
        raise BenchError("there is no contact in the set")
    answers: list[pd.DataFrame] = []
    times: list[tuple[str, str, float]] = []
    before = load()
    with _worker(plan) as worker, tempfile.TemporaryDirectory() as folder:
        for kind, contacts in batches(plan.contacts).items():
            path = Path(folder, f"{len(answers)}.h5")
            write(path, contacts)
            lost: dict[str, str] = {}
            for repetition in range(1 + plan.repetitions):
                for solver in plan.solvers:
                    listener(f"{kind} {solver.label}")
                    replay = _replay(worker, path, solver, plan.seconds, lost)
                    if repetition == 0:
                        answers.append(_answers(kind, contacts, solver, replay, lost.get(solver.label, "")))
                    elif solver.label not in lost:
                        times.append((kind, solver.label, 1e9 * replay.seconds / contacts.m))
    frame = pd.DataFrame(times, columns=["kind", "solver", "ns"])
    return Measured(pd.concat(answers, ignore_index=True), frame, before)


@contextmanager
def _worker(plan: Plan) -> Iterator[Worker]:
    """A worker on one core."""
    fingerprints = {solver.label: solver.registered.fingerprint for solver in plan.solvers}
    worker = Worker(Setting(plan.plugins, fingerprints, contact_desk.__name__, usable_cores()[-1]))
    try:
        yield worker
    finally:
        worker.end()


def _replay(worker: Worker, path: Path, solver: Configured, seconds: float, lost: dict[str, str]) -> Replay:
    """A replay in the worker; one that does not come back is `lost`, with its reason, and not tried again."""
    if solver.label in lost:
        return NOTHING
    try:
        return worker.ask("replay", (path, solver.label), seconds)
    except Hung:
        lost[solver.label] = "time"
    except (Crashed, Refused):
        lost[solver.label] = "crash"
    return NOTHING


def _answers(kind: str, contacts: OneContacts, solver: Configured, replay: Replay, lost: str) -> pd.DataFrame:
    """Rows of one solver on one batch."""
    frame = pd.DataFrame(
        {
            "kind": kind,
            "family": contacts.family,
            "condition": contacts.condition,
            "mu": contacts.mu,
            "solver": solver.label,
            "facets": solver.facets,
        }
    )
    if lost:
        return frame.assign(reason=lost, claimed=False)
    verdict = judge(contacts, replay, solver.facets)
    with np.errstate(all="ignore"):  # answers that failed may be anything
        error = np.linalg.norm(velocities(contacts, replay.r - contacts.answer), axis=1)
    return frame.assign(
        reason=verdict.reasons,
        claimed=replay.status == int(Status.CONVERGED),
        residual=verdict.residual,
        coulomb=verdict.coulomb,
        velocity_error=error,
        iterations=replay.iterations,
    )
