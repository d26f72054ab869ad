"""One block Gauss–Seidel sweep over any local solver, in push form.

The relative velocity `u = W r + b` is kept up to date: a visit reads `u_i`, solves its contact, and adds
`W_:i Δr_i` to its neighbours. A visit that changes nothing that matters costs no memory traffic.

The local solver comes in as a function of fixed signature, so this file is compiled once for all of them.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import BlockSystem, flush
from fibercontact.gauss_seidel.parts import Parts
from fibercontact.gauss_seidel.team import Team
from fibercontact.gauss_seidel.vectors import LINE, STRIDE, add_block, fetch
from fibercontact.gauss_seidel.visit_log import VisitLog, end_sweep, record, record_left_out
from fibercontact.jit import jit, jit_inline
from fibercontact.lanes import LANES, load, store
from fibercontact.local.algebra import OPEN, SLIP, STICK
from fibercontact.local.contract import Matrix, Status
from fibercontact.problem.cone import Vector, natural_map, norm, project

__all__ = ["COUNTERS", "LAST_FAILURE", "Sweeper", "regime", "sweep"]

CONVERGED, FIRST_FAILURE, LAST_FAILURE = int(Status.CONVERGED), int(Status.ITERATIONS), int(Status.NOT_FINITE)
COUNTERS = LAST_FAILURE + 6
"""Counters of the visits: one a status, then open, stick, slip, local iterations, and visits left out.

