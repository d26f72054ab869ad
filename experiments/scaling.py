"""How the number of contacts grows with the number of fibres, and the cost of a step with the number of contacts.

A head of full size is shaken (scene `scalp`) with more and more fibres, each run in a process of its own. A run
counts by the medians of the second half of its steps, when the hair lies on the head. Power laws are fitted to the
runs by least squares of the logarithms, with 95 % intervals of the exponents; runs with few contacts are left out of
those of costs. Writes two tables and a figure. Times want a machine that does nothing else.

    python experiments/scaling.py [--fibres 50,...,2000] [--models helix,clothoid] [--out results/scaling]
"""

import multiprocessing
import resource
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from scipy import stats

from fibercontact.bench.figures import COLOURS, MARKERS, save
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import Step, simulate
from fibercontact.simulation.watch import PARTS

FIBRES = "50,100,200,350,500,700,1000,1400,2000"
FEWEST = 100  # contacts of a run that tells about costs: below, a step costs what its calls cost


class Fit(NamedTuple):
    """A power law `factor x^exponent`; the exponent is within `interval` of it with 95 % confidence."""

    exponent: float
    interval: float
    factor: float

    def __str__(self) -> str:
        return f"{self.exponent:.2f} ± {self.interval:.2f}"


def fit(x: pd.Series, y: pd.Series) -> Fit:
    """Fit a power law; no numbers for fewer than three points."""
    good = (x > 0) & (y > 0)
    if good.sum() < 3:
        return Fit(np.nan, np.nan, np.nan)
    line = stats.linregress(np.log(x[good]), np.log(y[good]))
    interval = stats.t.ppf(0.975, good.sum() - 2) * line.stderr
    return Fit(line.slope, interval, np.exp(line.intercept))


def row_of(step: Step) -> dict[str, float]:
    blocks = len(step.problem.condense().W.indices) if step.problem else 0
    return {
        "contacts": len(step.contacts.gap),
        "between_fibres": int((step.contacts.obstacle < 0).sum()),
        "blocks": blocks,
        "sweeps": step.run.sweeps if step.run else 0,
        **{f"{part}_ms": 1e3 * seconds for part, seconds in step.parts.items()},
        "step_ms": 1e3 * step.seconds,
        "solved": step.run.claimed if step.run else True,
    }


def run(model: str, fibres: int, steps: int) -> dict[str, float | str]:
    """One run: medians of the second half of its steps; the first step also compiles."""
    scene = replace(build(Parameters("scalp", fibres, "mixed", 0.3, 0.3, 1, model)), steps=steps)
    rows = pd.DataFrame([row_of(step) for step in simulate(scene) if step.index >= steps // 2])
    medians = rows.drop(columns="solved").median().to_dict()
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "model": model,
        "fibres": fibres,
        **medians,
        "most_contacts": rows.contacts.max(),
        "unsolved_steps": int((~rows.solved).sum()),
        "peak_MiB": most,
    }


def measure(models: list[str], fibres: list[int], steps: int) -> pd.DataFrame:
    """All runs, each in a fresh process, so that the peak of memory is its own."""
    rows = []
    fresh = multiprocessing.get_context("spawn")
    for model in models:
        for count in fibres:
            with ProcessPoolExecutor(1, mp_context=fresh) as pool:
                rows.append(pool.submit(run, model, count, steps).result())
            print(
                f"{model} {count}: {rows[-1]['contacts']:.0f} contacts, {rows[-1]['step_ms']:.0f} ms a step"
            )
    return pd.DataFrame(rows)


def exponents(table: pd.DataFrame) -> pd.DataFrame:
    """The measured power laws of each model."""
    laws = []
    for model, runs in table.groupby("model", sort=False):
        many = runs[runs.contacts >= FEWEST]
        for y, x, data in (
            ("contacts", "fibres", runs),
            ("between_fibres", "fibres", runs),
            ("blocks", "contacts", many),
            ("sweeps", "contacts", many),
            *((f"{part}_ms", "contacts", many) for part in PARTS),
            ("step_ms", "contacts", many),
            ("step_ms", "fibres", runs),
        ):
            law = fit(data[x], data[y])
            laws.append({"model": model, "quantity": y, "against": x, **law._asdict(), "runs": len(data)})
    return pd.DataFrame(laws)


def draw(table: pd.DataFrame) -> Figure:
    """Contacts against fibres; the parts of a step against contacts (helices solid, others dashed)."""
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for k, (model, runs) in enumerate(table.groupby("model", sort=False)):
        law = fit(runs.fibres, runs.between_fibres)
        label = f"{model}: between fibres, exponent {law}"
        left.loglog(runs.fibres, runs.between_fibres, MARKERS[k], color=COLOURS[4 + k], label=label)
        left.loglog(runs.fibres, law.factor * runs.fibres**law.exponent, color=COLOURS[4 + k], linewidth=0.8)
        left.loglog(
            runs.fibres,
            runs.contacts,
            MARKERS[k],
            color=COLOURS[4 + k],
            fillstyle="none",
            label=f"{model}: all",
        )
        many = runs[runs.contacts >= FEWEST]
        for part, colour in zip((*PARTS, "step"), ("#8c6d31", *COLOURS[1:5], COLOURS[0]), strict=True):
            right.loglog(
                many.contacts, many[f"{part}_ms"], color=colour, linestyle="-" if k == 0 else "--", marker=".",
                label=("whole step" if part == "step" else part) if k == 0 else None,
            )  # fmt: skip
    left.set(xlabel="fibres", ylabel="contacts")
    right.set(xlabel="contacts", ylabel="ms a step")
    for axes in (left, right):
        axes.grid(which="major", color="0.9")
        axes.set_axisbelow(True)
        axes.legend(fontsize=7)
    left.set_xticks(table.fibres.unique(), [str(count) for count in table.fibres.unique()], fontsize=7)
    left.xaxis.set_minor_formatter(NullFormatter())
    return figure


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--fibres", default=FIBRES)
    parser.add_argument("--models", default="helix,clothoid")
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--out", type=Path, default=Path("results/scaling"))
    given = parser.parse_args()
    table = measure(given.models.split(","), [int(count) for count in given.fibres.split(",")], given.steps)
    write_table(table, given.out / "runs.csv")
    write_table(exponents(table), given.out / "exponents.csv")
    save(draw(table), given.out, "scaling")


if __name__ == "__main__":
    main()
