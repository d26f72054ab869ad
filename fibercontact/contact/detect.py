"""Contacts between fibres, and between fibres and obstacles, once for each touching.

A fibre is a polyline whose vertices lie on its centreline at equal steps h of arc length. Where the centreline's
curvature is at most kappa, the polyline is within the sagitta kappa h²/8 of it at the same arc length (linear
interpolation of a curve with |r''| ≤ kappa; equality in the middle of an arc, as h → 0). Distances between two
fibres are therefore in error by the sum of their sagittas at most: what is closer than the distance of activation
less that sum is found, and nothing is that is farther apart than the two together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.broad_phase import near_segments
from fibercontact.contact.frame import contact_frames
from fibercontact.contact.obstacles import Obstacle
from fibercontact.contact.segments import closest_on_segments
from fibercontact.jit import jit, jit_lean
from fibercontact.threads import over_ranges

__all__ = ["Contacts", "detect"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_WINDOW = 1.0 + 1e-6  # parallel fibres often have candidates at exactly half a segment: one touching
_PAIRS = 4096  # of a range, for a thread
_TIE = 1e-9  # of the threshold: distances that differ by less are equal


class Contacts(NamedTuple):
    """The m contacts of a configuration, sorted by (fibre_a, fibre_b, s_a).

    Contacts between fibres have fibre_a < fibre_b and obstacle = -1; with an obstacle, A is the fibre, B the
    obstacle, fibre_b = -1 and s_b = 0.
    """

    fibre_a: Ints  # (m,)
    s_a: Floats  # (m,) arc length from the root, m
    fibre_b: Ints  # (m,)
    s_b: Floats  # (m,) m
    obstacle: Ints  # (m,)
    normal: Floats  # (m, 3) unit, from B to A
    point: Floats  # (m, 3) halfway between the two surfaces, m
    gap: Floats  # (m,) distance of the surfaces, negative in penetration, m


class _Fibres(NamedTuple):
    """Polylines of R fibres with P segments of equal arc length; positions x along them count segments."""

    vertices: Floats  # (R, P + 1, 3)
    length: Floats  # (R,) arc length
    segment: Floats  # (R,) arc length of a segment
    radius: Floats  # (R,)
    reach: Floats  # (R,) radius of the bounding cylinders
    skip: Floats  # (R,) x below which contacts are ignored


class _Candidates(NamedTuple):
    """Points x_a of fibres within reach of points x_b of other fibres, or of an obstacle (x_b = 0)."""

    fibre_a: Ints
    x_a: Floats
    fibre_b: Ints
    x_b: Floats
    distance: Floats


def detect(
    vertices: Floats,
    length: Floats,
    radius: Floats,
    *,
    margin: float = 0.0,
    skip_root: float = 0.0,
    obstacles: Sequence[Obstacle] = (),
) -> Contacts:
    """Contacts between R fibres, polylines `vertices` (R, P + 1, 3) in m, and with `obstacles`.

    `length` (R,) and `radius` (R,) are in m; vertex k of fibre a lies at arc length k length[a] / P. A
    contact is active when the centrelines are closer than eps_a + eps_b, eps = radius (1 + margin), or when
    the centreline is closer than eps_a to an obstacle; with margin 0 these are the penetrating pairs. Points
    whose arc length, on either fibre, is less than `skip_root` m are ignored. A fibre's contacts with itself
    are not looked for.

    Candidates are the closest points of all pairs of segments; against an obstacle, the vertices and each
    segment's closest point. One contact is kept for one touching: candidates are walked through by increasing
    distance, and one is dropped if a contact of the same two bodies was kept within half a segment, and half
    the distance of activation, of it in both arc lengths. (With half a segment alone, parallel fibres shifted
    by less than that distance would also touch from vertex to vertex, obliquely.) Where two centrelines
    cross, the normal is the common perpendicular of the segments.

    Raises ValueError for arrays that do not fit together, vertices that are not finite, lengths and radii
    that are not positive, and a negative margin or skip_root.
    """
    fibres = _fibres(vertices, length, radius, margin, skip_root)
    found = [_fibre_contacts(fibres)]
    found += [_obstacle_contacts(fibres, body, index) for index, body in enumerate(obstacles)]
    joined = Contacts._make(map(np.concatenate, zip(*found, strict=True)))
    order = np.lexsort((joined.s_b, joined.s_a, joined.obstacle, joined.fibre_b, joined.fibre_a))
    return Contacts._make(column[order] for column in joined)


def _fibres(vertices: Floats, length: Floats, radius: Floats, margin: float, skip_root: float) -> _Fibres:
    vertices = np.ascontiguousarray(vertices, dtype=float)
    length, radius = np.asarray(length, dtype=float), np.asarray(radius, dtype=float)
    if vertices.ndim != 3 or len(vertices) < 1 or vertices.shape[1] < 2 or vertices.shape[2] != 3:
        raise ValueError(f"vertices must be (R, P + 1, 3) with R, P ≥ 1, got {vertices.shape}")
    for name, values in (("length", length), ("radius", radius)):
        if values.shape != vertices.shape[:1]:
            raise ValueError(f"{name} must be ({len(vertices)},), got {values.shape}")
        if not (np.isfinite(values) & (values > 0.0)).all():
            raise ValueError(f"{name} must be positive and finite")
    if not (finite := np.isfinite(vertices).all(axis=(1, 2))).all():
        raise ValueError(f"vertices of fibre {np.argmin(finite)} are not finite")
    if not (margin >= 0.0 and skip_root >= 0.0):
        raise ValueError(f"need margin ≥ 0 and skip_root ≥ 0, got {margin!r}, {skip_root!r}")
    segment = length / (vertices.shape[1] - 1)
    return _Fibres(vertices, length, segment, radius, radius * (1.0 + margin), skip_root / segment)


def _fibre_contacts(fibres: _Fibres) -> Contacts:
    a, x_a, b, x_b, distance = _one_touching(_fibre_candidates(fibres), fibres)
    point_a, tangent_a = _on_polylines(fibres.vertices, a, x_a)
    point_b, tangent_b = _on_polylines(fibres.vertices, b, x_b)
    crossing = distance <= _TIE * (fibres.reach[a] + fibres.reach[b])
    away = np.where(crossing[:, None], _common_perpendicular(tangent_a, tangent_b), point_a - point_b)
    normal = away / np.linalg.norm(away, axis=1, keepdims=True)
    gap = distance - fibres.radius[a] - fibres.radius[b]
    point = point_a - (fibres.radius[a] + 0.5 * gap)[:, None] * normal
    s_a, s_b = _arc_length(fibres, a, x_a), _arc_length(fibres, b, x_b)
    return Contacts(a, s_a, b, s_b, np.full_like(a, -1), normal, point, gap)


def _obstacle_contacts(fibres: _Fibres, body: Obstacle, index: int) -> Contacts:
    a, x_a, _, x_b, distance = _one_touching(_obstacle_candidates(fibres, body), fibres)
    point_a, _ = _on_polylines(fibres.vertices, a, x_a)
    _, normal = body.signed_distance(point_a)
    gap = distance - fibres.radius[a]
    point = point_a - (fibres.radius[a] + 0.5 * gap)[:, None] * normal
    none = np.full_like(a, -1)
    return Contacts(a, _arc_length(fibres, a, x_a), none, x_b, np.full_like(a, index), normal, point, gap)


def _arc_length(fibres: _Fibres, fibre: Ints, x: Floats) -> Floats:
    """Arc lengths of positions along polylines; rounding does not take them past the end of the fibre."""
    return np.minimum(x * fibres.segment[fibre], fibres.length[fibre])


def _fibre_candidates(fibres: _Fibres) -> _Candidates:
    R, P = fibres.vertices.shape[0], fibres.vertices.shape[1] - 1
    start, end = (ends.reshape(-1, 3) for ends in (fibres.vertices[:, :-1], fibres.vertices[:, 1:]))
    fibre = np.repeat(np.arange(R), P)
    pairs = near_segments(start, end, fibres.reach[fibre], fibre)
    closest = np.empty((3, len(pairs)))
    over_ranges(lambda *those: _closest(start, end, pairs, closest, *those), len(pairs), _PAIRS)
    s, t, distance = closest
    a, b = fibre[pairs.T]
    x_a, x_b = pairs[:, 0] - a * P + s, pairs[:, 1] - b * P + t
    near = (distance < fibres.reach[a] + fibres.reach[b]) & (x_a >= fibres.skip[a]) & (x_b >= fibres.skip[b])
    return _Candidates(a[near], x_a[near], b[near], x_b[near], distance[near])


def _obstacle_candidates(fibres: _Fibres, body: Obstacle) -> _Candidates:
    R, P = fibres.vertices.shape[0], fibres.vertices.shape[1] - 1
    a, x = np.repeat(np.arange(R), P + 1), np.tile(np.arange(P + 1.0), R)
    start, end = (ends.reshape(-1, 3) for ends in (fibres.vertices[:, :-1], fibres.vertices[:, 1:]))
    if (inside := body.closest_on_segments(start, end)) is not None:
        a = np.concatenate((a, np.repeat(np.arange(R), P)))
        x = np.concatenate((x, np.tile(np.arange(P), R) + inside))
    distance, _ = body.signed_distance(_on_polylines(fibres.vertices, a, x)[0])
    near = (distance < fibres.reach[a]) & (x >= fibres.skip[a])
    a, x, distance = a[near], x[near], distance[near]
    return _Candidates(a, x, np.full_like(a, -1), np.zeros_like(x), distance)


@jit_lean
def _closest(start: Floats, end: Floats, pairs: Ints, closest: Floats, begin: int, stop: int) -> None:
    """Fill in the closest points of the pairs of segments begin..stop: s, t and distance, (3, k)."""
    for row in range(begin, stop):
        i, j = pairs[row, 0], pairs[row, 1]
        closest[0, row], closest[1, row], closest[2, row] = closest_on_segments(
            start[i], end[i], start[j], end[j]
        )


def _on_polylines(vertices: Floats, fibre: Ints, x: Floats) -> tuple[Floats, Floats]:
    """Points (m, 3) of fibres at positions x (m,), and the edges (m, 3) of the polylines there."""
    k = np.minimum(x.astype(np.int64), vertices.shape[1] - 2)
    edge = vertices[fibre, k + 1] - vertices[fibre, k]
    return vertices[fibre, k] + (x - k)[:, None] * edge, edge


def _common_perpendicular(a: Floats, b: Floats) -> Floats:
    """Unit vectors (m, 3) orthogonal to edges a and b (m, 3); any such vector where they are parallel."""
    a, b = _directions(a), _directions(b)
    across = np.cross(a, b)
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    beside = contact_frames(np.where(a.any(axis=1, keepdims=True), a, b))[:, 1]
    return np.where(sine > _TIE, across, beside)


def _directions(edge: Floats) -> Floats:
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    return edge / np.where(length > 0.0, length, 1.0)


def _one_touching(found: _Candidates, fibres: _Fibres) -> _Candidates:
    """Thin out candidates to one for one touching; ties in distance go by position."""
    a, x_a, b, x_b, distance = found
    pair = a * len(fibres.radius) + b
    rank = np.rint(distance / (_TIE * fibres.reach.max()))
    order = np.lexsort((x_b, x_a, rank, pair))
    active = fibres.reach[a] + np.where(b >= 0, fibres.reach[b], 0.0)
    y_a = x_a / (0.5 + 0.5 * active / fibres.segment[a])
    y_b = x_b / (0.5 + 0.5 * active / fibres.segment[b])
    kept = order[_keep(pair[order], y_a[order], y_b[order])]
    return _Candidates._make(column[kept] for column in found)


@jit
def _keep(pair: Ints, y_a: Floats, y_b: Floats) -> NDArray[np.bool_]:
    """Keep a candidate unless one kept before it, of the same pair, is in its window in both y.

    The kept ones of the pair are chained by bins of y_a: `latest` of each bin, and the one kept `before` it.
    """
    keep = np.zeros(len(pair), np.bool_)
    bins = (y_a / _WINDOW).astype(np.int64) + 1
    latest = np.full(bins.max() + 2 if len(pair) else 0, -1)
    before = np.empty(len(pair), np.int64)
    opened = 0
    for i in range(len(pair)):
        if pair[i] != pair[opened]:
            for of_pair in range(opened, i):
                latest[bins[of_pair]] = -1
            opened = i
        keep[i] = True
        for neighbour in range(bins[i] - 1, bins[i] + 2):
            j = latest[neighbour]
            while j >= 0 and keep[i]:
                keep[i] = abs(y_a[i] - y_a[j]) > _WINDOW or abs(y_b[i] - y_b[j]) > _WINDOW
                j = before[j]
        if keep[i]:
            before[i], latest[bins[i]] = latest[bins[i]], i
    return keep
