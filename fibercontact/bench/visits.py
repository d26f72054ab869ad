"""Visit logs on disk (PROTOCOL level 2): one bounded HDF5 file a run, read back with every fault named.

A file takes at most 1.6 MB and 130 bytes a contact, whatever the run: a long one is stored in groups of sweeps, its
visits as two samples, the impulses of its last sweeps for the contacts that moved most.
"""

import hashlib
import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

import fibercontact
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.rows import Key
from fibercontact.errors import UserError
from fibercontact.files import replace_file
from fibercontact.gauss_seidel.solver import Run
from fibercontact.gauss_seidel.visit_log import (
    BY_SWEEP,
    CURED,
    SWITCHES,
    VISIT,
    VisitLog,
    recent_impulses,
    samples,
)
from fibercontact.local.contract import Status
from fibercontact.problem.hdf5 import has, load, open_file

__all__ = [
    "FIXED_BYTES", "MOST_SWEEPS", "PER_CONTACT_BYTES", "SAMPLE", "VisitRecord", "about", "check_sweeps",
    "log_file", "read_log", "record_of", "write_log",
]  # fmt: skip

FORMAT, VERSION = "fibercontact visit log", 1
SAMPLE = 1000
"""Visits in each of the two samples: of all, and of those whose local solve failed."""
MOST_SWEEPS = 1_000_000
"""Longer runs are not logged: their counts would fill the memory."""
ROWS = 5000
"""Rows of sweeps in a file; in longer runs each stands for a group of sweeps."""
MOVING = 500
"""Contacts whose recent impulses are stored: those that moved most."""
FIXED_BYTES, PER_CONTACT_BYTES = 1_600_000, 130
"""A file is not longer than the first and, for each contact, the second."""

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

STORED_VISIT = np.dtype(
    [(name, VISIT[name] if k > 4 else np.dtype("i4")) for k, name in enumerate(VISIT.names or ())]
)
"""`VISIT` with its counts as integers."""


@dataclass(frozen=True)
class VisitRecord:
    """What a run leaves of its visits. `sweeps[k]` sweeps were done at the end of row k, none at the first one's."""

    about: Mapping[str, Any]
    sweeps: Counts  # (rows,)
    residual: Array  # (rows,) then, relative to b
    size: Array  # (rows,) then, root mean square of sigma_i r_i relative to b
    counts: Counts  # (rows, 6) of the visits of the row, see BY_SWEEP
    statuses: Counts  # (n, statuses) visits of each contact
    switches: Counts  # (n,) changes of regime
    visits: NDArray[np.void]  # a uniform sample, of STORED_VISIT
    failures: NDArray[np.void]  # of those whose local solve failed
    amplitude: Array  # (n,) largest change of sigma_i r_i over the recent sweeps, relative to b
    moving: Counts  # (k,) the contacts that moved most, by number
    recent: Array  # (sweeps, k, 3) their impulses after each of the recent sweeps
    answer: Array  # (3n,) the best impulse

    @property
    def n(self) -> int:
        """Number of contacts."""
        return len(self.switches)


SHAPES = {
    "sweeps": ("rows",), "residual": ("rows",), "size": ("rows",), "counts": ("rows", len(BY_SWEEP)),
    "statuses": ("n", len(Status)), "switches": ("n",), "visits": ("visits",), "failures": ("failures",),
    "amplitude": ("n",), "moving": ("moving",), "recent": ("recent", "moving", 3), "answer": ("3n",),
}  # fmt: skip
"""The data sets of a file; a name stands for the same length wherever it appears."""

REQUIRED = (
    "problem", "problem_hash", "solver", "fingerprint", "options", "law_facets", "accuracy", "tolerance", "start",
    "outer", "max_sweeps", "max_seconds", "protocol", "outcome", "residual", "solved", "reason", "detail",
    "proximal_from",
)  # fmt: skip
"""What the attributes of a file say of its run at least; `proximal_from` is 0 when that term never came in force."""


def check_sweeps(sweeps: int) -> None:
    """Raise `BenchError` when a run may be too long for a log."""
    if sweeps > MOST_SWEEPS:
        raise BenchError(f"a visit log holds at most {MOST_SWEEPS} sweeps, not {sweeps}: see --max-sweeps")


def about(entry: Entry, key: Key, facets: int, tolerance: float) -> dict[str, Any]:
    """Say what a run is about: the part of a record's `about` that is known before it."""
    version = {"fibercontact": fibercontact.__version__}
    return {"problem": entry.name, "law_facets": facets, "tolerance": tolerance} | key.fields() | version


def log_file(folder: Path, entry: Entry, key: Key) -> Path:
    """Where the log of a run goes; other options, limits or sources give another name."""
    digest = hashlib.sha256(json.dumps(key.fields()).encode()).hexdigest()[:8]
    label = re.sub(r"[^A-Za-z0-9_=-]+", "-", key.solver)
    return folder / f"{entry.name}.{label}.{key.accuracy}.{digest}.hdf5"


