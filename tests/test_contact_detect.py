"""Closest points, detection and obstacles against slow oracles and closed forms."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from fibercontact.contact.broad_phase import near_segments
from fibercontact.contact.detect import detect
from fibercontact.contact.obstacles import Cylinder, Plane, Sphere
from fibercontact.contact.segments import closest_on_segments
from fibercontact.rods import CLOTHOID, HELIX, centreline, circular_rods, rest_state

# Oracles


def slow_closest(a0, a1, b0, b1):
    """(s, t, distance): the best of the critical point and the four edges of the unit square."""

    def foot(x, y0, y1):
        edge = y1 - y0
        return np.clip(edge @ (x - y0) / (edge @ edge), 0.0, 1.0) if edge.any() else 0.0

    u, v = a1 - a0, b1 - b0
    candidates = [(s, foot(a0 + s * u, b0, b1)) for s in (0.0, 1.0)]
    candidates += [(foot(b0 + t * v, a0, a1), t) for t in (0.0, 1.0)]
    s, t = np.linalg.lstsq(np.stack((u, -v), axis=1), b0 - a0, rcond=None)[0]
    if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
        candidates.append((s, t))
    distances = [np.linalg.norm(a0 + s * u - b0 - t * v) for s, t in candidates]
    best = int(np.argmin(distances))
    return *candidates[best], distances[best]


def slow_candidates(vertices, reach):
    """All pairs of segments of two fibres within reach: (a, b, x_a, x_b, distance)."""
    R, P = len(vertices), vertices.shape[1] - 1
    for a, b in itertools.combinations(range(R), 2):
        for k, l in itertools.product(range(P), repeat=2):  # noqa: E741
            A, B = vertices[a], vertices[b]
            s, t, distance = slow_closest(A[k], A[k + 1], B[l], B[l + 1])
            if distance < reach[a] + reach[b]:
                yield a, b, k + s, l + t, distance


def same_touching(p, q, segment, active):
    """Whether positions p and q, in segments, are within half a segment and half the activation distance.

    Near the limit the answer is None: rounding decides.
    """
    excess = np.max(np.abs(np.subtract(p, q)) - 0.5 - 0.5 * active / segment)
    return None if abs(excess) < 1e-5 else bool(excess < 0.0)


def point_on(vertices, segments):
    """Point at a position counted in segments."""
    k = min(int(segments), len(vertices) - 2)
    return vertices[k] + (segments - k) * (vertices[k + 1] - vertices[k])


# Assemblies


def random_fibres(seed, R=6, P=5, box=1.2):
    rng = np.random.default_rng(seed)
    edges = rng.standard_normal((R, 1, 3)) + 0.5 * rng.standard_normal((R, P, 3))
    edges /= np.linalg.norm(edges, axis=-1, keepdims=True)
    length = rng.uniform(0.5, 2.0, R)
    roots = rng.uniform(0.0, box, (R, 1, 3))
    steps = np.cumsum(edges * length[:, None, None] / P, axis=1)
    return np.concatenate((roots, roots + steps), axis=1), length, rng.uniform(0.02, 0.1, R)


def straight(starts, direction, length=1.0, P=4):
    direction = np.array(direction, float) / np.linalg.norm(direction)
    return np.array(starts, float)[:, None] + np.linspace(0.0, length, P + 1)[:, None] * direction


seeds = st.integers(0, 2**32 - 1)


# Closest points of two segments


def check_closest(a0, a1, b0, b1):
    s, t, distance = closest_on_segments(a0, a1, b0, b1)
    scale = max(np.abs([a0, a1, b0, b1]).max(), 1e-300)
    assert 0.0 <= s <= 1.0
    assert 0.0 <= t <= 1.0
    assert distance == pytest.approx(
        np.linalg.norm(a0 + s * (a1 - a0) - b0 - t * (b1 - b0)), abs=1e-14 * scale
    )
    assert distance == pytest.approx(slow_closest(a0, a1, b0, b1)[2], abs=1e-8 * scale)
    assert closest_on_segments(b0, b1, a0, a1)[2] == pytest.approx(distance, abs=1e-8 * scale)


# A coarse grid makes parallel, touching, collinear and zero-length segments common.
grid_points = st.lists(st.integers(-2, 2), min_size=12, max_size=12)
free_points = st.lists(st.floats(-1.0, 1.0).map(lambda x: round(x, 12)), min_size=12, max_size=12)


@given(grid_points | free_points)
@settings(deadline=None, max_examples=400)
def test_closest_points_are_the_best_of_the_unit_square(coordinates):
    check_closest(*np.array(coordinates, float).reshape(4, 3))


@given(seeds, st.floats(-16.0, -1.0))
@settings(deadline=None, max_examples=200)
def test_closest_points_of_nearly_parallel_segments(seed, exponent):
    rng = np.random.default_rng(seed)
    a0, a1, shift, tilt = rng.uniform(-1.0, 1.0, (4, 3))
    b0, b1 = a0 + shift, a0 + shift + rng.uniform(-2.0, 2.0) * (a1 - a0) + 10.0**exponent * tilt
    check_closest(a0, a1, b0, b1)


@given(seeds)
@settings(deadline=None)
def test_parallel_segments_meet_in_the_middle_of_their_overlap(seed):
    rng = np.random.default_rng(seed)
    axis, across = Rotation.random(random_state=seed).as_matrix()[:2]
    a, b = rng.uniform(-1.0, 1.0, (2, 2))
    ends = [x * axis for x in a] + [x * axis + 0.3 * across for x in b]
    low, high = max(a.min(), b.min()), min(a.max(), b.max())
    s, t, distance = closest_on_segments(*ends)
    on_a, on_b = a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])
    if low <= high:
        assert (on_a, on_b) == pytest.approx(((low + high) / 2, (low + high) / 2), abs=1e-9)
        assert distance == pytest.approx(0.3)
    else:
        assert abs(on_a - on_b) == pytest.approx(low - high, abs=1e-9)


# Broad phase


@given(seeds, st.sampled_from([1.0, 30.0]))
@settings(deadline=None, max_examples=25)
def test_broad_phase_finds_all_near_pairs_once_however_unequal_the_segments(seed, unequal):
    rng = np.random.default_rng(seed)
    n = 40
    start = rng.uniform(-1.0, 1.0, (n, 3))
    size = np.where(rng.random((n, 1)) < 0.1, unequal, 0.3)
    end = start + size * rng.standard_normal((n, 3)) * rng.integers(0, 2, (n, 3))
    reach = rng.uniform(0.0, 0.1, n) * np.where(rng.random(n) < 0.1, unequal, 1.0)
    fibre = np.sort(rng.integers(0, 12, n))
    found = [tuple(pair) for pair in near_segments(start, end, reach, fibre)]
    near = {
        (i, j)
        for i, j in itertools.combinations(range(n), 2)
        if fibre[i] != fibre[j]
        and closest_on_segments(start[i], end[i], start[j], end[j])[2] < reach[i] + reach[j] - 1e-9
    }
    assert len(found) == len(set(found))
    assert near <= set(found)
    assert all(i < j and fibre[i] != fibre[j] for i, j in found)


# The polyline of a centreline


def curled_rods(seed, basis, R=12, E=4):
    """Rods of random curvatures (rad/m) near one another; the largest curvature of each element's span."""
    rng = np.random.default_rng(seed)
    rods = circular_rods(
        length=rng.uniform(0.8, 1.2, R), radius=0.02, young=1e9, poisson=0.5, density=1e3, elements=E,
        basis=basis, curvature=rng.uniform(-8.0, 8.0, (R, E + (basis == CLOTHOID), 3)),
    )  # fmt: skip
    return rods, rest_state(
        rods, rng.uniform(0.0, 0.6, (R, 3)), Rotation.random(R, random_state=seed).as_matrix()
    )


