"""The tables of the page that are laid out once: cells of text, from the numbers of `bench.tables`."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from fibercontact.bench.html_report.runs import RunRead
from fibercontact.bench.protocol import ACCURACIES
from fibercontact.bench.report import View, number
from fibercontact.bench.rows import SETTING, TIMED
from fibercontact.bench.tables import rated

__all__ = ["Group", "Table", "differing", "headline_table", "overview", "side_by_side"]


class Group(NamedTuple):
    """Columns under one heading."""

    heading: str
    columns: Sequence[str]


@dataclass(frozen=True)
class Table:
    """Column groups, then a line for each of some names."""

    groups: Sequence[Group]
    lines: Sequence[tuple[str, Sequence[str]]]


Column = tuple[str, Callable[[dict[Any, Any]], str]]


def _numbers(*columns: tuple[str, str]) -> list[Column]:
    """Columns of the headline that are numbers."""
    return [(heading, _number_of(name)) for heading, name in columns]


def _number_of(name: str) -> Callable[[dict[Any, Any]], str]:
    return lambda line: number(line[name])


def headline_table(view: View, solvers: Sequence[str]) -> Table:
    """The headline, the talk's figures beside it."""
    timed = view.mode == TIMED
    others = [level for level in ACCURACIES if f"failure_percent_{level}" in view.table]
    times = [("time, mean (ms)", "time_mean_ms"), ("geometric mean (ms)", "time_geo_ms")]
    groups: dict[str, list[Column]] = {
        f"all {_problems(view)} problems": [
            *_numbers(("failures (%)", "failure_percent")),
            ("failed / run", lambda line: f"{line['failed']} / {line['problems']}"),
            ("false successes", lambda line: str(line["false_successes"])),
            *_numbers(*[(f"failures at {level} (%)", f"failure_percent_{level}") for level in others]),
        ],
        f"the {int(view.table['common'].max())} problems that all compared solvers solve": _numbers(
            ("sweeps, mean", "sweeps_mean"), ("median", "sweeps_median"), *(times if timed else [])
        ),
        "the 2014 talk": [
            ("local solver", lambda line: line["published"] if isinstance(line["published"], str) else "–"),
            *_numbers(
                ("failures (%)", "published_failure_percent"),
                ("GS iterations", "published_iterations"),
                ("time (ms)", "published_ms"),
            ),
        ],
        "each solver's own solved set": [
            ("problems", lambda line: str(line["own"])),
            *_numbers(("sweeps, mean", "own_sweeps_mean"), ("median", "own_sweeps_median")),
            *_numbers(("Coulomb residual, median", "coulomb_median"), ("worst", "coulomb_worst")),
        ],
        "set-up": _numbers(("mean (ms)", "setup_mean_ms")),
    }
    records = view.table.reset_index().to_dict("records")
    cells = [
        (line["solver"], [show(line) for columns in groups.values() for _, show in columns])
        for line in records
    ]
    return Table(
        [Group(name, [heading for heading, _ in columns]) for name, columns in groups.items()], cells
    )


def _problems(view: View) -> int:
    return int(rated(view.rows)["problem_hash"].nunique())


def overview(runs: Sequence[RunRead]) -> list[dict[str, Any]]:
    """A line a run: what was measured, on which machine, whether all of it is there."""
    return [
        {
            "name": run.name,
            "titles": [
                f"{view.title}, {'timed' if view.mode == TIMED else 'rates only'}" for view in run.views
            ],
            "solvers": len(run.solvers),
            "cpu": run.rows["cpu"].iloc[0],
            "last": str(run.rows["stamp"].max())[:10],
            "complete": not any(remark.startswith("incomplete") for remark in run.remarks),
        }
        for run in runs
    ]


def side_by_side(runs: Sequence[RunRead]) -> Table | None:
    """Failures, sweeps and times of all runs, each at its first accuracy; None for one run or several protocols."""
    if len(runs) < 2 or "protocol" in differing(runs):
        return None
    groups, columns = [], []
    for run in runs:
        view = run.views[0]
        shown = {
            "failures (%)": "failure_percent",
            "sweeps, mean": "sweeps_mean",
            "time, mean (ms)": "time_mean_ms",
        }
        groups.append(Group(f"{run.name}: {view.title}", list(shown)))
        columns += [view.table[name].map(number) for name in shown.values()]
    solvers = dict.fromkeys(solver for run in runs for solver in run.solvers)
    return Table(groups, [(name, [str(column.get(name, "–")) for column in columns]) for name in solvers])


def differing(runs: Sequence[RunRead]) -> list[str]:
    """What of the setting differs between runs."""
    return [name for name in SETTING if len({run.rows[name].iloc[0] for run in runs}) > 1]
