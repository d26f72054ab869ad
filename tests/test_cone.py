"""The cones, their projections and the residuals of one contact, against convex analysis and slow oracles."""

import numpy as np
import oracles
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fibercontact.problem.cone import (
    change_of_variable,
    fischer_burmeister,
    natural_map,
    norm,
    project,
    project_cone,
    project_pyramid,
)

FACETS = [0, *range(3, 17)]
LAWS = st.sampled_from(FACETS)
FRICTION = st.one_of(st.just(0.0), st.floats(1e-3, 10), st.sampled_from([1.0, 1e-6, 1e3]))
COMPONENT = st.one_of(st.just(0.0), st.floats(-1, 1, allow_subnormal=False).filter(lambda x: abs(x) > 1e-9))


@st.composite
def vectors(draw, largest=1e100):
    """A vector of any size, zero components among them."""
    size = draw(st.sampled_from([1.0, 1e-6, 1e6, 1 / largest, largest]))
    return tuple(size * draw(COMPONENT) for _ in range(3))


def jordan():
    """Vectors whose fourth powers are floating-point numbers."""
    return vectors(largest=1e60)


def slack(*xs):
    """Rounding's size for these vectors."""
    return 1e-13 * max(np.abs(x).max() for x in xs)


@given(vectors(), FRICTION, LAWS)
def test_projection_is_that_of_non_negative_least_squares(x, mu, facets):
    np.testing.assert_allclose(
        project(x, mu, facets), oracles.project(x, mu, facets), rtol=0, atol=100 * slack(x)
    )


@given(vectors(), FRICTION, LAWS)
def test_projection_obeys_the_optimality_conditions(x, mu, facets):
    """`p ∈ K`, `x - p` in the polar cone of K, `(x - p)·p = 0`: necessary and sufficient."""
    p = np.array(project(x, mu, facets))
    rest, tiny = np.array(x) - p, 10 * slack(x) * (1 + mu)
    if facets:
        edges = oracles.generators(mu, facets, x)
        apothem = mu * np.cos(np.pi / facets) * p[0]
        angles = np.pi * (2 * np.arange(facets) + 1) / facets
        assert np.all(np.cos(angles) * p[1] + np.sin(angles) * p[2] <= apothem + tiny)
        assert np.all(edges @ rest <= tiny)
    else:
        assert np.hypot(p[1], p[2]) <= mu * p[0] + tiny
        assert mu * np.hypot(rest[1], rest[2]) <= -rest[0] + tiny
    assert p[0] >= 0
    assert abs(rest @ p) <= tiny * max(np.abs(x))


@given(vectors(), FRICTION, LAWS)
def test_projection_is_idempotent(x, mu, facets):
    p = project(x, mu, facets)
    np.testing.assert_allclose(project(p, mu, facets), p, rtol=0, atol=10 * slack(p))


@given(vectors(), vectors(), FRICTION, LAWS)
def test_projection_is_firmly_nonexpansive(x, y, mu, facets):
    moved = np.subtract(project(x, mu, facets), project(y, mu, facets))
    given_move = np.subtract(x, y)
    scale = max(np.abs(x).max(), np.abs(y).max())
    assert moved @ moved <= moved @ given_move + 100 * slack(x, y) * scale


@given(vectors(), FRICTION, st.floats(1e-6, 1e6), LAWS)
def test_projection_is_positively_homogeneous(x, mu, t, facets):
    scaled = project(tuple(t * c for c in x), mu, facets)
    np.testing.assert_allclose(scaled, t * np.array(project(x, mu, facets)), rtol=0, atol=10 * t * slack(x))


@given(vectors(), st.floats(1e-3, 10))
def test_moreau_decomposition_over_the_dual_cone(x, mu):
    """`x = P_K(x) - P_{K*}(-x)` with `K_mu* = K_{1/mu}`."""
    dual = project_cone(tuple(-c for c in x), 1 / mu)
    np.testing.assert_allclose(np.subtract(project_cone(x, mu), dual), x, rtol=0, atol=10 * slack(x))


@given(vectors(), FRICTION, st.floats(0, 2 * np.pi), st.integers(3, 16))
def test_projection_turns_with_the_tangents(x, mu, angle, facets):
    for m, by in ((0, angle), (facets, 2 * np.pi / facets)):
        Q = oracles.turned(by)
        turned = project(tuple(Q @ x), mu, m)
        np.testing.assert_allclose(turned, Q @ project(x, mu, m), rtol=0, atol=100 * slack(x))


@pytest.mark.parametrize("facets", FACETS)
@pytest.mark.parametrize("x_N", [-2.0, -0.0, 0.0, 3.0])
@pytest.mark.parametrize("x_T", [(0.0, 0.0), (-0.0, 0.0), (1.0, 0.0), (-1.0, -2.0)])
def test_without_friction_the_cone_is_the_normal_half_line(facets, x_N, x_T):
    assert project((x_N, *x_T), 0.0, facets) == (max(x_N, 0.0), 0.0, 0.0)