def sagitta(rods, P):
    """Bound of the distance between a rod and its polyline: bending is at most that at a coefficient."""
    bending = np.linalg.norm(rods.q_rest[:, :, 1:], axis=2).max(axis=1)
    return bending * (rods.length / P) ** 2 / 8


@given(seeds, st.sampled_from([HELIX, CLOTHOID]), st.sampled_from([4, 5, 12]))
@settings(deadline=None, max_examples=25)
def test_a_polyline_is_within_its_sagitta_of_the_centreline(seed, basis, P):
    rods, state = curled_rods(seed, basis)
    fine, coarse = centreline(rods, state, 16 * P), centreline(rods, state, P)
    weight = np.arange(16)[:, None] / 16
    chords = coarse[:, :-1, None] * (1 - weight) + coarse[:, 1:, None] * weight
    error = np.linalg.norm(chords.reshape(len(fine), -1, 3) - fine[:, :-1], axis=2)
    assert (error.max(axis=1) <= (1 + 1e-9) * sagitta(rods, P)).all()


@pytest.mark.parametrize("P", [10, 40])
def test_an_arc_is_a_sagitta_away_from_its_chord(P):
    rods = circular_rods(
        length=1.0, radius=0.02, young=1e9, poisson=0.5, density=1e3, elements=1, curvature=[0.0, 3.0, 0.0]
    )
    vertices = centreline(rods, rest_state(rods), 2 * P)[0]
    error = np.linalg.norm(0.5 * (vertices[0] + vertices[2]) - vertices[1])
    assert error == pytest.approx(sagitta(rods, P)[0], rel=0.1 * (3.0 / P) ** 2)


