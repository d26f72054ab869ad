"""Ground truth on disk: one HDF5 file a set, beside the set and never in it, a group a problem.

    HASH/                 attributes: name, contacts, sought, seconds; existence, margin; method, residual,
                          attempts (JSON); gap; tried, reached, distance
        solution/ u r     FCLIB's group, with v where velocities are known; `best_known/` if the bar was missed
        certificate       (3n,) of existence
        associated/ r     the convexified law's
        others/K/ r       solutions with velocities of their own

HASH is the start of the SHA-256 of the problem's file. While a set is worked on, each problem is a file of its own in
a folder beside that file, so that nothing is lost when the run ends at any instant; `pack` puts them together.
Nothing is believed: residuals and certificate are computed anew when a group is read.
"""

import io
import json
import math
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.files import replace_file
from fibercontact.problem.hdf5 import has, load, member, open_file, write_array
from fibercontact.problem.incremental import ProblemError
from fibercontact.problem.measure import measure
from fibercontact.problem.step import StepProblem
from fibercontact.reference.conic import Problem, condensed, duality_gap
from fibercontact.reference.existence import UNDECIDED, UNSOLVABLE, Existence, recheck
from fibercontact.reference.ground_truth import GroundTruth, Search, ground_truth
from fibercontact.reference.truth import NONE, Attempt, Reference
from fibercontact.reference.uniqueness import Uniqueness

__all__ = ["Store", "StoreError", "part", "references_file"]

Array = NDArray[np.float64]


class StoreError(UserError):
    """A file of references that cannot be read or written; the message names it and the fault."""


def references_file(folder: Path) -> Path:
    """Where the references of a set are kept by default: beside its folder."""
    folder = folder.resolve()
    return folder.with_name(f"{folder.name}.references.hdf5")


