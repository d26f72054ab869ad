"""Positions of points on rods and their Jacobians, for any basis of curvature (THEORY §6).

A variation of the coefficient `q_{j,i}` turns everything downstream of where `phi_j` acts, about `n_i`:

    ∂r(s)/∂q_{j,i} = ∫_0^s phi_j n_i × (r(s) − r) ds' = A_{j,i}(s) × r(s) − B_{j,i}(s)
    A_{j,i}(s) = ∫_0^s phi_j n_i ds',   B_{j,i}(s) = ∫_0^s phi_j n_i × r ds'

The moments A and B are kept element by element. Inside an element they are integrated from the element's
start with 8 Gauss nodes, where frames and positions are those of the basis. If an element turns by the angle
θ its integrands have frequencies up to 2θ, so the relative error is below `1.7e-23 (2θ)^16`: 1e-15 for
θ = 1.5 rad, 1e-12 for θ = 2.3 rad, 1e-10 for θ = π. Positions are relative to the root throughout, so that a
rod far from the origin loses no digits.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fibercontact.jit import jit
from fibercontact.rods.model import Rods, RootMotion, State, dofs
from fibercontact.rods.quadrature import Rule, gauss
from fibercontact.rods.superhelix import SHAPES, shape, transport

__all__ = ["Points", "centreline", "point_jacobian", "prescribed_velocity"]

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
_NODES = 8


class Points(NamedTuple):
    """Points on rods: where they are, the material frame there, and how the dofs move them."""

    position: Array  # (m, 3) m
    frame: Array  # (m, 3, 3) columns t, n_1, n_2
    jacobian: Array  # (m, 3, D) ∂r/∂dofs


class Elements(NamedTuple):
    """Frame and position (relative to the root) at the start of each of E elements, and its moments."""

    frame: Array  # (R, E, 3, 3)
    position: Array  # (R, E, 3)
    A: Array  # (R, E, SHAPES, 3, 3): the vector A of shape a and direction i is A[rod, e, a, i]
    B: Array


def point_jacobian(rods: Rods, state: State, rod: ArrayLike, s: ArrayLike) -> Points:
    """Position, frame and Jacobian of the m points at arc-lengths `s` (m,) in metres of the rods `rod` (m,).

    The velocity of a point is `jacobian @ v[rod]`, plus `prescribed_velocity` where roots are clamped.
    ValueError when a point is not on a rod.
    """
    rod, s = _checked_points(rods, rod, s)
    m = len(s)
    points = Points(np.empty((m, 3)), np.empty((m, 3, 3)), np.zeros((m, 3, dofs(rods))))
    _fill_points(rods, state, tabulate(rods, state), gauss(_NODES), rod, s, points)
    return points


def prescribed_velocity(
    rods: Rods, state: State, root_motion: RootMotion | None, rod: NDArray[np.int64], position: Array
) -> Array:
    """Velocity (m, 3) that the motion of clamped roots gives points at `position` (m, 3) of `rod` (m,).

    It is `v_root + omega_root × (r − r_root)`; zero when roots are still, or free (then the dofs move them).
    """
    if rods.free or root_motion is None:
        return np.zeros_like(position)
    arm = position - state.root_position[rod]
    return root_motion.velocity[rod] + np.cross(root_motion.angular_velocity[rod], arm)


def centreline(rods: Rods, state: State, points: int) -> Array:
    """Vertices (R, points + 1, 3) of the rods at equal spacing in arc-length, both ends included."""
    if points < 1:
        raise ValueError("a centreline needs at least one interval")
    vertices = np.empty((len(rods.length), points + 1, 3))
    _fill_centreline(state, rods.length, tabulate(rods, state), vertices)
    return vertices


def tabulate(rods: Rods, state: State) -> Elements:
    """Compute what all points of a rod share."""
    R, E = len(rods.length), element_count(state.q)
    moments = (R, E, SHAPES, 3, 3)
    elements = Elements(np.empty((R, E, 3, 3)), np.empty((R, E, 3)), np.zeros(moments), np.zeros(moments))
    _fill_elements(rods, state, gauss(_NODES), elements)
    return elements


def _checked_points(rods: Rods, rod: ArrayLike, s: ArrayLike) -> tuple[NDArray[np.int64], Array]:
    rod, s = np.ascontiguousarray(rod, dtype=np.int64), np.ascontiguousarray(s, dtype=float)
    if rod.ndim != 1 or rod.shape != s.shape:
        raise ValueError(f"rod and s must be vectors of one length, not {rod.shape} and {s.shape}")
    if np.any((rod < 0) | (rod >= len(rods.length))):
        raise ValueError(f"rod must be in 0..{len(rods.length) - 1}")
    if not np.all((s >= 0) & (s <= rods.length[rod])):
        raise ValueError("s must be an arc-length between 0 and the length of its rod")
    return rod, s


@jit
def element_count(q: Array) -> int:
    """Count the elements of rods with coefficients `q` (R, N, 3)."""
    return q.shape[1] + 1 - SHAPES


@jit
def row(vector: Array) -> Vector:
    """Vector as a tuple: the compiler keeps tuples in registers."""
    return vector[0], vector[1], vector[2]


@jit
def column(matrix: Array, i: int) -> Vector:
    """Column of a matrix (3, 3) as a tuple."""
    return matrix[0, i], matrix[1, i], matrix[2, i]


@jit
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def place_nodes(
    rule: Rule,
    begin: float,
    end: float,
    coefficients: Array,
    length: float,
    frame: Array,
    position: Array,
    frames: Array,
    positions: Array,
) -> None:
    """Fill frames (n, 3, 3) and positions (n, 3) at the nodes of the part [begin, end] of an element.

    `frame` and `position` belong to the start of the element.
    """
    for k in range(len(rule.nodes)):
        xi = begin + (end - begin) * rule.nodes[k]
        transport(coefficients, length, xi, frame, position, frames[k], positions[k])


@jit
def add_moments(
    rule: Rule,
    begin: float,
    end: float,
    length: float,
    frames: Array,
    positions: Array,
    A: Array,
    B: Array,
) -> None:
    """Add the moments of the part [begin, end] of an element to its A and B (SHAPES, 3, 3)."""
    for k in range(len(rule.nodes)):
        xi = begin + (end - begin) * rule.nodes[k]
        for i in range(3):
            n = column(frames[k], i)
            n_x_r = cross(n, row(positions[k]))
            for a in range(SHAPES):
                weight = (end - begin) * length * rule.weights[k] * shape(a, xi)
                for c in range(3):
                    A[a, i, c] += weight * n[c]
                    B[a, i, c] += weight * n_x_r[c]


@jit
def add_columns(e: int, A: Array, B: Array, r: Array, jacobian: Array) -> None:
    """Add `A × r − B` of element `e`, moments (SHAPES, 3, 3), to the Jacobian (3, 3N) of the point `r`."""
    for a in range(SHAPES):
        for i in range(3):
            turned = cross(row(A[a, i]), row(r))
            for c in range(3):
                jacobian[c, 3 * (e + a) + i] += turned[c] - B[a, i, c]


@jit
def set_root_columns(r: Array, jacobian: Array) -> None:
    """Set the first six columns of the Jacobian (3, D) of a free rod: `v_root + omega_root × r`."""
    for c in range(3):
        jacobian[c, c] = 1.0
    jacobian[0, 4], jacobian[0, 5] = r[2], -r[1]
    jacobian[1, 3], jacobian[1, 5] = -r[2], r[0]
    jacobian[2, 3], jacobian[2, 4] = r[1], -r[0]


@jit
def _fill_elements(rods: Rods, state: State, rule: Rule, elements: Elements) -> None:
    frames, positions = np.empty((len(rule.nodes), 3, 3)), np.empty((len(rule.nodes), 3))
    frame, position = np.empty((3, 3)), np.empty(3)
    E = element_count(state.q)
    for rod in range(len(rods.length)):
        frame[:] = state.root_frame[rod]
        position[:] = 0.0
        length = rods.length[rod] / E
        for e in range(E):
            elements.frame[rod, e] = frame
            elements.position[rod, e] = position
            coefficients = state.q[rod, e : e + SHAPES]
            place_nodes(rule, 0.0, 1.0, coefficients, length, frame, position, frames, positions)
            add_moments(rule, 0.0, 1.0, length, frames, positions, elements.A[rod, e], elements.B[rod, e])
            transport(coefficients, length, 1.0, frame, position, frame, position)


@jit
def _fill_points(
    rods: Rods,
    state: State,
    elements: Elements,
    rule: Rule,
    rod: NDArray[np.int64],
    s: Array,
    points: Points,
) -> None:
    frames, positions = np.empty((len(rule.nodes), 3, 3)), np.empty((len(rule.nodes), 3))
    A, B = np.empty((SHAPES, 3, 3)), np.empty((SHAPES, 3, 3))
    E = element_count(state.q)
    for p in range(len(s)):
        k = rod[p]
        length = rods.length[k] / E
        e = min(int(s[p] / length), E - 1)
        xi = s[p] / length - e
        r, jacobian = points.position[p], points.jacobian[p]
        coefficients = state.q[k, e : e + SHAPES]
        frame, start = elements.frame[k, e], elements.position[k, e]
        transport(coefficients, length, xi, frame, start, points.frame[p], r)
        place_nodes(rule, 0.0, xi, coefficients, length, frame, start, frames, positions)
        A[:] = 0.0
        B[:] = 0.0
        add_moments(rule, 0.0, xi, length, frames, positions, A, B)
        curvature_columns = jacobian[:, 6 * rods.free :]
        for before in range(e):
            add_columns(before, elements.A[k, before], elements.B[k, before], r, curvature_columns)
        add_columns(e, A, B, r, curvature_columns)
        if rods.free:
            set_root_columns(r, jacobian)
        for c in range(3):
            r[c] += state.root_position[k, c]


@jit
def _fill_centreline(state: State, lengths: Array, elements: Elements, vertices: Array) -> None:
    E, frame = element_count(state.q), np.empty((3, 3))
    points = vertices.shape[1] - 1
    for rod in range(len(lengths)):
        for k in range(points + 1):
            e = min(k * E // points, E - 1)
            xi = k * E / points - e
            start = elements.position[rod, e]
            coefficients = state.q[rod, e : e + SHAPES]
            vertex = vertices[rod, k]
            transport(coefficients, lengths[rod] / E, xi, elements.frame[rod, e], start, frame, vertex)
            for c in range(3):
                vertex[c] += state.root_position[rod, c]
