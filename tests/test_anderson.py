"""Anderson acceleration by itself: on maps whose fixed points are known."""

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.gauss_seidel.anderson import LEAP, Acceleration, extrapolate, grow

TIKHONOV = Acceleration.tikhonov


def iterates(a_map, start, maps, scale=None, window=4):
    """The iterates after each map, accelerated; the residual never tells to drop the memory."""
    memory = Acceleration(window=window).memory(np.array(start, dtype=float), scale)
    for _ in range(maps):
        extrapolate(memory, np.asarray(a_map(memory.x), dtype=float), 1.0, TIKHONOV)
        yield memory.x.copy()


def maps_until(a_map, start, solved, maps=200, **how):
    for count, x in enumerate(iterates(a_map, start, maps, **how), start=1):
        if solved(x):
            return count
    return None


@given(seed=st.integers(0, 10**6))
def test_a_contraction_is_solved_in_as_many_maps_as_it_has_unknowns_and_two(seed):
    """As GMRES does: Walker and Ni 2011, theorem 2.2."""
    rng = np.random.default_rng(seed)
    A, fixed = oracles.definite(rng, 10.0, 4), rng.standard_normal(4)
    A *= 0.9 / np.linalg.norm(A, 2)
    *_, last = iterates(lambda x: fixed + A @ (x - fixed), np.zeros(4), 6)
    np.testing.assert_allclose(last, fixed, rtol=0, atol=1e-7 * np.abs(fixed).max())


@pytest.mark.parametrize("slope", [0.0, 1e-4])
@pytest.mark.parametrize("away", [1e2, 1e4])
def test_a_drift_is_left_in_a_number_of_maps_that_grows_like_the_logarithm_of_its_length(slope, away):
    """A step of 1, or nearly, until `away`; then a contraction. With the slope 1e-4 there is a repelling fixed point
    behind, which the least squares look for."""

    def drift(x):
        return x + np.where(x < away, 1.0 + slope * np.clip(x, -5e3, 5e3), 0.5 * (away + 3.0 - x))

    count = maps_until(drift, [0.0], lambda x: abs(x[0] - away - 3.0) < 1e-8)
    assert count is not None
    assert count <= 20 + 5 * np.log(away) / np.log(1.0 + LEAP)


def test_least_squares_that_oppose_the_map_are_not_followed():
    """`f` grows along the drift, so the secant's root lies behind."""
    x = list(iterates(lambda x: x + 1.0 + 1e-3 * x, [0.0], 8))
    assert np.all(np.diff([0.0, *(float(v[0]) for v in x)]) > 0.0)


def test_the_scale_decides_what_the_least_squares_weigh():
    """Two unknowns of which one map of memory can only serve one: the heavy one."""

    def contraction(x):
        return np.array([0.5, -0.3]) * x + 1.0

    for heavy in (0, 1):
        scale = np.where(np.arange(2) == heavy, 1e3, 1.0)
        *_, last = iterates(contraction, np.zeros(2), 4, scale=scale, window=1)
        assert abs(last - 1.0 / (1.0 - np.array([0.5, -0.3])))[heavy] < 1e-2


@given(seed=st.integers(0, 10**6))
def test_the_rounding_of_combined_velocities_stays_within_its_bound(seed):
    """Errors of one unit at most enter with each map, wherever they do most harm."""
    rng = np.random.default_rng(seed)
    memory = Acceleration(window=3).memory(np.zeros(1), velocities=1)
    error, image, rows = rng.uniform(-1, 1), 0.0, np.zeros(3)
    for k in range(12):
        error += rng.uniform(-1, 1)
        row, count = ((k - 1) % 3, min(k, 3)) if k > 0 else (-1, 0)
        if row >= 0:
            rows[row] = error - image
        image, gamma = error, rng.standard_normal(count)
        error = image - gamma @ rows[:count]
        assert abs(error) <= grow(memory, row, gamma)
