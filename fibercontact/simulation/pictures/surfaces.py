"""What is seen of an obstacle along straight rays: depth towards the eye, and the way its surface faces.

Everything is along the axes of an orthographic camera, whose rays are the lines (x, y, ·).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.frame import contact_frames
from fibercontact.contact.obstacles import Cylinder, Obstacle, Plane, Sphere
from fibercontact.simulation.pictures.camera import Camera

__all__ = ["Surface", "grid_lines", "reach", "seen_surface"]

Array = NDArray[np.float64]

GRAZING = 0.05  # cosine below which a plane is seen from its edge, or from below
PATCH = 0.55  # radius of the disc drawn of a plane, in longer sides of the window
LINES = 0.01  # m between the lines on a plane


class Surface(NamedTuple):
    """The nearest point of a surface on each of m rays."""

    depth: Array  # (m,) m, minus infinity where the ray misses
    normal: Array  # (m, 3) unit, outwards


def seen_surface(obstacle: Obstacle, x: Array, y: Array, camera: Camera) -> Surface:
    """An obstacle on the rays through x, y (m,) in m; of a plane a disc below the middle of the window."""
    point = camera.axes @ obstacle.point
    if isinstance(obstacle, Sphere):
        return _ball(x, y, point, obstacle.radius)
    if isinstance(obstacle, Cylinder):
        return _capsule(x, y, point, camera.axes @ obstacle.axis, obstacle.radius, obstacle.length)
    assert isinstance(obstacle, Plane)
    return _disc(x, y, point, camera.axes @ obstacle.normal, camera)


def reach(obstacle: Obstacle) -> float:
    """Radius of the ball round the obstacle's point that holds it, m."""
    if isinstance(obstacle, Sphere):
        return obstacle.radius
    return 0.5 * obstacle.length + obstacle.radius if isinstance(obstacle, Cylinder) else np.inf


def grid_lines(plane: Plane, points: Array, width: float) -> NDArray[np.bool_]:
    """Whether points (m, 3) of a plane lie on the lines, `width` m wide, that are drawn on it."""
    along = (points - plane.point) @ contact_frames(plane.normal[None])[0, 1:].T
    near = np.abs(along - LINES * np.round(along / LINES)) < 0.5 * width
    return near[:, 0] | near[:, 1]


def _ball(x: Array, y: Array, centre: Array, radius: float) -> Surface:
    right, up = (x - centre[0]) / radius, (y - centre[1]) / radius
    left_over = 1.0 - right * right - up * up
    towards = np.sqrt(np.maximum(left_over, 0.0))
    depth = np.where(left_over > 0.0, centre[2] + radius * towards, -np.inf)
    return Surface(depth, np.column_stack([right, up, towards]))


def _capsule(x: Array, y: Array, centre: Array, axis: Array, radius: float, length: float) -> Surface:
    """The side, `‖q − (q·axis) axis‖ = radius` at `q = (x, y, depth) − centre`, and a ball at each end."""
    q = np.column_stack([x - centre[0], y - centre[1], np.zeros_like(x)])
    ray = np.array([0.0, 0.0, 1.0]) - axis[2] * axis
    across = q - (q @ axis)[:, None] * axis
    a, b, c = max(float(ray @ ray), 1e-12), across @ ray, np.einsum("ij,ij->i", across, across) - radius**2
    t = (np.sqrt(np.maximum(b * b - a * c, 0.0)) - b) / a
    hit = (b * b > a * c) & (np.abs(q @ axis + t * axis[2]) <= 0.5 * length)
    side = Surface(np.where(hit, centre[2] + t, -np.inf), (across + t[:, None] * ray) / radius)
    if not np.isfinite(length):
        return side
    ends = (_ball(x, y, centre + share * length * axis, radius) for share in (-0.5, 0.5))
    return _nearest(side, *ends)


def _nearest(*surfaces: Surface) -> Surface:
    depth, normal = surfaces[0]
    for other in surfaces[1:]:
        nearer = other.depth > depth
        depth, normal = np.where(nearer, other.depth, depth), np.where(nearer[:, None], other.normal, normal)
    return Surface(depth, normal)


def _disc(x: Array, y: Array, point: Array, normal: Array, camera: Camera) -> Surface:
    facing = max(float(normal[2]), GRAZING)
    depth = (normal @ point - normal[0] * x - normal[1] * y) / facing
    foot = camera.middle - (normal @ (camera.middle - point)) * normal
    distance = np.linalg.norm(np.column_stack([x, y, depth]) - foot, axis=1)
    inside = distance < PATCH * max(camera.width, camera.height) / camera.scale
    seen = inside & (normal[2] > GRAZING)
    return Surface(np.where(seen, depth, -np.inf), np.broadcast_to(normal, (len(x), 3)))
