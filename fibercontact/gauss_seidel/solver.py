"""Block Gauss–Seidel over a local solver: the loop of THEORY §4, plain, accelerated, or robust."""

import math
import time
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numba.core import config
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import Acceleration, Memory
from fibercontact.gauss_seidel.blocks import BlockSystem, block_system, write_velocity
from fibercontact.gauss_seidel.crew import Crew, Member
from fibercontact.gauss_seidel.interior_point import interior_point
from fibercontact.gauss_seidel.loop import (
    State,
    compile_loop,
    new_guard,
    new_state,
    project_impulses,
    residual_of,
    run_sweeps,
)
from fibercontact.gauss_seidel.parts import Parts, owners, undivided
from fibercontact.gauss_seidel.sweep import COUNTERS, Sweeper
from fibercontact.gauss_seidel.team import alone, gather
from fibercontact.gauss_seidel.visit_log import VisitLog, check_log, no_log
from fibercontact.lanes import LANES
from fibercontact.local.contract import Status
from fibercontact.local.registry import Configured
from fibercontact.local.several import one_by_one
from fibercontact.problem.cone import COULOMB
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import relative
from fibercontact.threads import thread_count

__all__ = ["LOOPS", "GaussSeidel", "Outcome", "Run", "Visits"]

Array = NDArray[np.float64]

_ACCELERATION = Acceleration()

LOOPS: dict[str, dict[str, Any]] = {
    "plain": {"proximal": 0.0, "acceleration": None, "rescue_after": 0},
    "accelerated": {"proximal": 0.05, "acceleration": _ACCELERATION, "rescue_after": 0},
    "robust": {"proximal": 0.05, "acceleration": _ACCELERATION, "rescue_after": 1000},
}
"""The outer loops by name, as settings of `GaussSeidel`; `robust` is its default."""

LARGEST_RESCUE = 600_000
"""Blocks of W above which the interior-point method is not tried: its factors hold 2 to 10 times the numbers of W."""

SLICE_SECONDS = 0.05
"""The clock is looked at about this often: between slices of sweeps."""
VISIT_SECONDS = 2e-6
"""A visit is taken to last, until the clock has been looked at: longer than most do."""


class Outcome(IntEnum):
    """How a run ended, by its own account."""

    CONVERGED = 0
    SWEEPS = 1
    TIME = 2
    NOT_FINITE = 3

    @property
    def sentence(self) -> str:
        """The outcome in words."""
        return (
            "the residual met the tolerance",
            "the sweeps were exhausted",
            "the time was exhausted",
            "the residual is not finite",
        )[self]


@dataclass(frozen=True)
class Visits:
    """What happened at the visits of a run: statuses of the local solves, regimes of all."""

    by_status: dict[Status, int]
    open: int
    stick: int
    slip: int
    iterations: int
    left_out: int = 0
    """Visits at which the local solver was not asked, since its answer was known to be the impulse of before."""

    @property
    def failures(self) -> int:
        """Local solves that ended in any status but `CONVERGED`."""
        return sum(count for status, count in self.by_status.items() if status != Status.CONVERGED)

    @property
    def total(self) -> int:
        """All visits."""
        return sum(self.by_status.values()) + self.left_out

    @classmethod
    def from_counts(cls, counts: NDArray[np.int64]) -> "Visits":
        """Name the counters of the sweeps."""
        return cls(
            {status: int(counts[status]) for status in Status}, *(int(c) for c in counts[len(Status) :])
        )


@dataclass(frozen=True)
class Run:
    """One run of Gauss–Seidel: the best impulse and what the solver says of it.

    `r` (3n,) in N·s; `residual` relative to `b_ref` as in THEORY §2; `history` the residual before the first
    sweep and after each (NaN where it was not evaluated), empty unless asked for.
    """

    r: Array
    outcome: Outcome
    residual: float
    sweeps: int
    seconds: float
    visits: Visits
    history: Array = field(default_factory=lambda: np.empty(0))
    rescue: int = 0
    """Iterations of the interior-point method, 0 where the sweeps did not need it."""

    @property
    def claimed(self) -> bool:
        """Whether the solver says that it met the tolerance."""
        return self.outcome == Outcome.CONVERGED


