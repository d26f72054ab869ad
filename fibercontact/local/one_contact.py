"""One-contact problems: sets of them, their file, and their replay through a local solver (PROTOCOL level 1)."""

import io
import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import h5py
import numpy as np
from numba import types
from numba.core import config
from numpy.typing import ArrayLike, NDArray

from fibercontact.files import replace_file
from fibercontact.jit import jit
from fibercontact.local.algebra import affine
from fibercontact.local.contract import KERNEL_SIGNATURE, Matrix
from fibercontact.local.registry import Configured
from fibercontact.problem.cone import COULOMB, Vector, natural_map, norm
from fibercontact.problem.hdf5 import full_name, load, open_file, write_array
from fibercontact.problem.incremental import ProblemError, check_finite, check_friction

__all__ = ["OneContacts", "Replay", "compile_replay", "read", "read_counts", "replay", "residuals", "write"]

F64 = NDArray[np.float64]
Strings = NDArray[np.str_]

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of a symmetric block in the order of the file: NN, NT1, NT2, T1T1, T1T2, T2T2."""

WIDTHS = {"mu": (), "W": (6,), "b": (3,), "start": (3,), "answer": (3,)}
"""Datasets of numbers in a file, with the shape of one contact's row."""


@dataclass(frozen=True, eq=False)
class OneContacts:
    """`m` contacts to be solved one by one: find `(u, r)` with `u = W r + b` and Coulomb's law.

    `W` (m, 3, 3) in 1/kg, exactly symmetric, of positive trace; `b` (m, 3) in m/s; `mu` (m,); `start` (m, 3) in
    N·s, the impulse of the last visit; `family` (m,) strings that say where a contact comes from; `answer` (m, 3) in
    N·s, a solution where one is known and NaN elsewhere. Raises `ProblemError` if that is not so.
    """

    W: F64
    b: F64
    mu: F64
    start: F64
    family: Strings
    answer: F64

    def __post_init__(self) -> None:
        check_friction(self.mu)
        shapes = {"W": (self.m, 3, 3), "b": (self.m, 3), "start": (self.m, 3), "answer": (self.m, 3)}
        for name, shape in shapes.items():
            _check_shape(name, getattr(self, name), shape)
        for name, per in (("W", 9), ("b", 3), ("start", 3)):
            check_finite(name, getattr(self, name), per, "contact")
        _check_operators(self.W)
        _check_answers(self.answer)
        if self.family.shape != (self.m,) or self.family.dtype.kind != "U":
            raise ProblemError(f"family must be {self.m} strings, one a contact")

    @property
    def m(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    @cached_property
    def sigma(self) -> F64:
        """`trace(W) / 3`, (m,), in 1/kg: puts impulses into velocity units (THEORY §2)."""
        return np.trace(self.W, axis1=1, axis2=2) / 3

    @cached_property
    def condition(self) -> F64:
        """Condition numbers of `W`, (m,), infinite where the least eigenvalue is not positive to rounding."""
        eigenvalues = np.linalg.eigvalsh(self.W)
        least, largest = eigenvalues[:, 0], eigenvalues[:, 2]
        regular = least > np.finfo(float).eps * largest
        return np.where(regular, largest / np.where(regular, least, 1.0), np.inf)

    def select(self, which: ArrayLike) -> Self:
        """The contacts of a mask, or of a list of indices in its order."""
        return type(self)(*(getattr(self, f.name)[np.asarray(which)] for f in fields(self)))

    @classmethod
    def join(cls, sets: Sequence["OneContacts"]) -> Self:
        """The contacts of several sets (at least one), one set after the other."""
        return cls(*(np.concatenate([getattr(s, f.name) for s in sets]) for f in fields(cls)))


def _check_shape(name: str, x: Any, shape: tuple[int, ...]) -> None:
    if not isinstance(x, np.ndarray) or x.dtype != np.float64:
        raise ProblemError(f"{name} must be a float64 array")
    if x.shape != shape:
        raise ProblemError(f"{name} must have shape {shape} like mu: it has {x.shape}")


def _check_operators(W: F64) -> None:
    symmetric = (W.transpose(0, 2, 1) == W).all(axis=(1, 2))
    if not symmetric.all():
        raise ProblemError(f"W is not symmetric at contact {int(np.argmin(symmetric))}")
    moved = np.trace(W, axis1=1, axis2=2) > 0
    if not moved.all():
        raise ProblemError(f"W has no positive trace at contact {int(np.argmin(moved))}")


def _check_answers(answer: F64) -> None:
    sound = np.isfinite(answer).all(axis=1) | np.isnan(answer).all(axis=1)
    if not sound.all():
        at = int(np.argmin(sound))
        raise ProblemError(
            f"answer must be finite, or NaN throughout where it is not known: see contact {at}"
        )


# The file


def write(
    path: str | os.PathLike[str], contacts: OneContacts, counts: Mapping[str, int] | None = None
) -> None:
    """Write a set to one HDF5 file, whole or not at all, the same bytes for the same input.

    `counts` are integers kept beside it, as attributes: of how many visits the set is a sample, for instance.
    Raises `OSError` if writing fails.
    """
    image = io.BytesIO()
    rows, columns = np.transpose(UPPER)
    families, index = np.unique(contacts.family, return_inverse=True)
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        write_array(file, "W", np.ascontiguousarray(contacts.W[:, rows, columns]))
        for name in ("b", "mu", "start", "answer"):
            write_array(file, name, getattr(contacts, name))
        write_array(file, "family", index.astype(np.int16 if len(families) <= 2**15 else np.int32))
        write_array(file, "families", np.char.encode(families, "utf-8"))
        for name, count in (counts or {}).items():
            file.attrs[name] = int(count)
    replace_file(Path(path), image.getvalue())


def read(path: str | os.PathLike[str]) -> OneContacts:
    """Read a set; raises `ProblemError("PATH: fault")` whatever is wrong with the file."""
    path = Path(path)
    try:
        with open_file(path) as file:
            return _read_file(file)
    except ProblemError as fault:
        raise ProblemError(f"{path}: {fault}") from None


def read_counts(path: str | os.PathLike[str]) -> dict[str, int]:
    """The counts kept in the file of a set; raises `ProblemError("PATH: fault")`."""
    path = Path(path)
    try:
        with open_file(path) as file:
            return {name: int(value) for name, value in file.attrs.items()}
    except ProblemError as fault:
        raise ProblemError(f"{path}: {fault}") from None
    except Exception as fault:  # damaged bytes make h5py raise nearly any kind
        raise ProblemError(f"{path}: the counts cannot be read ({fault})") from None


def _read_file(file: h5py.File) -> OneContacts:
    values = {name: np.asarray(load(file, name, "f", "floating-point numbers")) for name in WIDTHS}
    m = len(values["mu"]) if values["mu"].ndim == 1 else 0
    for name, width in WIDTHS.items():
        if values[name].shape != (m, *width):
            shape = values[name].shape
            raise ProblemError(f"{full_name(file, name)} has shape {shape}, not {(m, *width)} like mu")
        values[name] = np.ascontiguousarray(values[name], dtype=np.float64)
    W = np.empty((m, 3, 3))
    for k, (i, j) in enumerate(UPPER):
        W[:, i, j] = W[:, j, i] = values["W"][:, k]
    return OneContacts(
        W, values["b"], values["mu"], values["start"], _read_families(file, m), values["answer"]
    )


def _read_families(file: h5py.File, m: int) -> Strings:
    names = np.asarray(load(file, "families", "S", "texts"))
    index = np.asarray(load(file, "family", "iu", "integers"))
    if names.ndim != 1 or index.shape != (m,):
        raise ProblemError(f"families and family have shapes {names.shape} and {index.shape}, mu has ({m},)")
    wrong = (index < 0) | (index >= len(names))
    if wrong.any():
        raise ProblemError(f"family {index[np.argmax(wrong)]} of contact {int(np.argmax(wrong))} has no name")
    try:
        return np.char.decode(names, "utf-8")[index] if m else np.empty(0, dtype=np.str_)
    except UnicodeDecodeError:
        raise ProblemError("families holds a name that is not UTF-8") from None


# Replay


class Replay(NamedTuple):
    """What a local solver made of a set: statuses (m,), impulses (m, 3), iterations (m,), seconds in all."""

    status: NDArray[np.int64]
    r: F64
    iterations: NDArray[np.int64]
    seconds: float


@jit
def vector_of(x: F64) -> Vector:
    """A row as a tuple."""
    return (x[0], x[1], x[2])


@jit
def matrix_of(W: F64) -> Matrix:
    """A block as a tuple of rows."""
    return (vector_of(W[0]), vector_of(W[1]), vector_of(W[2]))


@jit
def replay_all(
    kernel: Any,
    options: F64,
    W: F64,
    b: F64,
    mu: F64,
    start: F64,
    status: NDArray[np.int64],
    r: F64,
    iterations: NDArray[np.int64],
) -> None:
    """Solve each contact once, in order, from its own start."""
    for k in range(len(mu)):
        status[k], x, iterations[k] = kernel(
            matrix_of(W[k]), vector_of(b[k]), mu[k], vector_of(start[k]), options
        )
        r[k, 0], r[k, 1], r[k, 2] = x[0], x[1], x[2]


@jit
def residuals_of(W: F64, b: F64, mu: F64, r: F64, facets: int, out: F64) -> None:
    """Write the relative natural map of each contact into `out`, infinite where it is not finite."""
    for k in range(len(mu)):
        A, c, x = matrix_of(W[k]), vector_of(b[k]), vector_of(r[k])
        sigma = (A[0][0] + A[1][1] + A[2][2]) / 3.0
        size = norm(natural_map(affine(A, x, c), x, mu[k], sigma, facets))
        reference = norm(c)
        out[k] = (size / reference if reference > 0.0 else size) if math.isfinite(size) else math.inf


_MATRIX, _COUNTS = types.float64[:, ::1], types.int64[::1]
_SIGNATURE = types.void(
    types.FunctionType(KERNEL_SIGNATURE), types.float64[::1], types.float64[:, :, ::1], _MATRIX,
    types.float64[::1], _MATRIX, _COUNTS, _MATRIX, _COUNTS,
)  # fmt: skip


def compile_replay() -> None:
    """Compile `replay` for every local solver at once, or read it from the disk cache."""
    if config.DISABLE_JIT or replay_all.signatures:
        return
    replay_all.compile(_SIGNATURE)
    replay_all.disable_compile()


def replay(local: Configured, contacts: OneContacts) -> Replay:
    """Solve every contact of a set once with a local solver; what it claims is returned as it is.

    Raises `SolverError` when its kernel does not compile.
    """
    compile_replay()
    kernel, m = local.kernel(), contacts.m
    data = _laid_out(contacts.W, contacts.b, contacts.mu, contacts.start)
    status, r, iterations = np.zeros(m, np.int64), np.zeros((m, 3)), np.zeros(m, np.int64)
    with np.errstate(all="ignore"):  # when interpreted, numpy speaks of what failed solves compute
        began = time.perf_counter()
        replay_all(kernel, local.options, *data, status, r, iterations)
        seconds = time.perf_counter() - began
    return Replay(status, r, iterations, seconds)


def residuals(contacts: OneContacts, r: F64, facets: int = COULOMB) -> F64:
    """Natural map of a law at the impulses `r` (m, 3), (m,): relative to `|b|`, absolute where b = 0 (THEORY §2).

    Infinite where it is not finite. Raises `ProblemError` on a wrong shape.
    """
    _check_shape("r", r, (contacts.m, 3))
    out = np.empty(contacts.m)
    with np.errstate(all="ignore"):
        residuals_of(*_laid_out(contacts.W, contacts.b, contacts.mu, r), facets, out)
    return out


def _laid_out(*arrays: F64) -> list[F64]:
    """The arrays as compiled code wants them, copied only where they are not."""
    return [np.require(x, requirements=["C", "W"]) for x in arrays]
