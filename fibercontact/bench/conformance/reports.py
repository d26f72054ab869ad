"""What is reported of a local solver and is no breach: the hard contacts it misses, its speed, whole problems."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, eye_array

from fibercontact.bench.conformance.contacts import hard, kind, set_of
from fibercontact.bench.conformance.subject import Subject
from fibercontact.bench.contact_verdict import judge
from fibercontact.bench.passes import lay_out
from fibercontact.bench.problem_set import find_set
from fibercontact.bench.protocol import ACCURACIES, BenchError
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.local.one_contact import OneContacts, Replay, replay
from fibercontact.local.registry import Configured, configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure
from fibercontact.problem.step import StepProblem

__all__ = ["REPORTS", "Report", "Table"]

STEPS = 100
"""Visits that a step gets at a hard contact."""
REPETITIONS = 7
RUN_SECONDS = 2.0
"""For a whole problem."""


class Table(NamedTuple):
    """Figures, as they are shown."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Report(NamedTuple):
    """A sentence, and the figures behind it."""

    sentence: str
    table: Table


def hard_contacts(subject: Subject) -> Report:
    """How often it misses contacts that are hard, each family for a reason; to say so is no breach."""
    contacts = hard()
    verdict = judge(contacts, _replayed(subject, contacts), subject.facets)
    missed, reasons, rows = ~verdict.solved, verdict.reasons, []
    for family in sorted(set(contacts.family.tolist())):
        mine = contacts.family == family
        how = ", ".join(
            f"{reason} {count}" for reason, count in Counter(reasons[mine & missed]).most_common()
        )
        percent = f"{100 * missed[mine].mean():.1f}"
        rows.append((family.removeprefix("known: "), str(mine.sum()), percent, how))
    sentence = f"{100 * missed.mean():.1f} % of {contacts.m} missed"
    return Report(sentence, Table(("family", "contacts", "missed (%)", "how"), rows))


def _replayed(subject: Subject, contacts: OneContacts) -> Replay:
    """The answers of one visit each, or of as many as a step gets."""
    found = replay(subject.local, contacts)
    for _ in range(0 if subject.exact else STEPS):
        finite = np.isfinite(found.r).all(axis=1, keepdims=True)
        contacts = dataclasses.replace(contacts, start=np.where(finite, found.r, contacts.start))
        found = replay(subject.local, contacts)
    return found


def speed(subject: Subject) -> Report:
    """Time of a visit, at well-conditioned contacts from rest."""
    contacts, known = set_of(kind(1000)), registered()
    solvers = [subject.local, configure("secular", known), configure("hybrid", known)]
    best = np.min([[replay(s, contacts).seconds for s in solvers] for _ in range(REPETITIONS)], axis=0)
    ns = best / contacts.m * 1e9
    rows = [(s.label, f"{t:.0f}", f"{ns[0] / t:.2g}") for s, t in zip(solvers, ns, strict=True)]
    sentence = f"{ns[0]:.0f} ns a visit, {rows[1][2]} × secular, {rows[2][2]} × hybrid"
    return Report(sentence, Table(("solver", "ns a visit", "ratio"), rows))


def whole_problems(subject: Subject) -> Report:
    """Small problems solved by Gauss–Seidel to low accuracy."""
    solvers = [subject.local, configure("secular", registered())]
    rows = [
        (name, str(problem.n), *(_sweeps(solver, problem) for solver in solvers))
        for name, problem in small_problems()
    ]
    solved = sum(row[2] != NOT_SOLVED for row in rows)
    columns = ("problem", "contacts", f"sweeps, {subject.local.label}", "sweeps, secular")
    return Report(f"{solved} of {len(rows)} solved", Table(columns, rows))


NOT_SOLVED = "not solved"


def _sweeps(local: Configured, problem: IncrementalProblem) -> str:
    """Sweeps to low accuracy, by the harness's measure."""
    tolerance = ACCURACIES["low"]
    run = GaussSeidel(local, tolerance, max_seconds=RUN_SECONDS, check_every=1, **LOOPS["plain"]).solve(
        problem
    )
    solved = measure(problem, run.r, local.facets).residual <= tolerance
    return str(run.sweeps) if solved else NOT_SOLVED


@cache
def small_problems() -> Sequence[tuple[str, IncrementalProblem]]:
    """Two piles of masses, and the two smallest problems of core306 where it is at hand."""
    piles = [(f"pile of {n}", _pile(n)) for n in (10, 40)]
    try:
        files = sorted(find_set("core306").glob("*.hdf5"), key=lambda file: file.stat().st_size)[:2]
    except BenchError:
        return piles
    return piles + [(file.stem, lay_out(read(file).problem).problem) for file in files]


def _pile(n: int) -> IncrementalProblem:
    """Unit masses one on another, pushed down and aside; the lowest on the ground."""
    f = np.tile([1.0, 0.3, -0.2], n) + 0.3 * np.random.default_rng(n).standard_normal(3 * n)
    H = csr_array(np.kron(np.eye(n) - np.eye(n, k=-1), np.eye(3)))
    return StepProblem(eye_array(3 * n, format="csr"), f, H, np.zeros(3 * n), np.full(n, 0.4)).condense()


REPORTS: dict[str, Callable[[Subject], Report]] = {
    "hard contacts": hard_contacts,
    "speed": speed,
    "whole problems": whole_problems,
}
"""By name, in the order of the card."""
