"""FCLIB files (HDF5): the format in which codes exchange frictional contact problems (THEORY §7).

[Acary et al. 2014] FCLIB: a collection of discrete 3D frictional contact problems, Inria RT-0444. What the
files call `H` is our `Hᵀ`, and their `f` is our `−f`.
"""

import io
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array

from fibercontact.files import replace_file
from fibercontact.problem.constrained import ConstrainedStep
from fibercontact.problem.hdf5 import (
    DEFLATE_LIMIT,
    full_name,
    has,
    load,
    member,
    open_file,
    write_array,
)
from fibercontact.problem.incremental import (
    IncrementalProblem,
    ProblemError,
    check_finite,
    check_vector,
    symmetric_part,
)
from fibercontact.problem.memory import check_memory
from fibercontact.problem.step import StepProblem

__all__ = ["FclibFile", "Solution", "read", "write"]

F64 = NDArray[np.float64]
Ints = NDArray[np.int64]
Sizes = dict[str, int]  # of the vectors of a solution

CSC, CSR = -1, -2  # values of `nz`; any other is the number of entries of a triplet matrix


@dataclass(frozen=True, eq=False)
class Solution:
    """An answer or a guess: velocities `v` (d,), `u` (3n,), impulses `r` (3n,), bilateral multipliers `l`."""

    v: F64 | None = None
    u: F64 | None = None
    r: F64 | None = None
    l: F64 | None = None  # noqa: E741 (FCLIB's name)


@dataclass(frozen=True, eq=False)
class FclibFile:
    """What a file holds: `fclib_local` is an `IncrementalProblem`, `fclib_global` a `StepProblem`.

    Bilateral constraints are eliminated exactly, which leaves an `IncrementalProblem` in both cases; guesses
    and solution are then still in the file's own `v` and `l`. They are what the file claims: check them.
    """

    path: Path
    problem: IncrementalProblem | StepProblem
    guesses: tuple[Solution, ...]
    solution: Solution | None
    title: str
    description: str
    math_info: str

    def incremental(self) -> IncrementalProblem:
        """The problem as `(W, b, mu)`, condensed if need be; raises `ProblemError("PATH: fault")` if it cannot be."""
        if isinstance(self.problem, IncrementalProblem):
            return self.problem
        with _naming(self.path):
            return self.problem.condense()


