"""`M⁻¹` of a step, rod by rod: an envelope Cholesky factor, and the Delassus operator `H M⁻¹ Hᵀ` from it."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import connected_components

from fibercontact.jit import jit, jit_lean
from fibercontact.problem.incremental import ProblemError
from fibercontact.problem.memory import check_memory
from fibercontact.threads import over_ranges

__all__ = ["Mobility"]

F64 = NDArray[np.float64]
Index = NDArray[Any]

_CONTACTS = 512  # of a range, for a thread


class Factor(NamedTuple):
    """Cholesky factor `L` of `M`, each row stored from its first non-zero on, dofs numbered rod by rod."""

    place: Index  # (d,) number of a dof in the factor
    rod: Index  # (d,) rod of a row
    end: Index  # (d,) one past the last row of the row's rod
    first: Index  # (d,) first column of a row
    row: Index  # (d,) L_ij is L[row[i] + j]
    L: F64


class Arms(NamedTuple):
    """The lever arms of the contacts: one for each pair of a contact and a rod that it moves."""

    start: Index  # (n + 1,) arms of contact i are start[i] to start[i + 1]
    contact: Index  # (arms,)
    rod: Index  # (arms,)
    first: Index  # (arms,) first row of the factor that the contact reaches


class Mobility:
    """`M⁻¹` of a symmetric positive definite `M` (CSR), as a Cholesky factor.

    The rods are the connected components of `M`. Within a rod the factor fills the envelope of `M` only, so
    dense blocks and long banded ones both cost what they must. Raises `ProblemError` naming the rod and the
    degree of freedom at which `M` is not positive definite.
    """

    def __init__(self, M: csr_array) -> None:
        _, rod_of_dof = connected_components(M, directed=False)
        order = np.argsort(rod_of_dof, kind="stable")
        rod = rod_of_dof[order].astype(np.int64)
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        end = np.searchsorted(rod, rod, side="right")
        first = _envelope(M.indptr, M.indices, place)
        start = np.cumsum(np.arange(len(order)) - first + 1)
        size = int(start[-1]) if len(start) else 0
        check_memory("the factor of M", size)
        L = np.zeros(size)
        self.factor = Factor(place, rod, end, first, start - np.arange(len(order)) - 1, L)
        _scatter(M.indptr, M.indices, M.data, self.factor)
        fault = _factorise(self.factor)
        if fault >= 0:
            raise ProblemError(
                f"M is not positive definite: rod {rod[fault]}, degree of freedom {order[fault]}"
            )

    def solve(self, x: F64) -> F64:
        """`M⁻¹ x`, (d,)."""
        return _solve(self.factor, np.asarray(x, dtype=np.float64))

    def delassus(self, H: csr_array) -> bsr_array:
        """`H M⁻¹ Hᵀ` in 3×3 blocks, exactly symmetric, for `H` (3n, d): `Yᵀ Y` with `Y = L⁻¹ Hᵀ`."""
        n = H.shape[0] // 3
        arms = _find_arms(H.indptr, H.indices, n, self.factor)
        start = _starts(arms, self.factor)
        check_memory("H M⁻¹ Hᵀ", 3 * int(start[-1]))
        Y = np.zeros((start[-1], 3))

        def respond(begin: int, stop: int) -> None:
            arm_on = np.empty(len(self.factor.rod), dtype=np.int64)
            _half_responses(H.indptr, H.indices, H.data, arms, self.factor, start, Y, arm_on, begin, stop)

        over_ranges(respond, n, _CONTACTS)
        by_rod = _group_by_rod(arms, len(self.factor.rod))
        check_memory("W", 9 * _fewest_blocks(arms, by_rod))
        indptr, indices = _pattern(arms, by_rod)
        data = np.zeros((len(indices), 3, 3))

        def fill(begin: int, stop: int) -> None:
            block = np.empty(n, dtype=np.int64)
            _upper_blocks(arms, start, Y, by_rod, indptr, indices, data, block, begin, stop)

        over_ranges(fill, n, _CONTACTS)
        _mirror_blocks(indptr, indices, data)
        return bsr_array((data, indices, indptr), shape=(3 * n, 3 * n))


@jit
def _envelope(indptr: Index, indices: Index, place: Index) -> Index:
    first = np.arange(len(place))
    for dof in range(len(place)):
        i = place[dof]
        for at in range(indptr[dof], indptr[dof + 1]):
            first[i] = min(first[i], place[indices[at]])
    return first


@jit
def _scatter(indptr: Index, indices: Index, values: F64, factor: Factor) -> None:
    """Copy the lower triangle of `M` into the factor's storage."""
    for dof in range(len(factor.place)):
        i = factor.place[dof]
        for at in range(indptr[dof], indptr[dof + 1]):
            j = factor.place[indices[at]]
            if j <= i:
                factor.L[factor.row[i] + j] += values[at]


