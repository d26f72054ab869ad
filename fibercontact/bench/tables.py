"""From rows to tables: pure functions of the rows' data frame.

The rows given to them are those of one accuracy and one mode. A problem that is proved unsolvable is left out
of every rate; means are over the problems that all compared solvers of the exact law solved, so that a solver
cannot look fast by failing on what is slow.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd

from fibercontact.bench.protocol import PUBLISHED
from fibercontact.bench.rows import Row
from fibercontact.reference.existence import UNSOLVABLE

__all__ = [
    "common_problems",
    "compared",
    "contrary",
    "headline",
    "performance_ratios",
    "rated",
    "strata",
    "tally",
    "to_frame",
]

CONTACT_EDGES = (0, 50, 100, 200, 500, 1000, np.inf)
MU_EDGES = (-1.0, 0.0, 0.2, 0.5, 0.8, np.inf)


def to_frame(rows: Iterable[Row]) -> pd.DataFrame:
    """Tidy rows, one a measurement; what is not known is NaN."""
    frame = pd.DataFrame(list(rows))
    numbers = ("time_best", "time_median", "sweeps", "coulomb", "residual", "setup_seconds", "contacts")
    for name in numbers:
        frame[name] = pd.to_numeric(frame[name]) if name in frame else np.nan
    return frame


def rated(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows that count: those of problems not proved unsolvable."""
    return rows[rows["existence"] != UNSOLVABLE]


def compared(rows: pd.DataFrame) -> list[str]:
    """The solvers whose successes define the common problems: those with a success at all, of the exact law.

    Where no solver is of the exact law, those of any.
    """
    exact = rows[rows["law_facets"] == 0]
    candidates = exact if len(exact) else rows
    return list(candidates[candidates["solved"].astype(bool)]["solver"].unique())


def common_problems(rows: pd.DataFrame) -> pd.Index:
    """Problems that every compared solver of the exact law solved."""
    solvers = compared(rows)
    solved = rows[rows["solver"].isin(solvers) & rows["solved"].astype(bool)]
    successes = solved.groupby("problem_hash")["solver"].nunique()
    return successes.index[successes == len(solvers)]


def headline(rows: pd.DataFrame, solvers: Sequence[str]) -> pd.DataFrame:
    """The table of the 2014 talk, a row a solver in the order given, with the published figures beside it."""
    rows = rated(rows)
    common = common_problems(rows)
    by_solver = {name: rows[rows["solver"] == name] for name in solvers}
    table = pd.DataFrame.from_dict(
        {name: _figures(group, common) for name, group in by_solver.items() if len(group)}, orient="index"
    )
    return table.join(_published(table.index)).rename_axis("solver")


def _figures(rows: pd.DataFrame, common: pd.Index) -> dict[str, Any]:
    """The figures of one solver."""
    solved = rows[rows["solved"].astype(bool)]
    shared = solved[solved["problem_hash"].isin(common)]
    times = 1e3 * shared["time_median"].dropna()
    failed = len(rows) - len(solved)
    return {
        "problems": len(rows),
        "failed": failed,
        "failure_percent": 100.0 * failed / len(rows),
        "false_successes": int(rows["false_success"].astype(bool).sum()),
        "reasons": tally(rows["reason"]),
        "common": len(shared),
        "sweeps_mean": shared["sweeps"].mean(),
        "sweeps_median": shared["sweeps"].median(),
        "time_mean_ms": times.mean(),
        "time_geo_ms": geometric_mean(times),
        "own": len(solved),
        "own_sweeps_mean": solved["sweeps"].mean(),
        "own_sweeps_median": solved["sweeps"].median(),
        "setup_mean_ms": 1e3 * rows["setup_seconds"].mean(),
        "coulomb_median": solved["coulomb"].median(),
        "coulomb_worst": solved["coulomb"].max(),
    }


def geometric_mean(values: pd.Series) -> float:
    """`exp(mean(log x))` of positive values, NaN of none."""
    return float(np.exp(np.log(values).mean())) if len(values) else float("nan")


