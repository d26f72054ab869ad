"""Stick and slip of a clamped rod that is pressed on a floor and dragged along it, for every rod model.

A weightless rod of natural curvature 0.2/L, clamped 75° below the horizontal so that its tip touches the floor, is
pushed down by 0.2 L and then pulled back. The tip sticks, and slips when the floor's force reaches the cone: after a
distance that depends on mu alone. The reference is the plane elastica whose tip is a hinge, a boundary-value
problem. What follows is a snap: the rod lets go of its energy. Two things are measured: T/N when the clamp has
stopped at 0.3 L, and the distance at which the tip slips when the clamp goes on, in about 25 periods of the rod.
Times are in units of sqrt(rho S L⁴/EI). Writes a figure and a table.

    python experiments/rod_stick_slip.py [--elements 8,16,32] [--mus 0.2,0.3,0.4,0.5] [--dt 0.02] [--out results/rods]
"""

from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rods import references
from rods.contact_scenes import MODELS, Rod, contact_force, scene, tip
from rods.tables import PALETTE, with_errors

from fibercontact.bench.figures import MARKERS, save
from fibercontact.contact.obstacles import Plane
from fibercontact.rods import DiscreteState
from fibercontact.rods.interface import AnyState, rod_model
from fibercontact.simulation.scene import Motion, Scene
from fibercontact.simulation.step import simulate

DIP, BEND, DEPTH, DRAG, STOP = np.radians(75.0), 0.2, 0.2, 0.4, 0.3
TIMES = (5.0, 10.0)  # of pressing, of dragging
HOLD = 5.0  # until all is at rest
GONE = 0.02  # slip at which a run is over
UP = np.array([0.0, 0.0, 1.0])
REFERENCE = references.DraggedRod(DIP, BEND, DEPTH)


class Drag(NamedTuple):
    """Way of the clamp, forces on the tip and its slip, step by step; shapes of the rod at three moments."""

    way: np.ndarray
    T: np.ndarray
    N: np.ndarray
    slip: np.ndarray
    shapes: list[np.ndarray]  # natural, pressed, before it slips

    def onset(self, mu: float) -> float:
        """Distance at which T/N reaches mu."""
        ratio = self.T / np.where(self.N > 0, self.N, np.inf)
        until = np.argmax(ratio > (1 - 1e-5) * mu)
        if self.slip[-1] < GONE or until < 2:
            raise RuntimeError(f"the tip has not slipped at mu = {mu}")
        before = slice(until - 2, until)  # the last steps of sticking, continued
        return float(np.polynomial.Polynomial.fit(ratio[before], self.way[before], 1)(mu))


def pressed_rod(
    model: str, elements: int, mu: float, way: float, hold: float, dt: float, damping: float
) -> Scene:
    """The rod with its tip on the floor, at the very point where the model has it; the clamp moves, then rests."""
    rod = Rod(rest_curvature=-BEND, angle=-DIP, damping=damping)
    rods, state = rod.build(model, elements)
    low = rod_model(rods).centreline(state, 8)[0, -1, 2] - rod.radius

    def clamp(time: float) -> Motion:
        """Down, then back, each with a smooth beginning and end."""
        if time < TIMES[0] * (1 + 1e-9):
            return Motion(smooth(DEPTH, TIMES[0], time) * np.array([0.0, 0.0, -1.0]), np.zeros(3))
        return Motion(smooth(way, TIMES[1], time - TIMES[0]) * np.array([-1.0, 0.0, 0.0]), np.zeros(3))

    steps = round((sum(TIMES) + hold) / dt)
    floor = Plane(low * UP, UP)
    return scene(rods, state, floor, mu=mu, dt=dt, steps=steps, clamp=clamp, segments=8, tolerance=1e-8)


def smooth(way: float, duration: float, time: float) -> float:
    """Speed of what goes a way in a time."""
    return way / duration * (1 - np.cos(2 * np.pi * time / duration)) if time < duration * (1 + 1e-9) else 0.0


def forces_at_rest(model: str, elements: int, dt: float) -> float:
    """T/N after the clamp has stopped."""
    of_scene = pressed_rod(model, elements, 1.0, STOP, HOLD, dt, damping=0.05)
    *_, last = simulate(of_scene)
    force = contact_force(last, dt)
    return float(-force[0] / force[2])


def drag(model: str, elements: int, mu: float, dt: float) -> Drag:
    """Run until the tip has slipped."""
    of_scene = pressed_rod(model, elements, mu, DRAG, 0.0, dt, damping=0.01)
    start, pressed = tip(of_scene, of_scene.state)[0, 0], round(TIMES[0] / dt)

    def shape(state: AnyState) -> np.ndarray:
        return rod_model(of_scene.rods).centreline(state, 40)[0]

    rows, shapes, last, sticking = [], [shape(of_scene.state)], of_scene.state, of_scene.state
    for step in simulate(of_scene):
        state, force = step.world.state, contact_force(step, dt)
        slip = abs(tip(of_scene, state)[0, 0] - start)
        # A linearly implicit step balances forces where it begins, an implicit one where it ends.
        balanced = state if isinstance(state, DiscreteState) else last
        rows.append((-balanced.root_position[0, 0], -force[0], force[2], slip))
        if step.index == pressed:
            shapes.append(shape(state))
        if slip > GONE:
            break
        last, sticking = state, state if slip < GONE / 100 else sticking
    return Drag(*np.array(rows)[pressed:].T, [*shapes, shape(sticking)])