@given(seeds, st.sampled_from([HELIX, CLOTHOID]))
@settings(deadline=None, max_examples=25)
def test_contacts_of_curled_rods_are_found_up_to_their_sagittas(seed, basis):
    """Against all pairs of points of the rods themselves: none missed that is near enough, none too far."""
    P, active = 12, 2 * 0.02 * 1.3
    rods, state = curled_rods(seed, basis)
    found = detect(centreline(rods, state, P), rods.length, rods.radius, margin=0.3)
    pairs = set(zip(found.fibre_a, found.fibre_b, strict=True))
    fine, bound = centreline(rods, state, 120), sagitta(rods, P)
    step = rods.length / 120
    for a, b in itertools.combinations(range(len(fine)), 2):
        nearest = np.sqrt(((fine[a][:, None] - fine[b][None]) ** 2).sum(axis=2).min())
        if nearest < active - bound[a] - bound[b]:
            assert (a, b) in pairs
        if (a, b) in pairs:
            assert nearest < active + bound[a] + bound[b] + 0.5 * (step[a] + step[b])


# Fibre–fibre contacts


@given(seeds, st.sampled_from([0.0, 0.5]))
@settings(deadline=None, max_examples=25)
def test_every_touching_has_one_contact(seed, margin):
    vertices, length, radius = random_fibres(seed)
    P = vertices.shape[1] - 1
    found = detect(vertices, length, radius, margin=margin)
    kept = {}
    for a, s_a, b, s_b in zip(found.fibre_a, found.s_a, found.fibre_b, found.s_b, strict=True):
        kept.setdefault((a, b), []).append((s_a / length[a] * P, s_b / length[b] * P))

    reach = radius * (1.0 + margin)
    touching = set()
    for a, b, x_a, x_b, _ in slow_candidates(vertices, reach):
        touching.add((a, b))
        segment, active = length[[a, b]] / P, reach[a] + reach[b]
        near = [same_touching((x_a, x_b), q, segment, active) for q in kept.get((a, b), [])]
        assert True in near or None in near
    assert touching == set(kept)
    for (a, b), positions in kept.items():
        for p, q in itertools.combinations(positions, 2):
            assert same_touching(p, q, length[[a, b]] / P, reach[a] + reach[b]) is not True


