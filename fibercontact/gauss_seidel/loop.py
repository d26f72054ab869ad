"""The loop of sweeps, compiled once for all local solvers: sweep, measure, keep the best, extrapolate."""

import math
from typing import Any

import numpy as np
from numba import types
from numba.core import config
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import Memory, extrapolate, remember
from fibercontact.gauss_seidel.sweep import LAST_FAILURE, BlockSystem, Sweeper, residual_from, sweep, velocity
from fibercontact.gauss_seidel.visit_log import CURED, VisitLog
from fibercontact.jit import jit
from fibercontact.local.contract import KERNEL_SIGNATURE
from fibercontact.problem.cone import project

__all__ = ["MARK", "compile_loop", "new_guard", "run_sweeps", "scale_impulse"]

MARK = 100
"""Sweeps between two looks at whether the run cycles."""
PATIENCE = 5
"""Looks without a new least residual after which it does."""
CURE = 0.05
"""Proximal term that is then put in force: a contact with several solutions no longer jumps between them."""

Array = NDArray[np.float64]


@jit
def scale_impulse(s: BlockSystem, r: Array, x: Array) -> None:
    """Write `sqrt(sigma_i) r_i` into `x`."""
    for i in range(len(s.mu)):
        scale = math.sqrt(s.sigma[i])
        for c in range(3 * i, 3 * i + 3):
            x[c] = scale * r[c]


@jit
def into_cones(s: BlockSystem, facets: int, x: Array, r: Array) -> None:
    """Write the impulses of the scaled variable `x`, projected on their cones, into `r`."""
    for i in range(len(s.mu)):
        scale = 1.0 / math.sqrt(s.sigma[i])
        p = project((scale * x[3 * i], scale * x[3 * i + 1], scale * x[3 * i + 2]), s.mu[i], facets)
        r[3 * i], r[3 * i + 1], r[3 * i + 2] = p[0], p[1], p[2]


@jit
def accelerate(s: BlockSystem, how: Sweeper, m: Memory, r: Array, u: Array, residual: float) -> None:
    """One Anderson step: replace `r`, the image of `m.x`, by the extrapolated impulse."""
    g = np.empty_like(r)
    scale_impulse(s, r, g)
    remember(m, g, residual)
    extrapolate(m, how.tikhonov)
    into_cones(s, how.facets, m.x, r)
    scale_impulse(s, r, m.x)
    velocity(s, r, u)


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
    options: Array,
    s: BlockSystem,
    how: Sweeper,
    m: Memory,
    guard: Array,
    r: Array,
    u: Array,
    best_r: Array,
    visits: NDArray[np.int64],
    log: VisitLog,
    history: Array,
    best: float,
    done: int,
    budget: int,
) -> tuple[int, float, bool]:
    """Sweep until the target or until `budget` sweeps in all; returns (sweeps done, best residual, reached).

    `r` and `u` are updated in place, `best_r` is the best iterate, `history[k]` (when long enough) the
    residual after sweep k where it was evaluated. A residual that meets the target is confirmed on a
    velocity computed afresh. The best residual is returned as NaN when an iterate is not finite.
    """
    while done < budget:
        sweep(kernel, options, s, how, guard[0], r, u, visits, log)
        done += 1
        map_ends = how.period > 0 and done % how.period == 0
        marks = done % MARK == 0
        if done % how.check_every != 0 and done != budget and not map_ends and not marks:
            continue
        residual = residual_from(s, r, u, how.facets)
        if residual <= how.target:
            velocity(s, r, u)
            residual = residual_from(s, r, u, how.facets)
        if done < len(history):
            history[done] = residual
        if residual < best:
            best = residual
            best_r[:] = r
        if residual <= how.target:
            return done, best, True
        if not math.isfinite(residual):
            return done, math.nan, False
        if marks:
            before = guard[0]
            watch(guard, residual, visits[1 : LAST_FAILURE + 1].sum())
            if guard[0] > before:
                log.state[CURED] = done
        if map_ends:
            accelerate(s, how, m, r, u, residual)
    return done, best, False


_F, _I, _VECTOR, _INDEX, _MATRIX, _COUNTS, _TABLE = (
    types.float64, types.int64, types.float64[::1], types.int32[::1], types.float64[:, ::1], types.int64[::1],
    types.int64[:, ::1],
)  # fmt: skip
_SIGNATURE = types.Tuple((_I, _F, types.boolean))(
    types.FunctionType(KERNEL_SIGNATURE),
    _VECTOR,
    types.NamedTuple((_INDEX, _INDEX, _VECTOR, _MATRIX, _VECTOR, _VECTOR, _VECTOR), BlockSystem),
    types.NamedTuple((_I, _F, _F, _I, _I, _F), Sweeper),
    types.NamedTuple((_MATRIX, _MATRIX, _VECTOR, _VECTOR, _VECTOR, _VECTOR), Memory),
    _VECTOR, _VECTOR, _VECTOR, _VECTOR, _COUNTS,
    types.NamedTuple((_TABLE, _VECTOR, _TABLE, _MATRIX, _MATRIX, _MATRIX, _COUNTS), VisitLog),
    _VECTOR, _F, _I, _I,
)  # fmt: skip


def compile_loop() -> None:
    """Compile `run_sweeps` for every local solver at once, or read it from the disk cache."""
    if config.DISABLE_JIT or run_sweeps.signatures:
        return
    run_sweeps.compile(_SIGNATURE)
    run_sweeps.disable_compile()
