"""Energies of discrete rods with their first and second derivatives [Bergou 2008, 2010].

At an inner node between the edges e and f, with unit tangents t and u,

    kappa_b = 2 t×u / (1 + t·u)                       curvature binormal
    kappa_a = ½ kappa_b·(m_a^e + m_a^f)               bending strains, a = 1, 2 (kappa_a turns about m_a)
    m = θ^f − θ^e + reference twist                   twist

are the integrals of (tau, kappa_1, kappa_2) over the node's cell, in rad. Derivatives are taken with the
reference frames carried along by parallel transport from where they are: they are those of the energy as a
function of displacements from the present configuration.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods.discrete_model import DiscreteRods, DiscreteState, material_director
from fibercontact.rods.vectors import Vector, cross, row

__all__ = ["Derivatives", "Frames", "Law", "derivatives", "elastic_law", "frames", "law_energy", "strains"]

Array = NDArray[np.float64]


class Frames(NamedTuple):
    """Edges of R rods and their material frames."""

    length: Array  # (R, N) m
    tangent: Array  # (R, N, 3)
    m1: Array  # (R, N, 3)
    m2: Array  # (R, N, 3)


class Law(NamedTuple):
    """The energy `Σ ½ stiffness (strain − target)² + Σ ½ spring (length − natural)²` of nodes and edges."""

    stiffness: Array  # (R, N − 1, 3) J, for the strains (m, kappa_1, kappa_2)
    target: Array  # (R, N − 1, 3) rad
    spring: Array  # (R, N) N/m, zero for inextensible edges
    natural: Array  # (R, N) m


class Derivatives(NamedTuple):
    """Derivatives of a law's energy with respect to (e, θ^e, f, θ^f) of each node and to each edge vector."""

    node_gradient: Array  # (R, N − 1, 8)
    node_hessian: Array  # (R, N − 1, 8, 8)
    tension: Array  # (R, N) N
    axial: Array  # (R, N) N/m, stiffness along an edge
    transverse: Array  # (R, N) N/m, stiffness across it: negative under pressure


def elastic_law(rods: DiscreteRods) -> Law:
    """Elastic energy of the rods."""
    cells, edge = rods.cells[:, :, None], np.repeat(rods.edge_length[:, None], rods.edges, axis=1)
    spring = np.zeros_like(edge) if rods.inextensible else rods.stretching[:, None] / edge
    return Law(rods.stiffness[:, None] / cells, rods.rest_curvature * cells, spring, edge)


def frames(state: DiscreteState) -> Frames:
    """Compute lengths and material frames of the edges."""
    edge = np.diff(state.position, axis=1)
    length = np.linalg.norm(edge, axis=2)
    tangent = edge / length[:, :, None]
    return Frames(length, tangent, *material_director(state, tangent))


def strains(state: DiscreteState, at: Frames) -> Array:
    """Strains `(m, kappa_1, kappa_2)` (R, N − 1, 3) of the inner nodes, rad."""
    t, u = at.tangent[:, :-1], at.tangent[:, 1:]
    half_binormal = np.cross(t, u) / (1 + np.sum(t * u, axis=2, keepdims=True))
    bend = (np.sum(half_binormal * (m[:, :-1] + m[:, 1:]), axis=2) for m in (at.m1, at.m2))
    return np.stack([np.diff(state.theta, axis=1) + state.reference_twist, *bend], axis=2)


def law_energy(law: Law, state: DiscreteState) -> Array:
    """Energy (R,) in J."""
    at = frames(state)
    nodes = np.sum(law.stiffness * (strains(state, at) - law.target) ** 2, axis=(1, 2))
    edges = np.sum(law.spring * (at.length - law.natural) ** 2, axis=1)
    return np.asarray(nodes + edges, dtype=np.float64) / 2


