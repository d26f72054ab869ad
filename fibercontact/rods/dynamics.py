"""Equation of motion of rods and its linearly implicit step, for any basis of curvature (THEORY §6).

    𝕄(q) dv/dt + nu 𝕂 v + 𝕂 (q − q⁰) = F,      F = ∫ rho S Jᵀ (g − gamma) ds,   𝕄 = ∫ rho S Jᵀ J ds

`gamma` is the acceleration of the material when the generalised acceleration is zero: the velocity-quadratic
term and, for clamped roots, what their prescribed motion gives. Twist inertia is neglected when roots are
clamped. A straight free rod spinning about its axis would then have no inertia at all, so free rods keep the
rotary inertia of their sections about the tangent, `rho I_p = rho S radius²/2` a metre. The rate of the spin
momentum `rho I_p (t·omega) t`, with the turning `W = ∂omega/∂v`, adds

    ∫ rho I_p (Wᵀt)(Wᵀt)ᵀ ds   to 𝕄,      −∫ rho I_p Wᵀ ((t·alpha) t + (t·omega) omega × t) ds   to F.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fibercontact.rods.air import Drag
from fibercontact.rods.basis import element_count, shape, shapes
from fibercontact.rods.model import Rods, RootMotion, State, dofs, part, still
from fibercontact.rods.motion import POINTS, Samples, sample
from fibercontact.rods.quadrature import gauss
from fibercontact.threads import over_ranges

__all__ = [
    "Energy",
    "advance",
    "energy",
    "generalised_force",
    "inertia_matrix",
    "step_system",
    "stiffness_matrix",
]

Array = NDArray[np.float64]

_RODS = 128  # whose samples, a few MB, are in the cache at once


class Energy(NamedTuple):
    """Energy of each rod, J."""

    kinetic: Array  # (R,)
    elastic: Array  # (R,)
    gravitational: Array  # (R,)


def step_system(
    rods: Rods,
    state: State,
    root_motion: RootMotion | None,
    gravity: Array,
    dt: float,
    drag: Drag | None = None,
) -> tuple[Array, Array]:
    """Assemble `M` (R, D, D) and `f` (R, D) of the linearly implicit step `M v + f = Hᵀ r`.

    With `q + dt v` at the end of the step, `M = 𝕄 + dt nu 𝕂 + dt² 𝕂` and `f = −𝕄 v_t − dt (F − 𝕂 (q − q⁰))`, and
    the terms of `drag` (see `air`). M is symmetric positive definite. `gravity` (3,) in m/s², `dt` in s;
    `root_motion` None means still. ValueError when dt is not positive.
    """
    if not dt > 0:
        raise ValueError(f"dt must be positive, not {dt}")
    R, D = state.v.shape
    M, f, motion = np.empty((R, D, D)), np.empty((R, D)), root_motion or still(R)

    def fill(first: int, end: int) -> None:
        some = [part(whole, first, end) for whole in (rods, state, motion)]
        M[first:end], f[first:end] = _step_system(some[0], some[1], some[2], gravity, dt, drag)

    over_ranges(fill, R, _RODS)
    return M, f


def _step_system(
    rods: Rods, state: State, root_motion: RootMotion, gravity: Array, dt: float, drag: Drag | None
) -> tuple[Array, Array]:
    samples = sample(rods, state, root_motion)
    inertia, K = _inertia(rods, samples), stiffness_matrix(rods)
    M = inertia + (dt * rods.damping + dt**2)[:, None, None] * K
    force = _load(rods, samples, gravity) - _elastic_force(rods, state, K)
    f = -_times(inertia, state.v) - dt * force
    if drag is not None:
        resistance, drift_force = _drag_terms(rods, samples, root_motion, drag)
        M, f = M + dt * resistance, f + dt * drift_force
    return M, f


def advance(rods: Rods, state: State, v: Array, root_motion: RootMotion | None, dt: float) -> State:
    """Move the rods over a step with the velocity `v` (R, D) at its end.

    Roots move by the translation `dt · velocity` and the rotation vector `dt · angular velocity`, those of
    `v` when free and prescribed when clamped. Their frames stay orthonormal to rounding.
    """
    motion = root_motion or still(len(rods.length))
    velocity, omega = (v[:, :3], v[:, 3:6]) if rods.free else (motion.velocity, motion.angular_velocity)
    frame = Rotation.from_rotvec(dt * omega).as_matrix() @ state.root_frame
    frame = frame @ (3 * np.eye(3) - frame.transpose(0, 2, 1) @ frame) / 2  # rounding does not pile up
    q = state.q + dt * v[:, 6 * rods.free :].reshape(state.q.shape)
    return State(state.root_position + dt * velocity, frame, q, np.array(v))


def energy(rods: Rods, state: State, gravity: Array, root_motion: RootMotion | None = None) -> Energy:
    """Measure the energy of each rod; the potential of gravity is zero at the world's origin."""
    samples = sample(rods, state, root_motion or still(len(rods.length)))
    mass = _mass(rods)
    kinetic = np.sum(mass * np.sum(samples.velocity**2, axis=2), axis=1) / 2
    if rods.free:
        spin = np.sum(samples.tangent * samples.angular_velocity, axis=2)
        kinetic += np.sum(_rotary_inertia(rods) * spin**2, axis=1) / 2
    elastic = np.sum(_strain(rods, state) * _elastic_force(rods, state, stiffness_matrix(rods)), axis=1) / 2
    centre = np.sum(mass[:, :, None] * (samples.position + state.root_position[:, None]), axis=1)
    return Energy(kinetic, elastic, -centre @ np.asarray(gravity))


