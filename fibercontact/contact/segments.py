"""Closest points of two segments in space."""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean

__all__ = ["closest_on_segments"]

Vector = NDArray[np.float64]

_PARALLEL = 1e-9  # sine of the angle below which two segments count as parallel


@jit
def _clamp(x: float) -> float:
    return min(max(x, 0.0), 1.0)


@jit
def _ratio(x: float, y: float) -> float:
    """Divide x by y, clamped to [0, 1]; 0 on a segment without length."""
    return _clamp(x / y) if y > 0.0 else 0.0


@jit_lean
def closest_on_segments(a0: Vector, a1: Vector, b0: Vector, b1: Vector) -> tuple[float, float, float]:
    """Closest points of the segments a0–a1 and b0–b1, each vertex (3,) in m.

    Returns (s, t, distance): the points are a0 + s (a1 - a0) and b0 + t (b1 - b0), s and t in [0, 1].
    Where the points are not unique because the segments are parallel, the middle of the overlap is taken; a
    segment without length is a point. The crossing of the two lines gives s, clamped; t is the best for this
    s, clamped, and s the best for this t [Ericson 2005, Real-Time Collision Detection, 5.1.9]. The crossing
    is computed from cross products, so the distance is exact to rounding also when nearly parallel.
    """
    ux, uy, uz = a1[0] - a0[0], a1[1] - a0[1], a1[2] - a0[2]
    vx, vy, vz = b1[0] - b0[0], b1[1] - b0[1], b1[2] - b0[2]
    rx, ry, rz = b0[0] - a0[0], b0[1] - a0[1], b0[2] - a0[2]
    uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
    uv, ur, vr = ux * vx + uy * vy + uz * vz, ux * rx + uy * ry + uz * rz, vx * rx + vy * ry + vz * rz
    cx, cy, cz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    cc = cx * cx + cy * cy + cz * cz
    if cc > _PARALLEL**2 * uu * vv:
        s = _clamp((cx * (ry * vz - rz * vy) + cy * (rz * vx - rx * vz) + cz * (rx * vy - ry * vx)) / cc)
    else:
        s = 0.5 * (_ratio(ur, uu) + _ratio(ur + uv, uu))
    t = _ratio(s * uv - vr, vv)
    s = _ratio(t * uv + ur, uu)
    dx, dy, dz = rx + t * vx - s * ux, ry + t * vy - s * uy, rz + t * vz - s * uz
    return s, t, np.sqrt(dx * dx + dy * dy + dz * dz)
