"""The problem of a step with bilateral constraints, of inextensible rods for instance (THEORY §7)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array, vstack
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from fibercontact.problem.incremental import IncrementalProblem, ProblemError, check_csr
from fibercontact.problem.memory import check_memory
from fibercontact.problem.step import StepProblem

__all__ = ["ConstrainedStep"]

F64 = NDArray[np.float64]
Index = NDArray[Any]


@dataclass(frozen=True, eq=False)
class ConstrainedStep:
    """A step `M v + f = Hᵀ r + G lambda`, `u = H v + w` with the constraints `Gᵀ v + c = 0`.

    `G` (d, l) CSR, `c` (l,); the rest is that of `step`. Raises `ProblemError` if `G` does not fit.
    """

    step: StepProblem
    G: csr_array
    c: F64

    def __post_init__(self) -> None:
        check_csr("G", self.G, (self.step.d, len(self.c)))

    @property
    def n(self) -> int:
        """Number of contacts."""
        return self.step.n

    @property
    def d(self) -> int:
        """Number of degrees of freedom, before the constraints."""
        return self.step.d

    @property
    def mu(self) -> F64:
        """Friction coefficients (n,)."""
        return self.step.mu

    @property
    def H(self) -> csr_array:
        """Contact Jacobian (3n, d)."""
        return self.step.H

    @property
    def w(self) -> F64:
        """Velocity (3n,) in m/s that does not come from the dofs."""
        return self.step.w

    def condense(self) -> IncrementalProblem:
        """Eliminate multipliers and velocities.

        Exact: with `M = L Lᵀ`, `Lᵀ v` is a fixed vector of the range of `L⁻¹ G` plus any vector orthogonal to it,
        so that `W` is a Gram matrix again (the projected `M⁻¹` of THEORY §7). Dense within each group of coupled
        rods. Raises `ProblemError` if `G` is rank deficient, `M` not definite, or a group too large for the memory.
        """
        b = self.w.copy()
        responses = [csr_array((0, 3 * self.n))]
        for group in _coupled(self):
            Y, offset = _free_response(group)
            b[group.rows] += offset
            at = np.indices(Y.shape)
            entries = (Y.ravel(), (at[0].ravel(), group.rows[at[1].ravel()]))
            responses.append(csr_array(entries, (len(Y), 3 * self.n)))
        free = vstack(responses, format="csr")
        return IncrementalProblem.from_sparse(free.T @ free, b, self.mu)

    def velocities(self, r: F64) -> F64:
        """Generalised velocities (d,) under the impulses `r` (3n,)."""
        matrix = block_array([[self.step.M, -self.G], [self.G.T, None]], format="csc")
        known = np.concatenate([self.step.H.T @ r - self.step.f, -self.c])
        return np.asarray(splu(matrix).solve(known)[: self.d], dtype=np.float64)


class _Group(NamedTuple):
    """Rods that constraints couple, and the part of the step that is theirs, dense."""

    dofs: Index  # (D,)
    constraints: Index  # (l,)
    rows: Index  # (m,) of H that move them
    M: F64  # (D, D)
    f: F64  # (D,)
    H: F64  # (m, D)
    G: F64  # (D, l)
    c: F64  # (l,)


def _coupled(problem: ConstrainedStep) -> Iterator[_Group]:
    """The groups of coupled rods: connected components of dofs and constraints."""
    step, d = problem.step, problem.d
    blocks: Any = [[step.M, problem.G], [problem.G.T, None]]
    count, label = connected_components(block_array(blocks), directed=False)
    dofs, dof_start = _sorted(label[:d], count)
    constraints, constraint_start = _sorted(label[d:], count)
    M, H, G = step.M[dofs][:, dofs], step.H.tocsc()[:, dofs], problem.G[dofs][:, constraints]
    for k in range(count):
        here = slice(*dof_start[k : k + 2])
        there = slice(*constraint_start[k : k + 2])
        H_k = H[:, here].tocoo()
        rows, at = np.unique(H_k.row, return_inverse=True)
        D = len(dofs[here])
        check_memory("the elimination of bilateral constraints", D * (3 * D + len(rows)))
        yield _Group(
            dofs[here], constraints[there], rows, M[here, here].toarray(), step.f[dofs[here]],
            csr_array((H_k.data, (at, H_k.col)), (len(rows), D)).toarray(),
            G[here, there].toarray(), problem.c[constraints[there]],
        )  # fmt: skip


def _sorted(label: Index, count: int) -> tuple[Index, Index]:
    """Numbers of what is labelled 0..count, label by label, and where each label starts."""
    order = np.argsort(label, kind="stable")
    return order, np.searchsorted(label[order], np.arange(count + 1))


def _free_response(group: _Group) -> tuple[F64, F64]:
    """`Y` with `W += Yᵀ Y`, and what `b` gains, in the rows of the group."""
    if len(group.constraints) > len(group.dofs):
        raise ProblemError(
            f"G is rank deficient: bilateral constraints {group.constraints} on {len(group.dofs)} dofs"
        )
    L = _cholesky(group)
    Y_H, y_f, Y_G = (np.linalg.solve(L, rhs) for rhs in (group.H.T, group.f, group.G))
    fixed, free, R = _split(np.asarray(Y_G, dtype=np.float64), group.constraints)
    y_fixed = -fixed @ np.linalg.solve(R.T, group.c)
    Y_free = free.T @ Y_H
    return Y_free, Y_H.T @ y_fixed - Y_free.T @ (free.T @ y_f)


def _cholesky(group: _Group) -> F64:
    try:
        return np.asarray(np.linalg.cholesky(group.M), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise ProblemError(f"M is not positive definite among degrees of freedom {group.dofs}") from None


def _split(Y_G: F64, constraints: Index) -> tuple[F64, F64, F64]:
    """Orthonormal bases of the range of `Y_G` and of its complement, and `R` with `Y_G = range R`."""
    rank = Y_G.shape[1]
    Q, R = (np.asarray(factor, dtype=np.float64) for factor in np.linalg.qr(Y_G, mode="complete"))
    dependent = np.abs(np.diagonal(R)) <= 1e-10 * np.linalg.norm(Y_G, axis=0)
    if dependent.any():
        at = constraints[int(np.argmax(dependent))]
        raise ProblemError(f"G is rank deficient: bilateral constraint {at} depends on the others")
    return Q[:, :rank], Q[:, rank:], R[:rank]
