"""Cost of a Gauss–Seidel sweep, in ns a contact, for every local solver.

The problem is a seeded assembly of strands (`assemblies.py`). Each figure is the least of several runs of 20 sweeps
from zero, the solvers taking turns, without any evaluation of the residual in between.

    python experiments/sweep_cost.py [--contacts 1000] [--repetitions 30] [--solvers secular,hybrid]
"""

import numpy as np
from assemblies import strands
from common.script import options

from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.local.registry import configure, registered

SWEEPS = 20


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--contacts", type=int, default=1000)
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--solvers", default="secular,hybrid,mfb,dac,pac,enum-quartic,enum-companion,pyramid")
    given = parser.parse_args()
    problem = strands(given.contacts, 0.3, 3)
    system = block_system(problem)
    known = registered()
    loops = {
        name: GaussSeidel(
            configure(name, known), 0.0, SWEEPS, check_every=SWEEPS, negligible=0.0, **LOOPS["plain"]
        )
        for name in given.solvers.split(",")
    }
    least = dict.fromkeys(loops, np.inf)
    for _ in range(given.repetitions):
        for name, loop in loops.items():
            least[name] = min(least[name], loop.solve_system(system, problem.b_ref).seconds)
    print(
        f"{problem.n} contacts, {len(problem.W.indices) / problem.n:.1f} blocks a row, {SWEEPS} sweeps from zero"
    )
    for name, seconds in least.items():
        print(f"{name:<16}{1e9 * seconds / SWEEPS / problem.n:8.0f} ns a contact")


if __name__ == "__main__":
    main()