def derivatives(law: Law, state: DiscreteState, at: Frames) -> Derivatives:
    """First and second derivatives of the energy."""
    R, nodes = law.target.shape[:2]
    gradient, hessian = np.zeros((R, nodes, 8)), np.zeros((R, nodes, 8, 8))
    stress = law.stiffness * (strains(state, at) - law.target)
    _fill(at, stress, law.stiffness, np.empty((3, 8)), gradient, hessian)
    tension = law.spring * (at.length - law.natural)
    return Derivatives(gradient, hessian, tension, law.spring, tension / at.length)


class _Node(NamedTuple):
    """What the strains of a node share; `mean` is `(t + u)/(1 + t·u)`."""

    t: Vector
    u: Vector
    e: float  # lengths of the edges
    f: float
    chi: float  # 1 + t·u
    binormal: Vector
    mean: Vector


@jit
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@jit
def _combine(x: float, a: Vector, y: float, b: Vector) -> Vector:
    return x * a[0] + y * b[0], x * a[1] + y * b[1], x * a[2] + y * b[2]


@jit
def _node(t: Vector, u: Vector, e: float, f: float) -> _Node:
    chi = 1 + _dot(t, u)
    t_x_u = cross(t, u)
    binormal = _combine(2 / chi, t_x_u, 0.0, t_x_u)
    return _Node(t, u, e, f, chi, binormal, _combine(1 / chi, t, 1 / chi, u))


@jit_lean
def _fill(
    at: Frames, stress: Array, stiffness: Array, slopes: Array, gradient: Array, hessian: Array
) -> None:
    for rod in range(stress.shape[0]):
        for i in range(stress.shape[1]):
            node = _node(
                row(at.tangent[rod, i]),
                row(at.tangent[rod, i + 1]),
                at.length[rod, i],
                at.length[rod, i + 1],
            )
            m1_e, m1_f = row(at.m1[rod, i]), row(at.m1[rod, i + 1])
            m2_e, m2_f = row(at.m2[rod, i]), row(at.m2[rod, i + 1])
            minus_e, minus_f = _combine(-1.0, m1_e, 0.0, m1_e), _combine(-1.0, m1_f, 0.0, m1_f)
            H, force = hessian[rod, i], stress[rod, i]
            _twist(node, force[0], slopes[0], H)
            _bend(node, m1_e, m1_f, m2_e, m2_f, force[1], slopes[1], H)
            _bend(node, m2_e, m2_f, minus_e, minus_f, force[2], slopes[2], H)
            _add_squares(stiffness[rod, i], force, slopes, gradient[rod, i], H)


@jit_lean
def _add_squares(stiffness: Array, stress: Array, slopes: Array, gradient: Array, H: Array) -> None:
    """Add `Σ_a stress_a slopes_a` to the gradient and `Σ_a stiffness_a slopes_a slopes_aᵀ` to the Hessian."""
    for a in range(3):
        for p in range(8):
            gradient[p] += stress[a] * slopes[a, p]
            for q in range(8):
                H[p, q] += stiffness[a] * slopes[a, p] * slopes[a, q]


@jit_lean
def _twist(node: _Node, stress: float, slope: Array, H: Array) -> None:
    """Set the slope of the twist, and add its curvature times `stress` to H."""
    binormal, mean, t, u, e, f = node.binormal, node.mean, node.t, node.u, node.e, node.f
    slope[3], slope[7] = -1.0, 1.0
    for c in range(3):
        slope[c], slope[4 + c] = binormal[c] / (2 * e), binormal[c] / (2 * f)
        _add_cross(t, c, stress / (node.chi * e * f), H)
        for d in range(3):
            ee = binormal[c] * (t[d] + mean[d]) + (t[c] + mean[c]) * binormal[d]
            ff = binormal[c] * (u[d] + mean[d]) + (u[c] + mean[c]) * binormal[d]
            H[c, d] -= stress / (4 * e * e) * ee
            H[4 + c, 4 + d] -= stress / (4 * f * f) * ff
            ef = stress / (2 * e * f) * binormal[c] * mean[d]
            H[c, 4 + d] -= ef
            H[4 + d, c] -= ef


