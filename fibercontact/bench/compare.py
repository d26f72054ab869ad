"""Two runs beside each other: ratios with bootstrap intervals, problem by problem and overall, and regressions.

A measurement of A and one of B are a pair when they are of the same problem, solver, options, accuracy, start and
outer loop; the sources may differ, for that is what one compares. A ratio is B's figure over A's, where both solved.

What counts as a regression, B being the new run:

* a problem that A solved and B did not;
* a solver whose geometric mean ratio of times, or of sweeps, has its whole 95 % interval above `1 + margin`;
* a problem and solver whose ratio of times has its whole interval above `1 + problem_margin`, or whose ratio of
  sweeps, which nothing disturbs, is above that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fibercontact.bench.protocol import ACCURACIES, BenchError
from fibercontact.bench.record import Record
from fibercontact.bench.report import IDLE_LOAD, number
from fibercontact.bench.rows import TIMED
from fibercontact.reference.existence import UNSOLVABLE

__all__ = ["Comparison", "Interval", "Margins", "bootstrap", "compare"]

PAIRED = ("problem_hash", "solver", "options", "accuracy", "start", "outer")
"""What two rows of a pair have in common."""
SAME = ("protocol", "max_sweeps", "max_seconds")
"""What the two runs must have in common: the protocol."""
TOLD = ("code", "cpu", "threads", "fibercontact", "python", "numpy", "numba", "scipy")
"""What is told where the runs differ in it."""
RESAMPLES, SEED, COVERAGE = 2000, 20140319, 0.95

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Margins:
    """How much more than A's is too much, over all problems and on one of them."""

    overall: float = 0.05
    problem: float = 0.25


MARGINS = Margins()


@dataclass(frozen=True)
class Interval:
    """A figure with the ends of its 95 % interval, which are NaN where there is nothing to resample."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        ends = "" if np.isnan(self.low) else f" [{number(self.low)}, {number(self.high)}]"
        return f"{number(self.value)}{ends}"


@dataclass(frozen=True)
class Comparison:
    """Pairs, a row each; figures by accuracy and solver, and of all solvers; what must be said; regressions."""

    pairs: pd.DataFrame
    overall: pd.DataFrame
    notes: Sequence[str]
    regressions: Sequence[str]


def compare(a: Record, b: Record, margins: Margins = Margins()) -> Comparison:
    """Compare run B with run A.

    Raises `BenchError` when their protocols differ, naming what differs, or when no measurement is in both.
    """
    for run in (a, b):
        if not run.rows:
            raise BenchError(f"{run.folder}: no rows to compare")
    refused = [f"{name} {_list(a, name)} and {_list(b, name)}" for name in SAME if not _alike(a, b, name)]
    if refused:
        raise BenchError(f"{a.folder} and {b.folder} have different protocols: {'; '.join(refused)}")
    one, other = _measurements(a), _measurements(b)
    both = one.merge(other, on=list(PAIRED), suffixes=("_a", "_b"))
    if both.empty:
        differing = [name for name in PAIRED if not set(one[name]) & set(other[name])]
        raise BenchError(
            f"{a.folder} and {b.folder} have no measurement in common"
            + (f": they differ in {', '.join(differing)}" if differing else "")
        )
    pairs = _pairs(both, np.random.default_rng(SEED))
    overall = _overall(pairs)
    notes = [*_differences(a, b), *_unpaired(a, b, one, other, both)]
    return Comparison(
        pairs, overall, notes, [*_flips(pairs), *_slower(overall, margins), *_worse(pairs, margins)]
    )


def _list(run: Record, name: str) -> str:
    return ", ".join(map(str, run.values(name)))


def _alike(a: Record, b: Record, name: str) -> bool:
    return set(a.values(name)) == set(b.values(name))


def _measurements(run: Record) -> pd.DataFrame:
    """A row each, timed if there is one, the latest; problems that are proved unsolvable are left out."""
    frame = pd.DataFrame(run.rows[::-1])
    frame = frame[frame["existence"] != UNSOLVABLE]
    for name in ("sweeps", "times", "time_median"):
        frame[name] = frame.get(name)
    frame = frame.sort_values("mode", key=lambda modes: modes != TIMED, kind="stable")
    frame = frame.drop_duplicates(list(PAIRED))
    return frame[[*PAIRED, "problem", "scene", "solved", "reason", "sweeps", "time_median", "times"]]


def _pairs(both: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """The pairs with their ratios, problem by problem."""
    solved = [both[name].astype(bool) for name in ("solved_a", "solved_b")]
    shared = solved[0] & solved[1]
    sweeps = [pd.to_numeric(both[f"sweeps_{run}"]) for run in "ab"]
    times = [pd.to_numeric(both[f"time_median_{run}"]) for run in "ab"]
    intervals = [
        _ratio_of_medians(_seconds(ours), _seconds(theirs), rng) if share else (np.nan, np.nan)
        for ours, theirs, share in zip(both["times_a"], both["times_b"], shared, strict=True)
    ]
    frame = both[["problem_a", "scene_a", *PAIRED]].rename(
        columns={"problem_a": "problem", "scene_a": "scene"}
    )
    rank = {name: k for k, name in enumerate(ACCURACIES)}
    frame = frame.assign(
        solved_a=solved[0], solved_b=solved[1], reason_a=both["reason_a"], reason_b=both["reason_b"],
        sweeps_a=sweeps[0], sweeps_b=sweeps[1], sweeps_ratio=_ratio(sweeps, shared),
        time_a=times[0], time_b=times[1], time_ratio=_ratio(times, shared),
        time_low=[low for low, _ in intervals], time_high=[high for _, high in intervals],
    )  # fmt: skip
    keys = {"accuracy": lambda c: c.map(rank), "problem": lambda c: c, "solver": lambda c: c}
    return frame.sort_values(list(keys), key=lambda c: keys[str(c.name)](c), kind="stable", ignore_index=True)


def _ratio(figures: Sequence[pd.Series], shared: pd.Series) -> pd.Series:
    """B's over A's where both solved and A's is not zero."""
    a, b = figures
    return (b / a.where(a > 0)).where(shared)


