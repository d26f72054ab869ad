"""Which problems of a run are looked at closely, and where their files are."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from fibercontact.bench.problem_set import Entry, entry_of, problem_files
from fibercontact.bench.tables import rated

__all__ = ["RULE", "chosen", "locate", "named"]

RULE = (
    "those on which the solvers disagree most (the number that solved it times the number that did not), then those "
    "that took the most sweeps; a scene comes again only when each other one has had its turn"
)


def named(rows: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """Hashes of those of the problems named that are in the rows."""
    known = rows.drop_duplicates("problem").set_index("problem")["problem_hash"]
    return [str(known[name]) for name in dict.fromkeys(names) if name in known.index]


def chosen(rows: pd.DataFrame, count: int) -> list[str]:
    """Hashes of the `count` problems that come first by `RULE`; rows of one accuracy."""
    rows = rated(rows)
    by_problem = rows.assign(solved=rows["solved"].astype(bool)).groupby("problem_hash", sort=False)
    each = by_problem.agg(scene=("scene", "first"), solved=("solved", "sum"), runs=("solved", "size"))
    each["disagreement"] = each["solved"] * (each["runs"] - each["solved"])
    each["sweeps"] = by_problem["sweeps"].max().fillna(0.0)
    ranked = each.sort_values(["disagreement", "sweeps"], ascending=False, kind="stable")
    turn = ranked.groupby("scene", sort=False).cumcount()
    return [str(name) for name in turn.sort_values(kind="stable").index[:count]]


def locate(problem: str, digest: str, folders: Sequence[Path]) -> Entry | None:
    """The file of that name and hash; the name is compared with those that are there, no path is made of it."""
    for folder in folders:
        for file in problem_files(folder):
            if file.stem == problem and (entry := entry_of(file)).hash == digest:
                return entry
    return None
