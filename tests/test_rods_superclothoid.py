"""Transport along a Super-Clothoid element against Fresnel's integrals, arcs of helix and the ODE of frames."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import fresnel

from fibercontact.rods import superclothoid, superhelix
from fibercontact.rods.superclothoid import MOST, STEP, TAIL, TERMS

LENGTH = 0.3
TURNS = [0.0, 1e-9, 1e-3, 0.1, 0.4, 1.0, 5.0]  # turns of 2 pi in the element


def transport(basis, coefficients, places, frame=None):
    """Frames and positions at the places, from the origin."""
    frames, positions = np.empty((len(places), 3, 3)), np.empty((len(places), 3))
    frame = np.eye(3) if frame is None else frame
    basis.transport(
        np.array(coefficients, dtype=float), LENGTH, places, frame, np.zeros(3), frames, positions
    )
    return frames, positions


def random_ends(turns, seed):
    """Curvatures at the ends of an element in random directions, the larger of `turns`."""
    ends = np.random.default_rng(seed).normal(size=(2, 3))
    return 2 * np.pi * turns / LENGTH * ends / np.linalg.norm(ends, axis=1).max()


def cornu(start, rate, s):
    """Angle and point at arc-length s of the plane curve of curvature `start + rate s`, by Fresnel's integrals."""
    scale, shift = np.sqrt(np.pi / abs(rate)), start / rate
    S, C = np.array(fresnel((s + shift) / scale)) - np.array(fresnel([shift / scale]))
    spiral = scale * (C + 1j * np.sign(rate) * S) * np.exp(-1j * start**2 / (2 * rate))
    return start * s + rate * s**2 / 2, spiral.real, spiral.imag


@pytest.mark.parametrize("angles", [(0, 1), (0.3, -2), (9, 11), (-20, 20), (0, 60)])
@pytest.mark.parametrize("direction", [1, 2])
def test_a_plane_element_is_a_piece_of_cornus_spiral(angles, direction):
    start, end = np.array(angles) / LENGTH
    ends = np.zeros((2, 3))
    ends[:, direction] = start, end
    places = np.linspace(0, 1, 5)
    frames, positions = transport(superclothoid, ends, places)
    angle, x, y = cornu(start, (end - start) / LENGTH, places * LENGTH)
    across = -1 if direction == 1 else 1  # a bend about n_1 goes to −n_2
    plane = np.column_stack([x, np.zeros(5), np.zeros(5)])
    plane[:, 3 - direction] = across * y
    np.testing.assert_allclose(positions, plane, rtol=0, atol=1e-14)
    np.testing.assert_allclose(frames[:, 0, 0], np.cos(angle), rtol=0, atol=1e-13)
    np.testing.assert_allclose(frames[:, 3 - direction, 0], across * np.sin(angle), rtol=0, atol=1e-13)


@pytest.mark.parametrize("turns", TURNS)
def test_equal_ends_make_an_arc_of_helix(turns):
    kappa, places = random_ends(turns, 1)[0], np.linspace(0, 1, 4)
    frame = Rotation.random(random_state=2).as_matrix()
    clothoid = transport(superclothoid, [kappa, kappa], places, frame)
    helix = transport(superhelix, [kappa], places, frame)
    for ours, closed in zip(clothoid, helix, strict=True):
        np.testing.assert_allclose(ours, closed, rtol=0, atol=1e-14)


@pytest.mark.parametrize("turns", TURNS)
@pytest.mark.parametrize("seed", range(3))
def test_transport_solves_the_ode_of_frames(turns, seed):
    ends = random_ends(turns, seed)

    def rates(s, y):
        tau, kappa1, kappa2 = ends[0] + s / LENGTH * (ends[1] - ends[0])
        F, skew = y[3:].reshape(3, 3), [[0, -kappa2, kappa1], [kappa2, 0, -tau], [-kappa1, tau, 0]]
        return np.concatenate([F[:, 0], (F @ skew).ravel()])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    path = solve_ivp(rates, (0, LENGTH), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    frames, positions = transport(superclothoid, ends, np.array([0.4, 1.0]))
    np.testing.assert_allclose(positions[-1], path[:3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(frames[-1].ravel(), path[3:], rtol=0, atol=2e-12)


@given(st.floats(0, 10), st.integers(0, 10**6), st.integers(1, 40))
def test_steps_of_any_size_lead_to_the_same_place(turns, seed, steps):
    """Short steps need few terms and cancel nothing: they bound the error of long ones."""
    ends = random_ends(turns, seed)
    places = np.sort(np.random.default_rng(seed).uniform(size=steps))
    long, short = (transport(superclothoid, ends, np.append(x, 1.0)) for x in ([], places))
    for one, many in zip(long, short, strict=True):
        np.testing.assert_allclose(one[-1], many[-1], rtol=0, atol=1e-13)
    F = long[0][-1]
    np.testing.assert_allclose(F.T @ F, np.eye(3), rtol=0, atol=1e-13)


def test_the_table_of_terms_is_long_enough():
    """The majorant of the worst part falls below TAIL, twice in a row, before the table ends."""
    m, before = 1.0, 0.0
    for n in range(TERMS):
        m, before = (STEP * m + 2 * STEP * before) / (n + 1), m
    assert max(m, before) <= TAIL


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.1 * MOST / LENGTH])
@pytest.mark.parametrize("end", [0, 1])
def test_absurd_curvatures_give_nan(bad, end):
    ends = np.ones((2, 3))
    ends[end, 1] = bad
    with np.errstate(invalid="ignore"):
        frames, positions = transport(superclothoid, ends, np.array([1.0]))
    assert np.all(np.isnan(frames))
    assert np.all(np.isnan(positions))


def test_the_start_may_be_kept_at_the_end_of_the_outputs():
    ends, places = random_ends(0.5, 3), np.array([0.3, 1.0])
    expected = transport(superclothoid, ends, places)
    frames, positions = np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 3))
    superclothoid.transport(ends, LENGTH, places, frames[1], positions[1], frames, positions)
    np.testing.assert_array_equal(frames, expected[0])
    np.testing.assert_array_equal(positions, expected[1])
