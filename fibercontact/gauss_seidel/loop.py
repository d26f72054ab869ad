"""The loop of sweeps, compiled once for all local solvers: sweep, measure, keep the best, extrapolate.

Several threads may run it together (see `team`): each is given the same settings and problem, its own counters, and
takes the same decisions.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import config
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import (
    SUMS,
    Memory,
    add_products,
    begin,
    combine,
    grow,
    store,
    store_velocity,
    weights,
)
from fibercontact.gauss_seidel.blocks import (
    BlockSystem,
    new_velocity,
    push,
    root_mean_square,
    squares,
    write_velocity,
)
from fibercontact.gauss_seidel.parts import Parts
from fibercontact.gauss_seidel.sweep import LAST_FAILURE, Sweeper, sweep
from fibercontact.gauss_seidel.team import Team, alone, share, wait
from fibercontact.gauss_seidel.vectors import STRIDE
from fibercontact.gauss_seidel.visit_log import CURED, VisitLog
from fibercontact.jit import jit
from fibercontact.local.contract import KERNEL_SIGNATURE, SEVERAL_SIGNATURE
from fibercontact.local.several import one_by_one
from fibercontact.problem.cone import COULOMB, project

__all__ = ["MARK", "State", "compile_loop", "new_guard", "new_state", "project_impulses", "run_sweeps"]

MARK = 100
"""Sweeps between two looks at whether the run cycles."""
PATIENCE = 5
"""Looks without a new least residual after which it does."""
CURE = 0.05
"""Proximal term that is then put in force: a contact with several solutions no longer jumps between them."""

RANGE = 512
"""Contacts that are added up, stored and combined at a time; from 128 to 4096 it hardly matters."""
PUT_BACK = 0.1
"""Share of the residual that an extrapolated impulse may be outside its cone by, until its next visit."""
DRIFT = 0.01
"""Share of the target that rounding in combined velocities may come to, before they are computed afresh."""
EPSILON = float(np.finfo(np.float64).eps)

Array = NDArray[np.float64]


class State(NamedTuple):
    """What the threads of a run share; `sums` has a row for each range of contacts that is added up apart."""

    parts: Parts  # the order of its sweeps
    r: Array  # (3n,) impulse
    u: Array  # velocity, see `blocks.new_velocity`
    still: Array  # as u: velocity at a contact's last visit if that changed nothing, else infinite
    best_r: Array  # (3n,)
    outside: NDArray[np.bool_]  # (n,) whether the extrapolated impulse had to be put back into its cone
    moved: Array  # (3n,) by how much, where it had to
    sums: Array  # (ranges, 1 + SUMS, window or 1)
    failed: NDArray[np.int64]  # (team,) local failures that each thread has seen


def new_state(s: BlockSystem, parts: Parts, r: Array, window: int, threads: int) -> State:
    """The state of a run that begins at the impulse `r`."""
    u = new_velocity(parts)
    write_velocity(s, parts, r, alone(len(parts.parts) - 1), u)
    n = len(s.mu)
    sums = np.zeros((n // RANGE + 1, 1 + SUMS, max(1, window)))
    still, failed = np.full_like(u, np.inf), np.zeros(threads, dtype=np.int64)
    return State(parts, r, u, still, r.copy(), np.zeros(n, np.bool_), np.zeros(3 * n), sums, failed)


@jit
def into_cones(
    s: BlockSystem, how: Sweeper, m: Memory, state: State, least: float, first: int, end: int
) -> float:
    """Take the combined impulses `m.x` of a range, put back into their cones from more than `least` outside.

    Contacts whose impulse changes are awake. Returns the sum of the squares of `sigma_i r_i`.
    """
    sigma, mu, x, r, outside, moved, still = (
        s.sigma,
        s.mu,
        m.x,
        state.r,
        state.outside,
        state.moved,
        state.still,
    )
    total = 0.0
    for i in range(first, end):
        k, size = 3 * i, sigma[i]
        q = (x[k], x[k + 1], x[k + 2])
        tangent = size * size * (q[1] * q[1] + q[2] * q[2])
        total += size * size * q[0] * q[0] + tangent
        slack = size * mu[i] * q[0] + least
        outside[i] = False
        if how.facets != COULOMB or q[0] < 0.0 or tangent > slack * slack:
            p = project(q, mu[i], how.facets)
            d = (p[0] - q[0], p[1] - q[1], p[2] - q[2])
            outside[i] = size * max(abs(d[0]), abs(d[1]), abs(d[2])) > least
            if outside[i]:
                moved[k], moved[k + 1], moved[k + 2] = d
                x[k], x[k + 1], x[k + 2] = p
        change = max(abs(r[k] - x[k]), abs(r[k + 1] - x[k + 1]), abs(r[k + 2] - x[k + 2]))
        if size * change > how.negligible:
            still[STRIDE * i] = math.inf
        r[k], r[k + 1], r[k + 2] = x[k], x[k + 1], x[k + 2]
    return total


@jit
def project_impulses(s: BlockSystem, facets: int, r: Array, first: int, end: int) -> None:
    """Project the impulses of the contacts `first..end` on their cones."""
    mu = s.mu
    for i in range(first, end):
        p = project((r[3 * i], r[3 * i + 1], r[3 * i + 2]), mu[i], facets)
        r[3 * i], r[3 * i + 1], r[3 * i + 2] = p


@jit
def of_range(n: int, ranges: int, k: int) -> tuple[int, int]:
    """Contacts of range k."""
    return n * k // ranges, n * (k + 1) // ranges


@jit
def residual_of(s: BlockSystem, state: State, facets: int, team: Team) -> float:
    """The residual, added up range by range."""
    n, ranges = len(s.mu), len(state.sums)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        state.sums[k, 0, 0] = squares(s, state.r, state.u, STRIDE, facets, first, end)
    wait(team)
    return root_mean_square(state.sums[:, 0, 0].sum(), n)


@jit
def accelerate(s: BlockSystem, how: Sweeper, m: Memory, state: State, residual: float, team: Team) -> None:
    """One Anderson step: replace `r`, the image of `m.x`, by the extrapolated impulse, and `u` by its velocity."""
    n, ranges = len(s.mu), len(state.sums)
    row, count = begin(m, residual)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        store(m, row, state.r, 3 * first, 3 * end)
        store_velocity(m, row, state.u, STRIDE * first, STRIDE * end)
        if count > 0:
            add_products(m, row, count, 3 * first, 3 * end, state.sums[k, 1:])
    wait(team)
    gamma = weights(m, row, count, state.sums[:, 1:].sum(axis=0), how.tikhonov) if count > 0 else np.zeros(0)
    least = max(how.negligible, PUT_BACK * residual)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        combine(m.g, m.dG, gamma, 3 * first, 3 * end, m.x)
        combine(m.v, m.dV, gamma, STRIDE * first, STRIDE * end, state.u)
        state.sums[k, 0, 0] = into_cones(s, how, m, state, least, first, end)
    wait(team)
    unit = EPSILON * root_mean_square(state.sums[:, 0, 0].sum(), n)
    if grow(m, row, gamma) * unit > DRIFT * how.target:
        write_velocity(s, state.parts, state.r, team, state.u)
        m.rounding[len(m.dV)] = 1.0
    else:
        push(s, state.parts, state.moved, state.outside, team, state.u)


def new_guard(proximal: float) -> Array:
    """Watch for cycles: proximal term in force, least residual at a mark, marks since then, local failures."""
    return np.array([proximal, math.inf, 0.0, 0.0])


@jit
def watch(guard: Array, residual: float, failures: int) -> None:
    """Look at the residual at a mark; a run that cycles gets a proximal term.

    Only the outer loop's cycles are cured: a local solver that has failed since the last mark is not rescued.
    """
    failed = failures > guard[3]
    guard[3] = failures
    if residual < guard[1] or failed:
        guard[1], guard[2] = min(residual, guard[1]), 0.0
        return
    guard[2] += 1.0
    if guard[2] >= PATIENCE:
        guard[0], guard[2] = max(guard[0], CURE), 0.0


@jit
def run_sweeps(
    kernel: Any,
    several: Any,
    options: Array,
    s: BlockSystem,
    how: Sweeper,
    state: State,
    team: Team,
    m: Memory,
    guard: Array,
    visits: NDArray[np.int64],
    log: VisitLog,
    history: Array,
    best: float,
    done: int,
    budget: int,
) -> tuple[int, float, bool]:
    """Sweep until the target or until `budget` sweeps in all; returns (sweeps done, best residual, reached).

    The state is updated in place, `history[k]` (when long enough) is the residual after sweep k where it was
    evaluated. A residual that meets the target is confirmed on a velocity computed afresh. The best residual is
    returned as NaN when an iterate is not finite. `m`, `guard` and `visits` are the thread's own.
    """
    first, end = share(len(s.b), team)
    while done < budget:
        sweep(
            kernel,
            several,
            options,
            s,
            state.parts,
            how,
            guard[0],
            team,
            state.r,
            state.u,
            state.still,
            visits,
            log,
        )
        done += 1
        map_ends = how.period > 0 and done % how.period == 0
        marks = done % MARK == 0
        if done % how.check_every != 0 and done != budget and not map_ends and not marks:
            continue
        residual = residual_of(s, state, how.facets, team)
        if residual <= how.target:
            if how.period > 0:  # a contact that is left out may be outside its cone by what is negligible
                project_impulses(s, how.facets, state.r, *share(len(s.mu), team))
                wait(team)
            write_velocity(s, state.parts, state.r, team, state.u)
            residual = residual_of(s, state, how.facets, team)
        if done < len(history):
            history[done] = residual
        if residual < best:
            best = residual
            state.best_r[first:end] = state.r[first:end]
        wait(team)
        if residual <= how.target:
            return done, best, True
        if not math.isfinite(residual):
            return done, math.nan, False
        if marks:
            before = guard[0]
            state.failed[team.rank] = visits[1 : LAST_FAILURE + 1].sum()
            wait(team)
            watch(guard, residual, state.failed.sum())
            if guard[0] > before:
                log.state[CURED] = done
        if map_ends:
            accelerate(s, how, m, state, residual, team)
    return done, best, False


_F, _I, _VECTOR, _INDEX, _MATRIX, _COUNTS, _MASK, _TABLE = (
    types.float64, types.int64, types.float64[::1], types.int32[::1], types.float64[:, ::1], types.int64[::1],
    types.boolean[::1], types.int64[:, ::1],
)  # fmt: skip
_PARTS = types.NamedUniTuple(_INDEX, 7, Parts)
_SIGNATURE = types.Tuple((_I, _F, types.boolean))(
    types.FunctionType(KERNEL_SIGNATURE),
    types.FunctionType(SEVERAL_SIGNATURE),
    _VECTOR,
    types.NamedTuple((_INDEX, _INDEX, _VECTOR, _MATRIX, *3 * (_VECTOR,), _PARTS), BlockSystem),
    types.NamedTuple((_I, _F, _F, _I, _I, _F, types.boolean, _I), Sweeper),
    types.NamedTuple((_PARTS, *4 * (_VECTOR,), _MASK, _VECTOR, types.float64[:, :, ::1], _COUNTS), State),
    types.NamedTuple((_I, _I, _COUNTS, _INDEX), Team),
    types.NamedTuple((*3 * (_MATRIX,), *5 * (_VECTOR,), _MATRIX, _VECTOR, _VECTOR), Memory),
    _VECTOR, _COUNTS,
    types.NamedTuple((_TABLE, _VECTOR, _TABLE, _MATRIX, _MATRIX, _MATRIX, _COUNTS), VisitLog),
    _VECTOR, _F, _I, _I,
)  # fmt: skip


def compile_loop() -> None:
    """Compile `run_sweeps` for every local solver at once, or read it from the disk cache."""
    if config.DISABLE_JIT or run_sweeps.signatures:
        return
    one_by_one.compile(SEVERAL_SIGNATURE)
    one_by_one.disable_compile()
    run_sweeps.compile(_SIGNATURE)
    run_sweeps.disable_compile()