@given(seeds)
@settings(deadline=None, max_examples=25)
def test_geometry_of_contacts(seed):
    vertices, length, radius = random_fibres(seed)
    P = vertices.shape[1] - 1
    found = detect(vertices, length, radius, margin=0.3)
    assert (found.fibre_a < found.fibre_b).all()
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0)
    for a, s_a, b, s_b, _, normal, point, gap in zip(*found, strict=True):
        on_a, on_b = (point_on(vertices[i], s / length[i] * P) for i, s in ((a, s_a), (b, s_b)))
        distance = gap + radius[a] + radius[b]
        np.testing.assert_allclose(on_a - on_b, distance * normal, atol=1e-12)
        np.testing.assert_allclose(point, on_a - (radius[a] + gap / 2) * normal, atol=1e-12)
        np.testing.assert_allclose(point, on_b + (radius[b] + gap / 2) * normal, atol=1e-12)
        assert distance < 1.3 * (radius[a] + radius[b])
    order = list(zip(found.fibre_a, found.fibre_b, found.s_a, strict=True))
    assert order == sorted(order)


@given(seeds)
@settings(deadline=None, max_examples=25)
def test_contacts_move_with_the_fibres(seed):
    vertices, length, radius = random_fibres(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    shift = np.array([3.0, -1.0, 2.0])
    before = detect(vertices, length, radius, margin=0.3)
    after = detect(vertices @ turn.T + shift, length, radius, margin=0.3)
    for name in ("fibre_a", "fibre_b"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    for name in ("s_a", "s_b", "gap"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=1e-9)
    np.testing.assert_allclose(after.normal, before.normal @ turn.T, atol=1e-9)
    np.testing.assert_allclose(after.point, before.point @ turn.T + shift, atol=1e-9)


@given(seeds)
@settings(deadline=None, max_examples=25)
def test_numbering_of_fibres_does_not_matter(seed):
    vertices, length, radius = random_fibres(seed)
    new = np.random.default_rng(seed).permutation(len(vertices))
    plain = detect(vertices, length, radius, margin=0.3)
    permuted = detect(vertices[new], length[new], radius[new], margin=0.3)

    def rows(found, name_of):
        for a, s_a, b, s_b, _, normal, point, gap in zip(*found, strict=True):
            ends = (name_of[a], s_a, *normal), (name_of[b], s_b, *-normal)
            yield np.concatenate((*sorted(ends), point, [gap]))

    ours = np.array(sorted(map(tuple, rows(plain, np.arange(len(vertices))))))
    theirs = np.array(sorted(map(tuple, rows(permuted, new))))
    np.testing.assert_allclose(theirs, ours, atol=1e-9)


@pytest.mark.parametrize("offset", [0.0, 1e-4, 0.1, 0.25])
@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 1), (1, -2, 3)])
def test_parallel_fibres_have_one_contact_a_segment(direction, offset):
    P = 8
    along = np.array(direction) / np.linalg.norm(direction)
    across = np.cross(along, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(along, [0.0, 1.0, 0.0]))
    vertices = straight([[0, 0, 0], 0.015 * across + offset / P * along], direction, P=P)
    found = detect(vertices, np.ones(2), np.full(2, 0.01))
    assert P - 1 <= len(found.gap) <= P + 1
    np.testing.assert_allclose(np.diff(found.s_a), 1.0 / P, atol=0.5 / P)
    np.testing.assert_allclose(found.gap, -0.005, atol=1e-12)


def test_a_contact_at_shared_vertices_is_one_contact():
    cross = np.stack((straight([[-0.5, 0, 0]], [1, 0, 0])[0], straight([[0, -0.5, 0.01]], [0, 1, 0])[0]))
    found = detect(cross, np.ones(2), np.full(2, 0.01))
    assert [len(column) for column in found] == [1] * 8
    assert (found.s_a[0], found.s_b[0]) == pytest.approx((0.5, 0.5))
    np.testing.assert_allclose(found.normal[0], [0.0, 0.0, -1.0])


@pytest.mark.parametrize("direction", [(0, 1, 0), (1, 1, 0), (1, 0, 0), (1, 0, 1e-12)])
def test_crossing_centrelines_have_a_normal_orthogonal_to_both(direction):
    other = np.array(direction) / np.linalg.norm(direction)
    vertices = np.stack((straight([[-0.5, 0, 0]], [1, 0, 0])[0], straight([-0.5 * other], direction)[0]))
    found = detect(vertices, np.ones(2), np.full(2, 0.01))
    assert len(found.gap) >= 1
    np.testing.assert_allclose(found.gap, -0.02, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0)
    np.testing.assert_allclose(found.normal @ [1.0, 0.0, 0.0], 0.0, atol=1e-9)
    np.testing.assert_allclose(found.normal @ other, 0.0, atol=1e-9)


