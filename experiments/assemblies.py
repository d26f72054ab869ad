"""Synthetic fibre assemblies: the yardstick of the experiments on speed.

A strand has 15 degrees of freedom and a dense mobility of condition number 1e3; a contact couples two strands near
each other, in a random frame. `b = H v_free`, so that zero relative velocity can be reached and a solution exists.
About 20 blocks a row of W.

    python experiments/assemblies.py [--contacts 1000] [--mu 0.3] [--seed 3]
"""

import numpy as np
from common.script import options
from scipy.sparse import bsr_array

from fibercontact.problem.incremental import IncrementalProblem

__all__ = ["strands"]

DOFS, CONTACTS_PER_STRAND, CONDITION, REACH = 15, 10, 1e3, 4


def strands(contacts: int, mu: float, seed: int) -> IncrementalProblem:
    """The assembly of this seed; the order of the random numbers is part of its definition."""
    rng = np.random.default_rng(seed)
    count = max(3, round(2 * contacts / CONTACTS_PER_STRAND))
    reach = min(REACH, (count - 1) // 2) or 1
    spectrum = np.logspace(0, -np.log10(CONDITION), DOFS)
    bases = [np.linalg.qr(rng.standard_normal((DOFS, DOFS)))[0] for _ in range(count)]
    mobility = np.array([(Q * spectrum) @ Q.T for Q in bases])
    first = rng.integers(0, count, contacts)
    second = (first + rng.integers(1, reach + 1, contacts)) % count
    jacobian = rng.standard_normal((contacts, 2, 3, DOFS)) * 2 / np.sqrt(DOFS)
    frame = frames(rng, contacts)
    sides = np.stack([frame @ jacobian[:, 0], -(frame @ jacobian[:, 1])], axis=1)
    order = np.lexsort((second, first))
    columns = np.column_stack([first, second])[order].ravel()
    H = bsr_array(
        (sides[order].reshape(-1, 3, DOFS), columns, np.arange(0, 2 * contacts + 1, 2)),
        shape=(3 * contacts, DOFS * count),
    )
    inverse = bsr_array((mobility, np.arange(count), np.arange(count + 1)), shape=2 * (DOFS * count,))
    W = H @ inverse @ H.T
    b = H @ rng.standard_normal(DOFS * count)
    W = bsr_array((0.5 * (W + W.T)).tobsr((3, 3)))
    W.sort_indices()
    return IncrementalProblem(W, b, np.full(contacts, float(mu)))


def frames(rng: np.random.Generator, count: int) -> np.ndarray:
    """Random frames (count, 3, 3): normal, first and second tangent."""
    normal = rng.standard_normal((count, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    tangent = rng.standard_normal((count, 3))
    tangent -= np.sum(tangent * normal, axis=1)[:, None] * normal
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    return np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--contacts", type=int, default=1000)
    parser.add_argument("--mu", type=float, default=0.3)
    parser.add_argument("--seed", type=int, default=3)
    given = parser.parse_args()
    problem = strands(given.contacts, given.mu, given.seed)
    print(
        f"{problem.n} contacts, {len(problem.W.indices) / problem.n:.1f} blocks a row, |b| = {problem.b_ref:.4g}"
    )


if __name__ == "__main__":
    main()
