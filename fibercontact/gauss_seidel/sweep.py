"""One block Gauss–Seidel sweep over any local solver, in push form.

The relative velocity `u = W r + b` is kept up to date: a visit reads `u_i`, solves its contact, and adds
`W_:i Δr_i` to its neighbours. A visit that changes nothing that matters costs no memory traffic.

The local solver comes in as a function of fixed signature, so this file is compiled once for all of them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.visit_log import VisitLog, end_sweep, record
from fibercontact.jit import jit
from fibercontact.local.algebra import OPEN, SLIP, STICK
from fibercontact.local.contract import Matrix, Status
from fibercontact.problem.cone import Vector, natural_map, norm, project
from fibercontact.problem.incremental import IncrementalProblem

__all__ = [
    "COUNTERS",
    "LAST_FAILURE",
    "BlockSystem",
    "Sweeper",
    "block_system",
    "residual_from",
    "sweep",
    "velocity",
]

CONVERGED, FIRST_FAILURE, LAST_FAILURE = int(Status.CONVERGED), int(Status.ITERATIONS), int(Status.NOT_FINITE)
COUNTERS = LAST_FAILURE + 5
"""Counters of the visits: one a status, then open, stick, slip, and local iterations."""

STICK_MARGIN = 1.0 - 1e-9
"""Share of `mu r_N` below which `|r_T|` counts as stick in the statistics."""


class BlockSystem(NamedTuple):
    """An incremental problem laid out for sweeps: block row i is a contiguous 3 × 3k array."""

    starts: NDArray[np.int32]  # (n+1,) first block of each row
    columns: NDArray[np.int32]  # (blocks,)
    rows: NDArray[np.float64]  # (9 blocks,) row i: rows[9 starts[i] + 3k c + 3j + a] = W[i c, columns_j a]
    diagonal: NDArray[np.float64]  # (n, 9)
    sigma: NDArray[np.float64]  # (n,)
    b: NDArray[np.float64]  # (3n,)
    mu: NDArray[np.float64]  # (n,)


class Sweeper(NamedTuple):
    """What a run of sweeps is asked to do."""

    facets: int  # of the law that stops the run
    negligible: float  # change of sigma_i r_i that is not worth a push
    target: float  # residual to reach, in the unit of b
    check_every: int  # sweeps between two evaluations of the residual
    period: int  # sweeps a map of the Anderson acceleration, 0 for none
    tikhonov: float  # of the acceleration


@jit
def dense_rows(starts: NDArray[np.int32], blocks: NDArray[np.float64], rows: NDArray[np.float64]) -> None:
    """Copy BSR blocks (blocks, 3, 3) into contiguous 3 × 3k block rows."""
    for i in range(len(starts) - 1):
        first, width = starts[i], 3 * (starts[i + 1] - starts[i])
        for j in range(starts[i], starts[i + 1]):
            for c in range(3):
                for a in range(3):
                    rows[9 * first + width * c + 3 * (j - first) + a] = blocks[j, c, a]


def block_system(problem: IncrementalProblem) -> BlockSystem:
    """Lay a problem out for sweeps; one copy of the blocks."""
    W = problem.W
    starts, columns = W.indptr.astype(np.int32), W.indices.astype(np.int32)
    rows = np.empty(9 * len(columns))
    dense_rows(starts, np.ascontiguousarray(W.data), rows)
    diagonal = np.ascontiguousarray(problem.diagonal.reshape(problem.n, 9))
    return BlockSystem(starts, columns, rows, diagonal, problem.sigma, problem.b, problem.mu)


@jit
def block_row(
    rows: NDArray[np.float64], first: int, width: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The three rows, each of `width` numbers, of the block row whose first block is `first`."""
    begin = 9 * first
    return (
        rows[begin : begin + width],
        rows[begin + width : begin + 2 * width],
        rows[begin + 2 * width : begin + 3 * width],
    )


@jit
def velocity(s: BlockSystem, r: NDArray[np.float64], u: NDArray[np.float64]) -> None:
    """Write `W r + b` into `u`."""
    for i in range(len(s.mu)):
        first = s.starts[i]
        blocks = s.starts[i + 1] - first
        row0, row1, row2 = block_row(s.rows, first, 3 * blocks)
        u0, u1, u2 = s.b[3 * i], s.b[3 * i + 1], s.b[3 * i + 2]
        for j in range(blocks):
            at = 3 * s.columns[first + j]
            for a in range(3):
                x = r[at + a]
                u0 += row0[3 * j + a] * x
                u1 += row1[3 * j + a] * x
                u2 += row2[3 * j + a] * x
        u[3 * i], u[3 * i + 1], u[3 * i + 2] = u0, u1, u2


@jit
def residual_from(s: BlockSystem, r: NDArray[np.float64], u: NDArray[np.float64], facets: int) -> float:
    """Root mean square over the contacts of the natural map, in the unit of b (THEORY §2)."""
    total = 0.0
    n = len(s.mu)
    for i in range(n):
        e = natural_map((u[3 * i], u[3 * i + 1], u[3 * i + 2]), (r[3 * i], r[3 * i + 1], r[3 * i + 2]),
                        s.mu[i], s.sigma[i], facets)  # fmt: skip
        total += e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    return math.sqrt(total / max(1, n))