@given(vectors(), st.floats(1e-3, 10))
def test_pyramid_tends_to_the_cone_as_its_facets_grow(x, mu):
    """The inscribed polygon misses the disc by at most `1 - cos(pi/m)` of its radius."""
    exact = np.array(project_cone(x, mu))
    for facets in (8, 64, 512):
        gap = np.linalg.norm(np.subtract(project_pyramid(x, mu, facets), exact))
        assert gap <= 1.5 * (1 - np.cos(np.pi / facets)) ** 0.5 * norm(x) + slack(x)


@pytest.mark.parametrize("facets", range(3, 17))
def test_pyramid_leaves_its_edges_and_facets_where_they_are(facets):
    vertices = oracles.generators(0.7, facets, (1, 0, 0))
    middles = 0.5 * (vertices + np.roll(vertices, 1, axis=0))
    for x in np.vstack([vertices, middles]):
        np.testing.assert_allclose(project_pyramid(tuple(x), 0.7, facets), x, atol=1e-15)


@given(vectors(), FRICTION, LAWS)
def test_change_of_variable_adds_the_support_function(u, mu, facets):
    expected = u[0] + mu * oracles.support(-np.array(u[1:]), facets)
    changed = change_of_variable(u, mu, facets)
    assert changed[0] == pytest.approx(expected, rel=1e-12, abs=10 * slack(u) * (1 + mu))
    assert changed[1:] == u[1:]


@given(vectors(), FRICTION, LAWS)
def test_changed_velocity_closes_the_power_of_friction(u, mu, facets):
    """The least power `ũ·r` over the impulses of the law with `r_N = 1` is `u_N`: friction dissipates the most."""
    changed = np.array(change_of_variable(u, mu, facets))
    angles = np.linspace(0, 2 * np.pi, (facets or 3600) + 1)
    powers = changed[0] + mu * (np.cos(angles) * u[1] + np.sin(angles) * u[2])
    assert powers.min() == pytest.approx(
        u[0], abs=(2e-6 if not facets else 1e-12) * (1 + mu) * max(np.abs(u))
    )


def directions(facets):
    """(impulse direction, sliding direction) pairs allowed in slip: normals of disc or polygon at a point of it."""
    if not facets:
        return [((np.cos(a), np.sin(a)), (-np.cos(a), -np.sin(a))) for a in np.linspace(0, 6, 7)]
    half, pairs = np.pi / facets, []

    def unit(angle):
        return np.array([np.cos(angle), np.sin(angle)])

    for vertex in 2 * half * np.arange(facets):
        off = half * np.array([-0.9, 0.0, 0.5])  # any direction of the vertex's normal cone
        pairs += [(unit(vertex), -unit(vertex + angle)) for angle in off]
        ends = unit(vertex), unit(vertex + 2 * half)  # anywhere on a facet, along its normal
        pairs += [(s * ends[0] + (1 - s) * ends[1], -unit(vertex + half)) for s in (0.25, 0.5)]
    return pairs