def _seconds(times: object) -> Array:
    return np.array(times if isinstance(times, list) else [], dtype=np.float64)


def _ratio_of_medians(a: Array, b: Array, rng: np.random.Generator) -> tuple[float, float]:
    """The interval of the ratio of two medians of repeated times, both resampled."""
    if len(a) < 2 or len(b) < 2:
        return np.nan, np.nan
    medians = [np.median(x[rng.integers(0, len(x), (RESAMPLES, len(x)))], axis=1) for x in (a, b)]
    low, high = np.quantile(medians[1] / medians[0], _ends())
    return float(low), float(high)


def _ends() -> Array:
    return np.array([0.5 * (1.0 - COVERAGE), 0.5 * (1.0 + COVERAGE)])


def bootstrap(ratios: Array, figure: Callable[..., Array]) -> Interval:
    """A figure of the logarithms of ratios, back on their scale, with its percentile interval.

    Problems are what is resampled. Those of a scene are alike, so an interval speaks of problems from these scenes.
    """
    logarithms = np.log(ratios[np.isfinite(ratios)])
    if len(logarithms) == 0:
        return Interval(np.nan, np.nan, np.nan)
    value = float(np.exp(figure(logarithms, axis=0)))
    if len(logarithms) == 1:
        return Interval(value, np.nan, np.nan)
    rng = np.random.default_rng(SEED)
    drawn = logarithms[rng.integers(0, len(logarithms), (RESAMPLES, len(logarithms)))]
    low, high = np.exp(np.quantile(figure(drawn, axis=1), _ends()))
    return Interval(value, float(low), float(high))


