"""All that is known beyond doubt of a problem: existence, a solution, the convexified law's, other solutions."""

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.reference.conic import Problem, associated, condensed, duality_gap
from fibercontact.reference.existence import UNSOLVABLE, Existence, existence
from fibercontact.reference.truth import Reference, reference
from fibercontact.reference.uniqueness import Uniqueness, uniqueness

__all__ = ["GroundTruth", "Search", "ground_truth"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Search:
    """How ground truth is sought: residual that a reference must meet, seconds for it, starts to look for others."""

    bar: float = 1e-10
    max_seconds: float = 120.0
    starts: int = 2

    def __str__(self) -> str:
        return f"bar {self.bar:g}, {self.max_seconds:g} s, {self.starts} starts"


@dataclass(frozen=True)
class GroundTruth:
    """Existence, reference, impulses (3n,) of the associated model with their duality gap, other solutions."""

    existence: Existence
    reference: Reference
    associated: Array
    gap: float
    uniqueness: Uniqueness
    seconds: float


def ground_truth(problem: Problem, search: Search) -> GroundTruth:
    """Find all of it. An unsolvable problem's best impulses are looked for by free and short candidates only."""
    began = time.perf_counter()
    exists = existence(problem)
    seconds = search.max_seconds if exists.verdict != UNSOLVABLE else min(1.0, search.max_seconds)
    convex = associated(problem)
    found = reference(problem, search.bar, seconds)
    starts = search.starts if found.accepted else 0
    others = uniqueness(problem, found, convex.r, search.bar, seconds, starts)
    gap = duality_gap(condensed(problem), convex.r)
    return GroundTruth(exists, found, convex.r, gap, others, time.perf_counter() - began)
