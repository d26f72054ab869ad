"""What the scripts share: their options, the problems they are given, what a call takes, the tables they write."""

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from fibercontact.bench.problem_set import Entry, find_set, limited, load_set


def options(description: str | None) -> argparse.ArgumentParser:
    """A parser whose help is the description of the script, line by line."""
    return argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_sets(parser: argparse.ArgumentParser) -> None:
    """The options that `entries` reads."""
    parser.add_argument("--set", default="core306")
    parser.add_argument("--also", type=Path, action="append", default=[], help="other folders of FCLIB files")
    parser.add_argument("--limit", type=int, help="problems of each set; all by default")


def entries(given: argparse.Namespace) -> Iterator[tuple[str, Entry]]:
    """The set's name and each problem."""
    for folder in (find_set(given.set), *given.also):
        for entry in limited(load_set(folder), given.limit):
            yield folder.name, entry


def fastest(call: Callable[[], object], repetitions: int) -> float:
    """The least time of several calls, s."""
    times = []
    for _ in range(repetitions):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


def write_table(table: pd.DataFrame, file: Path, digits: int = 4) -> None:
    """Write a table as CSV and print it; its numbers have so many digits."""
    file.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(file, index=False, float_format=f"%.{digits}g")
    print(table.to_string(index=False, float_format=f"{{:.{digits}g}}".format))
