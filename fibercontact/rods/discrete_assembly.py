"""Gradient and matrix of a step of discrete rods, assembled from the derivatives of its nodes and edges.

The matrix `M = 𝕄 + dt² ∇²E`, with `dt C` of drag, is made definite rod by rod. Where the true M of a rod has a
Cholesky factor it is taken; where it has not, the second derivatives of each inner node, 8×8 in (e, θ^e, f, θ^f)
with e, f in edge lengths, lose their negative eigenvalues, and edges under pressure their negative transverse
stiffness: then M ≥ 𝕄 > 0.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.rods import bands
from fibercontact.rods.discrete_energy import Derivatives
from fibercontact.rods.discrete_model import DiscreteRods

__all__ = ["assemble_gradient", "assemble_matrix", "definite_matrix"]

Array = NDArray[np.float64]

_I3 = np.eye(3)
_NODE_MAP = np.zeros((8, 11))  # (e, θ^e, f, θ^f) from (x, θ, x, θ, x)
_NODE_MAP[:3, :3], _NODE_MAP[:3, 4:7], _NODE_MAP[3, 3] = -_I3, _I3, 1
_NODE_MAP[4:7, 4:7], _NODE_MAP[4:7, 8:], _NODE_MAP[7, 7] = -_I3, _I3, 1
_EDGE_MAP = np.hstack([-_I3, np.zeros((3, 1)), _I3])  # e from (x, θ, x)


def assemble_gradient(slopes: Derivatives, tangent: Array) -> Array:
    """Gradient (R, 4N + 3) of an energy, assembled from its nodes and edges."""
    R, N = slopes.tension.shape
    gradient = np.zeros((R, 4 * N + 3))
    of_nodes = slopes.node_gradient @ _NODE_MAP
    of_edges = (slopes.tension[:, :, None] * tangent) @ _EDGE_MAP
    for parts in (of_nodes, of_edges):
        count, width = parts.shape[1:]
        for p in range(width):
            gradient[:, p : p + 4 * count : 4] += parts[:, :, p]
    return gradient


def definite_matrix(
    rods: DiscreteRods, slopes: Derivatives, tangent: Array, dt: float, drag: Array | None
) -> tuple[Array, Array]:
    """Bands of M (R, 11, D), definite, in the dofs that are not prescribed, and their Cholesky factors."""
    M = assemble_matrix(rods.inertia, slopes, tangent, dt, drag)[:, :, rods.prescribed :]
    factor, definite = bands.cholesky(M)
    wrong = ~definite & np.isfinite(M).all(axis=(1, 2))
    if wrong.any():
        clamped = _clamped(Derivatives._make(x[wrong] for x in slopes), rods.edge_length[wrong])
        of_these = None if drag is None else drag[wrong]
        lower = assemble_matrix(rods.inertia[wrong], clamped, tangent[wrong], dt, of_these)
        M[wrong] = lower[:, :, rods.prescribed :]
        factor[wrong] = bands.cholesky(M[wrong])[0]
    return M, factor


def assemble_matrix(
    inertia: Array, slopes: Derivatives, tangent: Array, dt: float, drag: Array | None = None
) -> Array:
    """Bands (R, 11, 4N + 3) of `𝕄 + dt² ∇²E`, and of `dt C` with the drag C (R, N + 1, 3, 3) of the nodes."""
    matrix = np.zeros((len(inertia), 11, inertia.shape[1]))
    if drag is not None:
        bands.add_blocks(matrix, dt * drag, 4)
    bands.add_blocks(matrix, dt**2 * (_NODE_MAP.T @ slopes.node_hessian @ _NODE_MAP), 4)
    along = tangent[..., :, None] * tangent[..., None, :]
    axial, transverse = slopes.axial[..., None, None], slopes.transverse[..., None, None]
    bands.add_blocks(
        matrix, dt**2 * (_EDGE_MAP.T @ (transverse * _I3 + (axial - transverse) * along) @ _EDGE_MAP), 4
    )
    matrix[:, 0] += inertia
    return matrix


def _clamped(slopes: Derivatives, edge_length: Array) -> Derivatives:
    """Replace second derivatives by their parts that are not negative."""
    e = edge_length[:, None]
    unit = np.concatenate([np.tile(x, (1, m)) for x, m in ((e, 3), (0 * e + 1, 1)) * 2], axis=1)[:, None]
    scale = unit[..., :, None] * unit[..., None, :]
    values, vectors = np.linalg.eigh(slopes.node_hessian * scale)
    positive = (vectors * np.maximum(values, 0)[..., None, :]) @ vectors.swapaxes(-1, -2) / scale
    return slopes._replace(node_hessian=positive, transverse=np.maximum(slopes.transverse, 0))
