"""Rods against theory: heavy cantilever, and the transition of a curved hanging rod between plane and space.

The cantilever: height over width H/W of its end, a function of the weight Gamma = rho S g L³/EI alone [Romero 2021].
The transition: a rod of natural curvature kappa, clamped with its tangent downwards, has plane equilibria. One
branch begins at its natural arc and is followed as the weight grows (`curl`), one begins at the straight rod and is
followed as the weight falls (`hanging`). Each loses its stability against bending and twisting out of the plane at a
critical weight, a function of kappa L and GJ/EI = 1/1.5. For the models it is a zero of the least eigenvalue of
the energy's Hessian; the reference is Kirchhoff's boundary-value problem linearised about the plane elastica. Below
kappa L = 5.5 both branches end in a fold within the plane before that. Writes a figure and two tables.

    python experiments/rod_validation.py [--elements 8,16,32] [--bends 5.8,6,7,8,10,12,14] [--out results/rods]
"""

from collections import deque
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rods import references
from rods.cases import POISSON, Case
from rods.models import MODELS, Model
from rods.tables import PALETTE, with_errors

from fibercontact.bench.figures import MARKERS, save

MASTER_WEIGHTS = np.geomspace(0.1, 1000, 13)
TABLED_WEIGHT, TABLED_BEND = 10.0, 8.0
BRANCHES = ("curl", "hanging")


def aspect(end: np.ndarray) -> np.ndarray:
    """H/W of ends (..., 3)."""
    return -end[..., 2] / end[..., 0]


def cantilever(model: Model, elements: int, weights: np.ndarray) -> np.ndarray:
    """H/W at growing weights."""
    path = [Case(gravity=(0.0, 0.0, -weight)) for weight in weights]
    return aspect(np.array([end.centreline(1)[1] for end in model.follow(path, elements)]))


def transition(model: Model, elements: int, bend: float, branch: str, near: float) -> float:
    """Critical weight of a branch, sought from the stable side of a weight near it."""

    def case(weight: float, share: float = 1.0) -> Case:
        return Case((0.0, share * bend, 0.0), (weight, 0.0, 0.0))

    shares = np.linspace(0, 1, 6)[1:]
    start, factor = (0.7 * near, 1.1) if branch == "curl" else (1.3 * near, 0.92)
    path = [case(share * start) if branch == "curl" else case(start, share) for share in shares]
    begin = [case(0.0) if branch == "curl" else case(start, 0.0)]
    at = deque(model.follow(begin + path, elements), maxlen=1).pop()

    def stability(weight: float) -> float:
        nonlocal at
        at = next(model.follow([case(weight)], elements, at))
        return at.stability()

    return references.first_zero(stability, start, factor)


@cache
def reference_transition(branch: str, bend: float) -> float:
    return references.Hook(bend, 1 / (1 + POISSON)).transition(branch)


def accuracy(meshes: list[int]) -> pd.DataFrame:
    """Relative errors of every model on growing meshes, and their orders."""
    weight = np.array([TABLED_WEIGHT])
    exact = float(aspect(references.elastica(weight, np.ones(1))[0, 0]))
    rows = []
    for name, model in MODELS.items():
        for N in meshes:
            value = cantilever(model, N, weight)[0]
            rows.append((f"H/W, Gamma = {TABLED_WEIGHT:g}", name, N, value, exact))
            for branch in BRANCHES:
                near = reference_transition(branch, TABLED_BEND)
                value = transition(model, N, TABLED_BEND, branch, near)
                rows.append((f"Gamma of {branch}, kappa L = {TABLED_BEND:g}", name, N, value, near))
    return with_errors(rows)


def diagram(elements: int, bends: list[float]) -> pd.DataFrame:
    """Critical weights of every model and the reference's."""
    rows = []
    for branch, bend in product(BRANCHES, bends):
        near = reference_transition(branch, bend)
        weights = {name: transition(model, elements, bend, branch, near) for name, model in MODELS.items()}
        rows.append({"branch": branch, "bend": bend, "reference": near} | weights)
    return pd.DataFrame(rows)


def draw(elements: int, critical: pd.DataFrame, curve: np.ndarray) -> Figure:
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    _draw_cantilever(left, elements)
    _draw_diagram(right, elements, critical, curve)
    return figure


def _draw_cantilever(axes: Axes, elements: int) -> None:
    fine = np.geomspace(MASTER_WEIGHTS[0], MASTER_WEIGHTS[-1], 200)
    curve = aspect(references.elastica(fine, np.ones(1))[:, 0])
    axes.loglog(fine, curve, color="0.3", linewidth=1.2, label="elastica (solve_bvp)")
    axes.loglog(fine[:70], fine[:70] / 8, color="0.7", linestyle=":", label="small deflection, Gamma/8")
    for k, (name, model) in enumerate(MODELS.items()):
        _markers(axes, MASTER_WEIGHTS, cantilever(model, elements, MASTER_WEIGHTS), k, name)
    axes.set_xlabel("weight Gamma = rho S g L³/EI")
    axes.set_ylabel("H/W of the end")
    axes.set_title(f"heavy cantilever, {elements} elements", fontsize=10)
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=8)


def _draw_diagram(axes: Axes, elements: int, critical: pd.DataFrame, bends: np.ndarray) -> None:
    curves = {branch: [reference_transition(branch, bend) for bend in bends] for branch in BRANCHES}
    axes.fill_between(bends, curves["curl"], curves["hanging"], color="0.95")
    for branch, rows in critical.groupby("branch"):
        style = {"color": "0.3", "linewidth": 1.2, "linestyle": "-" if branch == "hanging" else "--"}
        axes.semilogy(bends, curves[branch], **style, label=f"{branch} branch, linearised BVP")
        for k, name in enumerate(MODELS):
            _markers(axes, rows.bend, rows[name], k, name if branch == "hanging" else None)
    for x, y, text in ((0.6, 0.42, "bent and twisted"), (0.3, 0.66, "plane hook"), (0.7, 0.1, "plane curl")):
        axes.annotate(text, (x, y), xycoords="axes fraction", ha="center", fontsize=8, color="0.3")
    axes.set_ylim(7, 4000)
    axes.set_xlabel("natural curvature kappa L")
    axes.set_ylabel("critical weight Gamma")
    axes.set_title(f"bend–twist transition of a hanging rod, {elements} elements", fontsize=10)
    axes.grid(which="major", color="0.9")
    axes.legend(fontsize=8, loc="upper left")


def _markers(axes: Axes, x, y, k: int, label: str | None) -> None:
    size, face = (8, "none") if k == 0 else (5, PALETTE[k])  # a hollow one behind the others
    axes.plot(x, y, MARKERS[k], color=PALETTE[k], label=label, markersize=size, markerfacecolor=face)


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--elements", default="8,16,32", help="meshes of the table; the middle one is drawn")
    parser.add_argument(
        "--bends", default="5.8,6,7,8,10,12,14", help="natural curvatures of the diagram, kappa L"
    )
    parser.add_argument("--curve", type=int, default=30, help="curvatures of the reference's curve in it")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    meshes = [int(x) for x in given.elements.split(",")]
    drawn = meshes[len(meshes) // 2]
    write_table(accuracy(meshes), given.out / "validation.csv", 6)
    bends = [float(x) for x in given.bends.split(",")]
    critical = diagram(drawn, bends)
    write_table(critical, given.out / "transition.csv", 6)
    save(draw(drawn, critical, np.linspace(bends[0], bends[-1], given.curve)), given.out, "validation")


if __name__ == "__main__":
    main()
