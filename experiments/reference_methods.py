"""What each way to a reference solves alone: how many problems to 1e-10, how far it gets on the others, how long.

The problems are spread evenly over core306, or with `--hard` over the scenes on which accelerated
sweeps from zero stall. Each way has the same time; the order of `fibercontact.reference.truth` follows from it.

    python experiments/reference_methods.py [--problems 30] [--hard] [--seconds 10] [--out results/references]
"""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options
from numpy.typing import NDArray

from fibercontact.bench.problem_set import find_set, limited, load_set
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.interior_point import interior_point
from fibercontact.problem.fclib import read
from fibercontact.problem.measure import measure
from fibercontact.problem.step import StepProblem
from fibercontact.reference.cadoux import STAGES, Cadoux
from fibercontact.reference.conic import associated, impulse_form, sharp_form, velocity_form
from fibercontact.reference.truth import polish

Array = NDArray[np.float64]
BAR, TARGET = 1e-10, 1e-12
HARD = ("comb-curly", "plane-straight", "plane-curly", "plane-mixed", "twist-straight-128", "twist-wavy")
PLAIN = STAGES[1:2]


def sweeps(step: StepProblem, start: Array | None, seconds: float) -> Array:
    return polish(step.condense(), start, TARGET, seconds)[0]


def plain_cadoux(step: StepProblem, seconds: float) -> Array:
    return Cadoux(velocity_form, TARGET, max_seconds=seconds, stages=PLAIN).solve(step).r


def staged_cadoux(step: StepProblem, seconds: float) -> Array:
    return Cadoux(velocity_form, TARGET, max_seconds=seconds).solve(step).r


def polished(form: Callable) -> Callable:
    def way(step: StepProblem, seconds: float) -> Array:
        run = Cadoux(form, TARGET, max_seconds=0.5 * seconds).solve(step)
        return sweeps(step, run.r, 0.5 * seconds)

    return way


def central_path(step: StepProblem, seconds: float) -> Array:
    problem = step.condense()
    deadline = time.perf_counter() + 0.5 * seconds
    run = interior_point(block_system(problem), problem.b_ref, TARGET * problem.b_ref, deadline=deadline)
    return sweeps(step, run.r, 0.5 * seconds)


WAYS = {
    "Cadoux, plain": plain_cadoux,
    "Cadoux, staged": staged_cadoux,
    "sweeps from zero": lambda step, seconds: sweeps(step, None, seconds),
    "associated, then sweeps": lambda step, seconds: sweeps(step, associated(step).r, seconds),
    "Cadoux, then sweeps": polished(velocity_form),
    "Cadoux in impulses, then sweeps": polished(impulse_form),
    "sharp Cadoux, then sweeps": polished(sharp_form),
    "central path, then sweeps": central_path,
}


def table(rows: pd.DataFrame) -> pd.DataFrame:
    grouped = rows.groupby("way", sort=False)
    return pd.DataFrame(
        {
            "solved": grouped["residual"].apply(lambda r: f"{(r <= BAR).sum()}/{len(r)}"),
            "median residual": grouped["residual"].median().map("{:.1e}".format),
            "worst residual": grouped["residual"].max().map("{:.1e}".format),
            "median s": grouped["seconds"].median().map("{:.2f}".format),
            "total s": grouped["seconds"].sum().map("{:.0f}".format),
        }
    )


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--problems", type=int, default=30)
    parser.add_argument("--hard", action="store_true", help="only problems of the hard scenes")
    parser.add_argument("--max-contacts", type=int, default=3000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    entries = load_set(find_set("core306"))
    if given.hard:
        entries = [entry for entry in entries if entry.name.startswith(HARD)]
    rows = []
    for entry in limited(entries, given.problems):
        step = read(entry.file).problem
        if step.n > given.max_contacts:
            continue
        sweeps(step, None, 0.0)  # compiles, factorises
        for name, way in WAYS.items():
            began = time.perf_counter()
            r = way(step, given.seconds)
            seconds = time.perf_counter() - began
            rows.append(
                {
                    "problem": entry.name,
                    "contacts": step.n,
                    "way": name,
                    "residual": measure(step.condense(), r).coulomb,
                    "seconds": seconds,
                }
            )
    frame = pd.DataFrame(rows)
    print(table(frame).to_string())
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        frame.to_csv(given.out / ("methods-hard.csv" if given.hard else "methods.csv"), index=False)


if __name__ == "__main__":
    main()
