"""Where the energy of a rod goes that is thrown on a floor, for every rod model: friction takes, and never gives.

A bent free rod without damping falls slantwise on a level floor, hops and skids. After every step its energy and
what friction has taken, the sum of −r_T·u_T over all contacts, are added; what lacks from the energy of the beginning
has gone into inelastic impacts and the damping of the implicit step. Besides, a straight rod that slides to rest:
there friction must have taken the kinetic energy, up to the step's first-order error dt mu g/v. Writes a figure and
two tables.

    python experiments/rod_energy.py [--steps 600] [--out results/rods]
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.figure import Figure
from rods.contact_scenes import MODELS, Rod, contact_work, scene, total_energy
from rods.tables import with_errors

from fibercontact.bench.figures import COLOURS, save
from fibercontact.contact.obstacles import Plane
from fibercontact.rods import DiscreteState
from fibercontact.rods.discrete_model import join
from fibercontact.rods.interface import AnyState
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import simulate

GRAVITY, SPEED, MU = 9.81, 0.5, 0.3
STEEL_LIKE = {"length": 0.1, "radius": 1e-3, "bending": 1e-4, "line_density": 3e-3, "free": True}
UP = np.array([0.0, 0.0, 1.0])
DT, SLIDING_DT = 5e-4, (4e-3, 2e-3, 1e-3)


class Balance(NamedTuple):
    """Energies after each step, the beginning included, in shares of the first; works of each step's contacts."""

    time: np.ndarray
    energy: np.ndarray  # (k + 1, 3) kinetic, elastic, gravitational
    friction: np.ndarray  # (k + 1,) taken until then
    most_given: float  # largest work of friction at a contact in a step

    @property
    def total(self) -> np.ndarray:
        """Whole energy."""
        return self.energy.sum(axis=1)

    @property
    def rest(self) -> np.ndarray:
        """What impacts and the integrator have taken."""
        return 1 - self.total - self.friction


def moving(state: AnyState, velocity: np.ndarray) -> AnyState:
    """A free rod in translation."""
    v = np.zeros_like(state.v)
    v[:, :3] = velocity
    if isinstance(state, DiscreteState):
        v = join(np.broadcast_to(velocity, state.position.shape), np.zeros_like(state.theta))
    return state._replace(v=v)


def on_floor(rod: Rod, model: str, dt: float, steps: int) -> Scene:
    """A rod thrown forwards over a level floor."""
    rods, state = rod.build(model, 8)
    state = moving(state, np.array([SPEED, 0.0, 0.0]))
    return scene(
        rods, state, Plane(np.zeros(3), UP), mu=MU, dt=dt, steps=steps, gravity=(0.0, 0.0, -GRAVITY),
        segments=8, tolerance=1e-9,
    )  # fmt: skip


def balance(of_scene: Scene) -> Balance:
    energies, taken, most_given = [total_energy(of_scene, of_scene.state)], [0.0], 0.0
    for step in simulate(of_scene):
        work = contact_work(step)[:, 1]
        most_given = max(most_given, work.max(initial=0.0))
        taken.append(taken[-1] - work.sum())
        energies.append(total_energy(of_scene, step.world.state))
    whole = sum(energies[0])
    time = of_scene.dt * np.arange(len(taken))
    return Balance(time, np.array(energies) / whole, np.array(taken) / whole, most_given / whole)


def thrown(model: str, steps: int) -> Balance:
    rod = Rod(**STEEL_LIKE, rest_curvature=6.0, angle=-0.15, position=(0.0, 0.0, 0.02))
    return balance(on_floor(rod, model, DT, steps))


def sliding() -> pd.DataFrame:
    """What friction has taken of the kinetic energy of a rod that slides to rest, for smaller and smaller steps."""
    rows = []
    for model in MODELS:
        for dt in SLIDING_DT:
            rod = Rod(**STEEL_LIKE, position=(0.0, 0.0, STEEL_LIKE["radius"]))
            of_scene = on_floor(rod, model, dt, round(1.2 * SPEED / (MU * GRAVITY) / dt))
            kinetic = total_energy(of_scene, of_scene.state)[0]
            run = balance(of_scene)
            taken = run.friction[-1] * sum(total_energy(of_scene, of_scene.state)) / kinetic
            rows.append(("energy taken by friction, ½ m v²", model, round(1 / dt), taken, 1.0))
    return with_errors(rows).rename(columns={"elements": "steps_a_second"})


def summary(runs: dict[str, Balance]) -> pd.DataFrame:
    """Shares of the energy at the beginning."""
    return pd.DataFrame(
        {
            "model": model,
            "left": run.total[-1],
            "friction": run.friction[-1],
            "rest": run.rest[-1],
            "most_given_by_friction": run.most_given,
            "largest_rise_in_a_step": max(np.diff(run.total).max(), 0.0),
            "largest_rise_of_the_rest": max(-np.diff(run.rest).min(), 0.0),
        }
        for model, run in runs.items()
    )


def draw(runs: dict[str, Balance]) -> Figure:
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    names = ("kinetic", "elastic", "gravitational", "taken by friction", "impacts and integrator")
    colours = (COLOURS[4], COLOURS[2], COLOURS[3], COLOURS[5], "0.8")
    for axes, (model, run) in zip(figure.subplots(1, 3, sharey=True), runs.items(), strict=True):
        parts = [*run.energy.T, run.friction, run.rest]
        axes.stackplot(run.time, *parts, colors=colours, labels=names, linewidth=0)
        axes.plot(run.time, run.total, color="black", linewidth=0.9, label="energy of the rod")
        axes.set_title(model, fontsize=10)
        axes.set_xlabel("time (s)")
        axes.set_xlim(0, run.time[-1])
        axes.set_ylim(0, 1.0)
    figure.axes[0].set_ylabel("share of the energy at the beginning")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=8
    )
    return figure


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--steps", type=int, default=600, help="steps of the thrown rod")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    runs = {model: thrown(model, given.steps) for model in MODELS}
    for name, table in {"energy": summary(runs), "sliding": sliding()}.items():
        write_table(table, given.out / f"{name}.csv", 6)
    save(draw(runs), given.out, "energy")


if __name__ == "__main__":
    main()
