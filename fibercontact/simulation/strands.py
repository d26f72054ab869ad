"""How the fibres of a scene begin: their curl, the patterns of their roots, the model of their rods."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fibercontact.rods.basis import CLOTHOID, HELIX
from fibercontact.rods.discrete_model import discrete_state, discretise
from fibercontact.rods.interface import AnyRods, AnyState
from fibercontact.rods.model import Rods, rest_state
from fibercontact.simulation.scene import SceneError

__all__ = [
    "MODELS",
    "basis_of",
    "begin",
    "cap",
    "coefficients",
    "curled",
    "hexagonal",
    "level",
    "turned_frames",
]

Array = NDArray[np.float64]

MODELS = ("helix", "clothoid", "discrete")
CURLS = ("straight", "wavy", "curly")
EDGES = 20  # of discrete rods


def basis_of(model: str) -> int:
    """Basis of curvature in which a model's fibres are described; discrete rods are made from helices."""
    return CLOTHOID if model == "clothoid" else HELIX


def coefficients(model: str, elements: int) -> int:
    """Count the coefficients of curvature that describe a fibre of so many elements."""
    return elements + (model == "clothoid")


def curled(curl: str, fibres: int, count: int, rng: np.random.Generator) -> Array:
    """Rest curvatures (R, count, 3): none, alternating bends, or a helix; `mixed` draws one of them a fibre."""
    if curl != "mixed" and curl not in CURLS:
        raise SceneError(f"unknown curl {curl!r} (known: {', '.join(CURLS)}, mixed)")
    kind = rng.integers(0, 3, fibres) if curl == "mixed" else np.full(fibres, CURLS.index(curl))
    q = np.zeros((fibres, count, 3))
    size = rng.uniform(0.7, 1.3, fibres)[:, None]
    sign = (-1.0) ** np.arange(count)
    wavy, curly = kind == 1, kind == 2
    q[wavy, :, 1] = 20.0 * size[wavy] * sign
    q[curly, :, 1] = 30.0 * size[curly]
    q[curly, :, 0] = 15.0 * size[curly]
    return q


def hexagonal(count: int, spacing: float) -> Array:
    """The `count` points (count, 2) of a hexagonal lattice that are nearest to its origin."""
    reach = math.ceil(math.sqrt(count)) + 2
    i, j = (x.ravel() for x in np.mgrid[-reach : reach + 1, -reach : reach + 1])
    points = spacing * np.column_stack([i + 0.5 * j, math.sqrt(0.75) * j])
    return points[np.lexsort((points[:, 1], points[:, 0], np.round(np.linalg.norm(points, axis=1), 9)))][
        :count
    ]


def cap(count: int, share: float = 0.7) -> Array:
    """Unit vectors (count, 3) spread evenly, along Fibonacci's spiral, over the heights from 1 to 1 − share."""
    golden = math.pi * (3 - math.sqrt(5))
    height = 1 - (np.arange(count) + 0.5) / count * share
    turn = golden * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])


def level(
    length: Array, spread: float, low: float, spacing: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Roots and tangents (R, 3) of level straight fibres, one above the other from the height `low` upwards."""
    count = len(length)
    angle = rng.uniform(0, 2 * math.pi, count)
    tangents = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(count)])
    middle = np.column_stack([rng.uniform(-spread, spread, (count, 2)), low + spacing * np.arange(count)])
    return middle - 0.5 * length[:, None] * tangents, tangents


def turned_frames(tangents: Array, rng: np.random.Generator) -> Array:
    """Frames (R, 3, 3) with the given tangents (R, 3) and a random turn about them."""
    frames = np.empty((len(tangents), 3, 3))
    # One by one: all at once they differ in the last digit, and with them the problems of the sets.
    for frame, tangent in zip(frames, tangents, strict=True):
        t = tangent / np.linalg.norm(tangent)
        across = np.cross(t, np.eye(3)[np.argmin(np.abs(t))])
        n1 = Rotation.from_rotvec(rng.uniform(0, 2 * math.pi) * t).apply(across / np.linalg.norm(across))
        frame[:] = np.column_stack([t, n1, np.cross(t, n1)])
    return frames


def begin(
    model: str,
    rods: Rods,
    roots: Array,
    frames: Array,
    *,
    natural: bool | NDArray[np.bool_] = False,
    edges: int = EDGES,
) -> tuple[AnyRods, AnyState]:
    """The rods as a model has them, at rest: straight, or in their natural shape; `natural` may say so rod by rod."""
    if model not in MODELS:
        raise SceneError(f"unknown rod model {model!r} (known: {', '.join(MODELS)})")
    share = np.broadcast_to(natural, len(rods.length))[:, None, None]
    if model == "discrete":
        discrete = discretise(rods, edges)
        return discrete, discrete_state(discrete, roots, frames, curvature=share * discrete.rest_curvature)
    return rods, rest_state(rods, roots, frames)._replace(q=share * rods.q_rest)
