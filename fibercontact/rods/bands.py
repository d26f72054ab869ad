"""Symmetric positive definite matrices of few bands, one a rod: Cholesky factors, solves, sparse form.

The lower bands of R matrices (D, D) of half-width w are an array (R, w + 1, D): entry (j + k, j) of a matrix is
`bands[k, j]`, and what would lie outside is zero (the layout of `scipy.linalg.solveh_banded`).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fibercontact.jit import jit_lean

__all__ = ["add_blocks", "cholesky", "solve", "sparse"]

Array = NDArray[np.float64]


def add_blocks(bands: Array, blocks: Array, stride: int) -> None:
    """Add blocks (R, n, m, m) of symmetric matrices, block i at the dofs from `i stride` on, to bands."""
    n, m = blocks.shape[1:3]
    for p in range(m):
        for q in range(p + 1):
            bands[:, p - q, q : q + stride * n : stride] += blocks[:, :, p, q]


def sparse(bands: Array) -> csr_array:
    """Block-diagonal matrix (R D, R D) of all rods; the whole band is stored, zeros too."""
    R, width, D = bands.shape
    first, end = np.maximum(np.arange(D) - width + 1, 0), np.minimum(np.arange(D) + width, D)
    start = np.concatenate([[0], np.cumsum(end - first)])
    row = np.repeat(np.arange(D), end - first)
    column = np.arange(start[-1]) - start[row] + first[row]
    data = bands[:, abs(row - column), np.minimum(row, column)].ravel()
    rods = np.arange(R)[:, None]
    indptr = np.append((rods * start[-1] + start[:-1]).ravel(), R * start[-1])
    return csr_array((data, (rods * D + column).ravel(), indptr), shape=(R * D, R * D))


def times(bands: Array, vector: Array) -> Array:
    """Products (R, D) of symmetric bands and vectors."""
    product = bands[:, 0] * vector
    for k in range(1, min(bands.shape[1], bands.shape[2])):
        product[:, k:] += bands[:, k, :-k] * vector[:, :-k]
        product[:, :-k] += bands[:, k, :-k] * vector[:, k:]
    return np.asarray(product, dtype=np.float64)


def cholesky(bands: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Factors L (R, w + 1, D) with `A = L Lᵀ`, and whether each was found; else A is not positive definite."""
    factor, definite = bands.copy(), np.ones(len(bands), dtype=np.bool_)
    _factorise(factor, definite)
    return factor, definite


@jit_lean
def _factorise(L: Array, definite: NDArray[np.bool_]) -> None:
    R, width, D = L.shape
    for rod in range(R):
        A = L[rod]
        for j in range(D):
            pivot = A[0, j]
            least = 2.0**-50 * pivot
            for k in range(max(0, j - width + 1), j):
                pivot -= A[j - k, k] ** 2
            if not (pivot > least and pivot < np.inf):
                definite[rod] = False
                break
            A[0, j] = np.sqrt(pivot)
            for i in range(j + 1, min(D, j + width)):
                for k in range(max(0, i - width + 1), j):
                    A[i - j, j] -= A[i - k, k] * A[j - k, k]
                A[i - j, j] /= A[0, j]


def solve(factor: Array, rhs: Array) -> Array:
    """`A⁻¹ rhs` for right-hand sides (R, D, c)."""
    x = np.array(rhs)
    _solve(factor, x)
    return x


@jit_lean
def _solve(L: Array, x: Array) -> None:
    R, width, D = L.shape
    for rod in range(R):
        A = L[rod]
        for c in range(x.shape[2]):
            y = x[rod, :, c]
            for i in range(D):
                for k in range(max(0, i - width + 1), i):
                    y[i] -= A[i - k, k] * y[k]
                y[i] /= A[0, i]
            for i in range(D - 1, -1, -1):
                for k in range(i + 1, min(D, i + width)):
                    y[i] -= A[k - i, i] * y[k]
                y[i] /= A[0, i]
