"""Answers of the solvers compared with references: by residual, by velocities, by regime, by friction's work.

Impulses are not unique and never compared. Velocities mostly are, and are compared in the norm of kinetic energy,
see `reference.distance`. A large error beside a small residual means an ill-conditioned problem, or another solution:
Coulomb's law may have several. Where several are known the nearest is compared with.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

import fibercontact
from fibercontact.bench.passes import gauss_seidel, judge, lay_out, options_text
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import ACCURACIES, Limits
from fibercontact.bench.rows import Row, RowFile
from fibercontact.jit import content_key
from fibercontact.local.registry import Configured
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure, relative
from fibercontact.reference.conic import Problem, associated, condensed, duality_gap
from fibercontact.reference.distance import friction_work, velocity_error
from fibercontact.reference.ground_truth import GroundTruth, Search
from fibercontact.reference.store import Store

__all__ = [
    "ASSOCIATED",
    "OPEN",
    "SLIP",
    "STICK",
    "Comparison",
    "Contender",
    "Listener",
    "associated_model",
    "compare",
    "contender",
    "regimes",
    "validate",
]

Array = NDArray[np.float64]

ASSOCIATED = "associated"
"""Name of the convex model `s = 0` among the solvers."""

SMALL_GAP = 1e-8
"""Relative duality gap up to which the convex model counts as solved."""
OPEN, STICK, SLIP = 0, 1, 2
RESOLUTION = 1e-3  # share of b_ref below which a speed does not make a regime


class Listener(Protocol):
    """Who is told how a validation goes."""

    def now(self, problem: str, what: str) -> None:
        """Something is about to be computed."""

    def done(self, problem: str) -> None:
        """A problem has all its rows."""

    def note(self, text: str) -> None:
        """Something must be said."""


@dataclass(frozen=True)
class Contender:
    """A solver to be judged: its name, what it is made of, and its answer with what it says of it."""

    name: str
    identity: str
    solve: Callable[[Problem], tuple[Array, Row]]


@dataclass(frozen=True)
class Comparison:
    """The rows, one a problem and solver, and the references they are compared with, one a problem."""

    rows: list[Row]
    references: list[Row]
    skipped: list[str]


def contender(local: Configured, accuracy: str) -> Contender:
    """Gauss–Seidel over a local solver, stopped at an accuracy of the protocol for its own law."""
    loop = gauss_seidel(local, ACCURACIES[accuracy], "plain", Limits())

    def solve(problem: Problem) -> tuple[Array, Row]:
        laid = lay_out(problem)
        run = loop.solve_system(laid.system, laid.problem.b_ref)
        measured = measure(laid.problem, run.r, local.facets)
        law = f"{local.facets} facets" if local.facets else "Coulomb"
        verdict = judge(run, measured, loop.tolerance)
        return run.r, {"law": law, "residual": measured.residual, "sweeps": run.sweeps, **verdict}

    identity = f"{accuracy} {local.registered.fingerprint} {options_text(local)}"
    return Contender(local.label, identity, solve)


def associated_model() -> Contender:
    """The convex model `s = 0`: exact for its own law, which is not Coulomb's."""

    def solve(problem: Problem) -> tuple[Array, Row]:
        answer = associated(problem)
        gap = duality_gap(condensed(problem), answer.r)
        return answer.r, {"law": ASSOCIATED, "solved": gap <= SMALL_GAP, "outcome": answer.status}

    return Contender(ASSOCIATED, "", solve)


