"""Runs as people read them: a list of them, and what is to be said of one before its table."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from fibercontact.bench.record import Record
from fibercontact.bench.report import MACHINE
from fibercontact.bench.rows import Key, writer

__all__ = ["listing", "progress", "sheet"]

ASKED = ("solver", "accuracy", "start", "outer", "repetitions", "max_sweeps", "max_seconds")
"""What of the protocol is asked for by a command."""


def listing(runs: Sequence[Record], folder: Path) -> pd.DataFrame:
    """Runs, a line each, as people read them; folders are told from `folder` on."""
    return pd.DataFrame(
        {
            "folder": str(run.folder.relative_to(folder)),
            "measured": max(run.values("stamp"), default="–"),
            "set": _told([asked.problem_set for asked in run.asked]),
            "protocol": _told(run.values("protocol")),
            "problems": str(len(run.values("problem_hash"))),
            "solvers": str(len(run.values("solver"))),
            "rows": progress(run),
            "now": f"measuring: {who}" if (who := writer(run.folder)) else "–",
            "machine": _told(run.values("cpu")),
        }
        for run in runs
    )


def sheet(run: Record) -> pd.DataFrame:
    """What is to be said of one run before its table: a line a thing."""
    lines = {
        "set": _told([asked.problem_set for asked in run.asked]),
        "begun": _told([asked.began for asked in run.asked]),
        "measured": f"{min(run.values('stamp'), default='–')} to {max(run.values('stamp'), default='–')}",
        "rows": progress(run),
        "rows of other commands": str(len(run.every) - len(run.rows)),
        **{name.replace("_", " "): _told(run.values(name)) for name in (*ASKED, *MACHINE)},
        "started on": _told([asked.environment["machine"] for asked in run.asked]),
    }
    return pd.DataFrame({"": lines.keys(), "value": lines.values()})


def progress(run: Record) -> str:
    """How many rows there are of those that were asked for."""
    total = str(len(run.wanted)) if run.asked else "?"
    return f"{len({Key.of(row) for row in run.rows})}/{total}"


def _told(values: Sequence[Any]) -> str:
    return ", ".join(dict.fromkeys(map(str, values))) or "–"