@jit_lean
def _add_cross(a: Vector, c: int, weight: float, H: Array) -> None:
    """Add row c of `weight [a]×` to the block (e, f) of H, and its transpose to the block (f, e)."""
    j, k = (c + 1) % 3, (c + 2) % 3
    H[c, 4 + k] += weight * a[j]
    H[4 + k, c] += weight * a[j]
    H[c, 4 + j] -= weight * a[k]
    H[4 + j, c] -= weight * a[k]


@jit
def _slopes(node: _Node, kappa: float, m: Vector) -> tuple[Vector, Vector]:
    """Derivatives of `kappa = (t×u)·m`, m = (m^e + m^f)/chi, with respect to the directions of e and f."""
    along_e = _combine(1.0, cross(node.u, m), -kappa, node.mean)
    along_f = _combine(1.0, cross(m, node.t), -kappa, node.mean)
    return along_e, along_f


@jit_lean
def _bend(
    node: _Node, m_e: Vector, m_f: Vector, n_e: Vector, n_f: Vector, stress: float, slope: Array, H: Array
) -> None:
    """Set the slope of a bending strain, and add its curvature times `stress` to H.

    The strain is that of the directors m, which turn towards n when θ grows.
    """
    binormal, chi = node.binormal, node.chi
    m = _combine(1 / chi, m_e, 1 / chi, m_f)
    kappa = (_dot(binormal, m_e) + _dot(binormal, m_f)) / 2
    along_e, along_f = _slopes(node, kappa, m)
    for c in range(3):
        slope[c], slope[4 + c] = along_e[c] / node.e, along_f[c] / node.f
    slope[3], slope[7] = _dot(binormal, n_e) / 2, _dot(binormal, n_f) / 2
    _add_turns(node, 3, m_e, n_e, slope[3], stress, H)
    _add_turns(node, 7, m_f, n_f, slope[7], stress, H)
    _add_directions(node, m, m_e, m_f, kappa, stress, H)


@jit_lean
def _add_turns(node: _Node, at: int, m: Vector, n: Vector, slope: float, stress: float, H: Array) -> None:
    """Add the second derivatives that have the twist in place `at`, whose director is m."""
    along_e, along_f = _slopes(node, slope, _combine(1 / node.chi, n, 0.0, n))
    H[at, at] -= stress * _dot(node.binormal, m) / 2
    for c in range(3):
        for p, value in ((c, along_e[c] / node.e), (4 + c, along_f[c] / node.f)):
            H[p, at] += stress * value
            H[at, p] += stress * value


@jit_lean
def _add_directions(
    node: _Node, m: Vector, m_e: Vector, m_f: Vector, kappa: float, stress: float, H: Array
) -> None:
    """Add the second derivatives with respect to the edge vectors."""
    t, u, e, f, b, mean = node.t, node.u, node.e, node.f, node.binormal, node.mean
    A, B, k = cross(u, m), cross(m, t), kappa / node.chi
    for c in range(3):
        _add_cross(m, c, -stress / (e * f), H)
        for d in range(3):
            same = k if c == d else 0.0
            square = 2 * kappa * mean[c] * mean[d] - same
            ee = square - A[c] * mean[d] - mean[c] * A[d] + k * t[c] * t[d]
            ff = square - B[c] * mean[d] - mean[c] * B[d] + k * u[c] * u[d]
            ef = square - A[c] * mean[d] - mean[c] * B[d] - k * t[c] * u[d]
            H[c, d] += stress / (e * e) * (ee + (b[c] * m_e[d] + m_e[c] * b[d]) / 4)
            H[4 + c, 4 + d] += stress / (f * f) * (ff + (b[c] * m_f[d] + m_f[c] * b[d]) / 4)
            H[c, 4 + d] += stress / (e * f) * ef
            H[4 + d, c] += stress / (e * f) * ef
