"""Ground truth for a whole set, in parallel, stored problem by problem, and what it says in one table."""

import math
import threading
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from fibercontact.bench import reference_desk
from fibercontact.bench.crew import share_out
from fibercontact.bench.environment import memory_share
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.reference_desk import Errand, Sought, seek
from fibercontact.bench.report import number
from fibercontact.bench.rows import Row
from fibercontact.bench.worker import Setting, Worker
from fibercontact.reference.existence import SOLVABLE, UNDECIDED, UNSOLVABLE
from fibercontact.reference.ground_truth import Search
from fibercontact.reference.store import Store
from fibercontact.reference.uniqueness import DIFFERENT

__all__ = ["Listener", "find_references", "reference_frame", "reference_notes", "summary"]

Listener = Callable[[Row], None]
"""Is told each row as it comes."""


def find_references(
    entries: Sequence[Entry],
    file: Path,
    search: Search,
    jobs: int,
    listener: Listener,
    cluster: str | None = None,
    memory: int | None = None,
) -> tuple[list[Row], list[str]]:
    """Ground truth for every problem of a set, `jobs` at a time: the rows, in the set's order, and faults.

    Each is stored when it is found; what is stored already is read and checked. `cluster` is the address of a Dask
    scheduler whose workers find what is not stored. A process that dies or hangs costs its problem, whose fault says
    so. Raises `StoreError` on a file of references that cannot be read, `BenchError` when the cluster cannot be used.
    """
    store, rows, faults = Store(file), dict[str, Row](), dict[str, str]()
    largest_first = sorted(entries, key=lambda entry: -entry.file.stat().st_size)
    taking = threading.Lock()

    def take(entry: Entry, sought: Sought) -> None:
        with taking:
            if isinstance(sought, str):
                faults[entry.hash] = sought
                return
            rows[entry.hash], content = sought
            if content:
                store.keep(entry.hash, content)
            listener(rows[entry.hash])

    def find(worker: Worker, entry: Entry) -> None:
        take(entry, seek(worker, entry.file, Errand(entry, search, file)))

    lost: list[str] = []
    stored = store.keys() if cluster else {entry.hash for entry in entries}
    here = [entry for entry in largest_first if entry.hash in stored]
    setting = Setting(desk=reference_desk.__name__, memory=memory or memory_share(jobs))
    share_out(here, [Worker(setting) for _ in range(min(jobs, len(here)))], find)
    if cluster:
        errands = {e: Errand(e, search, None) for e in largest_first if e.hash not in stored}
        lost = _on_cluster(errands, cluster, setting._replace(memory=memory), take)
    store.pack()
    known = [entry.hash for entry in entries]
    return [rows[key] for key in known if key in rows], [faults[key] for key in known if key in faults] + lost


def _on_cluster(
    errands: dict[Entry, Errand], address: str, setting: Setting, take: Callable[[Entry, Sought], None]
) -> list[str]:
    from fibercontact.bench.cluster import Cluster

    with Cluster(address, setting, warnings.warn) as cluster:
        return cluster.share_out(errands, seek, take)


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