Those left out have a regime, the one of before, and no status.
"""
ITERATIONS, LEFT_OUT = LAST_FAILURE + 4, LAST_FAILURE + 5

STICK_MARGIN = 1.0 - 1e-9
"""Share of `mu r_N` below which `|r_T|` counts as stick in the statistics."""

FEW = 3
"""Contacts from which on it is worth while to solve them at once."""

FETCHED = 4
"""Cache lines of a row that are fetched before its contact is solved; the processor sees for itself what follows."""

V, R, MU, PROXIMAL, DONE, STEPS, ROWS = 9, 12, 15, 16, 17, 18, 19
"""Rows of the table of contacts that are solved at once, `LANES` numbers each; those before are `W_ii`."""

Array = NDArray[np.float64]


class Sweeper(NamedTuple):
    """What a run of sweeps is asked to do."""

    facets: int  # of the law that stops the run
    negligible: float  # change of sigma_i r_i that is not worth a push
    target: float  # residual to reach, in the unit of b
    check_every: int  # sweeps between two evaluations of the residual
    period: int  # sweeps a map of the Anderson acceleration, 0 for none
    tikhonov: float  # of the acceleration
    everyone: bool  # whether the local solver is asked where the answer is known to be the impulse of before
    width: int  # contacts that are solved at once, if the local solver can: LANES, or 1


@jit
def local_problem(W: Matrix, u: Vector, r: Vector, shift: float) -> tuple[Matrix, Vector]:
    """`(W_ii + shift I, b_loc - shift r)`: the contact with all others fixed, fixed points unmoved."""
    W = (
        (W[0][0] + shift, W[0][1], W[0][2]),
        (W[1][0], W[1][1] + shift, W[1][2]),
        (W[2][0], W[2][1], W[2][2] + shift),
    )
    b = (
        u[0] - W[0][0] * r[0] - W[0][1] * r[1] - W[0][2] * r[2],
        u[1] - W[1][0] * r[0] - W[1][1] * r[1] - W[1][2] * r[2],
        u[2] - W[2][0] * r[0] - W[2][1] * r[1] - W[2][2] * r[2],
    )
    return W, b


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
def regime(r: Vector, mu: float) -> int:
    """Regime of an impulse."""
    if r[0] <= 0.0:
        return OPEN
    limit = STICK_MARGIN * mu * r[0]
    return STICK if r[1] * r[1] + r[2] * r[2] < limit * limit else SLIP


@jit_inline
def contact_matrix(diagonal: Array, i: int) -> Matrix:
    """`W_ii`."""
    return (
        (diagonal[i, 0], diagonal[i, 1], diagonal[i, 2]),
        (diagonal[i, 3], diagonal[i, 4], diagonal[i, 5]),
        (diagonal[i, 6], diagonal[i, 7], diagonal[i, 8]),
    )


@jit_inline
def several_answers(several: Any, table: Array, options: Array) -> Any:
    """Solve the contacts in the table: `(done, r, iterations)` of each."""
    W = (
        (load(table, 0), load(table, LANES), load(table, 2 * LANES)),
        (load(table, 3 * LANES), load(table, 4 * LANES), load(table, 5 * LANES)),
        (load(table, 6 * LANES), load(table, 7 * LANES), load(table, 8 * LANES)),
    )
    v = (load(table, V * LANES), load(table, (V + 1) * LANES), load(table, (V + 2) * LANES))
    r = (load(table, R * LANES), load(table, (R + 1) * LANES), load(table, (R + 2) * LANES))
    W, b = local_problem(W, v, r, load(table, PROXIMAL * LANES))
    return several(W, b, load(table, MU * LANES), r, options)


@jit
def sweep_part(
    kernel: Any,
    several: Any,
    options: Array,
    s: BlockSystem,
    parts: Parts,
    how: Sweeper,
    proximal: float,
    part: int,
    r: Array,
    u: Array,
    still: Array,
    counts: NDArray[np.int64],
    log: VisitLog,
) -> None:
    """The visits of one part.

    Unless everyone is asked, a contact is left out that is open and separates, which no law changes; and one whose
    velocity is, but for what is negligible, the one `still` at which its last visit changed nothing.

    Contacts that do not interact are solved at once, up to `how.width` of them. Where that gives no answer, and
    where they are few, they are solved one by one; the impulses are the same.

    No function that takes an array is called in the loop: to count its references would take longer than a push.
    """
    starts, blocks, order, targets, meets = s.starts, s.blocks, parts.order, parts.targets, parts.meets
    diagonal, friction, sizes, logged = s.diagonal, s.mu, s.sigma, len(log.by_contact) > 0
    visit, end = parts.parts[part], parts.parts[part + 1]
    together, table = np.zeros(LANES, np.int64), np.ones(ROWS * LANES)
    while visit < end:
        count, limit = 0, end
        while visit < limit and count < how.width:
            i, meeting = order[visit], meets[visit]
            visit += 1
            at = STRIDE * i
            v = (u[at], u[at + 1], u[at + 2])
            old = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
            if not how.everyone:
                since = max(abs(v[0] - still[at]), abs(v[1] - still[at + 1]), abs(v[2] - still[at + 2]))
                if since <= how.negligible or (old[0] == 0.0 and v[0] >= 0.0):
                    counts[LEFT_OUT] += 1
                    found = regime(old, friction[i])
                    counts[LAST_FAILURE + 1 + found] += 1
                    if logged:
                        record_left_out(log, found)
                    continue
            together[count] = i
            for line in range(FETCHED):
                fetch(blocks, 9 * starts[i] + LINE * line)
            if how.width > 1:
                for k in range(9):
                    table[k * LANES + count] = diagonal[i, k]
                for k in range(3):
                    table[(V + k) * LANES + count] = v[k]
                    table[(R + k) * LANES + count] = old[k]
                table[MU * LANES + count] = friction[i]
                table[PROXIMAL * LANES + count] = proximal * sizes[i]
            count += 1
            limit = min(limit, meeting)
        if count >= FEW:
            done, answers, steps = several_answers(several, table, options)
            for k in range(3):
                store(table, (R + k) * LANES, answers[k])
            store(table, DONE * LANES, done)
            store(table, STEPS * LANES, steps)
        for lane in range(count):
            i = together[lane]
            at, mu, sigma = STRIDE * i, friction[i], sizes[i]
            v = (u[at], u[at + 1], u[at + 2])
            old = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
            status, iterations = CONVERGED, 0
            if count >= FEW and table[DONE * LANES + lane] == 1.0:
                new = (table[R * LANES + lane], table[(R + 1) * LANES + lane], table[(R + 2) * LANES + lane])
                iterations = int(table[STEPS * LANES + lane])
            else:
                W, b = local_problem(contact_matrix(diagonal, i), v, old, proximal * sigma)
                status, new, iterations = kernel(W, b, mu, old, options)
                if status != CONVERGED or not math.isfinite(new[0] + new[1] + new[2]):
                    status = min(max(status, FIRST_FAILURE), LAST_FAILURE)
                    new = tempered(W, b, mu, sigma, old, new, how.facets)
            found = regime(new, mu)
            counts[status] += 1
            counts[LAST_FAILURE + 1 + found] += 1
            counts[ITERATIONS] += iterations
            if logged:
                W, b = local_problem(contact_matrix(diagonal, i), v, old, proximal * sigma)
                record(log, i, status, iterations, found, W, b, mu, old, new)
            d0, d1, d2 = new[0] - old[0], new[1] - old[1], new[2] - old[2]
            if sigma * max(abs(d0), abs(d1), abs(d2)) > how.negligible:
                r[3 * i], r[3 * i + 1], r[3 * i + 2] = new[0], new[1], new[2]
                ahead = 9 * (starts[together[min(lane + 1, count - 1)]] - starts[i])
                for j in range(starts[i], starts[i + 1]):
                    fetch(blocks, 9 * j + ahead)  # the next one's row, while this one is pushed
                    add_block(u, STRIDE * targets[j], blocks, 9 * j, d0, d1, d2)
                still[at] = math.inf
            else:
                still[at], still[at + 1], still[at + 2] = v


@jit
def sweep(
    kernel: Any,
    several: Any,
    options: Array,
    s: BlockSystem,
    parts: Parts,
    how: Sweeper,
    proximal: float,
    team: Team,
    r: Array,
    u: Array,
    still: Array,
    counts: NDArray[np.int64],
    log: VisitLog,
) -> None:
    """Visit every contact once, in the order of the parts; count statuses, regimes and local iterations.

    A `log` with contacts records every visit. `proximal` is the c of the term `c sigma_i I` that is renewed at each
    visit (THEORY §4).
    """
    for phase in range(len(parts.phases) - 1):
        for part in range(parts.phases[phase], parts.phases[phase + 1]):
            if team.owner[part] == team.rank:
                sweep_part(kernel, several, options, s, parts, how, proximal, part, r, u, still, counts, log)
        flush(parts, phase, team, u)
    end_sweep(log, s.sigma, r)
