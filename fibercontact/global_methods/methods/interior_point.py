"""Interior-point method on Coulomb's law itself, its slip term differentiated.

Equation: `y − |y_T| e = A x + c`, `x∘y = t e` with t → 0, x and y in the Lorentz cone; Nesterov and Todd's scaling,
Mehrotra's predictor and corrector, one sparse factorisation an iteration. It starts from impulses of its own.
Reference: `fibercontact/gauss_seidel/interior_point.py`, where it helps sweeps that stall.
Tens of iterations; rounding leaves residuals of 1e-6 to 1e-10. Refuses more contacts than the factors of W may fit
into memory for.
"""

import time

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import BlockSystem
from fibercontact.gauss_seidel.interior_point import interior_point
from fibercontact.global_methods.contract import Answer, GlobalMethod, Task
from fibercontact.global_methods.scaled import answer, check_size

__all__ = ["solver"]


def solve(system: BlockSystem, task: Task, options: NDArray[np.float64]) -> Answer:
    """Solve a problem; see the module's docstring."""
    check_size(system)
    deadline = time.perf_counter() + task.max_seconds
    run = interior_point(system, task.b_ref or 1.0, task.target, task.max_iterations, deadline)
    return answer(system, task, run.r, run.iterations, "no more progress was made")


solver = GlobalMethod(solve)
