"""Where a scene is looked at from: an orthographic view, framed once for all of the pictures of a run."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["TILT", "TURN", "Camera", "framed", "view_axes"]

Array = NDArray[np.float64]

TURN, TILT = -30.0, 20.0  # degrees
MARGIN = 0.06  # of the longer side, on each
ASPECT = 1.5  # of the longer side to the shorter one, at most
OUTLIERS = 0.2  # per cent of the points that may be out of the frame on each side: fibres fly off


@dataclass(frozen=True)
class Camera:
    """An orthographic view, and the window it is seen through."""

    axes: Array  # (3, 3) orthonormal rows: to the right, upwards, towards the eye
    middle: Array  # (3,) m, of what is seen, along those axes
    scale: float  # pixels a metre
    width: int  # pixels
    height: int

    def project(self, points: Array) -> Array:
        """Columns and rows in pixels (m, 2), from the upper left corner, of points (m, 3) of the world."""
        return self.place(points @ self.axes.T)

    def place(self, seen: Array) -> Array:
        """The same of points (m, 3) along the axes of the camera."""
        right, up = (seen[:, :2] - self.middle[:2]).T
        return np.column_stack([0.5 * self.width + self.scale * right, 0.5 * self.height - self.scale * up])

    def finer(self, factor: int) -> "Camera":
        """The same window with `factor` times as many pixels a side."""
        return replace(
            self, scale=factor * self.scale, width=factor * self.width, height=factor * self.height
        )


def view_axes(turn: float = TURN, tilt: float = TILT) -> Array:
    """Axes (3, 3) of a camera turned about the vertical, and looking down by `tilt`; both in degrees."""
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    level, down = math.cos(math.radians(tilt)), math.sin(math.radians(tilt))
    return np.array([[c, s, 0.0], [-down * s, down * c, level], [level * s, -level * c, down]])


def framed(axes: Array, groups: Iterable[Array], size: int) -> Camera:
    """The camera along `axes` whose window, `size` pixels at the longer side, holds groups of points (m, 3).

    Of each group nearly all: a fibre that flew off does not make the others small.
    """
    ends = [np.percentile(points @ axes.T, [OUTLIERS, 100.0 - OUTLIERS], axis=0) for points in groups]
    low, high = np.min(ends, axis=(0, 1)), np.max(ends, axis=(0, 1))
    extent = (high - low)[:2]
    longest = max(float(extent.max()), 1e-6)
    window = np.maximum(extent, longest / ASPECT) + 2.0 * MARGIN * longest
    scale = size / float(window.max())
    width, height = (2 * round(0.5 * scale * side) for side in window)  # codecs of films want even numbers
    return Camera(axes, 0.5 * (low + high), scale, width, height)
