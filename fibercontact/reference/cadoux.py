"""Cadoux's fixed point: Coulomb's law as a sequence of convex problems (THEORY §5).

`u` obeys Coulomb's law when it solves the convex problem of the slip term `s_i = ‖u_T,i‖`. The plain loop
`s ← ‖u_T(s)‖` creeps on some problems and cycles on others, which Anderson's acceleration cures; the accelerated one
chatters on a few where the plain loop converges; what is left cycles unless it is damped,
`s ← (1 − theta) s + theta ‖u_T(s)‖`. These are the stages of the loop: when the residual stalls, the next takes over.

References: [Cadoux 2009]; [Acary, Cadoux, Lemaréchal & Malick 2011] ZAMM 91.
"""

import math
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import Acceleration, Memory, extrapolate
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure
from fibercontact.reference.conic import Form, Problem, condensed, default_form

__all__ = ["STAGES", "Cadoux", "CadouxRun", "Stage", "sliding_speed"]

Array = NDArray[np.float64]


class Stage(NamedTuple):
    """A way from one slip term to the next."""

    name: str
    window: int  # of the acceleration, 0 for none
    theta: float


ACCELERATED, PLAIN = Stage("accelerated", 5, 1.0), Stage("plain", 0, 1.0)
STAGES = (ACCELERATED, PLAIN, *(Stage(f"damped, theta = {t:g}", 0, t) for t in (0.5, 0.25, 0.125)))
PATIENCE = 8  # iterations in which the residual must halve
FLOOR = 1e-6  # residual below which a stall is put down to Clarabel's accuracy, which no stage improves


@dataclass(frozen=True)
class CadouxRun:
    """Best impulses `r` (3n,) in N·s, their residual of Coulomb's law, and how the loop went."""

    r: Array
    residual: float
    iterations: int
    stage: str
    """The stage that the loop ended in."""


@dataclass(frozen=True)
class Cadoux:
    """The loop over any form of the convex problem."""

    form: Form = default_form
    tolerance: float = 1e-10
    max_iterations: int = 100
    max_seconds: float = 30.0
    stages: tuple[Stage, ...] = STAGES

    def solve(self, problem: Problem, slip: Array | None = None) -> CadouxRun:
        """Iterate from the slip term `slip` (n,) >= 0 in m/s; by default from zero, the associated model."""
        incremental, model = condensed(problem), self.form(problem)
        nothing = np.zeros(3 * problem.n)
        measure(incremental, nothing)  # compiles: before the clock starts
        best, k, began = CadouxRun(nothing, math.inf, 0, "not started"), 0, time.perf_counter()
        s = np.zeros(problem.n) if slip is None else slip
        for stage in self.stages:
            memory, level, stale = Acceleration(window=stage.window).memory(np.zeros(problem.n)), math.inf, 0
            while stale < PATIENCE:
                left = self.max_seconds - (time.perf_counter() - began)
                if k == self.max_iterations or left <= 0.0:
                    return best
                answer, k = model.solve(s, left), k + 1
                residual = measure(incremental, answer.r).coulomb
                r, least = (answer.r, residual) if residual < best.residual else (best.r, best.residual)
                best = CadouxRun(r, least, k, stage.name)
                if least <= self.tolerance or not math.isfinite(residual):
                    return best
                level, stale = (residual, 0) if residual <= 0.5 * level else (level, stale + 1)
                s = _next(s, sliding_speed(incremental, answer.r), residual, stage, memory)
            if best.residual <= FLOOR:
                break
        return best


def sliding_speed(problem: IncrementalProblem, r: Array) -> Array:
    """`‖u_T‖` (n,) in m/s under the impulses `r` (3n,)."""
    u = (problem.W @ r + problem.b).reshape(-1, 3)
    return np.hypot(u[:, 1], u[:, 2])


def _next(s: Array, slip: Array, residual: float, stage: Stage, memory: Memory) -> Array:
    """The next slip term (n,), from the speeds `slip` that `s` led to."""
    if stage.window == 0:
        return (1.0 - stage.theta) * s + stage.theta * slip
    memory.x[:] = s
    extrapolate(memory, slip, residual, Acceleration.tikhonov)
    return np.maximum(memory.x, 0.0)
