"""An incremental problem laid out for sweeps, and the velocity and residual of an impulse on that layout."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array

from fibercontact.gauss_seidel.parts import Parts, divide
from fibercontact.gauss_seidel.team import Team, alone, share, wait
from fibercontact.gauss_seidel.vectors import PAD, STRIDE, add_block
from fibercontact.jit import jit, jit_lean, jit_sum
from fibercontact.problem.cone import COULOMB, natural_map
from fibercontact.problem.incremental import IncrementalProblem

__all__ = [
    "BlockSystem", "block_system", "flush", "matrix", "new_velocity", "push", "residual_from", "root_mean_square",
    "squares", "velocity", "write_velocity",
]  # fmt: skip

Array = NDArray[np.float64]


class BlockSystem(NamedTuple):
    """An incremental problem laid out for sweeps: its block rows one after the other."""

    starts: NDArray[np.int32]  # (n+1,) first block of each row
    columns: NDArray[np.int32]  # (blocks,)
    blocks: Array  # (9 blocks + PAD,) row by row
    diagonal: Array  # (n, 9)
    sigma: Array  # (n,)
    b: Array  # (3n,)
    mu: Array  # (n,)
    parts: Parts


def block_system(problem: IncrementalProblem) -> BlockSystem:
    """Lay a problem out for sweeps, and divide it; one copy of the blocks."""
    W = problem.W
    starts, columns = W.indptr.astype(np.int32), W.indices.astype(np.int32)
    blocks = np.zeros(9 * len(columns) + PAD)
    blocks[: 9 * len(columns)] = np.ravel(W.data)
    diagonal = np.ascontiguousarray(problem.diagonal.reshape(problem.n, 9))
    parts = divide(starts, columns)
    return BlockSystem(starts, columns, blocks, diagonal, problem.sigma, problem.b, problem.mu, parts)


def matrix(s: BlockSystem, blocks: Array) -> csr_array:
    """The sparse matrix (3n, 3n) of such blocks in the places of those of W."""
    data = np.reshape(blocks[: 9 * len(s.columns)], (-1, 3, 3))
    return csr_array(bsr_array((data, s.columns, s.starts), shape=2 * (len(s.b),)))


def new_velocity(parts: Parts) -> Array:
    """Room for the velocities of all contacts, four numbers apart, and for the slots after them."""
    return np.zeros(STRIDE * (len(parts.order) + len(parts.slots)))


@jit
def flush(parts: Parts, phase: int, team: Team, u: Array) -> None:
    """End a phase of a sweep: add up what its parts have pushed on the same contacts."""
    wait(team)
    first, end = parts.flushes[phase], parts.flushes[phase + 1]
    if first == end:
        return
    slots, n = parts.slots, len(parts.order)
    mine, others = share(end - first, team)
    for k in range(_whole(slots, first, first + mine, end), _whole(slots, first, first + others, end)):
        at, slot = STRIDE * slots[k], STRIDE * (n + k)
        for a in range(3):
            u[at + a] += u[slot + a]
            u[slot + a] = 0.0
    wait(team)


@jit
def _whole(slots: NDArray[np.int32], first: int, k: int, end: int) -> int:
    """Slot k of `first..end`, moved back to where the slots of its contact begin: a contact's are not shared out."""
    while first < k < end and slots[k] == slots[k - 1]:
        k -= 1
    return k


@jit_lean
def push_impulses(
    s: BlockSystem,
    order: NDArray[np.int32],
    targets: NDArray[np.int32],
    first: int,
    end: int,
    r: Array,
    some: NDArray[np.uint8],
    u: Array,
) -> None:
    """`u += W_:i r_i` for the visits `first..end`; `W` is symmetric, so block row i serves as block column i."""
    starts, blocks, eight, visit = s.starts, s.blocks, some.view(np.uint64), first
    while visit < end:
        if len(some) > 0 and some[visit] == 0:
            visit += 8 if visit % 8 == 0 and eight[visit // 8] == 0 else 1
            continue
        i = order[visit]
        visit += 1
        r0, r1, r2 = r[3 * i], r[3 * i + 1], r[3 * i + 2]
        if r0 != 0.0 or r1 != 0.0 or r2 != 0.0:
            for j in range(starts[i], starts[i + 1]):
                add_block(u, STRIDE * targets[j], blocks, 9 * j, r0, r1, r2)


@jit
def write_velocity(s: BlockSystem, parts: Parts, r: Array, team: Team, u: Array) -> None:
    """Write `W r + b` into `u`, which the whole team needs; contacts without impulse cost nothing."""
    first, end = share(len(s.mu), team)
    b = s.b
    for i in range(first, end):
        u[STRIDE * i], u[STRIDE * i + 1], u[STRIDE * i + 2] = b[3 * i], b[3 * i + 1], b[3 * i + 2]
    wait(team)
    push(s, parts, r, np.zeros(0, np.uint8), team, u)


@jit
def push(s: BlockSystem, parts: Parts, r: Array, some: NDArray[np.uint8], team: Team, u: Array) -> None:
    """Add `W r` to `u`, which the whole team needs, with the impulses of `some` visits, or of all (0,).

    `some` is 1 at these, 0 elsewhere, and as long as a multiple of eight. Contacts without impulse cost nothing.
    """
    for phase in range(len(parts.phases) - 1):
        for part in range(parts.phases[phase], parts.phases[phase + 1]):
            if team.owner[part] == team.rank:
                push_impulses(
                    s, parts.order, parts.targets, parts.parts[part], parts.parts[part + 1], r, some, u
                )
        flush(parts, phase, team, u)


@jit_sum
def _squares(
    mu: Array, sigma: Array, r: Array, u: Array, stride: int, facets: int, first: int, end: int
) -> float:
    total = 0.0
    for i in range(first, end):
        k, at = 3 * i, stride * i
        e = natural_map((u[at], u[at + 1], u[at + 2]), (r[k], r[k + 1], r[k + 2]), mu[i], sigma[i], facets)
        total += e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    return total


@jit_lean
def squares(s: BlockSystem, r: Array, u: Array, stride: int, facets: int, first: int, end: int) -> float:
    """Sum of the squares of the natural map over the contacts `first..end`."""
    if facets == COULOMB and stride == STRIDE:  # with these known, several contacts at a time
        return _squares(s.mu, s.sigma, r, u, STRIDE, COULOMB, first, end)
    return _squares(s.mu, s.sigma, r, u, stride, facets, first, end)


@jit
def root_mean_square(total: float, n: int) -> float:
    """Of n contacts."""
    return math.sqrt(total / max(1, n))


@jit
def velocity(s: BlockSystem, r: Array, u: Array) -> None:
    """Write `W r + b` into `u` (3n,)."""
    n = len(s.mu)
    spread = np.zeros(STRIDE * (n + len(s.parts.slots)))
    write_velocity(s, s.parts, r, alone(len(s.parts.parts) - 1), spread)
    for i in range(n):
        for a in range(3):
            u[3 * i + a] = spread[STRIDE * i + a]


@jit
def residual_from(s: BlockSystem, r: Array, u: Array, facets: int) -> float:
    """Root mean square over the contacts of the natural map at the velocity `u` (3n,), in its unit (THEORY §2)."""
    return root_mean_square(squares(s, r, u, 3, facets, 0, len(s.mu)), len(s.mu))