@jit
def _factorise(factor: Factor) -> int:
    """Cholesky in place, row by row; returns the row whose pivot is not positive beyond rounding, or −1."""
    first, row, L = factor.first, factor.row, factor.L
    for i in range(len(first)):
        pivot = L[row[i] + i]
        least = 2.0**-50 * pivot
        for j in range(first[i], i):
            s = L[row[i] + j]
            for k in range(max(first[i], first[j]), j):
                s -= L[row[i] + k] * L[row[j] + k]
            s /= L[row[j] + j]
            L[row[i] + j] = s
            pivot -= s * s
        if not (pivot > least and pivot < np.inf):
            return i
        L[row[i] + i] = np.sqrt(pivot)
    return -1


@jit
def _solve(factor: Factor, x: F64) -> F64:
    place, first, row, L = factor.place, factor.first, factor.row, factor.L
    y = np.empty(len(place))
    for dof in range(len(place)):
        y[place[dof]] = x[dof]
    for i in range(len(y)):
        for j in range(first[i], i):
            y[i] -= L[row[i] + j] * y[j]
        y[i] /= L[row[i] + i]
    for i in range(len(y) - 1, -1, -1):
        y[i] /= L[row[i] + i]
        for j in range(first[i], i):
            y[j] -= L[row[i] + j] * y[i]
    return y[place]


@jit
def _find_arms(indptr: Index, indices: Index, n: int, factor: Factor) -> Arms:
    start = np.zeros(n + 1, dtype=np.int64)
    contact = np.empty(len(indices), dtype=np.int64)
    rod = np.empty(len(indices), dtype=np.int64)
    first = np.empty(len(indices), dtype=np.int64)
    latest = np.full(len(factor.rod), -1)  # the latest arm on a rod
    count = 0
    for i in range(n):
        start[i] = count
        for at in range(indptr[3 * i], indptr[3 * i + 3]):
            p = factor.place[indices[at]]
            arm = latest[factor.rod[p]]
            if arm < start[i]:
                arm = count
                contact[arm], rod[arm], first[arm] = i, factor.rod[p], p
                latest[factor.rod[p]] = arm
                count += 1
            first[arm] = min(first[arm], p)
    start[n] = count
    return Arms(start, contact[:count], rod[:count], first[:count])


@jit
def _starts(arms: Arms, factor: Factor) -> Index:
    """Where each arm has its rows of `Y = L⁻¹ Hᵀ`, one for each dof from its first to the end of its rod."""
    start = np.zeros(len(arms.rod) + 1, dtype=np.int64)
    for a in range(len(arms.rod)):
        start[a + 1] = start[a] + factor.end[arms.first[a]] - arms.first[a]
    return start


@jit_lean
def _half_responses(
    indptr: Index,
    indices: Index,
    values: F64,
    arms: Arms,
    factor: Factor,
    start: Index,
    Y: F64,
    arm_on: Index,
    begin: int,
    stop: int,
) -> None:
    """Fill the rows of `Y = L⁻¹ Hᵀ`, zero before, of the arms of the contacts in begin..stop.

    `arm_on` (rods,), work space, is the arm of the contact at hand on each of its rods.
    """
    for i in range(begin, stop):
        for a in range(arms.start[i], arms.start[i + 1]):
            arm_on[arms.rod[a]] = a
        for axis in range(3):
            for at in range(indptr[3 * i + axis], indptr[3 * i + axis + 1]):
                p = factor.place[indices[at]]
                a = arm_on[factor.rod[p]]
                Y[start[a] + p - arms.first[a], axis] += values[at]
        for a in range(arms.start[i], arms.start[i + 1]):
            _forward(factor, arms.first[a], Y[start[a] : start[a + 1]])


@jit_lean
def _forward(factor: Factor, begin: int, y: F64) -> None:
    """`y ← L⁻¹ y` for three right-hand sides that are zero before row `begin` of the factor."""
    for i in range(begin, begin + len(y)):
        y0, y1, y2 = y[i - begin, 0], y[i - begin, 1], y[i - begin, 2]
        for j in range(max(factor.first[i], begin), i):
            l_ij = factor.L[factor.row[i] + j]
            y0 -= l_ij * y[j - begin, 0]
            y1 -= l_ij * y[j - begin, 1]
            y2 -= l_ij * y[j - begin, 2]
        l_ii = factor.L[factor.row[i] + i]
        y[i - begin, 0], y[i - begin, 1], y[i - begin, 2] = y0 / l_ii, y1 / l_ii, y2 / l_ii