def record_of(log: VisitLog, run: Run, sigma: Array, b_ref: float, about: Mapping[str, Any]) -> VisitRecord:
    """The record of a run with history, cut to its bounded size."""
    unit = b_ref or 1.0
    ends = _row_ends(run.sweeps)
    counts = np.zeros((len(ends), len(BY_SWEEP)), dtype=np.int64)
    if run.sweeps:
        counts[1:] = np.add.reduceat(log.by_sweep[: run.sweeps], ends[:-1], axis=0)
    recent = recent_impulses(log)
    recent = recent.reshape(len(recent), len(sigma), 3)
    amplitude = sigma * _largest_change(recent) / unit
    moving = np.sort(np.argsort(-amplitude, kind="stable")[:MOVING])
    visits, failures = (sample.astype(STORED_VISIT) for sample in samples(log))
    outcome = {"outcome": run.outcome.name.lower(), "proximal_from": int(log.state[CURED])}
    return VisitRecord(
        {**about, **outcome},
        ends,
        run.history[ends],
        np.concatenate([[np.nan], log.size[: run.sweeps]])[ends] / unit,
        counts,
        log.by_contact[:, : len(Status)],
        log.by_contact[:, SWITCHES],
        visits,
        failures,
        amplitude,
        moving,
        recent[:, moving],
        run.r,
    )


def _row_ends(sweeps: int) -> Counts:
    """How many sweeps are done at the end of each row: 0, then one row for each group."""
    group = max(1, -(-sweeps // ROWS))
    return np.minimum(group * np.arange(-(-sweeps // group) + 1), sweeps)


def _largest_change(recent: Array) -> Array:
    """Largest distance of the impulses of each contact from its last one, (n,)."""
    if len(recent) == 0:
        return np.zeros(recent.shape[1])
    with np.errstate(invalid="ignore", over="ignore"):
        return np.nan_to_num(np.sqrt(((recent - recent[-1]) ** 2).sum(axis=2).max(axis=0)))


def write_log(path: Path, record: VisitRecord) -> None:
    """Write a record, whole or not at all; its folder is made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs.update({"format": FORMAT, "version": VERSION} | dict(record.about))
        for name in SHAPES:
            values = getattr(record, name)
            how = {"compression": "gzip", "shuffle": True} if values.size else {}
            file.create_dataset(name, data=values, **how)
    replace_file(path, image.getvalue())


def read_log(path: Path) -> VisitRecord:
    """Read a record back; raises `BenchError` naming the file and what is wrong with it."""
    if not path.is_file():
        raise BenchError(f"{path}: no such file")
    try:
        with open_file(path) as file:
            return _read(file)
    except UserError as fault:
        raise BenchError(f"{path}: {fault}") from None
    except Exception as fault:  # damaged bytes make h5py raise nearly any kind
        raise BenchError(f"{path}: not a readable HDF5 file ({fault})") from None


def _read(file: h5py.File) -> VisitRecord:
    said = {name: value.item() if hasattr(value, "item") else value for name, value in file.attrs.items()}
    if said.pop("format", None) != FORMAT:
        raise BenchError("not a visit log")
    if (version := said.pop("version", None)) != VERSION:
        raise BenchError(f"a visit log of version {version}; this program reads version {VERSION}")
    missing = [name for name in REQUIRED if name not in said] + [
        name for name in SHAPES if not has(file, name)
    ]
    if missing:
        raise BenchError(f"a visit log without {', '.join(missing)}")
    lengths: dict[str, int] = {}
    record = VisitRecord(said, **{name: _values(file, name, lengths) for name in SHAPES})
    for contacts in (record.moving, record.visits["contact"], record.failures["contact"]):
        if len(contacts) and not 0 <= contacts.min() <= contacts.max() < record.n:
            raise BenchError(f"contacts beyond the {record.n} that there are")
    return record


def _values(file: h5py.File, name: str, lengths: dict[str, int]) -> NDArray[Any]:
    """A data set, its shape checked against those that were read before."""
    values, expected = np.asarray(load(file, name, "ifV", "numbers")), SHAPES[name]
    good = values.dtype == STORED_VISIT if name in ("visits", "failures") else values.dtype.kind in "if"
    if not good:
        raise BenchError(f"{name}: its values are of another kind ({values.dtype})")
    found = dict(zip(map(str, expected), values.shape, strict=False))
    if "n" in found:
        found["3n"] = 3 * found["n"]
    known = {str(length): length for length in expected if isinstance(length, int)} | lengths
    if values.ndim != len(expected) or any(known.get(key, size) != size for key, size in found.items()):
        raise BenchError(f"{name}: its shape {values.shape} is not {expected}")
    lengths.update(found)
    return values