def lawful(mu, facets):
    """Exact solutions of a law: open, grazing, stick, stick on the edge of the cone, slip."""
    yield (0.3, 0.4, -0.2), (0.0, 0.0, 0.0)
    yield (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    yield (0.0, 0.3, 0.1), (0.0, 0.0, 0.0)  # sliding without a force
    yield (0.0, 0.0, 0.0), (1.7, 0.0, 0.0)
    yield (0.0, 0.0, 0.0), (1.7, 0.3 * mu, -0.4 * mu)
    for way, against in directions(facets):
        r = (1.7, 1.7 * mu * way[0], 1.7 * mu * way[1])
        yield (0.0, 0.0, 0.0), r
        yield (0.0, 0.6 * against[0], 0.6 * against[1]), r


@pytest.mark.parametrize("facets", [0, 3, 4, 5, 8, 16])
@pytest.mark.parametrize("mu", [0.0, 1e-3, 0.5, 1.0, 10.0])
@pytest.mark.parametrize("sigma", [1e-3, 1.0, 50.0])
def test_natural_map_vanishes_on_solutions(facets, mu, sigma):
    for u, r in lawful(mu, facets):
        size = norm(natural_map(u, r, mu, sigma, facets))
        assert size <= 1e-14 * (1 + sigma * (1 + mu)), (u, r)


UNLAWFUL = {
    "penetration": ((-0.1, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "penetration under load": ((-0.1, 0.0, 0.0), (1.0, 0.0, 0.0)),
    "impulse of an open contact": ((0.1, 0.0, 0.0), (1.0, 0.0, 0.0)),
    "adhesion": ((0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)),
    "impulse outside the cone": ((0.0, 0.0, 0.0), (1.0, 0.8, 0.0)),
    "slip inside the cone": ((0.0, -0.3, 0.0), (1.0, 0.2, 0.0)),
    "friction that pushes": ((0.0, 0.3, 0.0), (1.0, 0.5, 0.0)),
    "friction across": ((0.0, 0.0, -0.3), (1.0, 0.5, 0.0)),
    "friction without a load": ((0.0, -0.3, 0.0), (0.0, 0.1, 0.0)),
    "take-off of a slipping contact": ((0.1, -0.3, 0.0), (1.0, 0.5, 0.0)),
}


@pytest.mark.parametrize("facets", [0, 4, 8, 16])
@pytest.mark.parametrize("case", UNLAWFUL)
@pytest.mark.parametrize("sigma", [0.1, 1.0, 10.0])
def test_natural_map_sees_every_way_to_break_the_law(facets, case, sigma):
    u, r = UNLAWFUL[case]
    assert norm(natural_map(u, r, 0.5, sigma, facets)) > 1e-3


@pytest.mark.parametrize("facets", [0, 4, 8])
@pytest.mark.parametrize("size", [1e6, 1e16, 1e30, 1e150])
def test_natural_map_sees_a_velocity_under_an_impulse_of_any_size(facets, size):
    """Where `sigma r - ũ` is `sigma r` to the last bit: inside the cone and on its surface."""
    for r in ((size, 0.0, 0.0), (size, 0.3 * size, 0.0), (size, 0.5 * size, 0.0)):
        assert norm(natural_map((-1.0, 0.0, 0.0), r, 0.5, 1.0, facets)) >= 1.0


@given(vectors(), vectors(), FRICTION, st.floats(1e-3, 1e3), LAWS)
def test_natural_map_is_the_oracle_s(u, r, mu, sigma, facets):
    expected = oracles.natural_map(u, r, mu, sigma, facets)
    size = max(np.abs(u).max() * (1 + mu), sigma * np.abs(r).max())
    np.testing.assert_allclose(natural_map(u, r, mu, sigma, facets), expected, rtol=0, atol=1e-10 * size)


@given(jordan(), jordan())
def test_fischer_burmeister_is_the_oracle_s(x, y):
    """The smaller spectral value of the root is known to sqrt(eps) only."""
    size = max(np.abs(x).max(), np.abs(y).max())
    np.testing.assert_allclose(
        fischer_burmeister(x, y), oracles.fischer_burmeister(x, y), rtol=0, atol=1e-7 * size
    )


@given(jordan(), jordan())
def test_fischer_burmeister_takes_the_root_that_lies_in_the_cone(x, y):
    z = np.array(x) + np.array(y) - np.array(fischer_burmeister(x, y))
    size = max(np.abs(x).max(), np.abs(y).max())
    squares = oracles.arrow(np.array(x)) @ x + oracles.arrow(np.array(y)) @ y
    assert np.hypot(z[1], z[2]) <= z[0] + 1e-14 * size
    np.testing.assert_allclose(oracles.arrow(z) @ z, squares, rtol=0, atol=1e-13 * size**2)


@given(st.floats(0, 2 * np.pi), st.floats(1e-3, 1e3), st.floats(1e-3, 1e3), st.floats(0, 0.99), st.booleans())
def test_fischer_burmeister_vanishes_on_complementary_pairs(angle, p, q, inner, swap):
    """Pairs of the Lorentz cone with `x∘y = 0`: opposite boundary rays, or one of them zero."""
    d = np.array([np.cos(angle), np.sin(angle)])
    for x, y in (
        (np.array([p, *(p * d)]), np.array([q, *(-q * d)])),
        (np.array([p, *(inner * p * d)]), np.zeros(3)),
    ):
        pair = (tuple(y), tuple(x)) if swap else (tuple(x), tuple(y))
        assert norm(fischer_burmeister(*pair)) <= 1e-12 * max(p, q)


@given(jordan(), jordan())
def test_fischer_burmeister_sees_pairs_that_are_not_complementary(x, y):
    """Up to a constant it measures as the natural map `x - P_K(x - y)` does."""
    natural = norm(tuple(np.subtract(x, project_cone(tuple(np.subtract(x, y)), 1.0))))
    size = max(np.abs(x).max(), np.abs(y).max())
    assume(natural > 1e-6 * size)
    assert norm(fischer_burmeister(x, y)) >= 0.2 * natural


@given(jordan(), jordan(), st.floats(0, 2 * np.pi))
def test_fischer_burmeister_is_symmetric_and_turns_with_the_tangents(x, y, angle):
    Q, f = oracles.turned(angle), np.array(fischer_burmeister(x, y))
    size = max(np.abs(x).max(), np.abs(y).max())
    np.testing.assert_allclose(fischer_burmeister(y, x), f, rtol=0, atol=1e-7 * size)
    turned = fischer_burmeister(tuple(Q @ x), tuple(Q @ y))
    np.testing.assert_allclose(turned, Q @ f, rtol=0, atol=1e-7 * size)