def generalised_force(
    rods: Rods, state: State, gravity: Array, root_motion: RootMotion | None = None
) -> Array:
    """Sum the generalised forces `F − 𝕂 (q − q⁰)` (R, D), damping left out.

    With `v` zero a configuration is an equilibrium where this is zero.
    """
    samples = sample(rods, state, root_motion or still(len(rods.length)))
    return _load(rods, samples, gravity) - _elastic_force(rods, state, stiffness_matrix(rods))


def inertia_matrix(rods: Rods, state: State) -> Array:
    """Assemble the inertia 𝕄 (R, D, D); semi-definite when a clamped rod is straight (no twist inertia)."""
    return _inertia(rods, sample(rods, state, still(len(rods.length))))


def stiffness_matrix(rods: Rods) -> Array:
    """Assemble the elastic stiffness 𝕂 (R, D, D), `∫ phi_j phi_k ds K`; zero in the rows of a free root."""
    R, N = rods.q_rest.shape[:2]
    element = rods.length / element_count(rods.basis, rods.q_rest)
    blocks = np.einsum("r,jk,ri,im->rjikm", element, _gram(rods), rods.stiffness, np.eye(3), optimize=False)
    K, root = np.zeros((R, dofs(rods), dofs(rods))), 6 * rods.free
    K[:, root:, root:] = blocks.reshape(R, 3 * N, 3 * N)
    return K


def _gram(rods: Rods) -> Array:
    """`∫ phi_j phi_k` (N, N) in units of an element's length."""
    N, a, rule = rods.q_rest.shape[1], shapes(rods.basis), gauss(POINTS)
    phi = np.array([[shape(rods.basis, k, xi) for k in range(a)] for xi in rule.nodes])
    gram = np.zeros((N, N))
    for e in range(element_count(rods.basis, rods.q_rest)):
        gram[e : e + a, e : e + a] += phi.T @ (rule.weights[:, None] * phi)
    return gram


def _mass(rods: Rods) -> Array:
    """Mass (R, G) that each quadrature point stands for, kg."""
    E = element_count(rods.basis, rods.q_rest)
    return np.outer(rods.line_density * rods.length / E, np.tile(gauss(POINTS).weights, E))


def _rotary_inertia(rods: Rods) -> Array:
    """Polar inertia (R, G) of the sections that each quadrature point stands for, kg·m²."""
    return _mass(rods) * rods.radius[:, None] ** 2 / 2


def _inertia(rods: Rods, samples: Samples) -> Array:
    J = samples.jacobian
    inertia = _gramian(_mass(rods)[:, :, None, None] * J, J)
    if rods.free:
        W_t = samples.tangent[:, :, None, :] @ samples.turning
        inertia += _gramian(_rotary_inertia(rods)[:, :, None, None] * W_t, W_t)
    return inertia


def _gramian(X: Array, Y: Array) -> Array:
    """`Σ Xᵀ Y` (R, D, D) over the points and components of X and Y (R, G, c, D)."""
    R, D = X.shape[0], X.shape[3]
    return X.reshape(R, -1, D).transpose(0, 2, 1) @ Y.reshape(R, -1, D)


def _load(rods: Rods, samples: Samples, gravity: Array) -> Array:
    """Generalised force F (R, D) of gravity and inertia."""
    F = _power(samples.jacobian, _mass(rods), np.asarray(gravity) - samples.acceleration)
    if rods.free:
        t, omega, alpha = samples.tangent, samples.angular_velocity, samples.angular_acceleration
        t_alpha, t_omega = (np.sum(t * x, axis=2, keepdims=True) for x in (alpha, omega))
        torque = t_alpha * t + t_omega * np.cross(omega, t)
        F -= _power(samples.turning, _rotary_inertia(rods), torque)
    return F


def _drag_terms(rods: Rods, samples: Samples, root_motion: RootMotion, drag: Drag) -> tuple[Array, Array]:
    """Matrix (R, D, D) and vector (R, D) of the generalised force of drag, `−(matrix v + vector)`."""
    J, length = samples.jacobian, _mass(rods) / rods.line_density[:, None]
    slowed = drag.resistance(samples.tangent) @ J
    drift = np.broadcast_to(-drag.wind, samples.position.shape)
    if not rods.free:
        turning = np.cross(root_motion.angular_velocity[:, None], samples.position)
        drift = drift + root_motion.velocity[:, None] + turning
    return _gramian(length[:, :, None, None] * J, slowed), _power(slowed, length, drift)


def _power(J: Array, weight: Array, density: Array) -> Array:
    """`Σ weight Jᵀ density` over the points: (R, D)."""
    R, D = J.shape[0], J.shape[3]
    return ((weight[:, :, None] * density).reshape(R, 1, -1) @ J.reshape(R, -1, D))[:, 0]


def _strain(rods: Rods, state: State) -> Array:
    """`q − q⁰` (R, D), zero in the columns of a free root."""
    strain = np.zeros((len(rods.length), dofs(rods)))
    strain[:, 6 * rods.free :] = (state.q - rods.q_rest).reshape(len(strain), -1)
    return strain


def _elastic_force(rods: Rods, state: State, K: Array) -> Array:
    return _times(K, _strain(rods, state))


def _times(matrix: Array, vector: Array) -> Array:
    return (matrix @ vector[:, :, None])[:, :, 0]