def measure(
    meshes: list[int], mus: list[float], dt: float
) -> tuple[pd.DataFrame, dict[tuple[str, float], Drag]]:
    """T/N at rest of every model on all meshes, and the onsets on the middle one."""
    T, N = REFERENCE.forces(STOP)
    rest = [
        (
            f"T/N of the sticking tip, d = {STOP:g} L",
            model,
            elements,
            forces_at_rest(model, elements, dt),
            T / N,
        )
        for model, elements in product(MODELS, meshes)
    ]
    middle = meshes[len(meshes) // 2]
    runs = {(model, mu): drag(model, middle, mu, dt) for model, mu in product(MODELS, mus)}
    exact = dict(zip(mus, REFERENCE.onset(np.array(mus)), strict=True))
    onsets = [
        (f"onset of slip d/L, mu = {mu:g}", model, middle, run.onset(mu), exact[mu])
        for (model, mu), run in runs.items()
    ]
    return with_errors(rest + onsets), runs


def draw(table: pd.DataFrame, runs: dict[tuple[str, float], Drag], elements: int) -> Figure:
    figure = Figure(figsize=(10.0, 3.5), layout="constrained")
    shapes, forces, onsets = figure.subplots(1, 3, width_ratios=[0.85, 1.1, 1])
    mus = sorted({mu for _, mu in runs})
    _draw_shapes(shapes, runs["Super-Clothoid", mus[-1]], mus[-1])
    _draw_forces(forces, runs, mus)
    _draw_onsets(onsets, table, elements)
    return figure


def _draw_shapes(axes: Axes, run: Drag, mu: float) -> None:
    names = ("touching", "pushed down", f"about to slip, mu = {mu:g}")
    floor = run.shapes[0][-1, 2] - 2e-3
    axes.fill_between([-0.6, 0.6], floor, floor - 0.08, color="0.9")
    for points, name, shade in zip(run.shapes, names, ("0.65", "0.4", PALETTE[1]), strict=True):
        axes.plot(points[:, 0], points[:, 2], color=shade, linewidth=2, label=name)
        axes.plot(*points[0, ::2], "s", color=shade, markersize=6)
    axes.set_aspect("equal")
    axes.set_xlim(-0.55, 0.6)
    axes.set_ylim(floor - 0.08, 0.32)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.legend(fontsize=7.5, loc="upper center", frameon=False)
    axes.set_title("the rod", fontsize=10)


def _draw_forces(axes: Axes, runs: dict[tuple[str, float], Drag], mus: list[float]) -> None:
    d = np.linspace(0, 0.38, 39)
    T, N = REFERENCE.forces(d).T
    axes.plot(d, T / N, color="0.3", linewidth=1.2, label="elastica with a hinge (solve_bvp)")
    for k, model in enumerate(MODELS):
        run = runs[model, mus[-1]]
        sticking = np.flatnonzero(run.slip < GONE / 100)
        # Models at different places, or they would hide each other.
        points = sticking[
            np.searchsorted(run.way[sticking], np.arange(0.01 + 0.01 * k, run.way[sticking[-1]], 0.03))
        ]
        axes.plot(
            run.way[points], run.T[points] / run.N[points], MARKERS[k], color=PALETTE[k], markersize=5, label=model
        )  # fmt: skip
    for mu in mus:
        axes.axhline(mu, color="0.8", linewidth=0.8, zorder=0)
        axes.annotate(f"mu = {mu:g}", (0.0, mu), fontsize=7.5, color="0.4", va="bottom")
    axes.set_xlabel("distance dragged d/L")
    axes.set_ylabel("T/N at the tip")
    axes.set_title("the tip sticks until T/N = mu", fontsize=10)
    axes.legend(fontsize=7.5, loc="lower right")


def _draw_onsets(axes: Axes, table: pd.DataFrame, elements: int) -> None:
    fine = np.linspace(0.1, 0.6, 51)
    axes.plot(fine, REFERENCE.onset(fine), color="0.3", linewidth=1.2)
    for k, model in enumerate(MODELS):
        onsets = table[table.quantity.str.startswith("onset") & (table.elements == elements)]
        rows = onsets[onsets.model == model]
        mus = [float(name.split("=")[1]) for name in rows.quantity]
        size, face = (9, "none") if k == 0 else (5, PALETTE[k])
        axes.plot(
            mus, rows.value, MARKERS[k], color=PALETTE[k], markersize=size, markerfacecolor=face, label=model
        )
    axes.set_xlabel("friction coefficient mu")
    axes.set_ylabel("distance at which the tip slips, d/L")
    axes.set_title(f"onset of slip, {elements} elements", fontsize=10)
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=7.5, loc="upper left")


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--elements", default="8,16,32", help="meshes of the table; the middle one is drawn")
    parser.add_argument("--mus", default="0.2,0.3,0.4,0.5", help="coefficients of friction")
    parser.add_argument("--dt", type=float, default=0.02, help="time step")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    meshes = [int(x) for x in given.elements.split(",")]
    table, runs = measure(meshes, [float(x) for x in given.mus.split(",")], given.dt)
    write_table(table, given.out / "stick_slip.csv", 6)
    save(draw(table, runs, meshes[len(meshes) // 2]), given.out, "stick_slip")


if __name__ == "__main__":
    main()