def test_skip_root_ignores_contacts_near_either_root():
    vertices, length, radius = random_fibres(3, R=12)
    every = detect(vertices, length, radius, obstacles=[Sphere([0.5, 0.5, 0.5], 0.6)])
    some = detect(vertices, length, radius, obstacles=[Sphere([0.5, 0.5, 0.5], 0.6)], skip_root=0.4)
    assert 0 < len(some.gap) < len(every.gap)
    assert (some.s_a >= 0.4).all()
    assert (some.s_b[some.fibre_b >= 0] >= 0.4).all()


def test_no_contacts():
    vertices = straight([[0, 0, 0], [1, 0, 0]], [0, 0, 1])
    for fibres in (vertices, vertices[:1]):
        R = len(fibres)
        found = detect(fibres, np.ones(R), np.full(R, 0.01), obstacles=[Plane([0, 0, -1], [0, 0, 1])])
        assert [column.shape for column in found] == [(0,)] * 5 + [(0, 3)] * 2 + [(0,)]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.full((2, 5, 3), np.nan)}, "vertices of fibre 0 are not finite"),
        ({"vertices": np.zeros((2, 5))}, "vertices must be"),
        ({"vertices": np.zeros((2, 1, 3))}, "vertices must be"),
        ({"vertices": np.zeros((0, 5, 3))}, "vertices must be"),
        ({"length": np.ones(3)}, "length must be"),
        ({"length": np.array([1.0, 0.0])}, "length must be positive"),
        ({"radius": np.array([1.0, np.nan])}, "radius must be positive"),
        ({"margin": -0.1}, "margin"),
        ({"skip_root": np.nan}, "skip_root"),
    ],
)
def test_bad_input_is_named(change, message):
    good = {
        "vertices": straight([[0, 0, 0], [1, 0, 0]], [0, 0, 1]),
        "length": np.ones(2),
        "radius": np.ones(2),
    }
    with pytest.raises(ValueError, match=message):
        detect(**(good | change))


# Obstacles

AXIS = np.array([1.0, 2.0, 2.0]) / 3.0
MOTION = {"velocity": [0.3, -0.2, 0.5], "angular_velocity": [0.7, 1.1, -0.4]}
OBSTACLES = {
    "plane": Plane([0.1, 0.2, 0.3], 2.0 * AXIS, **MOTION),
    "sphere": Sphere([0.1, 0.2, 0.3], 0.6, **MOTION),
    "cylinder": Cylinder([0.1, 0.2, 0.3], 3.0 * AXIS, 0.4, **MOTION),
    "capsule": Cylinder([0.1, 0.2, 0.3], AXIS, 0.4, 0.8, **MOTION),
}
every_obstacle = pytest.mark.parametrize("body", OBSTACLES.values(), ids=OBSTACLES)


def closed_form(body, x):
    """Signed distance by Pythagoras and cases."""
    along = (x - body.point) @ AXIS
    across = np.linalg.norm(np.cross(x - body.point, AXIS))
    if isinstance(body, Plane):
        return along
    if isinstance(body, Sphere):
        return np.hypot(along, across) - body.radius
    return np.hypot(max(abs(along) - body.length / 2, 0.0), across) - body.radius


def carried(body, points, dt):
    """Material points of the body after dt, by the exponential of the velocity."""
    x, y, z = body.angular_velocity * dt
    turn = expm(np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    return body.point + dt * body.velocity + (points - body.point) @ turn.T


@every_obstacle
def test_signed_distance_and_its_gradient(body):
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (40, 3))
    distance, normal = body.signed_distance(points)
    np.testing.assert_allclose(distance, [closed_form(body, x) for x in points], atol=1e-12)
    h = 1e-6
    gradient = [
        (body.signed_distance(points + h * e)[0] - body.signed_distance(points - h * e)[0]) / (2 * h)
        for e in np.eye(3)
    ]
    np.testing.assert_allclose(normal, np.transpose(gradient), atol=1e-7)