def read(path: str | os.PathLike[str]) -> FclibFile:
    """Read a problem with its guesses and its solution; a global problem goes before a local one.

    Raises `ProblemError("PATH: fault")` whatever is wrong with the file. A matrix that is asymmetric beyond
    rounding is replaced by its symmetric part with a `ProblemWarning` that says by how much.
    """
    path = Path(path)
    with _naming(path), open_file(path) as file:
        return _read_file(file, path)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Put the path before what is wrong with the file."""
    try:
        yield
    except ProblemError as fault:
        raise ProblemError(f"{path}: {fault}") from None


def write(
    path: str | os.PathLike[str],
    problem: IncrementalProblem | StepProblem,
    *,
    title: str = "",
    description: str = "",
    math_info: str = "",
    guesses: Sequence[Solution] = (),
    solution: Solution | None = None,
) -> None:
    """Write an `fclib_local` or `fclib_global` file, whole or not at all, same bytes for same input.

    The arrays are compressed (gzip, shuffle, checksum), which every HDF5 library from 1.10 on reads. Raises
    `ProblemError` if a guess or the solution does not fit the problem or is not finite, `OSError` if writing fails.
    """
    if problem.n == 0:
        raise ProblemError("a problem without contacts has no place in a file")
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        kind = "fclib_global" if isinstance(problem, StepProblem) else "fclib_local"
        group = file.create_group(kind)
        _write_integer(group, "spacedim", 3)
        if isinstance(problem, StepProblem):
            _write_step(group, problem)
        else:
            _write_incremental(group, problem)
        _write_info(group.create_group("info"), title, description, math_info)
        _write_guesses(file, problem, guesses)
        if solution is not None:
            _write_solution(file.create_group("solution"), problem, solution)
    replace_file(Path(path), image.getvalue())


# Writing


def _write_incremental(group: h5py.Group, problem: IncrementalProblem) -> None:
    _write_csc(group.create_group("W"), problem.W.tocsr())
    vectors = group.create_group("vectors")
    write_array(vectors, "q", problem.b)
    write_array(vectors, "mu", problem.mu)


def _write_step(group: h5py.Group, problem: StepProblem) -> None:
    _write_csc(group.create_group("M"), problem.M)
    _write_csc(group.create_group("H"), problem.H)
    vectors = group.create_group("vectors")
    write_array(vectors, "f", -problem.f)
    write_array(vectors, "w", problem.w)
    write_array(vectors, "mu", problem.mu)


def _write_csc(group: h5py.Group, transpose: csr_array) -> None:
    """Write the transpose of a CSR matrix: its arrays are those of the CSC form."""
    n, m = transpose.shape
    for name, value in (("m", m), ("n", n), ("nzmax", transpose.nnz), ("nz", CSC)):
        _write_integer(group, name, value)
    write_array(group, "p", transpose.indptr.astype(np.int32))
    write_array(group, "i", transpose.indices.astype(np.int32))
    write_array(group, "x", transpose.data)


def _write_info(group: h5py.Group, title: str, description: str, math_info: str) -> None:
    for name, text in (("title", title), ("description", description), ("math_info", math_info)):
        encoded = text.encode()
        group.create_dataset(name, data=np.array(encoded, dtype=f"S{len(encoded) + 1}"))  # C wants the 0 byte


def _write_guesses(
    file: h5py.File, problem: IncrementalProblem | StepProblem, guesses: Sequence[Solution]
) -> None:
    if not guesses:
        return
    group = file.create_group("guesses")
    _write_integer(group, "number_of_guesses", len(guesses))
    for k, guess in enumerate(guesses, start=1):
        _write_solution(group.create_group(str(k)), problem, guess)


def _write_solution(group: h5py.Group, problem: IncrementalProblem | StepProblem, solution: Solution) -> None:
    sizes = {"u": 3 * problem.n, "r": 3 * problem.n}
    if isinstance(problem, StepProblem):
        sizes["v"] = problem.d
    for name, values in vars(solution).items():
        if values is None:
            continue
        if name not in sizes:
            raise ProblemError(f"{full_name(group, name)} has no place beside this problem")
        check_vector(full_name(group, name), values, sizes[name])
        check_finite(full_name(group, name), values, 1, "value")
        write_array(group, name, values)


def _write_integer(group: h5py.Group, name: str, value: int) -> None:
    group.create_dataset(name, data=np.array([value], dtype=np.int32))


# Reading


def _read_file(file: h5py.File, path: Path) -> FclibFile:
    if has(file, "fclib_global"):
        main = member(file, "fclib_global", h5py.Group)
        problem, sizes = _read_global(main, str(path))
    elif has(file, "fclib_local"):
        main = member(file, "fclib_local", h5py.Group)
        problem, sizes = _read_local(main, str(path))
    else:
        raise ProblemError("neither fclib_local nor fclib_global is in it")
    solution = None
    if has(file, "solution"):
        solution = _read_solution(member(file, "solution", h5py.Group), sizes)
    texts = (_read_text(main, name) for name in ("title", "description", "math_info"))
    return FclibFile(path, problem, _read_guesses(file, sizes), solution, *texts)


def _read_local(main: h5py.Group, source: str) -> tuple[IncrementalProblem, Sizes]:
    _check_spacedim(main)
    size = _shape(main, "W")[0]
    vectors = member(main, "vectors", h5py.Group)
    mu = _read_floats(vectors, "mu", _contacts("W", size))
    q = _read_floats(vectors, "q", size)
    W = _read_matrix(main, "W", (size, size))
    sizes = {"u": size, "r": size}
    if has(main, "V") != has(main, "R") or (has(vectors, "s") and not has(main, "R")):
        raise ProblemError("V and R, and vectors/s with them, must all be there or all be absent")
    if has(main, "R") and (bilateral := max(_shape(main, "R")[0], _shape(main, "V")[1])):
        sizes["l"] = bilateral
        s = _read_floats(vectors, "s", bilateral)
        V = _read_matrix(main, "V", (size, bilateral))
        R = _read_matrix(main, "R", (bilateral, bilateral))
        with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is found in the problem
            W, q = _eliminate(W, V, R, q, s)
    return IncrementalProblem.from_sparse(W, q, mu, symmetrise=True, source=source), sizes


def _eliminate(W: csr_array, V: csr_array, R: csr_array, q: F64, s: F64) -> tuple[csr_array, F64]:
    """Eliminate `lambda` from `u = W r + V lambda + q`, `Vᵀ r + R lambda + s = 0`."""
    check_memory("the elimination of bilateral constraints", R.shape[0] * (R.shape[0] + 2 * V.shape[0]))
    dense = R.toarray()
    rank = int(np.linalg.matrix_rank(dense))
    if rank < len(dense):
        raise ProblemError(
            f"bilateral constraints cannot be eliminated: R is singular (rank {rank} of {len(dense)})"
        )
    response = csr_array(np.linalg.solve(dense, V.toarray().T))
    return csr_array(W - V @ response), q - V @ np.linalg.solve(dense, s)


def _read_global(main: h5py.Group, source: str) -> tuple[IncrementalProblem | StepProblem, Sizes]:
    _check_spacedim(main)
    d, size = _shape(main, "H")
    vectors = member(main, "vectors", h5py.Group)
    mu = _read_floats(vectors, "mu", _contacts("H", size))
    w = _read_floats(vectors, "w", size)
    f = _read_floats(vectors, "f", d)
    M = symmetric_part(_read_matrix(main, "M", (d, d)), "M", symmetrise=True, source=source)
    step = StepProblem(M, -f, _read_matrix(main, "H", (d, size)).T.tocsr(), w, mu)
    sizes = {"v": d, "u": size, "r": size}
    if has(vectors, "b") and not has(main, "G"):
        raise ProblemError("G is missing, whose constraints vectors/b belongs to")
    if has(main, "G") and (bilateral := _shape(main, "G")[1]):
        sizes["l"] = bilateral
        b = _read_floats(vectors, "b", bilateral)
        with np.errstate(over="ignore", invalid="ignore"):
            return ConstrainedStep(step, _read_matrix(main, "G", (d, bilateral)), b).condense(), sizes
    _ = step.mobility  # raises if M is not positive definite
    return step, sizes


def _read_guesses(file: h5py.File, sizes: Sizes) -> tuple[Solution, ...]:
    if not has(file, "guesses"):
        return ()
    group = member(file, "guesses", h5py.Group)
    count = _read_integer(group, "number_of_guesses")
    stored = DEFLATE_LIMIT * file.id.get_filesize()
    if not 0 <= 8 * sizes["r"] * count <= stored:
        raise ProblemError(
            f"guesses/number_of_guesses is {count}: more cannot be in the file, nor fewer than none"
        )
    return tuple(_read_solution(member(group, str(k), h5py.Group), sizes) for k in range(1, count + 1))


def _read_solution(group: h5py.Group, sizes: Sizes) -> Solution:
    return Solution(
        **{name: _read_floats(group, name, size) for name, size in sizes.items() if has(group, name)}
    )


def _read_text(main: h5py.Group, name: str) -> str:
    if not has(main, "info") or not has(info := member(main, "info", h5py.Group), name):
        return ""
    text = load(info, name, "SO", "text")
    if not isinstance(text, bytes):
        raise ProblemError(f"{full_name(info, name)} is not one text")
    return text.split(b"\0")[0].decode(errors="replace")


def _check_spacedim(main: h5py.Group) -> None:
    spacedim = _read_integer(main, "spacedim")
    if spacedim != 3:
        raise ProblemError(f"spacedim is {spacedim}: only problems in 3 dimensions can be read")


def _contacts(name: str, size: int) -> int:
    if size == 0:
        raise ProblemError(f"there are no contacts: {name} is empty")
    if size % 3:
        raise ProblemError(f"the size {size} of {name} is not a multiple of 3")
    return size // 3


def _shape(main: h5py.Group, name: str) -> tuple[int, int]:
    group = member(main, name, h5py.Group)
    m, n = _read_integer(group, "m"), _read_integer(group, "n")
    if m < 0 or n < 0:
        raise ProblemError(f"{full_name(main, name)} has a negative size: {m} × {n}")
    return m, n


def _read_matrix(main: h5py.Group, name: str, shape: tuple[int, int]) -> csr_array:
    """Read a matrix, whose `shape` is known from vectors: a wrong size must not become an allocation."""
    m, n = _shape(main, name)
    label = full_name(main, name)
    if (m, n) != shape:
        raise ProblemError(f"{label} is {m} × {n}, not {shape[0]} × {shape[1]}")
    group = member(main, name, h5py.Group)
    nz, nzmax = _read_integer(group, "nz"), _read_integer(group, "nzmax")
    p, i = (_read_indices(group, key) for key in "pi")
    x = _read_floats(group, "x")
    matrix: Any
    if nz >= 0:
        matrix = _triplet(label, p, i, x, shape, nz, nzmax)
    elif nz == CSC:
        matrix = csc_array(_compressed(label, p, i, x, n, m, nzmax), shape)
    elif nz == CSR:
        matrix = csr_array(_compressed(label, p, i, x, m, n, nzmax), shape)
    else:
        raise ProblemError(f"{label}/nz is {nz}: neither triplets (>= 0) nor CSC (-1) nor CSR (-2)")
    matrix.sum_duplicates()
    return csr_array(matrix)


def _triplet(label: str, p: Ints, i: Ints, x: F64, shape: tuple[int, int], nz: int, nzmax: int) -> coo_array:
    """Triplets as they are in the files that exist: `p` is the column, `i` the row."""
    _check_count(label, "nz", nz, nzmax, len(p), len(i), len(x))
    _check_range(f"{label}/i", i[:nz], shape[0])
    _check_range(f"{label}/p", p[:nz], shape[1])
    return coo_array((x[:nz], (i[:nz], p[:nz])), shape)


def _compressed(
    label: str, p: Ints, i: Ints, x: F64, major: int, minor: int, nzmax: int
) -> tuple[F64, Ints, Ints]:
    if len(p) != major + 1:
        raise ProblemError(f"{label}/p has {len(p)} values, not {major + 1}")
    if p[0] != 0 or (np.diff(p) < 0).any():
        raise ProblemError(f"{label}/p does not rise from 0")
    count = int(p[-1])
    _check_count(label, "the last value of p", count, nzmax, len(i), len(x))
    _check_range(f"{label}/i", i[:count], minor)
    return x[:count], i[:count], p


def _check_count(label: str, what: str, count: int, nzmax: int, *lengths: int) -> None:
    if count > min(nzmax, *lengths):
        raise ProblemError(
            f"{label}: {what} is {count}, but nzmax is {nzmax} and the arrays have {lengths} values"
        )


def _check_range(label: str, indices: Ints, size: int) -> None:
    wrong = (indices < 0) | (indices >= size)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ProblemError(f"{label} holds {indices[at]} at {at}, out of range 0 to {size - 1}")


def _read_integer(group: h5py.Group, name: str) -> int:
    value = np.asarray(load(group, name, "iu", "integers"))
    if value.size != 1:
        raise ProblemError(f"{full_name(group, name)} must be one integer: its shape is {value.shape}")
    return int(value.item())


def _read_indices(group: h5py.Group, name: str) -> Ints:
    return _one_dimensional(group, name, np.asarray(load(group, name, "iu", "integers"), dtype=np.int64))


def _read_floats(group: h5py.Group, name: str, size: int | None = None) -> F64:
    values = np.asarray(load(group, name, "f", "floating-point numbers"), dtype=np.float64)
    _one_dimensional(group, name, values)
    label = full_name(group, name)
    if size is not None and len(values) != size:
        raise ProblemError(f"{label} has {len(values)} values, not {size}")
    check_finite(label, values, 1, "value")
    return values


def _one_dimensional(group: h5py.Group, name: str, values: Any) -> Any:
    if values.ndim != 1:
        raise ProblemError(f"{full_name(group, name)} must be one-dimensional: its shape is {values.shape}")
    return values
