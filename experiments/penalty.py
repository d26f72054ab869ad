"""Explicit penalty contact against Coulomb's law: creep without a threshold, and the steps it needs.

Creep: a rod lies on a slope of 10 degrees below the friction angle and begins at rest. Coulomb's law holds it. The
plain penalty law, whose friction jumps with the sign of the velocity, creeps: the velocity is moved by
`u + dt (g sin − mu g cos sign u)`, a rotation of a circle, of mean `dt g sin`. With friction that grows in proportion
below a slip speed it creeps at `slip tan/mu`.

Steps: with velocities of the beginning of the step, springs k and dashpots nu on a resting rod lose energy while

    (dt² k + 2 dt nu) lambda_max(H_N M(dt/2)⁻¹ H_Nᵀ) < 4,

M(dt/2) being the matrix of an implicit step of half the size: an oscillation that changes sign at every step is then
damped. For a mass m on one spring this is dt < 2/sqrt(k/m). The largest step at which a rod comes to rest on a smooth
plane is found by bisection. Beyond it contacts first chatter; the motion blows up when rods gain energy. The largest
steps without that, kinetic, elastic and potential energy never above what there was at the start, are found for the
rod, and on a ladder of factors sqrt(2) for fibres that fall on a plane. Writes a figure and two tables.

    python experiments/penalty.py [--time 0.5] [--stiffness 30,100,300,…] [--fibres 24] [--out results/penalty]
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from fibercontact.bench.figures import COLOURS, save
from fibercontact.contact.obstacles import Plane
from fibercontact.rods import circular_rods, rest_state, still
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.penalty import Penalty, penalty_for
from fibercontact.simulation.scene import Body, Scene
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import SimulationError, World, simulate, start

RADIUS, LENGTH, DENSITY, YOUNG = 1e-3, 0.1, 1000.0, 1e8
THETA, MU, G = math.radians(10.0), 0.5, 9.81
SEGMENTS, CONTACTS = 6, 7
WEIGHT = DENSITY * math.pi * RADIUS**2 * LENGTH * G
COULOMB_DT = 2e-3  # of the rod on the slope
PLAIN_DTS, SLIP_SPEEDS, SLIP_DT = (2e-4, 5e-5), (2e-2, 2e-3), 1e-4
LADDER = 2 ** np.arange(0.5, -9, -0.5)  # steps of the falling fibres, in the scene's
FALL = 0.12  # s
COULOMB_SHARES = (1.0, 0.5, 0.25, 0.125)  # steps of the falling fibres under Coulomb's law, in the scene's


def on_slope(theta: float, overlap: float, dt: float, steps: int, mu: float = 0.0) -> Scene:
    """A free rod along a slope, pressed in by `overlap`, at rest."""
    turn = Rotation.from_rotvec([0.0, theta, 0.0]).as_matrix()
    rods = circular_rods(
        length=LENGTH, radius=RADIUS, young=YOUNG, poisson=0.3, density=DENSITY, elements=3, free=True
    )
    return Scene(
        name="slope",
        description="A rod on a slope.",
        rods=rods,
        state=rest_state(rods, turn @ [0.0, 0.0, RADIUS - overlap], turn),
        bodies=[Body(np.zeros(3), obstacles=[Plane(np.zeros(3), turn @ [0.0, 0.0, 1.0])])],
        carrier=np.zeros(1, dtype=np.int64),
        dt=dt,
        steps=steps,
        mu_fibres=0.0,
        mu_obstacles=mu,
        segments=SEGMENTS,
        tolerance=1e-10,
    )


# Creep


class Slide(NamedTuple):
    """A way to hold the rod on the slope, and the speed at which theory says that it creeps."""

    law: str
    dt: float
    penalty: Penalty | None
    theory: float


def slides() -> list[Slide]:
    like = penalty_for(on_slope(0.0, 0.0, 1.0, 1))
    sine, ratio = math.sin(THETA), math.tan(THETA) / MU
    plain = [Slide("penalty", dt, like, dt * G * sine) for dt in PLAIN_DTS]
    smooth = [
        Slide(f"slip speed {1e3 * slip:g} mm/s", SLIP_DT, replace(like, slip_speed=slip), slip * ratio)
        for slip in SLIP_SPEEDS
    ]
    return [Slide("Coulomb", COULOMB_DT, None, 0.0), *plain, *smooth]


def displacements(slide: Slide, time: float) -> np.ndarray:
    """Way down the slope (steps,) after each step, m."""
    share = WEIGHT * math.cos(THETA) / CONTACTS
    overlap = share / slide.penalty.stiffness if slide.penalty else 0.0
    scene = on_slope(THETA, overlap, slide.dt, round(time / slide.dt), MU)
    down = np.array([math.cos(THETA), 0.0, -math.sin(THETA)])
    ends = [step.world.state.root_position[0] for step in simulate(scene, penalty=slide.penalty)]
    return (np.array(ends) - scene.state.root_position) @ down


def creep(time: float) -> tuple[pd.DataFrame, list[np.ndarray]]:
    """Speeds of all slides, and their ways."""
    ways = [displacements(slide, time) for slide in slides()]
    rows = [
        {"law": s.law, "dt": s.dt, "time": time, "way": way[-1], "speed": way[-1] / time, "theory": s.theory}
        for s, way in zip(slides(), ways, strict=True)
    ]
    return pd.DataFrame(rows), ways


# Steps


def touching(scene: Scene) -> tuple[World, csr_array]:
    """The world before the last step of a scene under Coulomb's law, and H_N of its contacts that carry."""
    before, last = start(scene), None
    for step in simulate(scene):
        before, last = (last.world if last else before), step
    carries = (last.run.r[::3] > 0) | (last.contacts.gap < 0)
    return before, csr_array(last.problem.H[::3][carries])


