"""Cadoux's fixed point over a method for the convex problem of a frozen slip term.

`s ← mu ‖y_T(s)‖`, where y(s) comes of minimising `½ xᵀA x + (c + s e)ᵀx` over the cones from the last impulses on.
The convex problem is solved until its residual is `INNER` times that of Coulomb's law where it began: more would be
lost at the next change of s. Where the fixed point is not attractive the loop cycles.

References: [Cadoux 2009]; [Acary, Cadoux, Lemaréchal & Malick 2011] ZAMM 91; THEORY §5.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import BlockSystem, velocity
from fibercontact.global_methods.contract import Answer, Solve, Task
from fibercontact.global_methods.scaled import (
    MARGIN,
    NO_SLIP,
    Budget,
    Scaled,
    answer,
    cone_residual,
    impulse,
    scale,
    slip_terms,
    start_of,
)

__all__ = ["cadoux", "followed"]

Array = NDArray[np.float64]

INNER = 0.1
ENOUGH = 0.3
"""Share of the target to which the convex problem is solved at most."""

Begin = Callable[[Scaled, Array], Any]
Run = Callable[[Scaled, Array, Any, float, int], tuple[int, bool]]


def cadoux(begin: Begin, run: Run) -> Solve:
    """The loop as a global method, the convex problems solved by `run` on the memory that `begin` gives."""

    def solve(system: BlockSystem, task: Task, options: Array) -> Answer:
        p, budget, target = scale(system), Budget(task), MARGIN * task.target
        x, steps = start_of(p, task), 0
        best, y = (math.inf, x), np.empty_like(x)
        while True:
            velocity(p.A, x, y)
            residual = cone_residual(p, NO_SLIP, x, y)
            best = min(best, (residual, x), key=lambda pair: pair[0])
            if not target < residual < math.inf or budget.slice == 0:
                break
            m, steps = begin(p, x), steps + 1
            advance(run, p, slip_terms(p, y), m, max(ENOUGH * target, INNER * residual), budget)
            x = m.x.copy()
        note = f"{budget.note} after {steps} slip terms"
        return answer(system, task, impulse(p, best[1]), budget.done, note)

    return solve


def followed(begin: Begin, run: Run) -> Solve:
    """The same inner method with the slip term of every iterate instead, as a global method."""

    def solve(system: BlockSystem, task: Task, options: Array) -> Answer:
        p, budget = scale(system), Budget(task)
        m = begin(p, start_of(p, task))
        advance(run, p, NO_SLIP, m, MARGIN * task.target, budget)
        return answer(system, task, impulse(p, m.best), budget.done, budget.note)

    return solve


def advance(run: Run, p: Scaled, slip: Array, m: Any, target: float, budget: Budget) -> None:
    """Iterate until the residual of this slip term is at most `target` or the budget is used up."""
    reached = False
    while not reached and (count := budget.slice):
        done, reached = run(p, slip, m, target, count)
        budget.done += done
