"""Frames, contact Jacobian and free velocity against finite differences of rigid straight rods."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from fibercontact.contact.assemble import assemble, obstacle_drift
from fibercontact.contact.detect import Contacts, detect
from fibercontact.contact.frame import contact_frames
from fibercontact.contact.obstacles import Plane, Sphere

DT, BETA, V_MAX = 0.01, 0.3, 0.5


def skew(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def sticks(seed, R=8, P=3):
    """Straight rods with 6 degrees of freedom each: vertices, lengths, radii."""
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal((R, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    roots = rng.uniform(0.0, 0.8, (R, 3))
    return (
        roots[:, None] + np.linspace(0.0, 1.0, P + 1)[:, None] * direction[:, None],
        np.ones(R),
        np.full(R, 0.05),
    )


def system(seed):
    """A random scene of rods and moving obstacles, and its contacts."""
    vertices, length, radius = sticks(seed)
    obstacles = [
        Plane([0, 0, 0.1], [0, 0.2, 1], velocity=[0.1, 0.2, 0.3], angular_velocity=[0.5, 0.2, 0.1]),
        Sphere([0.4, 0.4, 0.9], 0.4, velocity=[-0.2, 0.1, 0.4], angular_velocity=[0.1, -0.6, 0.2]),
    ]
    contacts = detect(vertices, length, radius, margin=0.2, obstacles=obstacles)
    return vertices, obstacles, contacts


def moved_point(root, x, motion, drift, h):
    """Where the material point x of a rigid rod is after h of (linear, angular) motion and of its drift."""
    return root + h * (motion[:3] + drift) + expm(h * skew(motion[3:])) @ (x - root)


def jacobians(contacts, fibre, vertices):
    """Point Jacobians (n, 3, 6) of rods that turn about their roots; zero for obstacles."""
    blocks = np.zeros((len(fibre), 3, 6))
    for block, a, x in zip(blocks, fibre, contacts.point, strict=True):
        if a >= 0:
            block[:] = np.hstack((np.eye(3), -skew(x - vertices[a, 0])))
    return blocks


@given(st.integers(0, 1000))
@settings(deadline=None, max_examples=6)
def test_u_is_the_relative_velocity_of_the_material_points_and_the_gap_term(seed):
    vertices, obstacles, contacts = system(seed)
    rng = np.random.default_rng(seed + 1)
    R, n = len(vertices), len(contacts.gap)
    motion, drift = rng.standard_normal((R, 6)), rng.standard_normal((R, 3))
    a, b = contacts.fibre_a, contacts.fibre_b
    drift_b = np.where(b[:, None] >= 0, drift[b], obstacle_drift(contacts, obstacles))
    built = assemble(
        contacts,
        jacobians(contacts, a, vertices),
        jacobians(contacts, b, vertices),
        drift[a],
        drift_b,
        dt=DT,
        rods=R,
        beta=BETA,
        v_max=V_MAX,
    )
    u = (built.H @ motion.ravel() + built.w).reshape(n, 3)
    h = 1e-5
    for i in range(n):
        x = contacts.point[i]

        def position(side, t, x=x, i=i):
            if side[i] >= 0:
                rod = side[i]
                return moved_point(vertices[rod, 0], x, motion[rod], drift[rod], t)
            body = obstacles[contacts.obstacle[i]]
            return body.point + t * body.velocity + expm(t * skew(body.angular_velocity)) @ (x - body.point)

        relative = [position(a, t) - position(b, t) for t in (h, -h)]
        expected = built.frames[i] @ (relative[0] - relative[1]) / (2 * h)
        gap = contacts.gap[i]
        expected[0] += gap / DT if gap >= 0.0 else max(BETA * gap / DT, -V_MAX)
        np.testing.assert_allclose(u[i], expected, atol=1e-7)


def test_csr_is_canonical_and_has_one_block_a_rod():
    vertices, _, contacts = system(0)
    R, n = len(vertices), len(contacts.gap)
    assert 0 < (contacts.fibre_b < 0).sum() < n
    blocks = np.random.default_rng(0).standard_normal((2, n, 3, 6))
    zero = np.zeros((n, 3))
    H = assemble(contacts, *blocks, zero, zero, dt=DT, rods=R).H
    assert H.shape == (3 * n, 6 * R)
    assert H.has_canonical_format
    for i in range(n):
        rods = [rod for rod in (contacts.fibre_a[i], contacts.fibre_b[i]) if rod >= 0]
        columns = np.concatenate([6 * rod + np.arange(6) for rod in rods])
        for row in range(3 * i, 3 * i + 3):
            np.testing.assert_array_equal(H.indices[H.indptr[row] : H.indptr[row + 1]], columns)


def single(gap):
    return Contacts(
        *map(np.array, ([0], [0.1], [1], [0.2], [-1])),
        normal=np.array([[0.0, 0.6, 0.8]]),
        point=np.zeros((1, 3)),
        gap=np.array([gap]),
    )


def test_a_contact_at_zero_normal_velocity_closes_its_gap_in_one_step():
    """With u_N = 0 the relative normal velocity is -gap / dt for open gaps, and recovery is limited."""
    J, zero = np.eye(3)[None], np.zeros((1, 3))
    for gap, after in ((0.002, 0.0), (0.0, 0.0), (-0.001, -0.0007), (-0.1, -0.095)):
        contacts = single(gap)
        H, w, _ = assemble(contacts, J, J, zero, zero, dt=DT, rods=2, beta=BETA, v_max=V_MAX)
        v, *_ = np.linalg.lstsq(H.toarray(), -w, rcond=None)
        approach = contacts.normal[0] @ (v[:3] - v[3:])
        assert gap + DT * approach == pytest.approx(after, abs=1e-12)


def test_no_contacts_make_an_empty_system():
    vertices, length, radius = sticks(0, R=1)
    contacts = detect(vertices, length, radius)
    empty, zero = np.zeros((0, 3, 6)), np.zeros((0, 3))
    H, w, frames = assemble(contacts, empty, empty, zero, zero, dt=DT, rods=1)
    assert (H.shape, w.shape, frames.shape) == ((0, 6), (0,), (0, 3, 3))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"jacobian_a": np.zeros((2, 3, 3))}, "jacobian_a must be"),
        ({"jacobian_b": np.zeros((1, 3, 4))}, "jacobian_b must be"),
        ({"drift_b": np.zeros((1, 2))}, "drift_b must be"),
        ({"dt": 0.0}, "dt > 0"),
        ({"v_max": np.nan}, "v_max"),
    ],
)
def test_bad_input_is_named(change, message):
    good = {name: np.zeros((1, 3, 3)) for name in ("jacobian_a", "jacobian_b")}
    good |= {name: np.zeros((1, 3)) for name in ("drift_a", "drift_b")} | {"dt": DT, "rods": 2}
    with pytest.raises(ValueError, match=message):
        assemble(single(0.0), **(good | change))


# Frames

directions = st.lists(st.floats(-1.0, 1.0) | st.sampled_from([0.0, -0.0, 1e-200]), min_size=3, max_size=3)


@given(directions.filter(lambda x: np.linalg.norm(x) > 1e-3))
@settings(deadline=None, max_examples=200)
def test_frames_are_right_handed_and_orthonormal(direction):
    normal = np.array(direction) / np.linalg.norm(direction)
    frame = contact_frames(normal[None])[0]
    np.testing.assert_array_equal(frame[0], normal)
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_frames_turn_continuously_on_each_hemisphere(z):
    normals = np.random.default_rng(0).standard_normal((200, 3))
    normals[:, 2] = z * np.abs(normals[:, 2])
    tilted = normals + 1e-7 * np.random.default_rng(1).standard_normal((200, 3)) * [1, 1, 0]
    unit = [x / np.linalg.norm(x, axis=1, keepdims=True) for x in (normals, tilted)]
    np.testing.assert_allclose(contact_frames(unit[0]), contact_frames(unit[1]), atol=1e-5)
