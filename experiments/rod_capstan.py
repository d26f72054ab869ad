"""Tension of a soft rod that slips on a turning drum, against the capstan's law exp(mu phi), for every rod model.

A rod hangs from its clamped root round a drum of radius 1 (in its centreline), half a turn or a whole one, and its
other end hangs freely, 1.5 pi long. The drum turns and drags the rod along its whole arc towards the free end, so
that in the steady state the root's tension is the hanging part's times exp(mu phi), but for the weight of the arc,
which a closed formula takes away. It is measured as what the drum's forces and the weight leave to the root.

The stiffness is EI = 0.001 T R² (T of the hanging part, R the radius). A rod leaves the drum under an angle alpha,
EI/(2 R²) = T (1 − cos alpha); by the elastica that makes the ratio smaller by the share (1 + mu²)/2 EI/(T R²) at each
end, 0.15 % at most here. The friction of these models acts at the centreline. Writes a figure and a table.

    python experiments/rod_capstan.py [--meshes 8,16] [--cases 0.1:1,0.3:1,...] [--out results/rods]
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rods import references
from rods.contact_scenes import MODELS, Rod, contact_force, scene
from rods.tables import PALETTE, with_errors

from fibercontact.bench.figures import MARKERS, save
from fibercontact.contact.obstacles import Cylinder
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.scene import Motion, Scene
from fibercontact.simulation.step import Step, simulate

LEAD, HANGING = np.pi / 4, 1.5 * np.pi  # straight parts; the weight of a unit length is 1
RADIUS = 0.05  # of the rod
SPEED, DT, STEPS = 0.3, 0.05, 100
PER_ELEMENT = 2  # segments of contact detection, one contact each


class Wrap(NamedTuple):
    """A coefficient of friction and the number of half turns of the rod on the drum."""

    mu: float
    halves: int

    @property
    def phi(self) -> float:
        return self.halves * np.pi


class Steady(NamedTuple):
    """The steady state: angles on the drum, the ratios of tensions there, the rod's shape, its root's ratio."""

    beta: np.ndarray
    ratio: np.ndarray
    shape: np.ndarray
    root: float


def drum(model: str, mesh: int, wrap: Wrap) -> Scene:
    """The rod on the drum, with `mesh` elements on half a turn."""
    h, phi = np.pi / mesh, wrap.phi
    length = LEAD + phi + HANGING
    up = -np.cos(phi)  # of the lead's tangent, 1 or −1
    rod = Rod(
        length=length,
        radius=RADIUS,
        bending=1e-3 * HANGING,
        damping=30.0,
        position=(np.cos(phi), 0.0, -LEAD * up),
        angle=phi - np.pi / 2,
        turned=lambda s: -np.clip(s - LEAD, 0.0, phi),
    )
    rods, state = rod.build(model, round(mesh * length / np.pi))
    # What touches are the middles of the polyline's segments: of edges with their nodes on the circle, or of chords.
    within = h / 2 / np.tan(h / 2) if model == "Discrete rod" else np.cos(h / PER_ELEMENT / 2)
    return scene(
        rods,
        state,
        Cylinder(np.zeros(3), np.array([0.0, 1.0, 0.0]), within - RADIUS),
        mu=wrap.mu,
        dt=DT,
        steps=STEPS,
        gravity=(0.0, 0.0, -1.0),
        obstacle_motion=lambda time: Motion(np.zeros(3), np.array([0.0, SPEED, 0.0])),
        segments=PER_ELEMENT * round(mesh * length / np.pi),
        tolerance=1e-6,
        max_sweeps=5000,
    )


def steady(model: str, mesh: int, wrap: Wrap) -> Steady:
    of_scene = drum(model, mesh, wrap)
    *_, last = simulate(of_scene)
    length, up = LEAD + wrap.phi + HANGING, -np.cos(wrap.phi)
    pull = (length - contact_force(last, DT)[2]) * -up  # of the root, along the lead
    on_drum = pull + up * LEAD
    root = references.string_on_a_drum(on_drum, HANGING, 1.0, wrap.mu, wrap.phi)
    shape = rod_model(of_scene.rods).centreline(last.world.state, 200)[0]
    return Steady(*tensions(last, wrap), shape, root)


def tensions(step: Step, wrap: Wrap) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the contacts and the ratios of tensions there, from the forces on all that hangs below.

    The tension jumps at a contact: the geometric mean of its two sides is taken, at the contacts that bear the rod.
    (Two contacts of one element may share their load in any way.)
    """
    s, force = step.contacts.s_a, step.world.impulses / DT
    beta = LEAD + wrap.phi - s
    along = np.column_stack([np.sin(beta), 0 * beta, -np.cos(beta)])
    weight = np.outer(HANGING + beta, [0.0, 0.0, 1.0])
    before = np.cumsum(force[::-1], axis=0)[::-1] - weight
    sides = [np.sum(below * along, axis=1) for below in (before, before - force)]
    ratios = [
        [references.string_on_a_drum(T, HANGING, 1.0, wrap.mu, b) for T, b in zip(side, beta, strict=True)]
        for side in sides
    ]
    load = np.linalg.norm(force, axis=1)
    bearing = load > 0.5 * load.max() * np.exp(-wrap.mu * (wrap.phi - beta))
    return beta[bearing], np.sqrt(np.prod(ratios, axis=0))[bearing]


