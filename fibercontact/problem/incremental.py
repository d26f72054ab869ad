"""The incremental problem `(W, b, mu)` of THEORY §1: find `u = W r + b` that obeys Coulomb's law."""

import hashlib
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import bsr_array, csr_array

from fibercontact.errors import UserError
from fibercontact.jit import jit

__all__ = [
    "IncrementalProblem",
    "ProblemError",
    "ProblemWarning",
    "check_csr",
    "check_finite",
    "check_friction",
    "check_vector",
    "symmetric_part",
]

F64 = NDArray[np.float64]
Index = NDArray[np.int32]

ROUNDING = 1e-12  # relative asymmetry that is put down to rounding
ASYMMETRY_LIMIT = 1e-2  # beyond it the average of a matrix and its transpose is another problem


class ProblemError(UserError):
    """A problem that is not one; the message names the fault and where it is."""


class ProblemWarning(UserWarning):
    """A problem that had to be altered to be one; the message says by how much."""


@dataclass(frozen=True, eq=False)
class IncrementalProblem:
    """An incremental problem: find `(u, r)` with `u = W r + b` and Coulomb's law at each of `n` contacts.

    `W` (3n, 3n) in 1/kg: BSR of 3×3 blocks with sorted indices, exactly symmetric, every diagonal block
    stored. `b` (3n,) in m/s, the velocity without contact. `mu` (n,), the friction coefficients. Raises
    `ProblemError` if that is not so; `from_sparse` takes other forms of `W`.
    """

    W: bsr_array
    b: F64
    mu: F64

    def __post_init__(self) -> None:
        check_friction(self.mu)
        check_vector("b", self.b, 3 * self.n)
        check_finite("b", self.b, 3, "contact")
        if not np.isfinite(self.b_ref) or (self.b_ref == 0 and self.b.any()):
            raise ProblemError(
                f"b, up to {np.abs(self.b).max():g} m/s, cannot be squared in double precision"
            )
        _check_layout(self.W, self.n)
        _check_operator(self.W)

    @classmethod
    def from_sparse(
        cls, W: Any, b: ArrayLike, mu: ArrayLike, symmetrise: bool = False, source: str = ""
    ) -> Self:
        """Make a problem of any sparse (or dense) `W`; `symmetrise` and `source` as in `symmetric_part`."""
        csr = csr_array(W, dtype=np.float64)
        csr.sum_duplicates()
        rows, columns = csr.shape
        if rows != columns or rows % 3:
            raise ProblemError(f"W must be square, its size a multiple of 3: it is {rows} × {columns}")
        check_finite("W", csr.data, 1, "stored value")
        blocks = bsr_array(symmetric_part(csr, "W", symmetrise, source).tobsr((3, 3)))
        blocks.sort_indices()
        return cls(blocks, np.asarray(b, dtype=np.float64), np.asarray(mu, dtype=np.float64))

    @property
    def n(self) -> int:
        """Number of contacts."""
        return len(self.mu)

    @cached_property
    def diagonal(self) -> F64:
        """The blocks `W_ii`, (n, 3, 3)."""
        return self.W.data[_diagonal_positions(self.W.indptr, self.W.indices)]

    @cached_property
    def sigma(self) -> F64:
        """`trace(W_ii) / 3`, (n,), in 1/kg: puts impulses into velocity units (THEORY §2)."""
        return np.trace(self.diagonal, axis1=1, axis2=2) / 3

    @cached_property
    def b_ref(self) -> float:
        """`sqrt(mean_i ‖b_i‖²)` in m/s, 0 without contacts."""
        with np.errstate(over="ignore"):  # no BLAS: after a long product its threads spin beside the sweeps
            return float(np.sqrt(np.square(self.b).sum() / max(self.n, 1)))

    def content_hash(self) -> str:
        """SHA-256 of sizes, non-zero blocks of `W`, `b` and `mu`: the same for equal problems."""
        stored = self.W.data.any(axis=(1, 2))
        row = np.repeat(np.arange(self.n), np.diff(self.W.indptr))[stored]
        digest = hashlib.sha256(f"incremental problem {self.n} {len(row)}\n".encode())
        for indices in (row, self.W.indices[stored]):
            digest.update(indices.astype("<i8").tobytes())
        for values in (self.W.data[stored], self.b, self.mu):
            digest.update((values + 0.0).astype("<f8").tobytes())  # + 0.0: −0 and 0 are one number
        return digest.hexdigest()


def check_vector(name: str, x: Any, size: int) -> None:
    """Raise `ProblemError` unless `x` is a float64 array of shape (size,)."""
    if not isinstance(x, np.ndarray) or x.dtype != np.float64:
        raise ProblemError(f"{name} must be a float64 array")
    if x.shape != (size,):
        raise ProblemError(f"{name} must have shape ({size},): it has {x.shape}")


def check_finite(name: str, values: F64, per: int, unit: str) -> None:
    """Raise `ProblemError` if a value is NaN or infinite, naming the `unit` of `per` values."""
    finite = np.isfinite(values)
    if not finite.all():
        at = int(np.argmin(finite))
        raise ProblemError(f"{name} is not finite ({values.flat[at]}) at {unit} {at // per}")


