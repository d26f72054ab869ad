"""The threads of a run, and how many of them sweep.

On a machine that does other things as well, threads that wait for each other can be slower than one alone. Since the
answer does not depend on how many there are, a long run tries now and then, and goes on with what is faster.
"""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import Memory
from fibercontact.gauss_seidel.sweep import LAST_FAILURE
from fibercontact.gauss_seidel.team import Team, alone
from fibercontact.threads import together

__all__ = ["Crew", "Member"]

FIRST_LOOK, NEXT_LOOK = 0.1, 0.5
"""Seconds from the start, and from one time to the next, until another number of threads is tried."""

Answer = TypeVar("Answer")


class Member(NamedTuple):
    """What a thread of a run has for its own; guard and memory are the same in all of them."""

    team: Team
    memory: Memory
    guard: NDArray[np.float64]
    visits: NDArray[np.int64]


class Crew:
    """The members of a run, of whom all sweep, or the first alone."""

    def __init__(self, members: Sequence[Member]) -> None:
        self.members = members
        self._one = [members[0]._replace(team=alone(len(members[0].team.owner)))]
        self._active: Sequence[Member] = members
        self._pace = {1: np.inf, len(members): 0.0}  # seconds a sweep, when last tried
        self._look_at = FIRST_LOOK

    def plan(self, elapsed: float, wanted: int, fewest: int) -> int:
        """Choose who sweeps next; returns how many sweeps, the fewest possible where something is tried."""
        if len(self.members) == 1:
            return wanted
        if elapsed >= self._look_at:
            self._look_at = elapsed + NEXT_LOOK
            self._active = self._one if len(self._active) > 1 else self.members
            return fewest
        self._active = self._one if self._pace[1] < self._pace[len(self.members)] else self.members
        return wanted

    def sweep(self, sweeps: Callable[[Member], Answer], count: int, failed: NDArray[np.int64]) -> Answer:
        """Do `count` sweeps; `failed` (members,) is told the local failures that each has seen."""
        for k, member in enumerate(self.members):
            member.memory.copy_numbers(self._one[0].memory)
            member.guard[:] = self._one[0].guard
            failed[k] = member.visits[1 : LAST_FAILURE + 1].sum()
        began = time.perf_counter()
        answer = together([partial(sweeps, member) for member in self._active])[0]
        self._pace[len(self._active)] = (time.perf_counter() - began) / max(1, count)
        return answer
