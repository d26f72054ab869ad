"""Error of every rod model against its degrees of freedom: equilibria and frequencies.

Three tests against references that share no code with the rods: the heavy elastica (a cantilever of weight 20
EI/L³), a curl (natural twist 4/L and bend 8/L, about one turn and a half, hanging under the same weight), and the
lowest frequencies of bending (clamped) and twist (free), in closed form. The error of a shape is the largest distance
at a quarter, half, three quarters and the end of the rod, in lengths. Writes a figure and a table.

    python experiments/rod_convergence.py [--most 32] [--out results/rods]
"""

from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from rods import references
from rods.cases import POISSON, RADIUS, Case
from rods.models import MODELS, Model
from rods.tables import PALETTE

from fibercontact.bench.figures import MARKERS, save

WEIGHT, CURL = 20.0, (4.0, 8.0, 0.0)
SHAPES = {
    "heavy elastica": [Case(gravity=(0.0, 0.0, -WEIGHT))],
    "hanging curl": [Case(CURL, (share * WEIGHT, 0.0, 0.0)) for share in (0.125, 0.25, 0.5, 0.75, 1.0)],
}
TESTS = (*SHAPES, "bending frequency", "twist frequency")


def reference_shapes() -> dict[str, np.ndarray]:
    """Points at the quarters of the rod, root included."""
    quarters = np.linspace(0, 1, 5)
    return {
        "heavy elastica": references.elastica(np.array([WEIGHT]), quarters)[0],
        "hanging curl": references.kirchhoff(CURL, (WEIGHT, 0.0, 0.0), 1 / (1 + POISSON), quarters),
    }


def errors(model: Model, elements: int, shapes: dict[str, np.ndarray]) -> Iterator[tuple[str, float]]:
    for test, path in SHAPES.items():
        end = deque(model.follow(path, elements), maxlen=1).pop()
        yield test, np.linalg.norm(end.centreline(4) - shapes[test], axis=1).max()
    yield "bending frequency", abs(model.bending_frequency(elements) / references.bending_frequency() - 1)
    shaft = references.twist_frequency(POISSON, RADIUS)
    yield "twist frequency", abs(model.twist_frequency(elements) / shaft - 1)


def measure(most: int) -> pd.DataFrame:
    """A row for each model, test and mesh; `order` compares a mesh to the one with half as many elements."""
    shapes, rows = reference_shapes(), []
    meshes = [4 * 2**k for k in range(10) if 4 * 2**k <= most]
    for name, model in MODELS.items():
        for N in meshes:
            rows += [
                {
                    "test": test,
                    "model": name,
                    "expected": model.order,
                    "elements": N,
                    "dofs": model.dofs(N),
                    "error": e,
                }
                for test, e in errors(model, N, shapes)
            ]
    table = pd.DataFrame(rows)
    table["order"] = table.groupby(["test", "model"])["error"].transform(lambda e: np.log2(e.shift() / e))
    return table


def draw(table: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    panels = {"heavy elastica": TESTS[:1], "hanging curl": TESTS[1:2], "lowest frequencies": TESTS[2:]}
    for axes, (title, tests) in zip(figure.subplots(1, 3, sharey=True), panels.items(), strict=True):
        for k, name in enumerate(MODELS):
            for test in tests:
                curve = table[(table.model == name) & (table.test == test)]
                label = None if test == "twist frequency" else name
                axes.loglog(
                    curve.dofs, curve.error, color=PALETTE[k], marker=MARKERS[k], markersize=5,
                    linestyle="--" if test == "twist frequency" else "-", label=label,
                )  # fmt: skip
                if test != "twist frequency" and name != "Discrete rod":
                    _draw_slope(axes, curve)
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("degrees of freedom")
        axes.set_xticks([12, 24, 48, 96], ["12", "24", "48", "96"])
        if len(tests) > 1:
            axes.plot([], [], "--", color="0.4", label="dashed: twist")
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(which="major", color="0.9")
        axes.legend(fontsize=7, loc="lower left", handlelength=3.2)
        axes.set_ylim(3e-10, 0.6)
        if title == "heavy elastica":
            axes.set_ylabel("error, in lengths; relative for frequencies")
    return figure


def _draw_slope(axes, curve: pd.DataFrame) -> None:
    """A grey line of the expected order through the finest mesh."""
    order, elements = curve.expected.iloc[0], curve.elements
    line = 0.4 * curve.error.iloc[-1] * (elements.iloc[-1] / elements) ** order
    axes.loglog(curve.dofs, line, color="0.6", linewidth=0.8)
    axes.annotate(
        f"order {order}", (curve.dofs.iloc[-1], line.iloc[-1]), fontsize=7, color="0.4", ha="right", va="top"
    )


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--most", type=int, default=32, help="elements of the finest mesh")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    table = measure(given.most)
    write_table(table, given.out / "convergence.csv")
    save(draw(table), given.out, "convergence")


if __name__ == "__main__":
    main()
