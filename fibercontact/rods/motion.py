"""Jacobians, velocities and accelerations at the quadrature points of whole rods, for any basis of curvature.

Along a rod whose curvatures change at the rates `qdot`, and with zero generalised acceleration,

    omega' = Σ phi_j qdot_{j,i} n_i,   alpha' = omega × omega',
    v' = omega × t,                    gamma' = alpha × t + omega × (omega × t),

from the values at the root. The quadrature points are 5 Gauss points an element (exact for the inertia of
straight rods). The four equations and the moments of `kinematics` are integrated from one such point to the
next by the 4-stage Gauss method, order 8, over less than 0.3 of an element. In an element of a Super-Helix that
turns by θ the relative error is about `6e-10 (0.6 θ)^8`; of a Super-Clothoid, with θ, β and P as in `kinematics`
but `0.3 θ` and `0.09 β` in their place, about `6e-10 (P_8 + 2.4 P_7)`: 4e-9, 8e-9, 3e-8 for θ = 1.5 rad and
β = θ/4, θ/2, θ where the Super-Helix has 9e-10.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods.basis import Path, carry, element_count, new_path, shape, shapes
from fibercontact.rods.kinematics import add_columns, add_moments, set_root_columns
from fibercontact.rods.model import Rods, RootMotion, State, dofs
from fibercontact.rods.quadrature import Rule, gauss
from fibercontact.rods.vectors import Vector, column, cross, row

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
    """Work space of one step along a rod: values (n, 3) at its nodes."""

    omega: Array
    omega_rate: Array
    alpha_rate: Array


def sample(rods: Rods, state: State, root_motion: RootMotion) -> Samples:
    """Compute the motion of the rods at their quadrature points from `state.v` and the roots' motion."""
    R, G, D = len(rods.length), POINTS * element_count(rods.basis, state.q), dofs(rods)
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
    stages = _Stages(np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)))
    moments = np.empty((2, rods.q_rest.shape[1], 3, 3))
    ends, path = _element_path(points, rule)
    origin = np.zeros(3)
    motion = RootMotion(np.empty(3), np.empty(3), np.empty(3), np.empty(3))
    for rod in range(len(rods.length)):
        _walk(rods, state, root, rod, ends, path, rule, origin, motion, stages, moments, samples)


@jit
def _element_path(points: Rule, rule: Rule) -> tuple[Array, Path]:
    """Ends of the parts of an element, and the path through the nodes of each part and its end."""
    ends, m = np.append(points.nodes, 1.0), len(rule.nodes) + 1
    path, begin = new_path(len(ends) * m), 0.0
    for g in range(len(ends)):
        path.place[g * m : (g + 1) * m - 1] = begin + (ends[g] - begin) * rule.nodes
        path.place[(g + 1) * m - 1] = begin = ends[g]
    return ends, path


@jit_lean
def _walk(
    rods: Rods,
    state: State,
    root: RootMotion,
    rod: int,
    ends: Array,
    path: Path,
    rule: Rule,
    origin: Array,
    motion: RootMotion,
    stages: _Stages,
    moments: Array,
    samples: Samples,
) -> None:
    E, G, n, a = element_count(rods.basis, state.q), len(ends) - 1, len(rule.nodes), shapes(rods.basis)
    length, qdot = rods.length[rod] / E, state.v[rod, 6 * rods.free :]
    frame, position = state.root_frame[rod], origin
    for c in range(3):
        motion.velocity[c], motion.angular_velocity[c] = root.velocity[rod, c], root.angular_velocity[rod, c]
        motion.acceleration[c] = root.acceleration[rod, c]
        motion.angular_acceleration[c] = root.angular_acceleration[rod, c]
    moments[:] = 0.0
    for e in range(E):
        rates, A, B = qdot[3 * e : 3 * (e + a)], moments[0, e : e + a], moments[1, e : e + a]
        carry(rods.basis, state.q[rod, e : e + a], length, frame, position, path)
        begin = 0.0
        for g in range(G + 1):
            end, first = ends[g], g * (n + 1)
            frames, positions = path.frame[first : first + n], path.position[first : first + n]
            add_moments(rods.basis, rule, begin, end, length, frames, positions, A, B)
            _march(rods.basis, rule, begin, end, length, rates, frames, stages, motion)
            if g < G:
                tangent, r = path.frame[first + n, :, 0], path.position[first + n]
                _record(rods.free, rod, e * G + g, tangent, r, moments[:, : e + a], motion, samples)
            begin = end
        frame, position = path.frame[-1], path.position[-1]


