"""The angle at which a rod slides down an incline, against atan(mu), for every rod model.

A free straight rod lies on a plane, along the slope or across it, at rest. It sticks if tan(theta) ≤ mu; else it
slides with the acceleration g (sin theta − mu cos theta). The threshold is sought by bisection between 1.3° below and
0.9° above it: the rod slides when after 0.1 s it is faster than 1e-5 g t (what an excess of 0.0006° gives). Writes
a figure and a table.

    python experiments/rod_incline.py [--mus 0.1,0.3,0.5,1] [--resolution 0.005] [--out results/rods]
"""

from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.figure import Figure
from rods.contact_scenes import MODELS, Rod, in_plane, scene
from rods.tables import PALETTE, with_errors

from fibercontact.bench.figures import MARKERS, save
from fibercontact.contact.obstacles import Plane
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import simulate

GRAVITY, DT, STEPS, ELEMENTS = 9.81, 5e-3, 20, 4
RADIUS, LENGTH = 1e-3, 0.1
LAID = ("along", "across")


def incline(model: str, degrees: float, mu: float, laid: str) -> Scene:
    """A rod at rest on a slope that rises along x; across it, the rod lies along y."""
    theta = np.radians(degrees)
    normal = in_plane(theta)[:, 1]
    along = in_plane(theta)
    rod = Rod(
        length=LENGTH, radius=RADIUS, bending=1e-4, line_density=3e-3, free=True, position=RADIUS * normal
    )
    frame = along if laid == "along" else np.column_stack([-along[:, 2], along[:, 1], along[:, 0]])
    rods, state = rod.build(model, ELEMENTS, frame)
    return scene(
        rods, state, Plane(np.zeros(3), normal), mu=mu, dt=DT, steps=STEPS, gravity=(0.0, 0.0, -GRAVITY),
        segments=ELEMENTS, tolerance=1e-9,
    )  # fmt: skip


def speed(model: str, degrees: float, mu: float, laid: str) -> float:
    """Speed of the rod's middle after the run, in g t."""
    of_scene = incline(model, degrees, mu, laid)
    *before, last = (step.world for step in simulate(of_scene))
    middle = [rod_model(of_scene.rods).centreline(world.state, 2)[0] for world in (before[-1], last)]
    return float(np.linalg.norm(np.mean(middle[1] - middle[0], axis=0)) / DT / (GRAVITY * last.time))


def threshold(model: str, mu: float, laid: str, resolution: float) -> float:
    """Angle in degrees at which the rod begins to slide."""
    low, high = np.degrees(np.arctan(mu)) + np.array([-1.3, 0.9])
    while high - low > resolution:
        middle = (low + high) / 2
        low, high = (low, middle) if speed(model, middle, mu, laid) > 1e-5 else (middle, high)
    return (low + high) / 2


def measure(mus: list[float], resolution: float) -> pd.DataFrame:
    rows = []
    for model, mu, laid in product(MODELS, mus, LAID):
        found = threshold(model, mu, laid, resolution)
        rows.append((f"incline, mu = {mu:g}, {laid} it", model, ELEMENTS, found, np.degrees(np.arctan(mu))))
    table = with_errors(rows).drop(columns="order")
    table["degrees"] = table.value - table.reference
    return table


def draw(table: pd.DataFrame, mu: float) -> Figure:
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    speeds, thresholds = figure.subplots(1, 2)
    exact = np.degrees(np.arctan(mu))
    excess = np.linspace(-0.3, 0.3, 7)
    fine = np.radians(exact + np.linspace(-0.3, 0.3, 301))
    coulomb = np.maximum(np.sin(fine) - mu * np.cos(fine), 0)
    speeds.plot(np.degrees(fine) - exact, 1e3 * coulomb, color="0.3", linewidth=1.2, label="Coulomb")
    for k, model in enumerate(MODELS):
        size, face = (9 - 2 * k, "none")
        found = [1e3 * speed(model, exact + x, mu, "along") for x in excess]
        style = {"color": PALETTE[k], "markersize": size, "markerfacecolor": face, "label": model}
        speeds.plot(excess, found, MARKERS[k], **style)
        rows = table[(table.model == model) & table.quantity.str.contains("along")]
        thresholds.plot(rows.reference, rows.degrees, MARKERS[k], **style)
    speeds.set_xlabel(f"angle − atan({mu:g}), degrees")
    speeds.set_ylabel("speed after 0.1 s, in 0.001 g t")
    speeds.set_title(f"a rod laid along the slope, mu = {mu:g}", fontsize=10)
    speeds.legend(fontsize=8)
    thresholds.axhspan(-0.1, 0.1, color="0.94", zorder=0)
    thresholds.axhline(0, color="0.3", linewidth=1.2)
    thresholds.set_ylim(-0.15, 0.15)
    thresholds.set_xlabel("atan(mu), degrees")
    thresholds.set_ylabel("error of the threshold, degrees")
    thresholds.set_title("threshold by bisection", fontsize=10)
    return figure


def main() -> None:
    parser = options(__doc__)
    parser.add_argument(
        "--mus", default="0.1,0.3,0.5,1", help="coefficients of friction; the middle one is drawn"
    )
    parser.add_argument("--resolution", type=float, default=0.005, help="of the bisection, in degrees")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    mus = [float(x) for x in given.mus.split(",")]
    table = measure(mus, given.resolution)
    write_table(table, given.out / "incline.csv", 6)
    save(draw(table, mus[len(mus) // 2]), given.out, "incline")


if __name__ == "__main__":
    main()
