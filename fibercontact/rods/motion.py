"""Jacobians, velocities and accelerations at the quadrature points of whole rods, for any basis of curvature.

Along a rod whose curvatures change at the rates `qdot`, and with zero generalised acceleration,

    omega' = Σ phi_j qdot_{j,i} n_i,   alpha' = omega × omega',
    v' = omega × t,                    gamma' = alpha × t + omega × (omega × t),

from the values at the root. The quadrature points are 5 Gauss points an element (exact for the inertia of
straight rods). The four equations and the moments of `kinematics` are integrated from one such point to the
next by the 4-stage Gauss method, order 8: for an element that turns by θ a step turns by less than 0.3 θ, and
the relative error is about `6e-10 (0.6 θ)^8`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.rods.kinematics import (
    Vector,
    add_columns,
    add_moments,
    column,
    cross,
    element_count,
    place_nodes,
    row,
    set_root_columns,
)
from fibercontact.rods.model import Rods, RootMotion, State, dofs
from fibercontact.rods.quadrature import Rule, gauss
from fibercontact.rods.superhelix import SHAPES, shape, transport

__all__ = ["POINTS", "Samples", "sample"]

Array = NDArray[np.float64]
POINTS = 5  # quadrature points an element
_STAGES = 4


class Samples(NamedTuple):
    """Motion of R rods at G = 5 E quadrature points each, world axes; positions are relative to the root."""

    position: Array  # (R, G, 3)
    tangent: Array  # (R, G, 3)
    jacobian: Array  # (R, G, 3, D) ∂r/∂dofs
    turning: Array  # (R, G, 3, D) ∂omega/∂v; filled for free rods only
    velocity: Array  # (R, G, 3) v, with the root's motion
    angular_velocity: Array  # (R, G, 3) omega
    acceleration: Array  # (R, G, 3) gamma: acceleration at zero generalised acceleration
    angular_acceleration: Array  # (R, G, 3) alpha, likewise


class _Stages(NamedTuple):
    """Work space of one step along a rod: values at its nodes."""

    frame: Array  # (n, 3, 3)
    position: Array  # (n, 3), as all below
    omega: Array
    omega_rate: Array
    alpha_rate: Array


def sample(rods: Rods, state: State, root_motion: RootMotion) -> Samples:
    """Compute the motion of the rods at their quadrature points from `state.v` and the roots' motion."""
    R, G, D = len(rods.length), POINTS * element_count(state.q), dofs(rods)
    vectors = [np.empty((R, G, 3)) for _ in range(6)]
    samples = Samples(vectors[0], vectors[1], np.zeros((R, G, 3, D)), np.zeros((R, G, 3, D)), *vectors[2:])
    root = _free_root(state) if rods.free else root_motion
    _fill_samples(rods, state, root, gauss(POINTS), gauss(_STAGES), samples)
    return samples


def _free_root(state: State) -> RootMotion:
    zero = np.zeros_like(state.root_position)
    return RootMotion(state.v[:, :3].copy(), state.v[:, 3:6].copy(), zero, zero)


@jit
def _fill_samples(
    rods: Rods, state: State, root: RootMotion, points: Rule, rule: Rule, samples: Samples
) -> None:
    n = len(rule.nodes)
    vectors = np.empty((4, n, 3))
    stages = _Stages(np.empty((n, 3, 3)), vectors[0], vectors[1], vectors[2], vectors[3])
    moments = np.empty((2, element_count(state.q), SHAPES, 3, 3))
    for rod in range(len(rods.length)):
        _walk(rods, state, root, rod, points, rule, stages, moments, samples)


@jit
def _walk(
    rods: Rods,
    state: State,
    root: RootMotion,
    rod: int,
    points: Rule,
    rule: Rule,
    stages: _Stages,
    moments: Array,
    samples: Samples,
) -> None:
    E, G = element_count(state.q), len(points.nodes)
    length = rods.length[rod] / E
    frame, position = state.root_frame[rod].copy(), np.zeros(3)
    here, r = np.empty((3, 3)), np.empty(3)
    motion = RootMotion(
        root.velocity[rod].copy(),
        root.angular_velocity[rod].copy(),
        root.acceleration[rod].copy(),
        root.angular_acceleration[rod].copy(),
    )
    moments[:] = 0.0
    qdot = state.v[rod, 6 * rods.free :]
    for e in range(E):
        q, rates = state.q[rod, e : e + SHAPES], qdot[3 * e : 3 * (e + SHAPES)]
        A, B = moments[0, e], moments[1, e]
        begin = 0.0
        for g in range(G + 1):
            end = points.nodes[g] if g < G else 1.0
            place_nodes(rule, begin, end, q, length, frame, position, stages.frame, stages.position)
            add_moments(rule, begin, end, length, stages.frame, stages.position, A, B)
            _march(rule, begin, end, length, rates, stages, motion)
            if g < G:
                transport(q, length, end, frame, position, here, r)
                _record(rods.free, rod, e * G + g, e, here[:, 0], r, moments, motion, samples)
            begin = end
        transport(q, length, 1.0, frame, position, frame, position)


