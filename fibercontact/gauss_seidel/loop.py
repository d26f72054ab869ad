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

from fibercontact.gauss_seidel.anderson import Memory, add_products, begin, combine, store, weights
from fibercontact.gauss_seidel.blocks import (
    BlockSystem,
    new_velocity,
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
from fibercontact.problem.cone import project

__all__ = ["MARK", "State", "compile_loop", "new_guard", "new_state", "run_sweeps", "scale_impulse"]

MARK = 100
"""Sweeps between two looks at whether the run cycles."""
PATIENCE = 5
"""Looks without a new least residual after which it does."""
CURE = 0.05
"""Proximal term that is then put in force: a contact with several solutions no longer jumps between them."""

Array = NDArray[np.float64]


class State(NamedTuple):
    """What the threads of a run share; `sums` has a row for each range of contacts that is added up apart."""

    parts: Parts  # the order of its sweeps
    r: Array  # (3n,) impulse
    u: Array  # velocity, see `blocks.new_velocity`
    still: Array  # as u: velocity at a contact's last visit if that changed nothing, else infinite
    best_r: Array  # (3n,)
    sums: Array  # (ranges, 3, window or 1)
    failed: NDArray[np.int64]  # (team,) local failures that each thread has seen


def new_state(s: BlockSystem, parts: Parts, r: Array, window: int, threads: int) -> State:
    """The state of a run that begins at the impulse `r`."""
    u = new_velocity(parts)
    write_velocity(s, parts, r, alone(len(parts.parts) - 1), u)
    sums = np.zeros((int(parts.phases[1]), 3, max(1, window)))
    return State(parts, r, u, np.full_like(u, np.inf), r.copy(), sums, np.zeros(threads, dtype=np.int64))


@jit
def scale_impulse(s: BlockSystem, r: Array, first: int, end: int, x: Array) -> None:
    """Write `sqrt(sigma_i) r_i` of the contacts `first..end` into `x`."""
    sigma = s.sigma
    for i in range(first, end):
        scale = math.sqrt(sigma[i])
        for c in range(3 * i, 3 * i + 3):
            x[c] = scale * r[c]


@jit
def into_cones(s: BlockSystem, facets: int, x: Array, first: int, end: int, r: Array) -> None:
    """Project the impulses of the scaled variable `x` on their cones, into `r` and, scaled, into `x`."""
    sigma, mu = s.sigma, s.mu
    for i in range(first, end):
        k, root = 3 * i, math.sqrt(sigma[i])
        scale = 1.0 / root
        p = project((scale * x[k], scale * x[k + 1], scale * x[k + 2]), mu[i], facets)
        r[k], r[k + 1], r[k + 2] = p[0], p[1], p[2]
        x[k], x[k + 1], x[k + 2] = root * p[0], root * p[1], root * p[2]


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
    """One Anderson step: replace `r`, the image of `m.x`, by the extrapolated impulse."""
    n, ranges = len(s.mu), len(state.sums)
    row, count = begin(m, residual)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        scale_impulse(s, state.r, first, end, m.image)
        store(m, row, 3 * first, 3 * end)
        if count > 0:
            add_products(m, row, count, 3 * first, 3 * end, state.sums[k, 1:])
    wait(team)
    gamma = weights(m, row, count, state.sums[:, 1:].sum(axis=0), how.tikhonov) if count > 0 else np.zeros(0)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        combine(m, gamma, 3 * first, 3 * end)
        into_cones(s, how.facets, m.x, first, end, state.r)
    wait(team)
    write_velocity(s, state.parts, state.r, team, state.u)


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


_F, _I, _VECTOR, _INDEX, _MATRIX, _COUNTS, _TABLE = (
    types.float64, types.int64, types.float64[::1], types.int32[::1], types.float64[:, ::1], types.int64[::1],
    types.int64[:, ::1],
)  # fmt: skip
_PARTS = types.NamedUniTuple(_INDEX, 7, Parts)
_SIGNATURE = types.Tuple((_I, _F, types.boolean))(
    types.FunctionType(KERNEL_SIGNATURE),
    types.FunctionType(SEVERAL_SIGNATURE),
    _VECTOR,
    types.NamedTuple((_INDEX, _INDEX, _VECTOR, _MATRIX, *3 * (_VECTOR,), _PARTS), BlockSystem),
    types.NamedTuple((_I, _F, _F, _I, _I, _F, types.boolean, _I), Sweeper),
    types.NamedTuple((_PARTS, *4 * (_VECTOR,), types.float64[:, :, ::1], _COUNTS), State),
    types.NamedTuple((_I, _I, _COUNTS, _INDEX), Team),
    types.NamedTuple((_MATRIX, _MATRIX, *4 * (_VECTOR,), _MATRIX, _VECTOR), Memory),
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