@dataclass(frozen=True)
class GaussSeidel:
    """Block Gauss–Seidel over the local solver `local`.

    `proximal` is the c of the term `c sigma_i I` renewed at each visit (0: none); `acceleration`, when given,
    extrapolates after each of its maps. `negligible` is the change of `sigma_i r_i`, as a share of the tolerance,
    below which a contact is left as it is. `check_every` sweeps pass between two evaluations of the residual.
    Under Coulomb's law a run that has not ended after `rescue_after` sweeps (0: never) goes on from the impulses of
    the interior-point method, if they are better. `LOOPS` has the settings of the loops that have a name.
    A run in which every local solve succeeds and whose residual, looked at every 100 sweeps, has found no new
    minimum for 500 is cycling: a proximal term of 0.05 is then put in force. Local failures are not cured so.
    """

    local: Configured
    tolerance: float = 1e-4
    max_sweeps: int = 5000
    max_seconds: float = 30.0
    check_every: int = 5
    proximal: float = 0.05
    acceleration: Acceleration | None = _ACCELERATION
    negligible: float = 0.01
    rescue_after: int = 1000

    def solve(self, problem: IncrementalProblem, start: Array | None = None, history: bool = False) -> Run:
        """Solve from `start` (3n,), zero by default. The same input gives the same answer, bit for bit.

        Raises `ValueError` when `start` has the wrong shape or is not finite.
        """
        return self.solve_system(block_system(problem), problem.b_ref, start, history)

    def solve_system(
        self,
        system: BlockSystem,
        b_ref: float,
        start: Array | None = None,
        history: bool = False,
        log: VisitLog | None = None,
    ) -> Run:
        """Solve a problem that is already laid out for sweeps; `log`, an empty one, records the visits.

        Raises `ValueError` when the start or the log does not fit the problem.
        """
        if log is not None:
            check_log(log, len(system.mu))
        compile_loop()
        kernel, several, options = self.local.kernel(), self.local.several(), self.local.options
        began = time.perf_counter()
        how, parts = self._sweeper(b_ref), self._parts(system)
        threads = 1 if log is not None else _threads(parts)
        acceleration = self.acceleration or Acceleration(window=0)
        state, memory = new_state(system, parts, _start(start, len(system.b)), acceleration, threads)
        team = alone(len(parts.parts) - 1)
        best = residual_of(system, memory.G[0], memory.V[0], state.sums, how.facets, team)
        past = np.full(self.max_sweeps + 1 if history else 0, np.nan)
        past[:1] = best
        crew = Crew(self._members(system, state, memory, threads))
        kernels = (kernel, several or one_by_one, options)
        rest = (log or no_log(), past)
        rescue_at = self._rescue_at(system)
        done, reached, elapsed, rescue = 0, best <= how.target, 0.0, 0
        while not reached and math.isfinite(best) and done < self.max_sweeps and elapsed < self.max_seconds:
            count = crew.plan(elapsed, self._slice(done, elapsed, len(system.mu)), self._step)
            end = min(self.max_sweeps, rescue_at if done < rescue_at else self.max_sweeps, done + count)

            def sweeps(member: Member, best: float = best, done: int = done, end: int = end) -> Any:
                return run_sweeps(*kernels, system, how, state, *member, *rest, best, done, end)

            done, best, reached = crew.sweep(sweeps, end - done, state.failed)
            if done == rescue_at and not reached and math.isfinite(best):
                rescue, best = self._rescue(system, b_ref, state, crew.members[0].memory, best, began)
                reached = best <= how.target
            elapsed = time.perf_counter() - began
        if not reached and math.isfinite(best):  # one that is reached has been confirmed
            best = _afresh(system, state, memory, how)
        past = past[: done + 1] / (b_ref or 1.0) if history else past
        outcome = _outcome(reached, best, done >= self.max_sweeps)
        residual = relative(best, b_ref)
        visits = Visits.from_counts(np.sum([member.visits for member in crew.members], axis=0))
        return Run(state.best_r, outcome, residual, done, elapsed, visits, past, rescue)

    def _parts(self, system: BlockSystem) -> Parts:
        """Plain sweeps are the textbook's: contact by contact, in the order of the problem."""
        return system.parts if self.acceleration else undivided(system.columns, len(system.mu))

    @property
    def _width(self) -> int:
        """Contacts solved at once: the textbook's sweeps and interpreted kernels take one."""
        can = self.local.registered.solver.several is not None and not config.DISABLE_JIT
        return LANES if can and self.acceleration else 1

    def _members(self, system: BlockSystem, state: State, memory: Memory, threads: int) -> list[Member]:
        """What each thread of a run has for its own."""
        return [
            Member(team, memory.own(), new_guard(self.proximal), np.zeros(COUNTERS, dtype=np.int64))
            for team in gather(threads, owners(state.parts, system.starts, threads))
        ]

    def _rescue_at(self, system: BlockSystem) -> int:
        """Sweeps after which the interior-point method is asked, 0 where it is not."""
        can = self.local.facets == COULOMB and len(system.columns) <= LARGEST_RESCUE
        return self.rescue_after if can else 0

    def _rescue(
        self,
        system: BlockSystem,
        b_ref: float,
        state: State,
        memory: Memory,
        best: float,
        began: float,
    ) -> tuple[int, float]:
        """Go on from the interior-point method's impulses, if they are better than the best so far."""
        target = 0.5 * self.tolerance * (b_ref or 1.0)
        run = interior_point(system, b_ref or 1.0, target, deadline=began + self.max_seconds)
        if run.residual < best:
            best = run.residual
            state.best_r[:], state.still[:] = run.r, np.inf
            team, u = alone(len(state.parts.parts) - 1), memory.restart(run.r)
            write_velocity(system, state.parts, run.r, team, u)
        return run.iterations, best

    def _sweeper(self, b_ref: float) -> Sweeper:
        target = self.tolerance * (b_ref or 1.0)
        period, tikhonov = (
            (self.acceleration.sweeps, self.acceleration.tikhonov) if self.acceleration else (0, 0.0)
        )
        return Sweeper(
            self.local.facets,
            float(self.negligible * target),
            float(target),
            self.check_every,
            period,
            tikhonov,
            self.acceleration is None,
            self._width,
        )

    @property
    def _step(self) -> int:
        """The fewest sweeps between two looks at the clock: a whole number of checks and of maps."""
        return self.check_every * (self.acceleration.sweeps if self.acceleration else 1)

    def _slice(self, done: int, elapsed: float, n: int) -> int:
        """Sweeps until the next look at the clock."""
        a_sweep = elapsed / done if done > 0 else n * VISIT_SECONDS
        return self._step * max(1, int(SLICE_SECONDS / max(a_sweep, 1e-9)) // self._step)


def _afresh(system: BlockSystem, state: State, memory: Memory, how: Sweeper) -> float:
    """The residual of the best impulses, put into their cones, without the rounding of a run's velocities."""
    team = alone(len(state.parts.parts) - 1)
    if how.period > 0:
        project_impulses(system, how.facets, state.best_r, 0, len(system.mu))
    write_velocity(system, state.parts, state.best_r, team, memory.V[0])
    return residual_of(system, state.best_r, memory.V[0], state.sums, how.facets, team)


def _threads(parts: Parts) -> int:
    """Threads that sweep a problem together: no more than there are leaves."""
    return 1 if config.DISABLE_JIT else min(thread_count(), int(parts.phases[1]))


def _outcome(reached: bool, best: float, exhausted: bool) -> Outcome:
    if reached:
        return Outcome.CONVERGED
    if not math.isfinite(best):
        return Outcome.NOT_FINITE
    return Outcome.SWEEPS if exhausted else Outcome.TIME


def _start(start: Array | None, size: int) -> Array:
    """A copy of the starting impulse; raises `ValueError` on a wrong shape or values that are not finite."""
    if start is None:
        return np.zeros(size)
    if start.shape != (size,) or not np.isfinite(start).all():
        raise ValueError(f"the start must be a finite vector of shape ({size},), not {start.shape}")
    return np.array(start, dtype=np.float64)
