"""Rods, their state and the motion of their roots: the data of a batch of Kirchhoff rods (THEORY §6).

All rods of a batch have the same number N of curvature coefficients. The degrees of freedom of a rod are its
coefficients `q[j, i]`, coefficient by coefficient, in the order `(tau, kappa_1, kappa_2)`. A free rod has six
more, which come first: velocity and angular velocity of its root in world axes. So `D = 3N` or `3N + 6`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fibercontact.rods.basis import CLOTHOID, HELIX, shapes

__all__ = [
    "Rods",
    "RootMotion",
    "State",
    "checked_points",
    "checked_roots",
    "circular_rods",
    "dofs",
    "part",
    "rest_state",
    "still",
]

Array = NDArray[np.float64]


class Rods(NamedTuple):
    """R Kirchhoff rods with N curvature coefficients each; `circular_rods` builds them from material data.

    Their law is `M = K (kappa − kappa_rest) + damping K kappa'`, `K = diag(GJ, EI_1, EI_2)`.
    """

    length: Array  # (R,) m
    line_density: Array  # (R,) rho S, kg/m
    radius: Array  # (R,) m
    stiffness: Array  # (R, 3) GJ, EI_1, EI_2, N·m²
    q_rest: Array  # (R, N, 3) rest curvatures, rad/m
    damping: Array  # (R,) nu, s
    free: bool  # True: the roots are dofs; False: they are clamped and their motion is prescribed
    basis: int  # HELIX or CLOTHOID


class State(NamedTuple):
    """Configuration and velocity of R rods; the columns of `root_frame` are `t, n_1, n_2`."""

    root_position: Array  # (R, 3) m
    root_frame: Array  # (R, 3, 3)
    q: Array  # (R, N, 3) curvatures, rad/m
    v: Array  # (R, D) rates of the dofs


class RootMotion(NamedTuple):
    """Prescribed motion of clamped roots at the end of a step, world axes; free rods ignore it."""

    velocity: Array  # (R, 3) m/s
    angular_velocity: Array  # (R, 3) rad/s
    acceleration: Array  # (R, 3) m/s²
    angular_acceleration: Array  # (R, 3) rad/s²


def dofs(rods: Rods) -> int:
    """Count the degrees of freedom D of one rod."""
    return 3 * rods.q_rest.shape[1] + 6 * rods.free


def part(batch: Any, first: int, end: int) -> Any:
    """The rods `first` to `end` of a batch: of its data, its state or the motion of its roots (views)."""
    return batch._replace(
        **{name: x[first:end] for name, x in batch._asdict().items() if isinstance(x, np.ndarray)}
    )


def still(count: int) -> RootMotion:
    """Motion of `count` roots that stay where they are."""
    return RootMotion(*np.zeros((4, count, 3)))


def circular_rods(
    *,
    length: ArrayLike,
    radius: ArrayLike,
    young: ArrayLike,
    poisson: ArrayLike,
    density: ArrayLike,
    elements: int,
    curvature: ArrayLike = 0.0,
    damping: ArrayLike = 0.0,
    free: bool = False,
    basis: int = HELIX,
) -> Rods:
    """Make rods of circular section: `EI = young pi radius⁴/4`, `GJ = EI/(1 + poisson)`.

    length, radius (m), young (Pa), poisson, density (kg/m³), damping (s): one number or one a rod, broadcast
    together. A Super-Helix has one coefficient an element, a Super-Clothoid one a node: `N = elements + 1`. The
    rest `curvature` (rad/m) broadcasts to (R, N, 3). ValueError names what is out of range.

    >>> rods = circular_rods(length=[0.1, 0.2], radius=1e-3, young=1e9, poisson=0.5, density=1e3, elements=4)
    >>> rods.q_rest.shape, f"{rods.stiffness[0, 1]:.3e}"
    ((2, 4, 3), '7.854e-04')
    """
    columns = np.broadcast_arrays(*np.atleast_1d(length, radius, young, poisson, density, damping))
    L, a, E, nu, rho, damp = (np.array(column, dtype=float) for column in columns)
    for name, value in {"length": L, "radius": a, "young": E, "density": rho}.items():
        _require(bool(np.all((value > 0) & np.isfinite(value))), f"{name} must be positive and finite")
    _require(bool(np.all((nu > -1) & (nu <= 0.5))), "poisson must lie in (-1, 0.5]")
    _require(bool(np.all((damp >= 0) & np.isfinite(damp))), "damping must be finite and not negative")
    _require(elements >= 1, "elements must be at least 1")
    _require(basis in (HELIX, CLOTHOID), "basis must be HELIX or CLOTHOID")
    N = elements + shapes(basis) - 1
    q_rest = np.array(np.broadcast_to(curvature, (len(L), N, 3)), dtype=float)
    _require(bool(np.all(np.isfinite(q_rest))), "curvature must be finite")
    bending = E * np.pi * a**4 / 4
    stiffness = np.column_stack([bending / (1 + nu), bending, bending])
    return Rods(L, rho * np.pi * a**2, a, stiffness, q_rest, damp, free, basis)


def rest_state(rods: Rods, root_position: ArrayLike = 0.0, root_frame: ArrayLike | None = None) -> State:
    """Rods at rest in their natural shape, with root data that broadcast to (R, 3) and (R, 3, 3).

    The default frame is the world's. ValueError when a root frame is not a rotation.
    """
    R = len(rods.length)
    position, frame = checked_roots(R, root_position, root_frame)
    return State(position, frame, rods.q_rest.copy(), np.zeros((R, dofs(rods))))


def checked_roots(count: int, position: ArrayLike, frame: ArrayLike | None) -> tuple[Array, Array]:
    """Positions (R, 3) and frames (R, 3, 3) of `count` roots, from what broadcasts to them; ValueError as above."""
    positions = np.array(np.broadcast_to(position, (count, 3)), dtype=float)
    frames = np.array(np.broadcast_to(np.eye(3) if frame is None else frame, (count, 3, 3)), dtype=float)
    orthonormal = np.allclose(frames.transpose(0, 2, 1) @ frames, np.eye(3), rtol=0, atol=1e-9)
    _require(orthonormal and bool(np.all(np.linalg.det(frames) > 0)), "root_frame must be a rotation")
    return positions, frames


def checked_points(length: Array, rod: ArrayLike, s: ArrayLike) -> tuple[NDArray[np.int64], Array]:
    """Rods (m,) and arc-lengths s (m,) of points; ValueError when one is not on a rod, of lengths (R,)."""
    rod, s = np.ascontiguousarray(rod, dtype=np.int64), np.ascontiguousarray(s, dtype=float)
    if rod.ndim != 1 or rod.shape != s.shape:
        raise ValueError(f"rod and s must be vectors of one length, not {rod.shape} and {s.shape}")
    _require(not np.any((rod < 0) | (rod >= len(length))), f"rod must be in 0..{len(length) - 1}")
    on_rod = bool(np.all((s >= 0) & (s <= length[rod])))
    _require(on_rod, "s must be an arc-length between 0 and the length of its rod")
    return rod, s


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)