class Store:
    """The references of one set: `file`, and the parts of a run that has not been packed."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self.parts = file.with_name(f"{file.stem}.parts")

    def get(self, key: str, problem: Problem, search: Search) -> GroundTruth | None:
        """What is stored of a problem, if it will do for the search: its bar is met, or was sought as hard."""
        for path in (self.parts / f"{key}.hdf5", self.file):
            if path.exists() and (found := _read(path, key, problem, search)) is not None:
                return found
        return None

    def unsolvable(self, key: str, problem: Problem) -> bool:
        """Whether a certificate that the problem has no solution is stored, and holds."""
        known = self.get(key, problem, Search(bar=math.inf, starts=0))
        return known is not None and known.existence.verdict == UNSOLVABLE

    def claimed_unsolvable(self) -> set[str]:
        """Keys of the packed problems that are said to have no solution."""
        if not self.file.exists():
            return set()
        with _opened(self.file) as file:
            try:
                return {key for key in file if _group(file, key).attrs.get("existence") == UNSOLVABLE}
            except Exception as fault:  # damaged bytes make h5py raise nearly any kind
                raise StoreError(f"{self.file}: {fault}") from None

    def find(self, key: str, name: str, problem: Problem, search: Search) -> GroundTruth:
        """What is stored, or else what is found now, which is stored then."""
        known = self.get(key, problem, search)
        if known is None:
            known = ground_truth(problem, search)
            self.put(key, name, problem, known, search)
        return known

    def put(self, key: str, name: str, problem: Problem, found: GroundTruth, search: Search) -> None:
        """Write the part of one problem."""
        self.keep(key, part(key, name, problem, found, search))

    def keep(self, key: str, content: bytes) -> None:
        """Write the part of one problem, whole or not at all; `content` is what `part` made, here or elsewhere."""
        self.parts.mkdir(parents=True, exist_ok=True)
        replace_file(self.parts / f"{key}.hdf5", content)

    def keys(self) -> set[str]:
        """The problems of which something is stored."""
        packed: set[str] = set()
        if self.file.exists():
            with _opened(self.file) as file:
                packed = set(file)
        return packed | {path.stem for path in self._kept()}

    def pack(self) -> None:
        """Move the parts into the file, which is replaced whole; parts go before what it held."""
        parts = self._kept()
        if not parts:
            return
        image = io.BytesIO()
        with h5py.File(image, "w", libver=("v110", "v110")) as target:
            for path in [*parts, *([self.file] if self.file.exists() else [])]:
                with _opened(path) as source:
                    for key in sorted(set(source) - set(target)):
                        source.copy(key, target)
        replace_file(self.file, image.getvalue())
        for path in parts:
            path.unlink()
        with suppress(OSError):  # another run has put something there meanwhile
            self.parts.rmdir()

    def _kept(self) -> list[Path]:
        """The parts, without the drafts of a process that was killed while it wrote one."""
        return sorted(self.parts.glob("[!.]*.hdf5"))


def part(key: str, name: str, problem: Problem, found: GroundTruth, search: Search) -> bytes:
    """What is stored of one problem: a file of its own until the run is packed."""
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        _write(file.create_group(key), name, problem, found, search)
    return image.getvalue()


def _write(group: h5py.Group, name: str, problem: Problem, found: GroundTruth, search: Search) -> None:
    exists, truth, unique = found.existence, found.reference, found.uniqueness
    group.attrs.update(
        name=name, contacts=problem.n, sought=str(search), seconds=found.seconds,
        existence=exists.verdict, margin=exists.margin,
        method=truth.method, residual=truth.residual,
        attempts=json.dumps([asdict(attempt) for attempt in truth.attempts]),
        gap=found.gap, tried=unique.tried, reached=unique.reached, distance=unique.distance,
    )  # fmt: skip
    _write_answer(group.create_group("solution" if truth.accepted else "best_known"), problem, truth.r)
    write_array(group, "associated/r", found.associated)
    write_array(group, "certificate", exists.certificate)
    for k, r in enumerate(unique.others):
        write_array(group, f"others/{k}/r", r)


def _write_answer(group: h5py.Group, problem: Problem, r: Array) -> None:
    incremental = condensed(problem)
    if isinstance(problem, StepProblem):
        write_array(group, "v", problem.velocities(r))
    write_array(group, "u", incremental.W @ r + incremental.b)
    write_array(group, "r", r)


def _read(path: Path, key: str, problem: Problem, search: Search) -> GroundTruth | None:
    """The group of a problem, measured anew; None when there is none or it will not do."""
    with _opened(path) as file:
        try:
            return _believed(_group(file, key), problem, search) if has(file, key) else None
        except Exception as fault:  # damaged bytes make h5py raise nearly any kind
            raise StoreError(f"{path}: group {key}: {fault}; delete it to have it made again") from None


def _believed(group: h5py.Group, problem: Problem, search: Search) -> GroundTruth | None:
    incremental, says = condensed(problem), dict(group.attrs)
    accepted = "solution" in group
    r = _vector(group, "solution/r" if accepted else "best_known/r", problem)
    residual = measure(incremental, r).coulomb
    same_search = says["sought"] == str(search)
    if residual > search.bar and (accepted or not same_search):
        return None
    if residual <= search.bar and search.starts > int(says["tried"]) and problem.mu.any():
        return None
    attempts = tuple(Attempt(**fields) for fields in json.loads(says["attempts"]))
    best = min(attempts, key=lambda attempt: attempt.residual)
    certificate, associated = _vector(group, "certificate", problem), _vector(group, "associated/r", problem)
    margin = recheck(incremental, says["existence"], certificate)
    others = (_vector(group, f"others/{k}/r", problem) for k in sorted(group.get("others", ()), key=int))
    solutions = tuple(other for other in others if measure(incremental, other).coulomb <= search.bar)
    return GroundTruth(
        Existence(says["existence"] if margin > 0.0 else UNDECIDED, certificate, margin),
        Reference(r, residual, best.method if residual <= search.bar else NONE, attempts),
        associated,
        duality_gap(incremental, associated),
        Uniqueness(int(says["tried"]), int(says["reached"]), float(says["distance"]), solutions),
        float(says["seconds"]),
    )


def _group(file: h5py.File, key: str) -> h5py.Group:
    group: h5py.Group = member(file, key, h5py.Group)
    return group


def _vector(group: h5py.Group, name: str, problem: Problem) -> Array:
    values = np.asarray(load(group, name, "f", "floating-point numbers"), dtype=np.float64)
    if values.shape != (3 * problem.n,):
        raise ValueError(f"{name} has shape {values.shape}, not ({3 * problem.n},)")
    return values


def _opened(path: Path) -> h5py.File:
    try:
        return open_file(path)
    except ProblemError as fault:
        raise StoreError(f"{path}: {fault}") from None
