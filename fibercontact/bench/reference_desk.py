"""Ground truth of one problem: what a worker process does for `fibercontact reference`, one request at a time."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.bench.problem_set import Entry
from fibercontact.bench.rows import Row
from fibercontact.bench.worker import Crashed, Hung, Refused, Worker
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import ProblemWarning
from fibercontact.problem.measure import relative
from fibercontact.reference.conic import Problem, condensed
from fibercontact.reference.distance import friction_work, velocity_error
from fibercontact.reference.ground_truth import GroundTruth, Search, ground_truth
from fibercontact.reference.store import Store, part

__all__ = ["Desk", "Errand", "Sought", "describe", "seek"]

Array = NDArray[np.float64]

TRIFLE = 1e-9
"""Share of the largest `sigma_i r_N,i` below which a contact counts as transmitting no impulse."""

FIXED_SECONDS, PATIENCE = 600.0, 4.0
"""A process is killed after the first and so many times what its search may take: its conic solves have no clock."""


class Errand(NamedTuple):
    """A problem, how its ground truth is sought, and the file in which it may be stored already."""

    entry: Entry
    search: Search
    store: Path | None


Sought = tuple[Row, bytes] | str
"""A row and what is to be stored, nothing where it is stored already; or a sentence on what went wrong."""


def seek(worker: Worker, file: Path, errand: Errand) -> Sought:
    """Have a worker find the ground truth of the problem in a file, which names its entry's where it is told of."""
    search = errand.search
    limit = FIXED_SECONDS + PATIENCE * (1 + search.starts) * search.max_seconds
    try:
        found: tuple[Row, bytes] = worker.ask("find", (file, errand), limit)
    except (Hung, Crashed, Refused) as fault:
        text = str(fault).replace(str(file), str(errand.entry.file))
        return text if str(errand.entry.file) in text else f"{errand.entry.file}: {text}"
    return found


class Desk:
    """Finds ground truth; no solver of a table's is needed for it."""

    def __init__(self, plugins: Sequence[Path], solvers: Sequence[str]) -> None:
        pass

    def fingerprints(self) -> dict[str, str]:
        """Of no solvers."""
        return {}

    def find(self, file: Path, errand: Errand) -> tuple[Row, bytes]:
        """What is known of the problem in a file, in a row, and what is to be stored of it."""
        entry, search = errand.entry, errand.search
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProblemWarning)  # of an asymmetry; said by `info`
            problem = read(file).problem
        head = {"problem": entry.name, "scene": entry.scene, "hash": entry.hash}
        known = Store(errand.store).get(entry.hash, problem, search) if errand.store is not None else None
        if known is not None:
            return head | describe(problem, known), b""
        found = ground_truth(problem, search)
        return head | describe(problem, found), part(entry.hash, entry.name, problem, found, search)


def describe(problem: Problem, found: GroundTruth) -> Row:
    """What is known of a problem, in numbers; the associated model's distances are empty without a reference."""
    row: Row = {
        "contacts": problem.n,
        "existence": found.existence.verdict,
        "margin": found.existence.margin,
        "reference": found.reference.method,
        "residual": found.reference.residual,
        "log": "; ".join(
            f"{a.method} {a.residual:.1e} in {a.seconds:.2g} s" for a in found.reference.attempts
        ),
        "seconds": found.seconds,
        "associated_gap": found.gap,
    }
    if found.reference.accepted:
        row |= _cost_of_convexity(problem, found.associated, found.reference.r)
        row |= {
            "starts": found.uniqueness.tried,
            "starts_reached": found.uniqueness.reached,
            "solutions": 1 + len(found.uniqueness.others),
            "distance": found.uniqueness.distance,
        }
    return row


def _cost_of_convexity(problem: Problem, r: Array, r_ref: Array) -> Row:
    """How far the associated model's answer is from Coulomb's: velocities, friction's work in J, lift-off speed.

    The last is the largest `u_N` at a contact that transmits an impulse, relative to `b_ref`: none, by Coulomb's law.
    """
    incremental = condensed(problem)
    u, u_ref = incremental.W @ r + incremental.b, incremental.W @ r_ref + incremental.b
    size = incremental.sigma * r[::3]
    closed = size > TRIFLE * size.max(initial=0.0)
    return {
        "associated_velocity_error": velocity_error(problem, r, r_ref),
        "friction_work": friction_work(u_ref, r_ref),
        "associated_friction_work": friction_work(u, r),
        "associated_lift_off": relative(float(u[::3][closed].max(initial=0.0)), incremental.b_ref),
    }
