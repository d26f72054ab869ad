"""The algebra of the Lorentz cone from its definitions."""

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.gauss_seidel import lorentz

tangents = st.tuples(st.floats(-10, 10), st.floats(-10, 10))
points = st.tuples(st.floats(1e-3, 10), tangents).map(lambda p: (np.hypot(*p[1]) + p[0], *p[1]))
anything = st.tuples(st.floats(-10, 10), tangents).map(lambda p: (p[0], *p[1]))


def one(vector):
    return np.array([vector])


@given(points, points)
def test_the_scaling_takes_both_points_to_the_same_one(x, y):
    theta, inverse, point = (part[0] for part in lorentz.scaling(one(x), one(y)))
    np.testing.assert_allclose(theta @ inverse, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(theta, theta.T)
    np.testing.assert_allclose(theta @ x, inverse @ y, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(point, theta @ x)


@given(points, anything)
def test_the_quotient_undoes_the_jordan_product(x, y):
    z = oracles.arrow(np.array(x)) @ y
    np.testing.assert_allclose(lorentz.arrow(one(x))[0], oracles.arrow(np.array(x)))
    np.testing.assert_allclose(lorentz.quotient(one(z), one(x))[0], y, rtol=1e-5, atol=1e-5)


@given(points, points)
def test_the_eigenvalues_are_those_of_the_scaled_point_squared(x, y):
    z = lorentz.scaling(one(x), one(y)).point[0]
    expected = (z[0] - np.hypot(z[1], z[2])) ** 2, (z[0] + np.hypot(z[1], z[2])) ** 2
    np.testing.assert_allclose(lorentz.eigenvalues(one(x), one(y))[:, 0], expected, rtol=1e-5)


@given(points, st.floats(1e-6, 10))
def test_equal_eigenvalues_are_the_central_path(x, lam):
    y = lorentz.quotient(lam * one((1.0, 0.0, 0.0)), one(x))
    np.testing.assert_allclose(lorentz.eigenvalues(one(x), y)[:, 0], lam, rtol=1e-5)


@pytest.mark.parametrize(
    ("x", "expected"), [((1, 0.6, 0.7), True), ((1, 0.6, 0.8), False), ((-2, 0, 0), False)]
)
def test_inside_leaves_the_boundary_out(x, expected):
    assert lorentz.inside(np.array([(1.0, 0.0, 0.0), x])) is expected
