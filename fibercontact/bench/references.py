"""Ground truth for a whole set, in parallel, stored problem by problem, and what it says in one table."""

import math
import multiprocessing
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fibercontact.bench.environment import one_thread
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.report import number
from fibercontact.bench.rows import Row
from fibercontact.problem.fclib import read
from fibercontact.problem.incremental import ProblemWarning
from fibercontact.problem.measure import relative
from fibercontact.reference.conic import Problem, condensed
from fibercontact.reference.distance import friction_work, velocity_error
from fibercontact.reference.existence import SOLVABLE, UNDECIDED, UNSOLVABLE
from fibercontact.reference.ground_truth import GroundTruth, Search
from fibercontact.reference.store import Store
from fibercontact.reference.uniqueness import DIFFERENT

__all__ = ["Listener", "find_references", "reference_frame", "reference_notes", "summary"]

Array = NDArray[np.float64]

Listener = Callable[[Row], None]
"""Is told each row as it comes."""

TRIFLE = 1e-9
"""Share of the largest `sigma_i r_N,i` below which a contact counts as transmitting no impulse."""


class _Task(NamedTuple):
    file: Path
    key: str
    name: str
    scene: str
    store: Path
    search: Search


def find_references(
    entries: Sequence[Entry], file: Path, search: Search, jobs: int, listener: Listener
) -> tuple[list[Row], list[str]]:
    """Ground truth for every problem of a set, `jobs` at a time: the rows, in the set's order, and faults of files.

    Each is stored when it is found; what is stored already is read and checked. Raises `BenchError` when a process
    dies, `StoreError` on a file of references that cannot be read.
    """
    tasks = [_Task(e.file, e.hash, e.name, e.scene, file, search) for e in entries]
    largest_first = sorted(tasks, key=lambda task: -task.file.stat().st_size)
    rows: dict[str, Row] = {}
    faults: dict[str, str] = {}
    with one_thread(), _crew(jobs) as crew:
        waiting: dict[Future[Row], _Task] = {crew.submit(_row, task): task for task in largest_first}
        while waiting:
            done, _ = wait(waiting, timeout=1.0, return_when=FIRST_COMPLETED)
            for future in done:
                task = waiting.pop(future)
                try:
                    rows[task.key] = future.result()
                    listener(rows[task.key])
                except BrokenProcessPool:
                    raise BenchError(
                        f"{task.file}: a process died (out of memory?); what was found is kept: run it again"
                    ) from None
                except ValueError as fault:
                    faults[task.key] = str(fault)
    Store(file).pack()
    return [rows[t.key] for t in tasks if t.key in rows], [faults[t.key] for t in tasks if t.key in faults]


@contextmanager
def _crew(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Worker processes, killed when the block is left early: none lives on after an interruption."""
    crew = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), initializer=_begin)
    try:
        yield crew
        crew.shutdown()
    except BaseException:
        crew.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.kill()
        raise


def _begin() -> None:
    """The parent decides what an interruption means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _row(task: _Task) -> Row:
    """Ground truth of one problem, stored, as a row."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # of an asymmetry; said by `info`
        problem = read(task.file).problem
    found = Store(task.store).find(task.key, task.name, problem, task.search)
    return {"problem": task.name, "scene": task.scene, "hash": task.key} | describe(problem, found)


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


def reference_frame(rows: Sequence[Row]) -> pd.DataFrame:
    """Tidy rows; what is not known is empty."""
    names = ["problem", "scene", "hash", "contacts", "existence", "margin", "reference", "residual", "log",
             "seconds", "associated_gap", "associated_velocity_error", "friction_work", "associated_friction_work",
             "associated_lift_off", "starts", "starts_reached", "solutions", "distance"]  # fmt: skip
    return pd.DataFrame(list(rows), columns=names)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """One line a scene, in text, and one for all."""
    lines = [_line(str(scene), mine) for scene, mine in rows.groupby("scene", sort=True)]
    if len(lines) != 1:
        lines.append(_line("all", rows))
    return pd.DataFrame(lines)


def _line(name: str, rows: pd.DataFrame) -> dict[str, str]:
    existence = rows["existence"].value_counts()
    accepted = rows["starts"].notna()
    several = int((rows["solutions"] > 1).sum())
    return {
        "scene": name,
        "problems": str(len(rows)),
        "solution exists: yes / no / ?": " / ".join(
            str(existence.get(verdict, 0)) for verdict in (SOLVABLE, UNSOLVABLE, UNDECIDED)
        ),
        "references": str(int(accepted.sum())),
        "residual ≤": number(rows["residual"][accepted].max()),
        "several solutions": str(several),
        "gap ≤": number(rows["associated_gap"].max()),
        "velocity error": _two(rows["associated_velocity_error"]),
        "friction's work": number(
            _ratio(rows["associated_friction_work"].sum(), rows["friction_work"].sum())
        ),
        "lift-off speed": _two(rows["associated_lift_off"]),
        "seconds": number(rows["seconds"].sum()),
    }


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0.0 else math.nan


def _two(values: pd.Series) -> str:
    return f"{number(values.median())} / {number(values.max())}"


def reference_notes(rows: pd.DataFrame) -> list[str]:
    """What must be said beside the table."""
    accepted, solvable = rows["starts"].notna(), rows["existence"] == SOLVABLE
    methods = rows["reference"][accepted].value_counts()
    said = [
        f"{int((accepted & solvable).sum())} of {int(solvable.sum())} solvable problems have a reference: "
        + ", ".join(f"{name} {count}" for name, count in methods.items()),
        "the four last figures are of the associated (convexified) law, s = 0: its relative duality gap, and beside "
        "the reference its velocity error (kinetic energy, median / largest), friction's work over all problems, "
        "lift-off speed where an impulse is transmitted, relative to b (median / largest)",
    ]
    several = rows[rows["solutions"] > 1]
    if len(several):
        said.append(
            f"several solutions (velocities more than {DIFFERENT:g} apart): "
            + ", ".join(
                f"{name} ({number(d)})" for name, d in zip(several.problem, several.distance, strict=True)
            )
        )
    for verdict in (UNSOLVABLE, UNDECIDED):
        names = list(rows["problem"][rows["existence"] == verdict])
        said += [f"{verdict}: {', '.join(names)}"] if names else []
    without = list(rows["problem"][~accepted])
    said += [f"no reference (best known only): {', '.join(without)}"] if without else []
    return said
