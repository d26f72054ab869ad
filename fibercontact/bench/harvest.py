"""The one-contact set: local problems taken from inside Gauss–Seidel runs, and the synthetic hard set beside them.

Each problem of a set is run by plain sweeps with each of `RUNNERS`, to 1e-4 or for at most `SWEEPS` sweeps; PAC's
iterates wander where others do not come. Of each run up to `LOOKED_AT` visits are looked at, all of them or a uniform
sample: each is replayed through every solver. Kept are

* `uniform: RUNNER`, the same number of visits of each run, drawn at random: a run that does not end does not outweigh
  the others;
* `hard: SOLVER REASON`, visits on which a solver failed, or was `slow` (more than `SLOW` iterations), and
  `hard: answers differ`, on which two solvers of Coulomb's law are right and their velocities differ. A visit with
  several reasons belongs to the one that is rarest in its run. At most `KEPT` of a run and reason are kept, drawn at
  random;
* `known: FAMILY`, the synthetic hard set.

How many visits there were, were looked at, and had each reason is counted without any cap.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fibercontact.bench.contact_verdict import judge, reason_of, velocities
from fibercontact.bench.passes import lay_out
from fibercontact.bench.problem_set import Entry
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.gauss_seidel.visit_log import new_log, samples
from fibercontact.local.hard_set import hard_set
from fibercontact.local.one_contact import OneContacts, replay
from fibercontact.local.registry import Configured, configure, registered
from fibercontact.problem.cone import COULOMB
from fibercontact.problem.fclib import read

__all__ = ["RUNNERS", "harvest"]

RUNNERS = ("secular", "pac")
TOLERANCE = 1e-4
SWEEPS = 1000
LOOKED_AT = 200_000
UNIFORM = 40
KEPT = 200
SLOW = 20
DIFFERENT = 1e-3
"""Distance of two velocities, relative to b, from which they are different answers."""

Mask = NDArray[np.bool_]


def harvest(
    entries: Sequence[Entry], solvers: Sequence[Configured], listener: Callable[[str], None]
) -> tuple[OneContacts, dict[str, int]]:
    """The one-contact set of a set of problems, and its counts; the same for the same problems.

    The listener hears what is done. Takes seconds a problem. Raises `ProblemError` when a file cannot be read.
    """
    runners = {name: configure(name, registered()) for name in RUNNERS}
    counts: Counter[str] = Counter()
    uniform: list[OneContacts] = []
    hard: list[OneContacts] = []
    for number, entry in enumerate(entries):
        laid = lay_out(read(entry.file).problem)
        for k, (name, local) in enumerate(runners.items()):
            log = new_log(laid.problem.n, 0, LOOKED_AT)
            loop = GaussSeidel(local, TOLERANCE, SWEEPS, np.inf, **LOOPS["plain"])
            loop.solve_system(laid.system, laid.problem.b_ref, log=log)
            contacts = from_visits(samples(log)[0])
            counts["visits"] += int(log.state[1])
            counts["visits looked at"] += contacts.m
            rng = np.random.default_rng([number, k])
            uniform.append(
                labelled(contacts, _drawn(rng, np.arange(contacts.m), UNIFORM), f"uniform: {name}")
            )
            hard += _hard(contacts, solvers, rng, counts)
        listener(entry.name)
    return OneContacts.join([*uniform, *hard, hard_set()]), dict(counts)


def from_visits(visits: NDArray[np.void]) -> OneContacts:
    """The local problems of logged visits, without labels and answers."""
    m = len(visits)
    data = {name: np.ascontiguousarray(visits[name]) for name in ("W", "b", "mu", "start")}
    return OneContacts(**data, family=np.full(m, ""), answer=np.full((m, 3), np.nan))


def labelled(contacts: OneContacts, which: NDArray[np.int64], label: str) -> OneContacts:
    """Some contacts, under a label."""
    some = contacts.select(which)
    return OneContacts(some.W, some.b, some.mu, some.start, np.full(some.m, label), some.answer)


def _drawn(rng: np.random.Generator, among: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """At most `count` of the indices, at random, in order."""
    return np.sort(rng.choice(among, count, replace=False)) if len(among) > count else among


def _hard(
    contacts: OneContacts, solvers: Sequence[Configured], rng: np.random.Generator, counts: Counter[str]
) -> Iterator[OneContacts]:
    """The hard visits of a run, reason by reason, the rarest first; all are counted."""
    reasons = {name: mask for name, mask in hard_visits(contacts, solvers).items() if mask.any()}
    counts.update({name: int(mask.sum()) for name, mask in reasons.items()})
    left = np.ones(contacts.m, dtype=bool)
    for name, mask in sorted(reasons.items(), key=lambda item: (item[1].sum(), item[0])):
        yield labelled(contacts, _drawn(rng, np.flatnonzero(mask & left), KEPT), f"hard: {name}")
        left &= ~mask


def hard_visits(contacts: OneContacts, solvers: Sequence[Configured]) -> dict[str, Mask]:
    """Which contacts are hard, by reason."""
    found: dict[str, Mask] = {}
    answers = []
    for local in solvers:
        replayed = replay(local, contacts)
        verdict = judge(contacts, replayed, local.facets)
        for code in np.unique(verdict.code[~verdict.solved]):
            found[f"{local.label} {reason_of(int(code))}"] = verdict.code == code
        found[f"{local.label} slow"] = verdict.solved & (replayed.iterations > SLOW)
        if local.facets == COULOMB:
            right = np.where(verdict.solved[:, None], replayed.r, np.nan)
            answers.append(velocities(contacts, right))
    return found | {"answers differ": _spread(np.array(answers)) > DIFFERENT}


def _spread(answers: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far the velocities (solvers, m, 3) of right answers are apart: their bounding box's diagonal, (m,)."""
    largest, least = np.fmax.reduce(answers), np.fmin.reduce(answers)
    return np.nan_to_num(np.linalg.norm(largest - least, axis=1))
