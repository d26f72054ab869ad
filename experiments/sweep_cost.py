"""Cost of a Gauss–Seidel sweep, in ns a contact, for every local solver.

The problem is a seeded assembly of strands with about 20 blocks a row of W: 15 dofs a strand, a dense SPD
mobility of condition number 1e3, random contact frames. Each figure is the least of several runs of 20 sweeps
from zero, the solvers taking turns, without any evaluation of the residual in between.

    python experiments/sweep_cost.py [--contacts 1000] [--repetitions 30] [--solvers secular,hybrid]
"""

import argparse

import numpy as np
from scipy.sparse import block_diag, csr_array

from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem

SWEEPS = 20
DOFS = 15


def strands(contacts: int, mu: float, seed: int) -> IncrementalProblem:
    """Contacts between neighbours among strands with random SPD dynamics; no contact is `b = H v_free`."""
    rng = np.random.default_rng(seed)
    count = max(3, contacts // 5)
    bases = [np.linalg.qr(rng.standard_normal((DOFS, DOFS)))[0] for _ in range(count)]
    M = csr_array(block_diag([(Q * np.logspace(0, 3, DOFS)) @ Q.T for Q in bases]))
    first = np.sort(rng.integers(0, count, contacts))
    second = (first + rng.integers(1, min(4, count - 1) + 1, contacts)) % count
    rows, columns, values = [], [], []
    for i, (a, b) in enumerate(zip(first, second, strict=True)):
        frame = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        for rod, sign in ((a, 1.0), (b, -1.0)):
            block = sign * frame @ rng.standard_normal((3, DOFS)) * 2 / np.sqrt(DOFS)
            rows.append(np.repeat(3 * i + np.arange(3), DOFS))
            columns.append(np.tile(DOFS * rod + np.arange(DOFS), 3))
            values.append(block.ravel())
    index = (np.concatenate(rows), np.concatenate(columns))
    jacobian = csr_array((np.concatenate(values), index), shape=(3 * contacts, DOFS * count))
    free = rng.standard_normal(DOFS * count)
    M = csr_array(0.5 * (M + M.T))
    return StepProblem(M, -(M @ free), jacobian, np.zeros(3 * contacts), np.full(contacts, mu)).condense()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
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