def step_limit(scene: Scene, world: World, normal: csr_array, penalty: Penalty) -> float:
    """Largest stable step by theory."""
    rods, roots = rod_model(scene.rods), still(len(scene.rods.length))

    def excess(logarithm: float) -> float:
        dt = math.exp(logarithm)
        M = rods.begin(world.state, roots, scene.gravity(0.0), dt / 2).system.matrix()
        W = normal @ splu(M.tocsc()).solve(normal.T.toarray())
        return (dt**2 * penalty.stiffness + 2 * dt * penalty.damping) * np.linalg.eigvalsh(W)[-1] - 4

    return math.exp(brentq(excess, math.log(1e-8), math.log(1.0), xtol=1e-4))


def energy(scene: Scene, world: World) -> float:
    return float(sum(part.sum() for part in rod_model(scene.rods).energy(world.state, scene.gravity(0.0))))


def watched(scene: Scene, penalty: Penalty | None, stored: float = 0.0) -> tuple[bool, float]:
    """Whether a run never has more energy than its start and what was stored in springs; deepest overlap in radii."""
    most, overlap = energy(scene, start(scene)) + stored, 0.0
    try:
        with np.errstate(all="ignore"):
            for step in simulate(scene, penalty=penalty):
                overlap = max(overlap, -step.contacts.gap.min(initial=0.0) / scene.rods.radius[0])
                if not energy(scene, step.world) <= most:
                    return False, overlap
    except SimulationError:
        return False, overlap
    return True, overlap


def gains_no_energy(scene: Scene, penalty: Penalty, stored: float) -> bool:
    return watched(scene, penalty, stored)[0]


def comes_to_rest(scene: Scene, penalty: Penalty, stored: float) -> bool:
    """Whether the kinetic energy at the end of a run is nothing beside what was stored in springs."""
    try:
        with np.errstate(all="ignore"):
            *_, last = simulate(scene, penalty=penalty)
    except SimulationError:
        return False
    kinetic = rod_model(scene.rods).energy(last.world.state, scene.gravity(0.0)).kinetic.sum()
    return bool(kinetic < 1e-4 * stored)


def largest_step(
    holds: Callable[[Scene, Penalty, float], bool], penalty: Penalty, near: float, trial: int
) -> float:
    """Largest step that holds for the rod on a plane in so many steps, by bisection."""
    overlap = WEIGHT / CONTACTS / penalty.stiffness
    low, high = near / 2, near * 2
    while high / low > 1.02:
        middle = math.sqrt(low * high)
        scene = on_slope(0.0, overlap, middle, trial)
        low, high = (middle, high) if holds(scene, penalty, WEIGHT * overlap / 2) else (low, middle)
    return math.sqrt(low * high)


def rod_limits(stiffness: Sequence[float], trial: int) -> pd.DataFrame:
    rows = []
    for k in stiffness:
        scene = on_slope(0.0, WEIGHT / CONTACTS / k, COULOMB_DT, 1)
        penalty = penalty_for(scene, k)
        theory = step_limit(scene, *touching(scene), penalty)
        rest, gain = (
            largest_step(holds, penalty, theory, trial) for holds in (comes_to_rest, gains_no_energy)
        )
        rows.append({"scene": "rod", "stiffness": k, "theory": theory, "rest": rest, "no gain": gain})
    return pd.DataFrame(rows)


def falling(fibres: int, dt: float | None = None) -> Scene:
    """Fibres that fall on a plane, at the step of the scene or another."""
    scene = build(Parameters("plane", fibres, "straight", 0.5, 0.5, 7))
    dt = dt or scene.dt
    return replace(scene, dt=dt, steps=round(FALL / dt))


def largest_of_ladder(fibres: int, penalty: Penalty) -> tuple[float, float]:
    """The largest step of the ladder that gains no energy, and the deepest overlap with it in radii."""
    for dt in LADDER * falling(fibres).dt:
        passive, overlap = watched(falling(fibres, dt), penalty)
        if passive:
            return dt, overlap
    return math.nan, math.nan