def measure(meshes: list[int], wraps: list[Wrap]) -> tuple[pd.DataFrame, dict[tuple[str, Wrap], Steady]]:
    """Ratios of every model: all wraps on the finest mesh, the second one on all."""
    rows, states = [], {}
    tabled = wraps[min(1, len(wraps) - 1)]
    for model in MODELS:
        for wrap in wraps:
            for mesh in meshes if wrap == tabled else meshes[-1:]:
                states[model, wrap] = steady(model, mesh, wrap)
                name = f"capstan, mu = {wrap.mu:g}, phi = {wrap.halves} pi"
                rows.append((name, model, mesh, states[model, wrap].root, np.exp(wrap.mu * wrap.phi)))
    return with_errors(rows), states


def draw(table: pd.DataFrame, states: dict[tuple[str, Wrap], Steady], wraps: list[Wrap], mesh: int) -> Figure:
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    shape, along, errors = figure.subplots(1, 3, width_ratios=[0.55, 1.1, 1])
    _draw_shape(shape, states["Super-Clothoid", wraps[0]])
    _draw_along(along, states, wraps)
    _draw_errors(errors, table[table.elements == mesh], wraps, mesh)
    return figure


def _draw_shape(axes: Axes, state: Steady) -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    axes.fill(np.cos(turn) * 0.95, np.sin(turn) * 0.95, color="0.9")
    axes.plot(state.shape[:, 0], state.shape[:, 2], color=PALETTE[1], linewidth=2)
    axes.plot(*state.shape[0, ::2], "s", color="0.3", markersize=6)
    arc = np.linspace(2.2, 0.9, 30)
    axes.plot(0.6 * np.cos(arc), 0.6 * np.sin(arc), color="0.4", linewidth=1)
    axes.annotate(
        "", 0.6 * np.array([np.cos(0.8), np.sin(0.8)]), 0.6 * np.array([np.cos(0.95), np.sin(0.95)]),
        arrowprops={"arrowstyle": "-|>", "color": "0.4"},
    )  # fmt: skip
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title("phi = pi", fontsize=10)


def _draw_along(axes: Axes, states: dict[tuple[str, Wrap], Steady], wraps: list[Wrap]) -> None:
    for j, wrap in enumerate(wraps):
        fine = np.linspace(0, wrap.phi, 2)
        axes.semilogy(
            fine / np.pi,
            np.exp(wrap.mu * fine),
            color="0.3",
            linewidth=1,
            label=None if j else "exp(mu beta)",
        )
        end = (wrap.phi / np.pi, np.exp(wrap.mu * wrap.phi))
        axes.annotate(f" {wrap.mu:g}", end, fontsize=8, color="0.3", va="center")
        for k, model in enumerate(MODELS):
            state, few = states[model, wrap], slice(k, None, 4)
            axes.plot(
                state.beta[few] / np.pi, state.ratio[few], MARKERS[k], color=PALETTE[k], markersize=4.5,
                label=None if j else model,
            )  # fmt: skip
    axes.set_xlim(-0.05, max(wrap.halves for wrap in wraps) + 0.2)
    axes.set_yticks([1, 2, 5, 10], ["1", "2", "5", "10"])
    axes.set_xlabel("angle beta from the hanging end, in pi")
    axes.set_ylabel("tension over that of the hanging end")
    axes.set_title("tension along the drum; mu at the lines", fontsize=10)
    axes.legend(fontsize=7.5, loc="upper left")


def _draw_errors(axes: Axes, table: pd.DataFrame, wraps: list[Wrap], mesh: int) -> None:
    axes.axhspan(-2, 2, color="0.94", zorder=0)
    axes.axhline(0, color="0.3", linewidth=1)
    for k, model in enumerate(MODELS):
        rows = table[table.model == model]
        size, face = (9, "none") if k == 0 else (5, PALETTE[k])
        axes.plot(
            np.log(rows.reference), 100 * (rows.value / rows.reference - 1), MARKERS[k], color=PALETTE[k],
            markersize=size, markerfacecolor=face, label=model,
        )  # fmt: skip
    axes.set_ylim(-2.6, 2.6)
    axes.set_xlabel("mu phi")
    axes.set_ylabel("error of the ratio, %")
    axes.set_title(f"whole wraps, {mesh} elements on half a turn", fontsize=10)
    axes.legend(fontsize=7.5, loc="upper left", ncols=2)


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--meshes", default="8,16", help="elements on half a turn; the finest is drawn")
    parser.add_argument("--cases", default="0.1:1,0.3:1,0.5:1,0.7:1,0.2:2,0.4:2", help="mu:half turns, …")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    meshes = [int(x) for x in given.meshes.split(",")]
    wraps = [
        Wrap(float(mu), int(halves)) for mu, halves in (case.split(":") for case in given.cases.split(","))
    ]
    table, states = measure(meshes, wraps)
    write_table(table, given.out / "capstan.csv", 6)
    save(draw(table, states, wraps, meshes[-1]), given.out, "capstan")


if __name__ == "__main__":
    main()
