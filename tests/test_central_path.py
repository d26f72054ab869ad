"""The central path: Newton's equations and the tangent by finite differences, and turns that must be followed."""

from itertools import islice

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csc_array

from fibercontact.gauss_seidel import central_path as method
from fibercontact.gauss_seidel import interior_point as interior_point_module
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.central_path import Point, walk
from fibercontact.gauss_seidel.interior_point import _in_cones, interior_point
from fibercontact.gauss_seidel.lorentz import arrow, inside, tangential, times

TURNING = [(4, 8, 1.0), (117, 8, 1.0), (27, 6, 2.0), (119, 6, 2.0)]
"""Seed, contacts and mu of three rods of 6 dofs, on which the path turns."""


def problem(seed, contacts=8, mu=1.0, dofs=6):
    return oracles.strands(seed, rods=3, dofs=dofs, contacts=contacts, mu=mu).condense()


def equations(given):
    return _in_cones(block_system(given), given.b_ref)[0]


def some_point(n, seed=2, lam=0.3):
    rng = np.random.default_rng(seed)
    x, y = (np.abs(rng.standard_normal((n, 3))) + np.array([3, 0, 0]) for _ in range(2))
    return Point(x, y, lam)


def shift(eq):
    """The d of the path, from the definition of its start."""
    e = np.tile([1.0, 0.0, 0.0], (len(eq.c), 1))
    return e - (eq.A @ e.ravel()).reshape(e.shape) - eq.c


def defect(eq, p):
    """What the first equation of the path lacks at a point."""
    slip = np.zeros_like(p.y)
    slip[:, 0] = np.hypot(p.y[:, 1], p.y[:, 2])
    return (eq.A @ p.x.ravel()).reshape(p.x.shape) + eq.c + p.lam * shift(eq) + (1 - p.lam) * slip - p.y


def after(p, change, h):
    return Point(p.x + h * change.x, p.y + h * change.y, p.lam * (1 + h * change.lam))


def chart(eq, p):
    return method._chart(eq, method._layout(eq), shift(eq), p)


def test_newtons_step_cancels_the_linearised_equations():
    eq = equations(problem(1))
    p = some_point(len(eq.c))
    newton = method._newton(eq, method._layout(eq), p)
    target = np.random.default_rng(3).standard_normal(p.x.shape)
    step = Point(*method._solve(newton, defect(eq, p), target), 0.0)
    h = 1e-6
    change = (defect(eq, after(p, step, h)) - defect(eq, after(p, step, -h))) / (2 * h)
    np.testing.assert_allclose(defect(eq, p) + change, 0, atol=1e-7)
    scaled = times(newton.scale.theta, step.x) + times(newton.scale.inverse, step.y)
    np.testing.assert_allclose(times(arrow(newton.scale.point), scaled), target, atol=1e-9)


def on_the_path(eq, p):
    """The point of the path that corrections from p lead to."""
    for _ in range(12):
        found = chart(eq, p)
        if found.distance < 1e-16:
            return found
        p = method._moved(p, found.back)
    raise AssertionError("not reached")


def test_the_tangent_is_tangent():
    """Along it the first equation and `x∘y = lam e` hold to first order, at points where they hold."""
    eq = equations(problem(1))
    for p in islice(walk(eq), 4):
        found, h = on_the_path(eq, p), 1e-6
        p, ahead = found.at, found.ahead
        np.testing.assert_allclose(defect(eq, p), 0, atol=1e-8)
        change = (defect(eq, after(p, ahead, h)) - defect(eq, after(p, ahead, -h))) / (2 * h)
        np.testing.assert_allclose(change, 0, atol=1e-6)
        products = times(arrow(p.x), ahead.y) + times(arrow(p.y), ahead.x)
        products[:, 0] -= p.lam * ahead.lam
        np.testing.assert_allclose(products, 0, atol=1e-4 * p.lam)


def test_corrections_are_orthogonal_to_the_tangent():
    eq = equations(problem(1))
    found = chart(eq, some_point(len(eq.c)))
    local = [method._local(found.at, found.scale, p) for p in (found.ahead, found.back, found.ahead_bend)]
    for other in local[1:]:
        assert abs(np.sum(local[0] * other)) < 1e-9 * np.linalg.norm(local[0]) * np.linalg.norm(other)


def test_the_bend_makes_a_change_obey_the_equation_to_third_order():
    eq = equations(problem(1))
    p = some_point(len(eq.c))
    newton, ahead = method._newton(eq, method._layout(eq), p), chart(eq, p).ahead

    def lacks(h, bends):
        change = method._scaled(h, ahead)
        change = method._plus(change, bends, method._bend(newton, change))
        return np.linalg.norm(defect(eq, after(p, change, 1.0)) - defect(eq, p))

    first, second = (lacks(0.1, bends) / lacks(0.05, bends) for bends in (0.0, 1.0))
    assert first == pytest.approx(4.0, rel=0.2)
    assert second > 6.5


@given(st.integers(0, 10**6), st.integers(1, 7))
def test_the_orientation_is_the_sign_of_the_determinant(seed, size):
    matrix = np.random.default_rng(seed).standard_normal((size, size))
    sparse = csc_array(matrix)
    sign = np.linalg.slogdet(matrix)[0]
    for order in ("NATURAL", "MMD_AT_PLUS_A"):
        factor = method._factor(sparse.data, sparse.indices, sparse.indptr, order)
        assert method._orientation(factor) == sign


@pytest.mark.parametrize("mu", [0.0, 0.3, 2.0])
def test_the_walk_starts_at_e_and_ends_where_the_equations_hold_inside_the_cones(mu):
    eq = equations(problem(3, mu=mu))
    for k, p in enumerate(islice(walk(eq), 60)):
        assert inside(p.x)
        assert inside(p.y)
        assert 0.0 < p.lam <= 1.0
        if k == 0:
            assert p.lam == 1.0
            np.testing.assert_array_equal(p.x, p.y)
            assert np.all(tangential(p.x) == 0.0)
        if p.lam < 1e-10:
            break
    assert p.lam < 1e-10
    np.testing.assert_allclose(defect(eq, p), 0, atol=1e-8)


@pytest.mark.parametrize(("seed", "contacts", "mu"), TURNING)
def test_a_path_that_turns_is_followed_to_a_solution(seed, contacts, mu, monkeypatch):
    """And a method that only lets lam fall does not get there, which is what the orientation is for."""
    given = problem(seed, contacts, mu)
    signs, orientation = [], method._orientation
    monkeypatch.setattr(method, "_orientation", lambda f: signs.append(orientation(f)) or signs[-1])
    run = interior_point(block_system(given), given.b_ref, 1e-7 * given.b_ref)
    assert run.residual <= 1e-7 * given.b_ref
    assert run.iterations < 150
    assert {-1.0, 1.0} == set(signs)
    monkeypatch.setattr(method, "_orientation", lambda f: 1.0)
    monkeypatch.setattr(interior_point_module, "STARTS", (1.0,))
    falling = interior_point(block_system(given), given.b_ref, 1e-7 * given.b_ref, max_iterations=150)
    assert falling.residual > 1e-4 * given.b_ref