class ByRod(NamedTuple):
    """The arms sorted by rod and then by contact."""

    arm: Index  # (arms,)
    position: Index  # (arms,) of an arm in `arm`
    start: Index  # (rods + 1,) arms of a rod are arm[start[rod]:start[rod + 1]]


@jit
def _group_by_rod(arms: Arms, rods: int) -> ByRod:
    start = np.zeros(rods + 1, dtype=np.int64)
    for rod in arms.rod:
        start[rod + 1] += 1
    start = np.cumsum(start)
    by_rod = np.empty(len(arms.rod), dtype=np.int64)
    position = np.empty(len(arms.rod), dtype=np.int64)
    fill = start.copy()
    for a in range(len(arms.rod)):
        position[a] = fill[arms.rod[a]]
        by_rod[position[a]] = a
        fill[arms.rod[a]] += 1
    return ByRod(by_rod, position, start)


def _fewest_blocks(arms: Arms, by_rod: ByRod) -> int:
    """A bound from below on the blocks of `W`: contacts on one rod meet, and share as many rods as they have arms."""
    on_rod, arms_of = np.diff(by_rod.start), np.diff(arms.start)
    return int((on_rod**2).sum()) // int(arms_of.max(initial=1))


@jit
def _neighbours(arms: Arms, by_rod: ByRod, j: int, seen: Index, found: Index) -> int:
    """Put the contacts that share a rod with contact `j`, itself included, into `found`; their number."""
    count = 0
    for a in range(arms.start[j], arms.start[j + 1]):
        for at in range(by_rod.start[arms.rod[a]], by_rod.start[arms.rod[a] + 1]):
            i = arms.contact[by_rod.arm[at]]
            if seen[i] != j:
                seen[i] = j
                found[count] = i
                count += 1
    return count


@jit
def _pattern(arms: Arms, by_rod: ByRod) -> tuple[Index, Index]:
    """Block structure of `W`; filled by columns, so that the indices of each row come out sorted."""
    n = len(arms.start) - 1
    found = np.empty(n, dtype=np.int64)
    indptr = np.zeros(n + 1, dtype=np.int32)
    seen = np.full(n, -1)
    for j in range(n):
        indptr[j + 1] = indptr[j] + _neighbours(arms, by_rod, j, seen, found)
    indices = np.empty(indptr[n], dtype=np.int32)
    fill = indptr.copy()
    seen[:] = -1
    for j in range(n):
        for i in found[: _neighbours(arms, by_rod, j, seen, found)]:
            indices[fill[i]] = j
            fill[i] += 1
    return indptr, indices


@jit_lean
def _upper_blocks(
    arms: Arms,
    start: Index,
    Y: F64,
    by_rod: ByRod,
    indptr: Index,
    indices: Index,
    data: F64,
    block: Index,
    begin: int,
    stop: int,
) -> None:
    """Fill the blocks `W_ij = Σ_rods Y_iᵀ Y_j`, zero before, of the rows i in begin..stop with j >= i.

    `block` (n,), work space, is where block (i, j) of the current row is.
    """
    for i in range(begin, stop):
        for at in range(indptr[i], indptr[i + 1]):
            block[indices[at]] = at
        for a in range(arms.start[i], arms.start[i + 1]):
            for at in range(by_rod.position[a], by_rod.start[arms.rod[a] + 1]):
                c = by_rod.arm[at]
                first = max(arms.first[a], arms.first[c])
                Y_a = Y[start[a] + first - arms.first[a] : start[a + 1]]
                Y_c = Y[start[c] + first - arms.first[c] : start[c + 1]]
                _add_product(Y_a, Y_c, data[block[arms.contact[c]]])


@jit
def _mirror_blocks(indptr: Index, indices: Index, data: F64) -> None:
    """Copy the blocks above the diagonal to their mirror images below."""
    mirror = indptr.copy()
    for i in range(len(indptr) - 1):
        for at in range(indptr[i], indptr[i + 1]):
            j = indices[at]
            if j > i:
                for a in range(3):
                    for c in range(3):
                        data[mirror[j], a, c] = data[at, c, a]
                mirror[j] += 1


@jit_lean
def _add_product(A: F64, B: F64, block: F64) -> None:
    """`block += Aᵀ B` for two arrays of rows of three."""
    for i in range(3):
        x, y, z = block[i, 0], block[i, 1], block[i, 2]
        for k in range(len(A)):
            x += A[k, i] * B[k, 0]
            y += A[k, i] * B[k, 1]
            z += A[k, i] * B[k, 2]
        block[i, 0], block[i, 1], block[i, 2] = x, y, z
