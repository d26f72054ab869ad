"""Rigid obstacles in prescribed motion: plane, sphere, cylinder, and their signed distances."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from fibercontact.contact.frame import contact_frames
from fibercontact.contact.segments import closest_on_segments
from fibercontact.jit import jit_lean

__all__ = ["Cylinder", "Obstacle", "Plane", "Sphere"]

Floats = NDArray[np.float64]


def _zero() -> Floats:
    return np.zeros(3)


def _vector(name: str, value: ArrayLike) -> Floats:
    vector = np.asarray(value, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name} must be three finite numbers, got {value!r}")
    return vector


def _unit(name: str, value: ArrayLike) -> Floats:
    vector = _vector(name, value)
    if not (norm := float(np.linalg.norm(vector))) > 0.0:
        raise ValueError(f"{name} must not be zero")
    return vector / norm


def _check_positive(name: str, value: float, most: float = np.finfo(float).max) -> None:
    if not 0.0 < value <= most:
        raise ValueError(f"{name} must be positive{'' if most == np.inf else ' and finite'}, got {value!r}")


@dataclass(frozen=True, eq=False)
class Obstacle(ABC):
    """A rigid body whose `point` (3,), in m, moves with `velocity` (3,), in m/s.

    The body turns about `point` with `angular_velocity` (3,), in rad/s. Raises ValueError for vectors that
    are not three finite numbers, directions that are zero, radii that are not positive and finite, and lengths
    that are not positive.
    """

    point: Floats
    velocity: Floats = field(default_factory=_zero, kw_only=True)
    angular_velocity: Floats = field(default_factory=_zero, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("point", "velocity", "angular_velocity"):
            object.__setattr__(self, name, _vector(name, getattr(self, name)))

    @abstractmethod
    def signed_distance(self, points: Floats) -> tuple[Floats, Floats]:
        """Distance (m,) of points (m, 3) to the surface, in m, negative inside, and its gradient (m, 3).

        The gradient is the unit normal that points out of the obstacle.
        """

    def closest_on_segments(self, start: Floats, end: Floats) -> Floats | None:
        """Parameter (m,) in [0, 1] of the point of each segment closest to the obstacle.

        None when that point is always an end of the segment.
        """
        return None

    def velocity_at(self, points: Floats) -> Floats:
        """Velocities (m, 3), in m/s, of the obstacle's material points at `points` (m, 3)."""
        return self.velocity + np.cross(self.angular_velocity, points - self.point)

    def moved(self, dt: float) -> Self:
        """The obstacle after a time `dt`, in s, of its motion (exact for constant velocities)."""
        return replace(self, point=self.point + dt * self.velocity)

    def _turned(self, direction: Floats, dt: float) -> Floats:
        return Rotation.from_rotvec(dt * self.angular_velocity).apply(direction)


@dataclass(frozen=True, eq=False)
class Plane(Obstacle):
    """The half-space below `point`, bounded by the plane with the outward `normal` (3,)."""

    normal: Floats

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "normal", _unit("normal", self.normal))

    def signed_distance(self, points: Floats) -> tuple[Floats, Floats]:
        """Distance (m,) to the plane and normals (m, 3)."""
        return np.einsum("mi,i->m", points - self.point, self.normal), np.broadcast_to(
            self.normal, points.shape
        )

    def moved(self, dt: float) -> Self:
        """The plane after a time `dt`, in s."""
        return replace(super().moved(dt), normal=self._turned(self.normal, dt))


@dataclass(frozen=True, eq=False)
class Sphere(Obstacle):
    """The ball of `radius`, in m, round `point`. At the centre the normal is the z axis."""

    radius: float

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_positive("radius", self.radius)

    def signed_distance(self, points: Floats) -> tuple[Floats, Floats]:
        """Distance (m,) to the sphere and normals (m, 3)."""
        distance, normal = _distance_from(points, self.point, np.array([0.0, 0.0, 1.0]))
        return distance - self.radius, normal

    def closest_on_segments(self, start: Floats, end: Floats) -> Floats:
        """Parameter (m,) in [0, 1] of the point of each segment closest to the centre."""
        centre = np.full_like(start, self.point)
        return _closest_parameters(start, end, centre, centre)


@dataclass(frozen=True, eq=False)
class Cylinder(Obstacle):
    """The points within `radius`, in m, of the line through `point` along `axis` (3,).

    With a `length`, in m, of the piece of that line of this length with `point` in its middle: a capsule,
    longer than `length` by a radius at each end. On the axis the normal is orthogonal to it.
    """

    axis: Floats
    radius: float
    length: float = np.inf

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "axis", _unit("axis", self.axis))
        _check_positive("radius", self.radius)
        _check_positive("length", self.length, np.inf)

    def _on_axis(self, points: Floats) -> Floats:
        along = np.clip(
            np.einsum("mi,i->m", points - self.point, self.axis), -0.5 * self.length, 0.5 * self.length
        )
        return self.point + along[:, None] * self.axis

    def signed_distance(self, points: Floats) -> tuple[Floats, Floats]:
        """Distance (m,) to the surface and normals (m, 3)."""
        across = contact_frames(self.axis[None])[0, 1]
        distance, normal = _distance_from(points, self._on_axis(points), across)
        return distance - self.radius, normal

    def closest_on_segments(self, start: Floats, end: Floats) -> Floats:
        """Parameter (m,) in [0, 1] of the point of each segment closest to the axis."""
        # The part of the axis beside a segment holds the closest point, also when the axis is infinite.
        return _closest_parameters(start, end, self._on_axis(start), self._on_axis(end))

    def moved(self, dt: float) -> Self:
        """The cylinder after a time `dt`, in s."""
        return replace(super().moved(dt), axis=self._turned(self.axis, dt))


def _distance_from(points: Floats, core: Floats, fallback: Floats) -> tuple[Floats, Floats]:
    """Distance (m,) of points to their `core` points and unit vectors away from them (`fallback` at zero)."""
    away = points - core
    distance = np.linalg.norm(away, axis=1)
    normal = np.where(distance[:, None] > 0.0, away, fallback)
    return distance, normal / np.where(distance > 0.0, distance, 1.0)[:, None]


def _closest_parameters(a0: Floats, a1: Floats, b0: Floats, b1: Floats) -> Floats:
    parameters = np.empty(len(a0))
    _fill_parameters(a0, a1, b0, b1, parameters)
    return parameters


@jit_lean
def _fill_parameters(a0: Floats, a1: Floats, b0: Floats, b1: Floats, parameters: Floats) -> None:
    for i in range(len(a0)):
        parameters[i] = closest_on_segments(a0[i], a1[i], b0[i], b1[i])[0]
