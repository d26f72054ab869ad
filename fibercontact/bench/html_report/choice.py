"""Which problems of a run are looked at closely, and where their files are."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from fibercontact.bench.problem_set import HASH_DIGITS, SUFFIXES, Entry
from fibercontact.bench.tables import rated

__all__ = ["RULE", "chosen", "locate", "named", "shelves"]

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


def shelves(given: Sequence[Path] = ()) -> list[Path]:
    """Folders to look for problems in: those given, then the sets of the checkout and of the current folder."""
    roots = [Path(__file__).parents[3] / "problems", Path("problems")]
    known = [
        folder for root in roots if root.is_dir() for folder in sorted(root.iterdir()) if folder.is_dir()
    ]
    return [*given, *known]


def locate(problem: str, digest: str, folders: Sequence[Path]) -> Entry | None:
    """The file of that name and hash; the name is compared with those that are there, no path is made of it."""
    for folder in folders:
        for file in sorted(folder.iterdir()):
            if file.suffix in SUFFIXES and file.stem == problem:
                found = hashlib.sha256(file.read_bytes()).hexdigest()[:HASH_DIGITS]
                if found == digest:
                    return Entry(file, folder.resolve().name, found)
    return None