def validate(
    entries: Sequence[Entry],
    contenders: Sequence[Contender],
    folder: Path,
    listener: Listener,
    *,
    references: Path,
    search: Search,
    max_contacts: int = 300,
) -> Comparison:
    """Compare contenders with references on the problems of up to `max_contacts` contacts.

    Rows go to `folder/rows.jsonl`, references that are not in the file `references` yet beside that file, each as it
    comes; what is there already is not computed again. Raises `ProblemError` on a file that cannot be read,
    `StoreError` on references that cannot be, `BenchError` while another run writes to the folder.
    """
    store = Store(references)
    file, result = RowFile(folder), Comparison([], [], [])
    with file.appending():
        known = {_key(row): row for row in file.read()}
        for entry in entries:
            problem = read(entry.file).problem
            if problem.n > max_contacts:
                result.skipped.append(
                    f"{entry.name}: skipped, {problem.n} contacts are more than {max_contacts}"
                )
                listener.note(result.skipped[-1])
            else:
                listener.now(entry.name, "reference")
                truth = store.find(entry.hash, entry.name, problem, search)
                result.references.append(_reference_row(entry, problem, truth))
                for one in contenders:
                    listener.now(entry.name, one.name)
                    head = _head(entry, one, truth)
                    row = known.get(_key(head))
                    if row is None:
                        row = head | _compared(problem, one, truth)
                        file.append(row)
                    result.rows.append(row)
            listener.done(entry.name)
    store.pack()
    return result


def _head(entry: Entry, one: Contender, truth: GroundTruth) -> Row:
    """What identifies a row."""
    return {
        "problem_hash": entry.hash,
        "solver": one.name,
        "identity": f"{_code()} {one.identity}",
        "reference": truth.reference.method,
        "reference_residual": truth.reference.residual,
        "problem": entry.name,
        "scene": entry.scene,
    }


def _key(row: Row) -> tuple[Any, ...]:
    names = ("problem_hash", "solver", "identity", "reference", "reference_residual", "problem")
    return tuple(row.get(name) for name in names)


def _code() -> str:
    """Key of the sources that decide the numbers, the local solvers aside."""
    package = Path(fibercontact.__file__).parent
    rooms = [package / room for room in ("problem", "gauss_seidel", "reference")]
    return content_key([*(file for room in rooms for file in room.rglob("*.py")), Path(__file__)])


def _reference_row(entry: Entry, problem: Problem, truth: GroundTruth) -> Row:
    return {
        "problem": entry.name,
        "contacts": problem.n,
        "existence": truth.existence.verdict,
        "reference": truth.reference.method,
        "residual": truth.reference.residual,
        "solutions": 1 + len(truth.uniqueness.others),
    }


def _compared(problem: Problem, one: Contender, truth: GroundTruth) -> Row:
    """The answer of a contender, measured; compared with the reference if there is one."""
    r, account = one.solve(problem)
    incremental = condensed(problem)
    found = measure(incremental, r)
    row = {"contacts": problem.n, **account, "coulomb": found.coulomb, "created_power": found.created_power}
    if truth.reference.accepted and np.isfinite(r).all():
        known = (truth.reference.r, *truth.uniqueness.others)
        nearest = min(known, key=lambda r_ref: velocity_error(problem, r, r_ref))
        row |= compare(problem, incremental, r, nearest)
    return row


def compare(problem: Problem, incremental: IncrementalProblem, r: Array, r_ref: Array) -> Row:
    """Compare finite impulses `r` (3n,) with those of a reference, in what is physical."""
    u, u_ref = incremental.W @ r + incremental.b, incremental.W @ r_ref + incremental.b
    same = regimes(incremental, u) == regimes(incremental, u_ref)
    work, work_ref = friction_work(u, r), friction_work(u_ref, r_ref)
    return {
        "velocity_error": velocity_error(problem, r, r_ref),
        "same_regime": float(same.mean()) if len(same) else 1.0,
        "friction_work": work,
        "reference_friction_work": work_ref,
        "friction_work_error": relative(abs(work - work_ref), work_ref),
    }


def regimes(problem: IncrementalProblem, u: Array) -> NDArray[np.int64]:
    """Regime (n,) of each contact from its velocity alone: impulses, not being unique, do not tell.

    Speeds below `RESOLUTION b_ref` count as none: take-off if `u_N` is above, slip if only `‖u_T‖` is.
    """
    u, least = u.reshape(-1, 3), RESOLUTION * (problem.b_ref or 1.0)
    slides = np.where(np.hypot(u[:, 1], u[:, 2]) > least, SLIP, STICK)
    return np.where(u[:, 0] > least, OPEN, slides)
