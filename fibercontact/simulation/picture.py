"""A still picture of a scene: fibres as shaded lines, obstacles as wire frames, contacts as dots."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

from fibercontact.contact.obstacles import Cylinder, Obstacle, Sphere
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import Step

__all__ = ["draw"]

Array = NDArray[np.float64]

VIEW = (0.55, -0.25)  # turn about the vertical and tilt of the camera, rad
POINTS = 60


def draw(scene: Scene, step: Step, file: Path) -> None:
    """Draw the world after a step into `file` (PNG or SVG by its suffix), in orthographic projection."""
    figure = Figure(figsize=(7, 6.2), dpi=150, layout="constrained")
    axes = figure.add_subplot()
    vertices = rod_model(scene.rods).centreline(step.world.state, POINTS)
    plane, depth = _project(vertices.reshape(-1, 3))
    plane, depth = plane.reshape(*vertices.shape[:2], 2), depth.reshape(vertices.shape[:2])
    for body in step.world.bodies:
        for obstacle in body.obstacles:
            _draw_obstacle(axes, obstacle)
    segments = np.stack([plane[:, :-1], plane[:, 1:]], axis=2).reshape(-1, 2, 2)
    nearness = (0.5 * (depth[:, :-1] + depth[:, 1:])).ravel()
    span = max(float(np.ptp(nearness)), 1e-12)
    order = np.argsort(nearness)
    hue = np.repeat(np.linspace(0.15, 0.85, len(vertices)), vertices.shape[1] - 1)
    colours = matplotlib.colormaps["copper"](hue)
    colours[:, :3] *= (0.55 + 0.45 * (nearness - nearness.min()) / span)[:, None]
    width = 1.3 if len(vertices) < 100 else 0.9
    axes.add_collection(LineCollection(list(segments[order]), colors=colours[order], linewidths=width))
    if step.run is not None:
        active = step.run.r.reshape(-1, 3)[:, 0] > 0
        dots, _ = _project(step.contacts.point[active])
        axes.plot(dots[:, 0], dots[:, 1], ".", color="#1f9bb4", markersize=2.5, zorder=3)
    middle, half = _frame(plane.reshape(-1, 2))
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(
        f"{scene.name}, {step.world.time:.2f} s: {len(vertices)} fibres, {len(step.contacts.gap)} contacts",
        fontsize=10,
    )
    figure.savefig(file)


def _frame(points: Array) -> tuple[Array, float]:
    """Centre and half width of the square that holds nearly all of the fibres."""
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    return 0.5 * (low + high), 0.56 * float((high - low).max()) + 5e-3


def _project(points: Array) -> tuple[Array, Array]:
    """Coordinates in the picture (m, 2) and nearness to the camera (m,)."""
    turn, tilt = VIEW
    c, s = np.cos(turn), np.sin(turn)
    right, back = c * points[:, 0] + s * points[:, 1], -s * points[:, 0] + c * points[:, 1]
    up = np.cos(tilt) * points[:, 2] - np.sin(tilt) * back
    return np.column_stack([right, up]), -np.cos(tilt) * back - np.sin(tilt) * points[:, 2]


def _draw_obstacle(axes: Axes, obstacle: Obstacle) -> None:
    if isinstance(obstacle, Sphere):
        centre, _ = _project(obstacle.point[None])
        axes.add_patch(Circle((centre[0, 0], centre[0, 1]), obstacle.radius, color="#e8e2da", zorder=0))
    elif isinstance(obstacle, Cylinder):
        half = 0.5 * min(obstacle.length, 0.12)
        ends, _ = _project(obstacle.point + np.array([[-half], [half]]) * obstacle.axis)
        along = ends[1] - ends[0]
        across = obstacle.radius * np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-12)
        corners = [ends[0] + across, ends[1] + across, ends[1] - across, ends[0] - across]
        axes.add_patch(Polygon(corners, color="#dcd6ce", zorder=0))
