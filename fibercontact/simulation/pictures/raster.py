"""Rods and obstacles as an image: true to scale, hidden by what is before them, shaded.

Every pixel keeps the nearest surface: its depth in metres towards the eye, the way it faces, its colour.
"""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from fibercontact.contact.obstacles import Obstacle, Plane
from fibercontact.simulation.pictures.camera import Camera
from fibercontact.simulation.pictures.surfaces import grid_lines, reach, seen_surface

__all__ = ["Raster"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

SMOOTH = 2  # pixels of the raster a side for one of the image
THINNEST = 0.7  # radius of a tube in pixels of the raster
STEP = 0.7  # pixels between points of a tube, so that none is missed
LIGHT = np.array([-0.40, 0.56, 0.726])  # unit, in the axes of the camera
AMBIENT, GLOSS = 0.45, 0.2  # light that comes from everywhere, and that of highlights
OBSTACLE, LINE = 0.90, 0.72  # greys
DARKENING = 0.4  # of what lies far below its surroundings
BATCH = 100  # fibres that are drawn at once: more would take much memory
BLUR, DEEP = 0.008, 0.05  # extent of surroundings, and what is far, in longer sides of the image


class Raster:
    """An image in the making; its pixels are counted row by row."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera.finer(SMOOTH)
        self.shape = (self.camera.height, self.camera.width)
        pixels = self.shape[0] * self.shape[1]
        self.depth = np.full(pixels, -np.inf)
        self.normal = np.zeros((pixels, 3))
        self.colour = np.ones((pixels, 3))

    def tubes(self, polylines: Array, radius: Array, colours: Array) -> None:
        """Draw polylines (R, P + 1, 3) as tubes of `radius` (R,) m and `colours` (R, 3)."""
        for r in np.unique(radius):
            mine = np.flatnonzero(radius == r)
            for few in np.array_split(mine, math.ceil(len(mine) / BATCH)):
                self._draw_tubes(polylines[few] @ self.camera.axes.T, float(r), colours[few])

    def _draw_tubes(self, polylines: Array, radius: float, colours: Array) -> None:
        """Draw the half of each tube that faces the eye, point by point; its ends are open.

        A point fills its pixel, so the outermost points lie half a pixel inwards.
        """
        width = max(radius * self.camera.scale, THINNEST) - 0.5
        middle, side, front = _along(polylines, STEP / self.camera.scale)
        rod = np.repeat(np.arange(len(polylines)), len(middle) // len(polylines))
        lines = []
        for normal in _round(side, front, width):
            points = middle + width / self.camera.scale * normal
            point, pixel = self._pixels(points)
            np.maximum.at(self.depth, pixel, points[point, 2])
            lines.append((normal, points[point, 2], point, pixel))
        for normal, depth, point, pixel in lines:
            seen = depth == self.depth[pixel]
            self.normal[pixel[seen]] = normal[point[seen]]
            self.colour[pixel[seen]] = colours[rod[point[seen]]]

    def _pixels(self, points: Array) -> tuple[Ints, Ints]:
        """The points (m, 3), along the camera's axes, that are in the window, and their pixels."""
        column, row = np.floor(self.camera.place(points)).astype(np.int64).T
        inside = (column >= 0) & (column < self.camera.width) & (row >= 0) & (row < self.camera.height)
        point = np.flatnonzero(inside)
        return point, row[point] * self.camera.width + column[point]

    def obstacle(self, obstacle: Obstacle) -> None:
        """Draw an obstacle; of a plane a disc with lines a centimetre apart, of its lower side nothing."""
        pixel, x, y = self._rays(obstacle)
        depth, normal = seen_surface(obstacle, x, y, self.camera)
        nearer = depth > self.depth[pixel]
        pixel, depth = pixel[nearer], depth[nearer]
        self.depth[pixel], self.normal[pixel], self.colour[pixel] = depth, normal[nearer], OBSTACLE
        if isinstance(obstacle, Plane):
            points = np.column_stack([x[nearer], y[nearer], depth]) @ self.camera.axes
            self.colour[pixel[grid_lines(obstacle, points, SMOOTH / self.camera.scale)]] = LINE

    def _rays(self, obstacle: Obstacle) -> tuple[Ints, Array, Array]:
        """Pixels that an obstacle may cover, and where their rays are, m to the right and upwards."""
        c = self.camera
        where = c.project(obstacle.point[None])[0]
        far = min(c.scale * reach(obstacle), 1e9)
        low = np.clip(np.floor(where - far), 0, (c.width, c.height)).astype(int)
        high = np.clip(np.ceil(where + far), 0, (c.width, c.height)).astype(int)
        row, column = (g.ravel() for g in np.mgrid[low[1] : high[1], low[0] : high[0]])
        x = c.middle[0] + (column + 0.5 - 0.5 * c.width) / c.scale
        y = c.middle[1] - (row + 0.5 - 0.5 * c.height) / c.scale
        return row * c.width + column, x, y

    def image(self) -> Array:
        """The shaded picture (height, width, 3), colours from 0 to 1, on white."""
        covered = np.isfinite(self.depth)
        lit = np.clip(self.normal @ LIGHT, 0.0, 1.0)
        shade = (AMBIENT + (1.0 - AMBIENT) * lit) * (1.0 - DARKENING * self._hollow(covered))
        colour = self.colour * shade[:, None] + (GLOSS * lit**30)[:, None]
        colour = np.where(covered[:, None], np.minimum(colour, 1.0), 1.0)
        height, width = self.shape
        return colour.reshape(height // SMOOTH, SMOOTH, width // SMOOTH, SMOOTH, 3).mean(axis=(1, 3))

    def _hollow(self, covered: NDArray[np.bool_]) -> Array:
        """How far, from 0 to 1, each pixel lies below its surroundings [Luft et al. 2006, depth darkening]."""
        if not covered.any():
            return np.zeros_like(self.depth)
        depth = np.where(covered, self.depth, self.depth[covered].min())
        around = gaussian_filter(depth.reshape(self.shape), BLUR * max(self.shape)).ravel()
        return np.clip((around - depth) * self.camera.scale / (DEEP * max(self.shape)), 0.0, 1.0)


def _along(polylines: Array, step: float) -> tuple[Array, Array, Array]:
    """Points (m, 3) a `step` apart or less on polylines, and two unit normals there: level, and towards the eye."""
    pieces = int(np.ceil(np.linalg.norm(np.diff(polylines, axis=1), axis=2).max() / step))
    share = (np.arange(pieces) / pieces)[:, None]
    middle, tangent = (
        (x[:, :-1, None] + share * np.diff(x, axis=1)[:, :, None]).reshape(-1, 3)
        for x in (polylines, np.gradient(polylines, axis=1))
    )
    side = _unit(np.column_stack([-tangent[:, 1], tangent[:, 0], np.zeros(len(tangent))]))
    front = _unit(np.cross(tangent, side))
    return middle, side, np.where(front[:, 2:] < 0.0, -front, front)


def _unit(vectors: Array) -> Array:
    """Unit vectors, the first axis for those that are zero."""
    norm = np.linalg.norm(vectors, axis=1)[:, None]
    return np.where(norm > 0.0, vectors / np.where(norm > 0.0, norm, 1.0), np.array([1.0, 0.0, 0.0]))


def _round(side: Array, front: Array, radius: float) -> Iterator[Array]:
    """Normals (m, 3) of the half of a tube of `radius` pixels that faces the eye, line by line."""
    for angle in np.linspace(0.0, np.pi, 1 + int(np.ceil(np.pi * radius / STEP))):
        yield np.cos(angle) * side + np.sin(angle) * front