@jit_lean
def _march(
    basis: int,
    rule: Rule,
    begin: float,
    end: float,
    length: float,
    rates: Array,
    frames: Array,
    stages: _Stages,
    motion: RootMotion,
) -> None:
    """Carry `motion` over the part [begin, end] of an element whose coefficients change at `rates`."""
    n, h = len(rule.nodes), (end - begin) * length
    omega_0, alpha_0 = row(motion.angular_velocity), row(motion.angular_acceleration)
    for k in range(n):
        xi = begin + (end - begin) * rule.nodes[k]
        _set_omega_rate(basis, xi, rates, frames[k], stages.omega_rate[k])
    for k in range(n):
        omega = _stage(rule, k, h, omega_0, stages.omega_rate)
        omega_rate = row(stages.omega_rate[k])
        _set(stages.omega[k], omega)
        _set(stages.alpha_rate[k], cross(omega, omega_rate))
        _add(motion.angular_velocity, h * rule.weights[k], omega_rate)
    for k in range(n):
        weight, omega, t = h * rule.weights[k], row(stages.omega[k]), column(frames[k], 0)
        alpha = _stage(rule, k, h, alpha_0, stages.alpha_rate)
        v_rate = cross(omega, t)
        _add(motion.angular_acceleration, weight, row(stages.alpha_rate[k]))
        _add(motion.velocity, weight, v_rate)
        _add(motion.acceleration, weight, cross(alpha, t))
        _add(motion.acceleration, weight, cross(omega, v_rate))


@jit_lean
def _set_omega_rate(basis: int, xi: float, rates: Array, frame: Array, omega_rate: Array) -> None:
    """Set `Σ phi_a rates_{a,i} n_i` at the point `xi` of an element."""
    for c in range(3):
        total = 0.0
        for a in range(shapes(basis)):
            for i in range(3):
                total += shape(basis, a, xi) * rates[3 * a + i] * frame[c, i]
        omega_rate[c] = total


@jit_lean
def _stage(rule: Rule, k: int, h: float, start: Vector, rates: Array) -> Vector:
    """Value at node k of what begins at `start` and changes at `rates` (n, 3)."""
    x = y = z = 0.0
    for m in range(len(rule.nodes)):
        weight = rule.matrix[k, m]
        x += weight * rates[m, 0]
        y += weight * rates[m, 1]
        z += weight * rates[m, 2]
    return start[0] + h * x, start[1] + h * y, start[2] + h * z


@jit_lean
def _set(out: Array, vector: Vector) -> None:
    for c in range(3):
        out[c] = vector[c]


@jit_lean
def _add(out: Array, weight: float, vector: Vector) -> None:
    for c in range(3):
        out[c] += weight * vector[c]


@jit_lean
def _record(
    free: bool,
    rod: int,
    g: int,
    tangent: Array,
    r: Array,
    moments: Array,
    motion: RootMotion,
    samples: Samples,
) -> None:
    """Store the quadrature point `g`; `moments` holds those of the coefficients upstream, up to the point."""
    for c in range(3):
        samples.position[rod, g, c], samples.tangent[rod, g, c] = r[c], tangent[c]
        samples.velocity[rod, g, c] = motion.velocity[c]
        samples.angular_velocity[rod, g, c] = motion.angular_velocity[c]
        samples.acceleration[rod, g, c] = motion.acceleration[c]
        samples.angular_acceleration[rod, g, c] = motion.angular_acceleration[c]
    jacobian = samples.jacobian[rod, g]
    for j in range(moments.shape[1]):
        add_columns(j, moments[0, j], moments[1, j], r, jacobian[:, 6 * free :])
    if free:
        set_root_columns(r, jacobian)
        _set_turning(moments[0], samples.turning[rod, g])


@jit_lean
def _set_turning(A: Array, turning: Array) -> None:
    for c in range(3):
        turning[c, 3 + c] = 1.0
        for j in range(len(A)):
            for i in range(3):
                turning[c, 6 + 3 * j + i] += A[j, i, c]