def _overall(pairs: pd.DataFrame) -> pd.DataFrame:
    """A line for each accuracy and solver, and one for all solvers, whose problems have their mean ratio."""
    lines = []
    for accuracy, level in pairs.groupby("accuracy", sort=False):
        lines += [_line(accuracy, solver, group) for solver, group in level.groupby("solver", sort=True)]
        if level["solver"].nunique() > 1:
            lines.append(_line(accuracy, "all", level))
    return pd.DataFrame(lines)


def _line(accuracy: object, solver: object, pairs: pd.DataFrame) -> dict[str, object]:
    times, sweeps = _by_problem(pairs, "time_ratio"), _by_problem(pairs, "sweeps_ratio")
    return {
        "accuracy": accuracy,
        "solver": solver,
        "pairs": len(pairs),
        "newly failed": int((pairs["solved_a"] & ~pairs["solved_b"]).sum()),
        "newly solved": int((~pairs["solved_a"] & pairs["solved_b"]).sum()),
        "timed": int(pairs["time_ratio"].notna().sum()),
        "time geo": bootstrap(times, np.mean),
        "time median": bootstrap(times, np.median),
        "sweeps geo": bootstrap(sweeps, np.mean),
        "sweeps median": bootstrap(sweeps, np.median),
    }


def _by_problem(pairs: pd.DataFrame, name: str) -> Array:
    """Geometric mean of a ratio over the solvers, a figure a problem."""
    ratios = pairs[pairs[name].notna()]
    return np.exp(np.log(ratios[name]).groupby(ratios["problem_hash"]).mean()).to_numpy()


def _differences(a: Record, b: Record) -> list[str]:
    """What else than the numbers is different."""
    told = [f"{name}: {_list(a, name)} | {_list(b, name)}" for name in TOLD if not _alike(a, b, name)]
    if not _alike(a, b, "cpu"):
        told.append("times of two machines: their ratios are those of the machines, too")
    for run in (a, b):
        loads = [row["load"] for row in run.rows if row["mode"] == TIMED and row["load"] is not None]
        if loads and (load := float(np.mean(loads))) > IDLE_LOAD:
            told.append(f"{run.folder}: the machine was not idle ({load:.1f} other processes at work)")
    return told


def _unpaired(a: Record, b: Record, one: pd.DataFrame, other: pd.DataFrame, both: pd.DataFrame) -> list[str]:
    alone = ((a.folder, len(one) - len(both)), (b.folder, len(other) - len(both)))
    return [f"{count} measurement(s) only in {folder}" for folder, count in alone if count]


def _named(pair: pd.Series) -> str:
    return f"{pair['problem']} {pair['solver']} at {pair['accuracy']}"


def _flips(pairs: pd.DataFrame) -> list[str]:
    lost = pairs[pairs["solved_a"] & ~pairs["solved_b"]]
    return [f"{_named(pair)}: solved before, failed now ({pair['reason_b']})" for _, pair in lost.iterrows()]


def _slower(overall: pd.DataFrame, margins: Margins) -> list[str]:
    """Solvers that take longer, or more sweeps, beyond doubt."""
    return [
        f"{line['solver']} at {line['accuracy']}: {what}, geometric mean ratio {line[column]}"
        for _, line in overall.iterrows()
        for column, what in (("time geo", "slower"), ("sweeps geo", "more sweeps"))
        if line[column].low > 1.0 + margins.overall
    ]


def _worse(pairs: pd.DataFrame, margins: Margins) -> list[str]:
    """Single problems that take longer beyond doubt, or more sweeps."""
    found = []
    for _, pair in pairs.iterrows():
        if pair["time_low"] > 1.0 + margins.problem:
            ratio = Interval(pair["time_ratio"], pair["time_low"], pair["time_high"])
            found.append(f"{_named(pair)}: slower, ratio {ratio}")
        if pair["sweeps_ratio"] > 1.0 + margins.problem:
            found.append(f"{_named(pair)}: {pair['sweeps_a']:.0f} sweeps before, {pair['sweeps_b']:.0f} now")
    return found