def check_csr(name: str, A: Any, shape: tuple[int, int]) -> None:
    """Raise `ProblemError` unless `A` is a float64 CSR array of that shape, its stored values finite."""
    if getattr(A, "format", None) != "csr" or A.dtype != np.float64:
        raise ProblemError(f"{name} must be a float64 CSR array")
    if A.shape != shape:
        raise ProblemError(f"{name} must have shape {shape}: it has {A.shape}")
    check_finite(name, A.data, 1, "stored value")


def check_friction(mu: Any) -> None:
    """Raise `ProblemError` unless `mu` is a vector of finite coefficients >= 0, one a contact."""
    check_vector("mu", mu, len(mu) if np.ndim(mu) == 1 else 0)
    check_finite("mu", mu, 1, "contact")
    if (mu < 0).any():
        at = int(np.argmax(mu < 0))
        raise ProblemError(f"mu is negative ({mu[at]}) at contact {at}")


def symmetric_part(A: csr_array, name: str, symmetrise: bool = False, source: str = "") -> csr_array:
    """Return `A` exactly symmetric.

    Rounding (a relative asymmetry `max|A − Aᵀ| / max|A|` up to 1e-12) is averaged away. More raises
    `ProblemError`, or up to 1e-2 with `symmetrise` a `ProblemWarning` only, which names `source` (a file).
    """
    if A.has_canonical_format and _asymmetric_block(A.indptr, A.indices, A.data.reshape(-1, 1, 1)) < 0:
        return A
    gap = float(abs(A - A.T).max()) if A.nnz else 0.0
    if gap == 0:
        return A
    gap /= float(abs(A).max())
    if gap > ASYMMETRY_LIMIT or (gap > ROUNDING and not symmetrise):
        raise ProblemError(f"{name} is not symmetric: relative asymmetry {gap:.1e}")
    if gap > ROUNDING:
        place = f"{source}: {name}" if source else name
        message = f"{place} is asymmetric by {gap:.1e} (relative), replaced by its symmetric part"
        warnings.warn(message, ProblemWarning, stacklevel=3)
    return csr_array(0.5 * (A + A.T))


def _check_layout(W: Any, n: int) -> None:
    if getattr(W, "format", None) != "bsr" or W.blocksize != (3, 3) or W.dtype != np.float64:
        raise ProblemError("W must be a float64 BSR array of 3×3 blocks (see IncrementalProblem.from_sparse)")
    if W.shape != (3 * n, 3 * n):
        raise ProblemError(f"W must have shape ({3 * n}, {3 * n}) for {n} contacts: it has {W.shape}")
    if not W.has_sorted_indices:
        raise ProblemError("the block indices of W must be sorted")


def _check_operator(W: bsr_array) -> None:
    row = np.repeat(np.arange(len(W.indptr) - 1), np.diff(W.indptr))
    if not (finite := np.isfinite(W.data)).all():
        at = int(np.argmin(finite)) // 9
        raise ProblemError(f"W is not finite in the block of contacts {row[at]} and {W.indices[at]}")
    positions = _diagonal_positions(W.indptr, W.indices)
    if (positions < 0).any():
        raise ProblemError(f"W has no diagonal block at contact {int(np.argmax(positions < 0))}")
    with np.errstate(over="ignore"):
        trace = np.trace(W.data[positions], axis1=1, axis2=2)
    moved = (trace > 0) & (trace < np.inf)
    if not moved.all():
        at = int(np.argmin(moved))
        raise ProblemError(
            f"the diagonal block of W at contact {at} is zero or has no positive trace that is finite"
        )
    at = _asymmetric_block(W.indptr, W.indices, W.data)
    if at >= 0:
        raise ProblemError(f"W is not symmetric: see the blocks of contacts {row[at]} and {W.indices[at]}")


@jit
def _find(indices: Index, start: int, end: int, j: int) -> int:
    """Position of `j` in the sorted `indices[start:end]`, −1 if it is not there."""
    at = start + int(np.searchsorted(indices[start:end], j))
    return at if at < end and indices[at] == j else -1


@jit
def _diagonal_positions(indptr: Index, indices: Index) -> NDArray[np.int64]:
    positions = np.empty(len(indptr) - 1, dtype=np.int64)
    for i in range(len(positions)):
        positions[i] = _find(indices, indptr[i], indptr[i + 1], i)
    return positions


@jit
def _asymmetric_block(indptr: Index, indices: Index, data: F64) -> int:
    """Position of a block that is not exactly the transpose of its mirror image, −1 if none; indices are sorted.

    Row after row, the mirror images of its blocks above the diagonal are the next blocks of their rows.
    """
    mirror = indptr[:-1].copy()
    for i in range(len(mirror)):
        for at in range(indptr[i], indptr[i + 1]):
            j = indices[at]
            if j < i:
                if at >= mirror[i]:
                    return at
                continue
            image = mirror[j] if j > i else at
            if image == indptr[j + 1] or indices[image] > i:
                return at
            if indices[image] < i:
                return image
            mirror[j] = image + 1
            for a in range(data.shape[1]):
                for c in range(data.shape[2]):
                    if data[at, a, c] != data[image, c, a]:
                        return at
    return -1
