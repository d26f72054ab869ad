"""What happened at the visits of a run, contact by contact and sweep by sweep, in bounded memory.

Counts are exact. Of the visits themselves two uniform samples are kept, one of all and one of those whose local solve
failed: each visit replaces a random one once its sample is full [Vitter 1985, algorithm R], the same ones in every
run. The impulses after the last sweeps are kept whole, which shows what cycles.

What a visit calls is compiled into the sweep: calls that pass arrays count references, which takes longer than to
record.

Reference: Vitter, Random sampling with a reservoir, ACM Trans. Math. Software 11, 1985; PROTOCOL level 2.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_inline
from fibercontact.local.contract import Matrix, Status
from fibercontact.problem.cone import Vector

__all__ = [
    "BY_SWEEP", "CURED", "FAILED", "RECENT", "SEEN", "SWEEPS", "SWITCHES", "VISIT", "VisitLog", "check_log",
    "end_sweep", "new_log", "no_log", "recent_impulses", "record", "record_left_out",
    "samples",
]  # fmt: skip

RECENT = 64
"""Last sweeps whose impulses are kept."""

CONVERGED, STATUSES = int(Status.CONVERGED), len(Status)
SWITCHES, LAST_REGIME = STATUSES, STATUSES + 1  # columns of `by_contact` after the statuses
UNSEEN = -1
BY_SWEEP = ("open", "stick", "slip", "failures", "iterations", "switches")
"""Columns of `by_sweep`."""
FAILURES, ITERATIONS, CHANGES = 3, 4, 5
SWEEPS, SEEN, FAILED, RANDOM, CURED = range(5)  # what `state` counts, see VisitLog

VISIT = np.dtype(
    [
        ("sweep", "f8"), ("contact", "f8"), ("status", "f8"), ("iterations", "f8"), ("regime", "f8"),
        ("W", "f8", (3, 3)), ("b", "f8", 3), ("mu", "f8"), ("start", "f8", 3), ("r", "f8", 3),
    ]
)  # fmt: skip
"""A visit of a sample: the local problem as the solver got it, the impulse it started from and its answer."""
WIDTH = VISIT.itemsize // 8
Head = tuple[float, float, float, float, float]

PRIME, SEED = 2**31 - 1, 19_850_301


class VisitLog(NamedTuple):
    """Filled in place by the sweeps; without contacts it records nothing."""

    by_sweep: NDArray[np.int64]  # (sweeps, 6), see BY_SWEEP
    size: NDArray[np.float64]  # (sweeps,) root mean square of sigma_i r_i after each sweep, m/s
    by_contact: NDArray[np.int64]  # (n, statuses + 2): visits by status, changes of regime, last regime
    visits: NDArray[np.float64]  # (capacity, WIDTH), rows of VISIT
    failures: NDArray[np.float64]  # (capacity, WIDTH)
    recent: NDArray[np.float64]  # (RECENT, 3n) impulses after sweep k, from 0, in row k % RECENT
    # (5,): sweeps done, visits and failures seen, random number, sweeps when the proximal term came in force
    state: NDArray[np.int64]


def new_log(contacts: int, sweeps: int, capacity: int) -> VisitLog:
    """An empty log for a run of at most `sweeps` sweeps; each sample holds up to `capacity` visits."""
    by_contact = np.zeros((contacts, STATUSES + 2), dtype=np.int64)
    by_contact[:, LAST_REGIME] = UNSEEN
    return VisitLog(
        np.zeros((sweeps, len(BY_SWEEP)), dtype=np.int64),
        np.zeros(sweeps),
        by_contact,
        np.zeros((capacity, WIDTH)),
        np.zeros((capacity, WIDTH)),
        np.zeros((RECENT, 3 * contacts)),
        np.array([0, 0, 0, SEED, 0]),
    )


def no_log() -> VisitLog:
    """The log of a run that is not recorded."""
    return new_log(0, 0, 0)


def check_log(log: VisitLog, contacts: int) -> None:
    """Raise `ValueError` unless `log` is an empty one for that many contacts."""
    if len(log.by_contact) != contacts or log.state[SWEEPS]:
        raise ValueError(
            f"the log must be empty and for {contacts} contacts, not {len(log.by_contact)} contacts "
            f"after {log.state[SWEEPS]} sweeps"
        )


def recent_impulses(log: VisitLog) -> NDArray[np.float64]:
    """The impulses after each of the last sweeps, in the order of the run: (sweeps, 3n)."""
    done = int(log.state[SWEEPS])
    return log.recent[np.arange(max(0, done - RECENT), done) % RECENT]


def samples(log: VisitLog) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """The sampled visits, all and failed ones, as arrays of `VISIT`, in the order of the run."""
    found = []
    for rows, seen in ((log.visits, log.state[SEEN]), (log.failures, log.state[FAILED])):
        kept = np.ascontiguousarray(rows[: min(int(seen), len(rows))]).view(VISIT).reshape(-1)
        found.append(kept[np.lexsort((kept["contact"], kept["sweep"]))])
    return found[0], found[1]


@jit_inline
def place(state: NDArray[np.int64], seen: int, capacity: int) -> int:
    """Where in a sample the next visit goes, given how many were seen; -1: nowhere."""
    if seen < capacity:
        return seen
    product = state[RANDOM] * 48271  # [Park & Miller 1988]; what follows is the rest of its division by PRIME
    number = (product & PRIME) + (product >> 31)
    state[RANDOM] = number - PRIME if number >= PRIME else number
    slot = int(state[RANDOM] * (1.0 / PRIME) * (seen + 1))
    return slot if slot < capacity else -1


@jit_inline
def store(rows: NDArray[np.float64], at: int, head: Head, W: Matrix, b: Vector, mu: float, old: Vector,
          new: Vector) -> None:  # fmt: skip
    """Write a visit in the layout of `VISIT`."""
    for k in range(5):
        rows[at, k] = head[k]
    for k in range(3):
        rows[at, 5 + k], rows[at, 8 + k], rows[at, 11 + k] = W[0][k], W[1][k], W[2][k]
        rows[at, 14 + k], rows[at, 18 + k], rows[at, 21 + k] = b[k], old[k], new[k]
    rows[at, 17] = mu


@jit_inline
def record(log: VisitLog, i: int, status: int, iterations: int, regime: int, W: Matrix, b: Vector, mu: float,
           old: Vector, new: Vector) -> None:  # fmt: skip
    """Record the visit of contact i."""
    sweep, last = log.state[SWEEPS], log.by_contact[i, LAST_REGIME]
    failed, switched = status != CONVERGED, last != regime and last != UNSEEN
    log.by_contact[i, status] += 1
    log.by_contact[i, SWITCHES] += switched
    log.by_contact[i, LAST_REGIME] = regime
    if sweep < len(log.by_sweep):
        log.by_sweep[sweep, regime] += 1
        log.by_sweep[sweep, FAILURES] += failed
        log.by_sweep[sweep, ITERATIONS] += iterations
        log.by_sweep[sweep, CHANGES] += switched
    head = (float(sweep), float(i), float(status), float(iterations), float(regime))
    slot = place(log.state, log.state[SEEN], len(log.visits))
    log.state[SEEN] += 1
    if slot >= 0:
        store(log.visits, slot, head, W, b, mu, old, new)
    if failed:
        slot = place(log.state, log.state[FAILED], len(log.failures))
        log.state[FAILED] += 1
        if slot >= 0:
            store(log.failures, slot, head, W, b, mu, old, new)


@jit_inline
def record_left_out(log: VisitLog, regime: int) -> None:
    """Record that a contact stays in its regime without a local solve: it counts in `by_sweep` alone."""
    sweep = log.state[SWEEPS]
    if sweep < len(log.by_sweep):
        log.by_sweep[sweep, regime] += 1


@jit
def end_sweep(log: VisitLog, sigma: NDArray[np.float64], r: NDArray[np.float64]) -> None:
    """Record the impulses after a sweep; the visits that follow belong to the next one."""
    if len(log.by_contact) == 0:
        return
    sweep, total = log.state[SWEEPS], 0.0
    for i in range(len(sigma)):
        for k in range(3 * i, 3 * i + 3):
            log.recent[sweep % RECENT, k] = r[k]
            total += sigma[i] * r[k] * sigma[i] * r[k]
    if sweep < len(log.size):
        log.size[sweep] = math.sqrt(total / len(sigma))
    log.state[SWEEPS] += 1
