"""Anderson acceleration by itself: on maps whose fixed points are known."""

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.gauss_seidel.anderson import (
    LEAP,
    Acceleration,
    ago,
    combine,
    extrapolate,
    go_on,
    grow,
    newest,
)

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
    """Three unknowns of which two differences can only serve two: the heavy ones."""
    slopes = np.array([0.5, -0.3, 0.1])

    def contraction(x):
        return slopes * x + 1.0

    for light in range(3):
        scale = np.where(np.arange(3) == light, 1.0, 1e3)
        *_, last = iterates(contraction, np.zeros(3), 5, scale=scale, window=2)
        error = abs(last - 1.0 / (1.0 - slopes))
        assert np.delete(error, light).max() < 1e-2 * np.delete(1.0 / (1.0 - slopes), light).max()


def test_a_window_of_one_is_refused():
    with pytest.raises(ValueError, match="two at least"):
        Acceleration(window=1)


@given(seed=st.integers(0, 10**6), window=st.integers(2, 10))
def test_rows_are_combined_by_their_weights(seed, window):
    """In place of the oldest, whatever the number of rows; against the sum, row by row."""
    rng = np.random.default_rng(seed)
    memory = Acceleration(window=window).memory(np.zeros(5))
    for _ in range(rng.integers(0, 2 * window)):
        go_on(memory)
    memory.G[:] = rng.standard_normal(memory.G.shape)
    alpha = rng.standard_normal(window + 1)
    alpha[newest(memory)] += 1.0 - alpha.sum()
    before, place = memory.G.copy(), ago(memory, -1)
    combine(memory, memory.G, alpha, 1, 4)
    np.testing.assert_allclose(memory.G[place, 1:4], (alpha @ before)[1:4], rtol=0, atol=1e-13 * window)
    before[place, 1:4] = memory.G[place, 1:4]
    np.testing.assert_array_equal(memory.G, before)


@given(seed=st.integers(0, 10**6))
def test_the_rounding_of_combined_velocities_stays_within_its_bound(seed):
    """Errors of one unit at most enter with a product and with each map, wherever they do most harm."""
    rng = np.random.default_rng(seed)
    memory = Acceleration(window=3).memory(np.zeros(1), velocities=1)
    errors = np.zeros(4)
    errors[0] = rng.uniform(-1, 1)
    for _ in range(12):
        row = newest(memory)
        errors[row] += rng.uniform(-1, 1)
        alpha = rng.standard_normal(4) * (np.abs(errors) > 0)
        alpha[row] += 1.0 - alpha.sum()
        combined = alpha @ errors
        assert abs(combined) <= grow(memory, alpha)
        go_on(memory)
        errors[newest(memory)] = combined