def fall_limits(stiffness: Sequence[float], fibres: int) -> pd.DataFrame:
    rows = []
    for share in COULOMB_SHARES:
        dt = share * falling(fibres).dt
        passive, overlap = watched(falling(fibres, dt), None)
        if not passive:
            raise RuntimeError("Coulomb's law has gained energy")
        rows.append({"scene": "fibres, Coulomb", "no gain": dt, "overlap": overlap})
    scene = falling(fibres)
    touch = touching(scene)
    for k in stiffness:
        penalty = penalty_for(scene, k)
        dt, overlap = largest_of_ladder(fibres, penalty)
        theory = step_limit(scene, *touch, penalty)
        rows.append({"scene": "fibres", "stiffness": k, "theory": theory, "no gain": dt, "overlap": overlap})
    return pd.DataFrame(rows)


# The figure


def draw(table: pd.DataFrame, ways: Sequence[np.ndarray], limits: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(12.0, 3.9), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _draw_creep(left, table, ways)
    _draw_rod(middle, limits[limits.scene == "rod"])
    _draw_fibres(right, limits[limits.scene == "fibres"], limits[limits.scene == "fibres, Coulomb"])
    return figure


def _draw_creep(axes: Axes, table: pd.DataFrame, ways: Sequence[np.ndarray]) -> None:
    for k, (row, way) in enumerate(zip(table.itertuples(), ways, strict=True)):
        time = row.dt * np.arange(1, len(way) + 1)
        axes.loglog(
            time, np.abs(way), color=COLOURS[k], linewidth=1.4, label=f"{row.law}, dt {1e3 * row.dt:g} ms"
        )
        if row.theory:
            axes.loglog(time, row.theory * time, color=COLOURS[k], linestyle=":", linewidth=1)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("way down the slope (m)")
    axes.set_title("a slope of 10° that should hold (friction 26.6°)", fontsize=10)
    axes.grid(which="major", color="0.9")
    axes.set_ylim(1e-22, 1e-1)
    axes.legend(fontsize=7, loc="center right")


def _draw_rod(axes: Axes, rows: pd.DataFrame) -> None:
    axes.axhline(COULOMB_DT, color=COLOURS[0], linewidth=1.4, label="Coulomb, the step used")
    axes.loglog(rows.stiffness, rows.theory, color="0.5", linestyle=":", label="penalty, theory")
    axes.loglog(rows.stiffness, rows.rest, "s", color=COLOURS[4], label="penalty, comes to rest")
    axes.loglog(rows.stiffness, rows["no gain"], "o", color=COLOURS[5], label="penalty, gains no energy")
    axes.set_xlabel("stiffness (N/m)")
    _finish_steps(axes, "a rod at rest on a plane")


def _draw_fibres(axes: Axes, penalty: pd.DataFrame, coulomb: pd.DataFrame) -> None:
    axes.loglog(coulomb.overlap, coulomb["no gain"], "-D", color=COLOURS[0], label="Coulomb")
    axes.loglog(penalty.overlap, penalty["no gain"], "o", color=COLOURS[5], label="penalty, gains no energy")
    axes.loglog(penalty.overlap, penalty.theory, "_", color="0.5", label="penalty, theory")
    points = zip(penalty.stiffness, penalty[["overlap", "no gain"]].to_numpy(), cycle((-1, 1)))
    for k, at, side in points:
        style = {"textcoords": "offset points", "va": "center", "fontsize": 7}
        axes.annotate(f"{k:g} N/m", at, (7 * side, 0), ha="left" if side > 0 else "right", **style)
    axes.margins(x=0.2, y=0.1)
    axes.set_xlabel("deepest overlap (radii)")
    _finish_steps(axes, "fibres that fall on a plane")


def _finish_steps(axes: Axes, title: str) -> None:
    axes.set_ylabel("dt (s)")
    axes.set_title(title, fontsize=10)
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=7)


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--time", type=float, default=0.5, help="seconds of creep")
    parser.add_argument("--stiffness", default="30,100,300,1000,3000,10000", help="of contacts, N/m")
    parser.add_argument("--trial", type=int, default=600, help="steps in which a rod must stay where it is")
    parser.add_argument("--fibres", type=int, default=24, help="fibres that fall")
    parser.add_argument("--out", type=Path, default=Path("results/penalty"))
    given = parser.parse_args()
    table, ways = creep(given.time)
    write_table(table, given.out / "creep.csv")
    stiffness = [float(k) for k in given.stiffness.split(",")]
    limits = pd.concat(
        [rod_limits(stiffness, given.trial), fall_limits(stiffness, given.fibres)], ignore_index=True
    )
    write_table(limits, given.out / "steps.csv")
    save(draw(table, ways, limits), given.out, "penalty")


if __name__ == "__main__":
    main()