@jit
def _march(
    rule: Rule, begin: float, end: float, length: float, rates: Array, stages: _Stages, motion: RootMotion
) -> None:
    """Carry `motion` over the part [begin, end] of an element whose coefficients change at `rates`."""
    n, h = len(rule.nodes), (end - begin) * length
    omega_0, alpha_0 = row(motion.angular_velocity), row(motion.angular_acceleration)
    for k in range(n):
        xi = begin + (end - begin) * rule.nodes[k]
        _set_omega_rate(xi, rates, stages.frame[k], stages.omega_rate[k])
    for k in range(n):
        omega = _stage(rule, k, h, omega_0, stages.omega_rate)
        omega_rate = row(stages.omega_rate[k])
        _set(stages.omega[k], omega)
        _set(stages.alpha_rate[k], cross(omega, omega_rate))
        _add(motion.angular_velocity, h * rule.weights[k], omega_rate)
    for k in range(n):
        weight, omega, t = h * rule.weights[k], row(stages.omega[k]), column(stages.frame[k], 0)
        alpha = _stage(rule, k, h, alpha_0, stages.alpha_rate)
        v_rate = cross(omega, t)
        _add(motion.angular_acceleration, weight, row(stages.alpha_rate[k]))
        _add(motion.velocity, weight, v_rate)
        _add(motion.acceleration, weight, cross(alpha, t))
        _add(motion.acceleration, weight, cross(omega, v_rate))


@jit
def _set_omega_rate(xi: float, rates: Array, frame: Array, omega_rate: Array) -> None:
    """Set `Σ phi_a rates_{a,i} n_i` at the point `xi` of an element."""
    for c in range(3):
        total = 0.0
        for a in range(SHAPES):
            for i in range(3):
                total += shape(a, xi) * rates[3 * a + i] * frame[c, i]
        omega_rate[c] = total


@jit
def _stage(rule: Rule, k: int, h: float, start: Vector, rates: Array) -> Vector:
    """Value at node k of what begins at `start` and changes at `rates` (n, 3)."""
    x = y = z = 0.0
    for m in range(len(rule.nodes)):
        weight = rule.matrix[k, m]
        x += weight * rates[m, 0]
        y += weight * rates[m, 1]
        z += weight * rates[m, 2]
    return start[0] + h * x, start[1] + h * y, start[2] + h * z


@jit
def _set(out: Array, vector: Vector) -> None:
    for c in range(3):
        out[c] = vector[c]


@jit
def _add(out: Array, weight: float, vector: Vector) -> None:
    for c in range(3):
        out[c] += weight * vector[c]


@jit
def _record(
    free: bool,
    rod: int,
    g: int,
    e: int,
    tangent: Array,
    r: Array,
    moments: Array,
    motion: RootMotion,
    samples: Samples,
) -> None:
    """Store the quadrature point `g`, which lies in element `e`; `moments` holds those up to the point."""
    samples.position[rod, g] = r
    samples.tangent[rod, g] = tangent
    samples.velocity[rod, g] = motion.velocity
    samples.angular_velocity[rod, g] = motion.angular_velocity
    samples.acceleration[rod, g] = motion.acceleration
    samples.angular_acceleration[rod, g] = motion.angular_acceleration
    jacobian = samples.jacobian[rod, g]
    for upstream in range(e + 1):
        add_columns(upstream, moments[0, upstream], moments[1, upstream], r, jacobian[:, 6 * free :])
    if free:
        set_root_columns(r, jacobian)
        _set_turning(e, moments[0], samples.turning[rod, g])


@jit
def _set_turning(e: int, A: Array, turning: Array) -> None:
    for c in range(3):
        turning[c, 3 + c] = 1.0
        for upstream in range(e + 1):
            for a in range(SHAPES):
                for i in range(3):
                    turning[c, 6 + 3 * (upstream + a) + i] += A[upstream, a, i, c]