@every_obstacle
def test_motion_carries_the_surface_and_its_material_points(body):
    points = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 3))
    there = carried(body, points, 0.7)
    np.testing.assert_allclose(
        body.moved(0.7).signed_distance(there)[0], body.signed_distance(points)[0], atol=1e-12
    )
    h = 1e-5
    velocity = (carried(body, points, h) - carried(body, points, -h)) / (2 * h)
    np.testing.assert_allclose(body.velocity_at(points), velocity, atol=1e-8)


@pytest.mark.parametrize("body", [OBSTACLES["sphere"], OBSTACLES["cylinder"], OBSTACLES["capsule"]])
def test_normal_on_the_axis_is_a_unit_vector(body):
    distance, normal = body.signed_distance(body.point[None])
    assert distance[0] == pytest.approx(-body.radius)
    assert np.linalg.norm(normal[0]) == pytest.approx(1.0)
    if isinstance(body, Cylinder):
        assert normal[0] @ AXIS == pytest.approx(0.0, abs=1e-12)


@every_obstacle
@given(seed=seeds)
@settings(deadline=None, max_examples=10)
def test_obstacle_contacts_against_dense_sampling(body, seed):
    vertices, length, radius = random_fibres(seed, R=8)
    P = vertices.shape[1] - 1
    found = detect(vertices, length, radius, obstacles=[body], margin=0.2)
    with_body = found.obstacle == 0
    found = type(found)._make(column[with_body] for column in found)
    assert (found.fibre_b == -1).all()
    for a in range(len(vertices)):
        here = found.fibre_a == a
        x = found.s_a[here] / length[a] * P
        on_a = np.array([point_on(vertices[a], at) for at in x]).reshape(-1, 3)
        distance, normal = body.signed_distance(on_a)
        np.testing.assert_allclose(found.gap[here], distance - radius[a], atol=1e-12)
        np.testing.assert_allclose(found.normal[here], normal, atol=1e-9)
        surface = on_a - (radius[a] + found.gap[here] / 2)[:, None] * normal
        np.testing.assert_allclose(found.point[here], surface, atol=1e-12)
        segment, active = length[a] / P, 1.2 * radius[a]
        assert all(same_touching(p, q, segment, active) is not True for p, q in itertools.pairwise(x))
        samples = np.array([point_on(vertices[a], at) for at in np.linspace(0, P, 400)])
        nearest = body.signed_distance(samples)[0].min()
        if nearest < 1.2 * radius[a]:
            assert distance.min() <= nearest + 1e-12
        vertex_distance = body.signed_distance(vertices[a])[0]
        for k in np.flatnonzero(vertex_distance < 1.2 * radius[a]):
            assert any(same_touching(k, at, segment, active) is not False for at in x)


def test_a_rod_lying_on_a_plane_touches_with_every_vertex():
    vertices = straight([[0, 0, 0.009]], [1, 0, 0], P=6)
    found = detect(vertices, np.ones(1), np.full(1, 0.01), obstacles=[Plane([0, 0, 0], [0, 0, 1])])
    np.testing.assert_allclose(found.s_a, np.arange(7) / 6)
    np.testing.assert_allclose(found.gap, -0.001)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Plane([0, 0, 0], [0, 0, 0]), "normal must not be zero"),
        (lambda: Plane([0, 0], [0, 0, 1]), "point must be three"),
        (lambda: Sphere([0, 0, 0], 0.0), "radius must be positive and finite"),
        (lambda: Cylinder([0, 0, 0], [0, 0, 1], np.inf), "radius must be positive and finite"),
        (lambda: Sphere([0, 0, np.inf], 1.0), "point must be three"),
        (lambda: Cylinder([0, 0, 0], [0, 0, 1], 1.0, -1.0), "length must be positive"),
        (lambda: Sphere([0, 0, 0], 1.0, velocity=[np.nan, 0, 0]), "velocity must be three"),
    ],
)
def test_bad_obstacles_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
