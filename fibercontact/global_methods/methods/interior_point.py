"""Interior-point method on Coulomb's law itself, its slip term differentiated.

Equation: `y − (1 − lam) |y_T| e = A x + c + lam d`, `x∘y = lam e`, x and y in the Lorentz cone: a path from lam = 1,
a convex problem of known solution, to Coulomb's law at lam = 0. Nesterov and Todd's scaling, steps along the path's
tangent and its curvature, one sparse factorisation an iteration; where the path turns, lam rises. It starts from
impulses of its own.
Reference: `fibercontact/gauss_seidel/central_path.py`; it helps sweeps that stall.
Tens of iterations, hundreds on jammed problems; rounding leaves residuals of 1e-7 to 1e-11. Loses a path of many
sharp turns. Refuses more contacts than the factors of W may fit into memory for.
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
    return answer(system, task, run.r, run.iterations, "the path could not be followed further")


solver = GlobalMethod(solve)
