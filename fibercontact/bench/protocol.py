"""What a number in a table means: accuracies, limits and the published figures it is shown beside.

Rows of different protocol versions are never mixed in one table.
"""

from dataclasses import dataclass
from typing import NamedTuple

from fibercontact.errors import UserError

__all__ = [
    "ACCURACIES",
    "DEFAULT_SOLVERS",
    "GLOBAL",
    "LOGS",
    "OUTERS",
    "PROTOCOL",
    "PUBLISHED",
    "STARTS",
    "BenchError",
    "Limits",
    "Published",
]

PROTOCOL = 1

ACCURACIES = {"low": 1e-2, "mid": 1e-4, "high": 1e-6, "full": 1e-8}
"""Tolerances on the residual, relative to b."""

STARTS = ("cold", "guess")
OUTERS = ("plain", "accelerated", "robust")
GLOBAL = "global"
"""The outer loop of a method that takes the whole problem: none."""
LOGS = ("visits",)

DEFAULT_SOLVERS = (
    "pyramid",
    "pac",
    "dac",
    "mfb",
    "enum-quartic",
    "enum-companion",
    "hybrid",
    "secular",
)
"""The local solvers of the table, in the order of the talk; others follow them."""


class BenchError(UserError):
    """A benchmark that cannot be run as asked; the message says why."""


@dataclass(frozen=True)
class Limits:
    """What a solver may spend on one problem."""

    sweeps: int = 5000
    seconds: float = 30.0


class Published(NamedTuple):
    """One row of the 2014 talk's table: 306 incremental problems, hardware and tolerance not given."""

    name: str
    failure_percent: float
    iterations: float
    milliseconds: float


_ENUM = Published("Enum", 1.0, 67, 1044)

PUBLISHED = {
    "pyramid": Published("Linearised", 0.0, 575, 6497),
    "pac": Published("PAC", 19.3, 163, 1265),
    "dac": Published("DAC", 0.33, 60, 874),
    "mfb": Published("MFB", 4.9, 72, 484),
    "enum-quartic": _ENUM,
    "enum-companion": _ENUM,
    "hybrid": Published("MFB + Enum", 0.0, 41, 312),
}
"""Published figures by the name of our local solver."""