def tally(reasons: pd.Series) -> str:
    """Reasons with their counts, the most frequent first."""
    counts = reasons[reasons != ""].value_counts()
    return ", ".join(f"{reason} {count}" for reason, count in counts.items())


def _published(solvers: pd.Index) -> pd.DataFrame:
    """The talk's figures for these solvers, NaN where it has none."""
    columns = ["published", "published_failure_percent", "published_iterations", "published_ms"]
    unknown = (None, np.nan, np.nan, np.nan)
    figures = {name: tuple(PUBLISHED.get(name, unknown)) for name in solvers}
    return pd.DataFrame.from_dict(figures, orient="index", columns=columns)


def strata(rows: pd.DataFrame, solvers: Sequence[str]) -> pd.DataFrame:
    """The headline's figures by scene, by contacts, by (largest) mu, and by rod model where scenes name several.

    One row each a solver.
    """
    kinds = {
        "scene": rows["scene"],
        "contacts": _binned(rows["contacts"], CONTACT_EDGES),
        "mu": _binned(pd.to_numeric(rows["mu_max"]), MU_EDGES),
    }
    model = rows["scene"].str.partition("@")[2].replace("", "helix")
    if model.nunique() > 1:
        kinds["rods"] = model
    keep = ["problems", "failed", "failure_percent", "common", "sweeps_mean", "time_mean_ms", "time_geo_ms"]
    parts = [
        headline(group, solvers)[keep].reset_index().assign(by=kind, stratum=str(stratum))
        for kind, labels in kinds.items()
        for stratum, group in rows.groupby(labels, observed=True)
        if len(rated(group))
    ]
    return pd.concat(parts)[["by", "stratum", "solver", *keep]].reset_index(drop=True)


def _binned(values: pd.Series, edges: Sequence[float]) -> pd.Series:
    """Half-open bins `(low, high]`, labelled in words."""
    labels = [_bin_label(low, high) for low, high in pairwise(edges)]
    return pd.cut(values, list(edges), labels=labels)


def _bin_label(low: float, high: float) -> str:
    if low < 0:
        return f"{high:g}"
    return f"over {low:g}" if np.isinf(high) else f"{low:g} to {high:g}"


def contrary(table: pd.DataFrame, by_stratum: pd.DataFrame) -> list[str]:
    """Sentences on the strata in which the headline's second solver comes before its first."""
    sentences: list[str] = []
    for column, words, unit, count in (
        ("failure_percent", "failure rate", "%", "problems"),
        ("time_geo_ms", "time", "ms", "common"),
    ):
        ranking = table[column].dropna().sort_values(kind="stable")
        if len(ranking) < 2 or ranking.iloc[0] == ranking.iloc[1]:
            continue
        first, second = ranking.index[:2]
        for _, stratum in by_stratum.groupby(["by", "stratum"], sort=False):
            line = stratum.set_index("solver").reindex([first, second])
            if line.loc[second, column] < line.loc[first, column]:
                by, label = stratum[["by", "stratum"]].iloc[0]
                sentences.append(
                    f"by {words}, {first} comes before {second} on the whole set, not where {by} is {label}: "
                    f"{line.loc[first, column]:.3g} against {line.loc[second, column]:.3g} {unit} "
                    f"on {line.loc[first, count]} problems"
                )
    return sentences


def performance_ratios(rows: pd.DataFrame, solvers: Sequence[str]) -> pd.DataFrame:
    """Time over the best time on each problem (rows) by solver (columns), infinite where it failed.

    Dolan and Moré, Math. Program. 91, 2002. Problems that not every solver was run on are left out.
    """
    rows = rated(rows)
    seconds = rows["time_median"].where(rows["solved"].astype(bool), np.inf)
    times = rows.assign(seconds=seconds).pivot(index="problem_hash", columns="solver", values="seconds")
    times = times[[name for name in solvers if name in times]].dropna()
    best = times.min(axis=1)
    return times.div(best, axis=0).where(times < np.inf, np.inf)
