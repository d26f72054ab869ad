"""A step of a scene as a page to turn about in a browser."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.frame import contact_frames
from fibercontact.contact.obstacles import Cylinder, Obstacle, Plane, Sphere
from fibercontact.local.algebra import OPEN
from fibercontact.simulation.pictures.camera import TILT, TURN
from fibercontact.simulation.pictures.page import Rows, contact_rows, contact_trace, lay_out
from fibercontact.simulation.pictures.shown import REGIMES, Shown, force_scale, held
from fibercontact.simulation.step import Step

if TYPE_CHECKING:
    from plotly.basedatatypes import BaseTraceType
    from plotly.graph_objects import Figure

__all__ = ["scene_page", "tubes"]

Array = NDArray[np.float64]

TUBES = 250  # fibres: tubes of more would make a heavy page, they are lines
SEGMENTS, SIDES = 30, 6  # of a fibre, and corners of the rings of a tube
ROUND = 12  # points of a quarter of a circle
FIBRES = [[0.0, "#8f7561"], [1.0, "#edd6b8"]]
SHADES = 6  # of fibres that are lines
STONE = [[0.0, "#d9d6d1"], [1.0, "#d9d6d1"]]
FORCE = "#444444"


def scene_page(
    shown: Shown, step: Step, turn: float = TURN, tilt: float = TILT, most_tubes: int = TUBES
) -> "Figure":
    """Fibres, obstacles, contacts by regime and forces of a step; each can be switched off.

    More fibres than `most_tubes` are lines.
    """
    from plotly.graph_objects import Figure

    points = np.concatenate(held(shown))
    low, high = points.min(axis=0), points.max(axis=0)
    figure = Figure(list(_fibres(shown, most_tubes)))
    for obstacle in shown.obstacles:
        figure.add_traces(list(_obstacle(obstacle, low, high)))
    figure.add_trace(_forces(shown, force_scale([shown], float((high - low).max()))))
    rows = _rows(step)
    for kind in REGIMES:
        mine = np.flatnonzero(shown.regime == kind)
        figure.add_trace(contact_trace(kind, shown.points[mine], [rows[i] for i in mine]))
    lay_out(figure, turn, tilt)
    return figure


def _rows(step: Step) -> Rows:
    """What is said of the contacts of a step."""
    if step.run is None or step.problem is None:
        return []
    problem, contacts = step.problem.condense(), step.contacts
    bodies = zip(contacts.fibre_a, contacts.fibre_b, contacts.obstacle, contacts.gap, strict=True)
    names = [
        (f"fibres {a} and {b}" if obstacle < 0 else f"fibre {a} and obstacle {obstacle}")
        + f", gap {1e3 * gap:.3g} mm before the step"
        for a, b, obstacle, gap in bodies
    ]
    return contact_rows(names, problem.mu, step.run.r, problem.W @ step.run.r + problem.b)


def _forces(shown: Shown, newton: float) -> "BaseTraceType":
    """Lines from the contacts, `newton` metres for a newton."""
    from plotly.graph_objects import Scatter3d

    pushing = shown.regime != OPEN
    start = shown.points[pushing]
    x, y, z = _broken(np.stack([start, start + newton * shown.force[pushing]], axis=1))
    name = "forces" if newton == 0.0 else f"forces, {newton:.2g} mm for a mN"
    return Scatter3d(x=x, y=y, z=z, mode="lines", name=name, line={"color": FORCE, "width": 3},
                     hoverinfo="skip", showlegend=True)  # fmt: skip


def _broken(lines: Array) -> NDArray[np.float32]:
    """Coordinates (3, k (p + 1)) of k lines of p points (k, p, 3), with a gap after each."""
    gaps = np.full((len(lines), 1, 3), np.nan)
    return np.concatenate([lines, gaps], axis=1).reshape(-1, 3).T.astype(np.float32)


def _fibres(shown: Shown, most_tubes: int) -> Iterator["BaseTraceType"]:
    """Tubes as thick as the fibres, or lines where there are too many."""
    from plotly.graph_objects import Mesh3d

    shade = np.random.default_rng(0).uniform(size=len(shown.fibres)).astype(np.float32)
    fibres = _thinned(shown.fibres, SEGMENTS)
    if len(fibres) > most_tubes:
        yield from _strokes(fibres, shade)
        return
    corner, triangle = tubes(fibres, shown.radius, SIDES)
    x, y, z = corner.T.astype(np.float32)
    i, j, k = triangle.T.astype(np.int32)
    yield Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, intensity=np.repeat(shade, len(corner) // len(shade)), name="fibres",
                 colorscale=FIBRES, showscale=False, showlegend=True, hoverinfo="skip")  # fmt: skip


def _strokes(fibres: Array, shade: NDArray[np.float32]) -> Iterator["BaseTraceType"]:
    """Fibres as lines of a few shades, one trace each, switched on and off together."""
    from plotly.colors import sample_colorscale
    from plotly.graph_objects import Scatter3d

    group = (SHADES * shade).astype(int)
    for k in np.unique(group):
        x, y, z = _broken(fibres[group == k])
        (colour,) = sample_colorscale(FIBRES, [(k + 0.5) / SHADES])
        yield Scatter3d(x=x, y=y, z=z, mode="lines", name="fibres", line={"color": colour, "width": 3},
                        legendgroup="fibres", showlegend=bool(k == group.min()), hoverinfo="skip")  # fmt: skip


def _thinned(polylines: Array, segments: int) -> Array:
    """Polylines with every other vertex, or less, if they have more segments than that; both ends stay."""
    count = polylines.shape[1]
    keep = np.unique(np.round(np.linspace(0, count - 1, min(count, segments + 1))).astype(int))
    return polylines[:, keep]


def tubes(polylines: Array, radius: Array, sides: int) -> tuple[Array, NDArray[np.int64]]:
    """Corners (R P sides, 3) and triangles (…, 3) of tubes round polylines (R, P, 3), open at the ends."""
    rods, points, _ = polylines.shape
    tangent = np.gradient(polylines, axis=1)
    tangent /= np.linalg.norm(tangent, axis=2, keepdims=True)
    side = _carried(tangent)[:, :, None]
    angle = (2.0 * np.pi * np.arange(sides) / sides)[:, None]
    outwards = np.cos(angle) * side + np.sin(angle) * np.cross(tangent[:, :, None], side)
    corner = polylines[:, :, None] + radius[:, None, None, None] * outwards
    number = np.arange(rods * points * sides).reshape(rods, points, sides)
    a, b = number[:, :-1], number[:, 1:]
    c, d = np.roll(a, -1, axis=2), np.roll(b, -1, axis=2)
    triangles = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([c, b, d], axis=-1)])
    return corner.reshape(-1, 3), triangles.reshape(-1, 3)


def _carried(tangent: Array) -> Array:
    """Unit normals (R, P, 3) of unit tangents, each the one before without its part along the tangent."""
    side = np.empty_like(tangent)
    side[:, 0] = contact_frames(tangent[:, 0])[:, 1]
    for k in range(1, tangent.shape[1]):
        along = np.einsum("ri,ri->r", side[:, k - 1], tangent[:, k])
        side[:, k] = side[:, k - 1] - along[:, None] * tangent[:, k]
        side[:, k] /= np.linalg.norm(side[:, k], axis=1)[:, None]
    return side


def _obstacle(obstacle: Obstacle, low: Array, high: Array) -> Iterator["BaseTraceType"]:
    """An obstacle as surfaces; those without end are cut a little outside of the box from `low` to `high`."""
    if isinstance(obstacle, Plane):
        yield _patch(obstacle, low, high)
        return
    assert isinstance(obstacle, Sphere | Cylinder)
    axis = obstacle.axis if isinstance(obstacle, Cylinder) else np.array([0.0, 0.0, 1.0])
    length = obstacle.length if isinstance(obstacle, Cylinder) else 0.0
    point = obstacle.point
    if not np.isfinite(length):
        point = point + ((0.5 * (low + high) - point) @ axis) * axis
        length = 1.2 * float(np.linalg.norm(high - low))
    yield _stone(*_capsule(point, axis, obstacle.radius, length))


def _capsule(point: Array, axis: Array, radius: float, length: float) -> tuple[Array, Array, Array]:
    """Coordinates, each (p, q), of a capsule's surface; a ball when its length is 0."""
    angle = np.linspace(0.0, np.pi, 2 * ROUND)
    along = -radius * np.cos(angle) + 0.5 * length * np.sign(angle - 0.5 * np.pi)
    _, t1, t2 = contact_frames(axis[None])[0]
    turn = np.linspace(0.0, 2.0 * np.pi, 4 * ROUND + 1)[:, None, None]
    ring = np.cos(turn) * t1 + np.sin(turn) * t2
    surface = point + along[:, None] * axis + radius * np.sin(angle)[:, None] * ring
    x, y, z = np.moveaxis(surface, -1, 0)
    return x, y, z


def _patch(plane: Plane, low: Array, high: Array) -> "BaseTraceType":
    """A square of the plane below the middle of the box."""
    middle = 0.5 * (low + high)
    foot = middle - ((middle - plane.point) @ plane.normal) * plane.normal
    _, t1, t2 = contact_frames(plane.normal[None])[0]
    share = 0.6 * float(np.linalg.norm(high - low)) * np.array([-1.0, 1.0])
    x, y, z = np.moveaxis(foot + share[:, None, None] * t1 + share[:, None] * t2, -1, 0)
    return _stone(x, y, z)


def _stone(x: Array, y: Array, z: Array) -> "BaseTraceType":
    from plotly.graph_objects import Surface

    coordinates = {name: values.astype(np.float32) for name, values in zip("xyz", (x, y, z), strict=True)}
    return Surface(**coordinates, colorscale=STONE, showscale=False, hoverinfo="skip", name="obstacle",
                   surfacecolor=np.zeros(x.shape, dtype=np.float32), lighting={"specular": 0.05})  # fmt: skip
