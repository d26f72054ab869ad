"""What the experiments with rods rest on: their references, the discrete equilibria, what the tables claim."""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp, trapezoid

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

from rods import contact_scenes, discrete, references  # noqa: E402
from rods.cases import Case  # noqa: E402

from fibercontact.contact.obstacles import Plane  # noqa: E402
from fibercontact.rods import discrete_state  # noqa: E402
from fibercontact.rods.discrete_energy import elastic_law, law_energy  # noqa: E402
from fibercontact.rods.discrete_model import split  # noqa: E402
from fibercontact.simulation.step import simulate  # noqa: E402

RESULTS = ROOT / "results" / "rods"
MODELS = contact_scenes.MODELS


# References


@pytest.mark.parametrize(("mu", "phi"), [(0.0, 2.0), (0.3, np.pi), (0.7, 5.0)])
def test_the_heavy_string_on_a_drum_obeys_its_equation(mu, phi):
    hanging, weight = 3.0, 1.3

    def rate(beta, T):
        return mu * T + weight * (np.cos(beta) + mu * np.sin(beta))

    root = solve_ivp(rate, (0, phi), [hanging], rtol=1e-11, atol=1e-12).y[0, -1]
    ratio = references.string_on_a_drum(root, hanging, weight, mu, phi)
    assert ratio == pytest.approx(np.exp(mu * phi), rel=1e-9)


def test_the_force_on_the_sticking_tip_does_the_work_that_bends_the_rod():
    """Seen from the clamp, the tip goes forwards by d against T."""
    drags = np.linspace(0, 0.3, 31)
    shapes, forces = zip(*references.DraggedRod(np.radians(75), 0.2, 0.2).follow(drags), strict=True)
    energies = [trapezoid((shape[1] - 0.2) ** 2, dx=0.01) / 2 for shape in shapes]
    work = -trapezoid([T for T, _ in forces], drags)
    assert energies[-1] - energies[0] == pytest.approx(work, rel=1e-3)


# Equilibria of discrete rods


def bent(elements=6):
    model = discrete.DiscreteRod()
    rods = model._rods(elements, Case((1.0, 2.0, -1.0)))
    state = discrete_state(rods)
    turns = 0.2 * np.random.default_rng(0).normal(size=(elements - 1, 3))
    return rods, discrete._turned(rods, state, turns)


def test_turns_keep_the_lengths_and_the_clamp():
    _, state = bent()
    np.testing.assert_allclose(np.linalg.norm(np.diff(state.position[0], axis=0), axis=1), 1 / 6, rtol=1e-13)
    np.testing.assert_allclose(state.position[0, :2], [[0, 0, 0], [1 / 6, 0, 0]], atol=1e-15)


def test_slopes_of_the_energy_are_those_of_differences():
    rods, state = bent()
    law, gravity = elastic_law(rods), np.array([1.0, -2.0, 3.0])

    def energy(turns):
        moved = discrete._turned(rods, state, turns.reshape(-1, 3))
        mass = split(rods.inertia)[0][0]
        return law_energy(law, moved)[0] - np.sum(mass * (moved.position[0] @ gravity)[:, None]) / 3

    gradient, hessian = discrete._slopes(rods, law, state, gravity)
    D, h = len(gradient), 1e-4
    steps = h * np.eye(D)
    found = [(energy(s) - energy(-s)) / (2 * h) for s in steps]
    np.testing.assert_allclose(gradient, found, atol=1e-5 * abs(gradient).max())
    second = [
        [(energy(s + t) - energy(s - t) - energy(t - s) + energy(-s - t)) / (4 * h * h) for s in steps]
        for t in steps
    ]
    np.testing.assert_allclose(hessian, second, atol=2e-5 * abs(hessian).max())


# Contact


@pytest.mark.parametrize("model", MODELS)
def test_the_work_of_friction_is_that_of_the_force_on_the_way(model):
    """A rod pulled along a floor from rest by a force of 5 N/kg: friction mu m g, on the way of the steps."""
    rod = contact_scenes.Rod(
        length=0.1, radius=1e-3, bending=1e-4, line_density=3e-3, free=True, position=(0, 0, 1e-3)
    )
    rods, state = rod.build(model, 4)
    scene = contact_scenes.scene(
        rods, state, Plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), mu=0.3, dt=1e-3, steps=40,
        gravity=(5.0, 0.0, -9.81), segments=4, tolerance=1e-10,
    )  # fmt: skip
    normal, friction = np.sum(
        [contact_scenes.contact_work(step).sum(axis=0) for step in simulate(scene)], axis=0
    )
    way = sum(5.0 * (1 - 0.3 * 9.81 / 5.0) * k * 1e-3**2 for k in range(1, 41))
    assert friction == pytest.approx(-0.3 * 3e-4 * 9.81 * way, rel=2e-3)
    assert abs(normal) < 1e-3 * abs(friction)


# The tables


def read(name):
    return pd.read_csv(RESULTS / f"{name}.csv")


def test_every_quantity_is_there_for_every_model():
    table = read("table")
    assert (table.groupby("quantity").model.nunique() == len(MODELS)).all()


def test_the_document_shows_the_table():
    assert (RESULTS / "table.md").read_text() in (ROOT / "docs" / "rods.md").read_text()


def test_what_the_tables_claim():
    """The bounds that the models were to meet."""
    capstan, incline, energy = read("capstan"), read("incline"), read("energy")
    assert (capstan[capstan.elements == capstan.elements.max()].error < 0.02).all()
    assert (incline.degrees.abs() < 0.1).all()
    assert (energy.most_given_by_friction < 1e-8).all()
    assert (energy.largest_rise_in_a_step == 0).all()