@jit
def local_problem(d: NDArray[np.float64], u: Vector, r: Vector, shift: float) -> tuple[Matrix, Vector]:
    """`(W_ii + shift I, b_loc - shift r)`: the contact with all others fixed, fixed points unmoved."""
    b = (
        u[0] - d[0] * r[0] - d[1] * r[1] - d[2] * r[2] - shift * r[0],
        u[1] - d[3] * r[0] - d[4] * r[1] - d[5] * r[2] - shift * r[1],
        u[2] - d[6] * r[0] - d[7] * r[1] - d[8] * r[2] - shift * r[2],
    )
    return ((d[0] + shift, d[1], d[2]), (d[3], d[4] + shift, d[5]), (d[6], d[7], d[8] + shift)), b


@jit
def local_residual(W: Matrix, b: Vector, mu: float, sigma: float, r: Vector, facets: int) -> float:
    """Norm of the natural map of the law at `r`; infinite when not finite."""
    u = (
        b[0] + W[0][0] * r[0] + W[0][1] * r[1] + W[0][2] * r[2],
        b[1] + W[1][0] * r[0] + W[1][1] * r[1] + W[1][2] * r[2],
        b[2] + W[2][0] * r[0] + W[2][1] * r[1] + W[2][2] * r[2],
    )
    size = norm(natural_map(u, r, mu, sigma, facets))
    return size if math.isfinite(size) else math.inf


@jit
def tempered(W: Matrix, b: Vector, mu: float, sigma: float, old: Vector, new: Vector, facets: int) -> Vector:
    """What a failed local answer is worth: whole if better than the old impulse, half-way there if only finite."""
    size = local_residual(W, b, mu, sigma, new, facets)
    if size < local_residual(W, b, mu, sigma, old, facets):
        return new
    if not math.isfinite(size):
        return old
    middle = (0.5 * (old[0] + new[0]), 0.5 * (old[1] + new[1]), 0.5 * (old[2] + new[2]))
    return project(middle, mu, facets)


@jit
def push(s: BlockSystem, i: int, d0: float, d1: float, d2: float, u: NDArray[np.float64]) -> None:
    """`u += W_:i Δr_i`; `W` is symmetric, so block row i serves as block column i."""
    first = s.starts[i]
    blocks = s.starts[i + 1] - first
    row0, row1, row2 = block_row(s.rows, first, 3 * blocks)
    for j in range(blocks):
        at = 3 * s.columns[first + j]
        k = 3 * j
        u[at] += row0[k] * d0 + row1[k] * d1 + row2[k] * d2
        u[at + 1] += row0[k + 1] * d0 + row1[k + 1] * d1 + row2[k + 1] * d2
        u[at + 2] += row0[k + 2] * d0 + row1[k + 2] * d1 + row2[k + 2] * d2


@jit
def regime(r: Vector, mu: float) -> int:
    """Regime of an impulse."""
    if r[0] <= 0.0:
        return OPEN
    limit = STICK_MARGIN * mu * r[0]
    return STICK if r[1] * r[1] + r[2] * r[2] < limit * limit else SLIP


@jit
def sweep(
    kernel: Any,
    options: NDArray[np.float64],
    s: BlockSystem,
    how: Sweeper,
    proximal: float,
    r: NDArray[np.float64],
    u: NDArray[np.float64],
    visits: NDArray[np.int64],
    log: VisitLog,
) -> None:
    """Visit every contact once, in order; count statuses, regimes and local iterations in `visits`.

    A `log` with contacts records every visit. `proximal` is the c of the term `c sigma_i I` that is renewed at each
    visit (THEORY §4).
    """
    for i in range(len(s.mu)):
        old = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
        W, b = local_problem(
            s.diagonal[i], (u[3 * i], u[3 * i + 1], u[3 * i + 2]), old, proximal * s.sigma[i]
        )
        status, new, iterations = kernel(W, b, s.mu[i], old, options)
        if status != CONVERGED or not math.isfinite(new[0] + new[1] + new[2]):
            status = min(max(status, FIRST_FAILURE), LAST_FAILURE)
            new = tempered(W, b, s.mu[i], s.sigma[i], old, new, how.facets)
        found = regime(new, s.mu[i])
        visits[status] += 1
        visits[LAST_FAILURE + 1 + found] += 1
        visits[LAST_FAILURE + 4] += iterations
        if len(log.by_contact) > 0:
            record(log, i, status, iterations, found, W, b, s.mu[i], old, new)
        d0, d1, d2 = new[0] - old[0], new[1] - old[1], new[2] - old[2]
        if s.sigma[i] * max(abs(d0), abs(d1), abs(d2)) > how.negligible:
            r[3 * i], r[3 * i + 1], r[3 * i + 2] = new[0], new[1], new[2]
            push(s, i, d0, d1, d2, u)
    end_sweep(log, s.sigma, r)
