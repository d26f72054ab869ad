"""The loop of sweeps, compiled once for all local solvers: sweep, measure, keep the best, extrapolate.

Several threads may run it together (see `team`): each is given the same settings and problem, its own counters, and
takes the same decisions.
"""

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import config
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import (
    SUMS,
    Acceleration,
    Memory,
    add_products,
    add_steps,
    ago,
    another,
    begin,
    combine,
    go_on,
    grow,
    in_use,
    newest,
    store,
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
from fibercontact.jit import jit, jit_lean
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

RANGE = 256
"""Contacts that are added up, stored and combined at a time; from 128 to 4096 it hardly matters."""
PUT_BACK = 0.1
"""Share of the residual that an extrapolated impulse may be outside its cone by, until its next visit."""
DRIFT = 0.01
"""Share of the target that rounding in combined velocities may come to, before they are computed afresh."""
EPSILON = float(np.finfo(np.float64).eps)

Array = NDArray[np.float64]


class State(NamedTuple):
    """What the threads of a run share, with its memory; `sums` has rows for each range of contacts added up apart."""

    parts: Parts  # the order of its sweeps
    still: Array  # as the velocity: that of a contact's last visit if that changed nothing, else infinite
    best_r: Array  # (3n,)
    visits: NDArray[np.int32]  # (n,) when each contact is visited
    outside: NDArray[
        np.uint8
    ]  # (8k,) of each visit, whether the extrapolated impulse was put back into its cone
    moved: Array  # (3n,) by how much, where it had to
    sums: (
        Array  # (ranges, 1 + SUMS, 2 or window): two sums of `look` and `accelerate`, and those of the memory
    )
    failed: NDArray[np.int64]  # (team,) local failures that each thread has seen


def new_state(
    s: BlockSystem, parts: Parts, r: Array, acceleration: Acceleration, threads: int
) -> tuple[State, Memory]:
    """The state of a run that begins at the impulse `r`, and its memory."""
    u, n = new_velocity(parts), len(s.mu)
    memory = acceleration.memory(r, np.repeat(np.sqrt(s.sigma), 3), len(u))
    write_velocity(s, parts, r, alone(len(parts.parts) - 1), memory.V[0])
    sums = np.zeros((n // RANGE + 1, 1 + SUMS, max(2, acceleration.window)))
    still, failed = np.full_like(u, np.inf), np.zeros(threads, dtype=np.int64)
    visits, outside = np.empty_like(parts.order), np.zeros(n + -n % 8, np.uint8)
    visits[parts.order] = np.arange(n, dtype=np.int32)
    return State(parts, still, r.copy(), visits, outside, np.zeros(3 * n), sums, failed), memory


@jit_lean
def into_cones(
    s: BlockSystem, how: Sweeper, m: Memory, state: State, least: float, first: int, end: int
) -> float:
    """Take the combined impulses of a range, put back into their cones from more than `least` outside.

    Contacts whose impulse changes are awake. Returns the sum of the squares of `sigma_i r_i`.
    """
    sigma, mu, x, before, start = s.sigma, s.mu, m.G[ago(m, -1)], m.G[newest(m)], m.x
    visits, outside, moved, still = state.visits, state.outside, state.moved, state.still
    total = 0.0
    for i in range(first, end):
        k, size = 3 * i, sigma[i]
        q = (x[k], x[k + 1], x[k + 2])
        tangent = size * size * (q[1] * q[1] + q[2] * q[2])
        total += size * size * q[0] * q[0] + tangent
        slack = size * mu[i] * q[0] + least
        leaves = False
        if how.facets != COULOMB or q[0] < 0.0 or tangent > slack * slack:
            p = project(q, mu[i], how.facets)
            d = (p[0] - q[0], p[1] - q[1], p[2] - q[2])
            leaves = size * max(abs(d[0]), abs(d[1]), abs(d[2])) > least
            if leaves:
                moved[k], moved[k + 1], moved[k + 2] = d
                x[k], x[k + 1], x[k + 2] = q = p
        outside[visits[i]] = leaves
        change = max(abs(before[k] - q[0]), abs(before[k + 1] - q[1]), abs(before[k + 2] - q[2]))
        if size * change > how.negligible:
            still[STRIDE * i] = math.inf
        start[k], start[k + 1], start[k + 2] = q
    return total


@jit_lean
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
def residual_of(s: BlockSystem, r: Array, u: Array, sums: Array, facets: int, team: Team) -> float:
    """The residual, added up range by range."""
    n, ranges = len(s.mu), len(sums)
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        sums[k, 0, 0] = squares(s, r, u, STRIDE, facets, first, end)
    wait(team)
    return root_mean_square(sums[:, 0, 0].sum(), n)


@jit
def look(s: BlockSystem, facets: int, m: Memory, sums: Array, map_ends: bool, team: Team) -> float:
    """The residual; where a map has ended it is stored besides, and its products added up, while it is at hand."""
    n, ranges, row, count = len(s.mu), len(sums), newest(m), in_use(m)
    r, u = m.G[row], m.V[row]
    for k in range(team.rank, ranges, team.size):
        first, end = of_range(n, ranges, k)
        sums[k, 0, 0] = squares(s, r, u, STRIDE, facets, first, end)
        if map_ends:
            store(m, 3 * first, 3 * end)
            add_products(m, count, 3 * first, 3 * end, sums[k, 1:])
    wait(team)
    return root_mean_square(sums[:, 0, 0].sum(), n)


@jit
def extrapolated(
    s: BlockSystem, how: Sweeper, m: Memory, state: State, alpha: Array, least: float, first: bool, team: Team
) -> None:
    """Combine the images with the weights alpha, and their velocities; at `first` add up where that leads."""
    n, ranges, sums = len(s.mu), len(state.sums), state.sums
    for k in range(team.rank, ranges, team.size):
        begin, end = of_range(n, ranges, k)
        combine(m, m.G, alpha, 3 * begin, 3 * end)
        combine(m, m.V, alpha, STRIDE * begin, STRIDE * end)
        if first:
            add_steps(m, 3 * begin, 3 * end, sums[k, 1:])
        sums[k, 0, 1] = into_cones(s, how, m, state, least, begin, end)
    wait(team)


@jit
def accelerate(s: BlockSystem, how: Sweeper, m: Memory, state: State, residual: float, team: Team) -> None:
    """One Anderson step: from the newest image, whose residual is given, to the next iterate and its velocity."""
    least = max(how.negligible, PUT_BACK * residual)
    alpha = weights(m, begin(m, residual), state.sums[:, 1:].sum(axis=0), how.tikhonov)
    extrapolated(s, how, m, state, alpha, least, True, team)
    instead = another(m, state.sums[:, 1:].sum(axis=0))
    if len(instead) > 0:
        alpha = instead
        extrapolated(s, how, m, state, alpha, least, False, team)
    unit = EPSILON * root_mean_square(state.sums[:, 0, 1].sum(), len(s.mu))
    rounded = grow(m, alpha) * unit > DRIFT * how.target
    go_on(m)
    r, u = m.G[newest(m)], m.V[newest(m)]
    if rounded:
        write_velocity(s, state.parts, r, team, u)
        m.rounding[newest(m)] = 2.0
    else:
        push(s, state.parts, state.moved, state.outside, team, u)


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
    latest = -1  # row of the best impulse, until it is copied: before others come in its place
    while done < budget:
        row = newest(m)
        r, u = m.G[row], m.V[row]
        sweep(
            kernel, several, options, s, state.parts, how, guard[0], team, r, u, state.still, visits, log
        )  # fmt: skip
        done += 1
        map_ends = how.period > 0 and done % how.period == 0
        marks = done % MARK == 0
        if done % how.check_every != 0 and done != budget and not map_ends and not marks:
            continue
        residual = look(s, how.facets, m, state.sums, map_ends, team)
        if residual <= how.target:
            if how.period > 0:  # a contact that is left out may be outside its cone by what is negligible
                project_impulses(s, how.facets, r, *share(len(s.mu), team))
                wait(team)
            write_velocity(s, state.parts, r, team, u)
            residual = look(s, how.facets, m, state.sums, map_ends, team)
        if done < len(history):
            history[done] = residual
        if residual < best:
            best, latest = residual, row
        if latest >= 0 and (
            not map_ends or not how.target < residual < math.inf or done == budget or latest == ago(m, -1)
        ):
            first, end = share(len(s.b), team)
            state.best_r[first:end] = m.G[latest, first:end]
            latest = -1
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
    types.uint8[::1], types.int64[:, ::1],
)  # fmt: skip
_PARTS = types.NamedUniTuple(_INDEX, 7, Parts)
_SIGNATURE = types.Tuple((_I, _F, types.boolean))(
    types.FunctionType(KERNEL_SIGNATURE),
    types.FunctionType(SEVERAL_SIGNATURE),
    _VECTOR,
    types.NamedTuple((_INDEX, _INDEX, _VECTOR, _MATRIX, *3 * (_VECTOR,), _PARTS), BlockSystem),
    types.NamedTuple((_I, _F, _F, _I, _I, _F, types.boolean, _I), Sweeper),
    types.NamedTuple((_PARTS, *2 * (_VECTOR,), _INDEX, _MASK, _VECTOR, types.float64[:, :, ::1], _COUNTS), State),
    types.NamedTuple((_I, _I, _COUNTS, _INDEX), Team),
    types.NamedTuple((*3 * (_MATRIX,), *2 * (_VECTOR,), _MATRIX, *2 * (_VECTOR,)), Memory),
    _VECTOR, _COUNTS,
    types.NamedTuple((_TABLE, _VECTOR, _TABLE, _MATRIX, _MATRIX, _MATRIX, _COUNTS), VisitLog),
    _VECTOR, _F, _I, _I,
)  # fmt: skip


@cache
def compile_loop() -> None:
    """Compile `run_sweeps` for every local solver at once, or read it from the disk cache."""
    if config.DISABLE_JIT:
        return
    one_by_one.compile(SEVERAL_SIGNATURE)
    one_by_one.disable_compile()
    run_sweeps.compile(_SIGNATURE)
    run_sweeps.disable_compile()
