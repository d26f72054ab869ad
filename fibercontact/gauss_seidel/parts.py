"""Parts of a problem that can be swept at the same time, with the same answer for any number of threads.

The contacts are bisected again and again: a few of them, the separator, are taken out so that no two contacts of the
rest interact across the cut [George 1973]; a long separator is divided like the whole. A sweep visits the leaves of
this tree first, then its separators from the deepest to the root; parts of one such phase do not interact, so the
order of visits is that of one Gauss–Seidel sweep. Where two parts of a phase push the same contact, each has a slot
of its own for it, and the slots are added up in order when the phase is over.

References: George, Nested dissection of a regular finite element mesh, SIAM J. Numer. Anal. 10, 1973; Cuthill and
McKee, Proc. 24th ACM National Conference, 1969, for the order in which contacts are cut; Graham, Bounds on
multiprocessing timing anomalies, SIAM J. Appl. Math. 17, 1969, for who takes what.
"""

from itertools import pairwise, zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from fibercontact.jit import jit
from fibercontact.lanes import LANES

__all__ = ["Parts", "divide", "owners", "undivided"]

Index = NDArray[np.int32]

LEAF = 2048
"""Contacts of a leaf, about."""
SHORTEST = 256
"""Contacts of a separator from which it is bisected itself."""
TOGETHER, AHEAD = 2 * LANES, 128
"""Contacts that are put together, since some will be left out, and among how many they are sought."""
VISIT = 10
"""Blocks whose push takes as long as to solve a contact."""
SMALLEST = 3000
"""Contacts from which a problem is divided: below, threads cost more than they save."""


class Parts(NamedTuple):
    """The order of a sweep, in phases of parts."""

    order: Index  # (n,) contacts in the order of their visits
    parts: Index  # (parts+1,) first visit of each part
    phases: Index  # (phases+1,) first part of each phase
    targets: Index  # (blocks,) where the push of each block goes: to its column, or to n + a slot
    slots: Index  # (slots,) contact that each slot is for, slots of a phase together
    flushes: Index  # (phases+1,) first slot of each phase
    meets: (
        Index  # (n,) of each visit, the first later one that it has an influence on, or the end of the part
    )


def undivided(columns: Index, n: int) -> Parts:
    """All n contacts in one part, visited in order and one at a time."""
    none, one = np.zeros(0, np.int32), np.array([0, 1], np.int32)
    order = np.arange(n, dtype=np.int32)
    return Parts(order, np.array([0, n], np.int32), one, columns, none, np.zeros(2, np.int32), order + 1)


def divide(starts: Index, columns: Index) -> Parts:
    """Divide the contacts of block rows `starts`, `columns`, and spread each part."""
    parts = _divided(starts, columns, len(starts) - 1)
    _spread(starts, columns, parts.parts, parts.order, parts.meets)
    return parts


def _divided(starts: Index, columns: Index, n: int) -> Parts:
    if n < SMALLEST:
        return undivided(columns, n)
    graph = csr_array((np.ones(len(columns), np.int8), columns, starts), shape=(n, n))
    work = np.diff(starts).astype(np.int64) + VISIT
    levels = _bisect(graph, work, np.arange(n, dtype=np.int32), max(1, int(np.log2(n / LEAF))))
    parts = [part for level in levels for part in level]
    order = np.concatenate(parts)
    first_visits = np.cumsum([0, *map(len, parts)]).astype(np.int32)
    phases = np.cumsum([0, *map(len, levels)]).astype(np.int32)
    part_of = np.empty(n, np.int32)
    part_of[order] = np.repeat(np.arange(len(parts), dtype=np.int32), np.diff(first_visits))
    phase_of = np.searchsorted(phases, np.arange(len(parts)), side="right").astype(np.int32) - 1
    return Parts(
        order, first_visits, phases, *_slots(starts, columns, part_of, phase_of), np.zeros(n, np.int32)
    )


@jit
def _spread(starts: Index, columns: Index, parts: Index, order: Index, meets: Index) -> None:
    """Put next to each other contacts of a part that do not interact, `TOGETHER` of them at a time.

    They are sought among the next `AHEAD`, so that a sweep's order is changed but locally.
    """
    n = len(order)
    group, place, later = np.full(n, -1, np.int32), np.full(n, n, np.int32), np.full(n + 1, n, np.int32)
    for part in range(len(parts) - 1):
        first, end = parts[part], parts[part + 1]
        later[first:end] = end
        left, head, done = order[first:end].copy(), 0, first
        while done < end:
            began, k, kept = done, head, 0
            while k < len(left) and done - began < TOGETHER and kept < AHEAD:
                i = left[k]
                if i >= 0 and group[i] == began:
                    kept += 1
                elif i >= 0:
                    for j in range(starts[i], starts[i + 1]):
                        other = columns[j]
                        group[other] = began
                        later[place[other]] = min(later[place[other]], done)
                    order[done], place[i], left[k] = i, done, -1
                    done += 1
                k += 1
            while head < len(left) and left[head] < 0:
                head += 1
    meets[:] = later[:n]


def _bisect(graph: csr_array, work: NDArray[np.int64], contacts: Index, depth: int) -> list[list[Index]]:
    """The phases of some contacts: those of both sides of a cut, then those of the separator."""
    if depth == 0 or len(contacts) < SHORTEST:
        return [[contacts]]
    inner = graph[contacts][:, contacts] if len(contacts) < graph.shape[0] else graph
    order = reverse_cuthill_mckee(inner, symmetric_mode=True)
    separator, side = _cut(inner, work[contacts], order)
    halves = [_bisect(graph, work, contacts[np.sort(order[side == k])], depth - 1) for k in (0, 1)]
    sides: list[list[Index]] = [a + b for a, b in zip_longest(*halves, fillvalue=[])]
    return sides + _bisect(graph, work, contacts[np.sort(separator)], depth)


def _cut(graph: csr_array, work: NDArray[np.int64], order: Index) -> tuple[Index, NDArray[np.int8]]:
    """The cut of an order that two threads are through with first; sides 0 and 1, 2 for the separator."""
    n = len(order)
    position = np.empty(n, np.int64)
    position[order] = np.arange(n)
    reach = np.zeros((2, n), np.int64)
    _reach(graph.indptr, graph.indices, position, reach)
    taken = np.zeros(
        (2, n + 2), np.int64
    )  # work of the separator of a cut before k, on its left and on its right
    _count(reach, work[order], taken)
    left = np.concatenate([[0], np.cumsum(work[order])])
    on_left, on_right = taken[:, : n + 1]
    right = left[-1] - left
    time = np.stack(
        [np.maximum(left - on_left, right) + on_left, np.maximum(left, right - on_right) + on_right]
    )
    on, cut = np.unravel_index(np.argmin(time), time.shape)
    places = np.arange(n)
    side = (places >= cut).astype(np.int8)
    separator = (places < cut) & (reach[1] >= cut) if on == 0 else (places >= cut) & (reach[0] < cut)
    side[separator] = 2
    return order[separator], side


@jit
def _reach(indptr: Index, indices: Index, position: NDArray[np.int64], reach: NDArray[np.int64]) -> None:
    """First and last position of each position's neighbours."""
    for i in range(len(position)):
        low = high = position[i]
        for j in range(indptr[i], indptr[i + 1]):
            p = position[indices[j]]
            low, high = min(low, p), max(high, p)
        reach[0, position[i]], reach[1, position[i]] = low, high


@jit
def _count(reach: NDArray[np.int64], work: NDArray[np.int64], taken: NDArray[np.int64]) -> None:
    """`taken[0, k]`: work of positions before k with a neighbour from k on; `taken[1, k]` the other way round."""
    n = reach.shape[1]
    for p in range(n):
        taken[0, p + 1] += work[p]
        taken[0, reach[1, p] + 1] -= work[p]
        taken[1, reach[0, p] + 1] += work[p]
        taken[1, p + 1] -= work[p]
    for k in range(1, n + 2):
        taken[0, k] += taken[0, k - 1]
        taken[1, k] += taken[1, k - 1]


def owners(parts: Parts, starts: Index, threads: int) -> Index:
    """Which of some threads takes each part: phase by phase the longest first, to who has least [Graham 1969]."""
    if threads == 1:
        return np.zeros(len(parts.parts) - 1, np.int32)
    work = np.diff(starts)[parts.order] + VISIT
    sizes = np.add.reduceat(np.append(work, 0), parts.parts[:-1]) * (np.diff(parts.parts) > 0)
    owner = np.zeros(len(sizes), np.int32)
    for first, end in pairwise(parts.phases):
        load = np.zeros(threads, np.int64)
        for part in first + np.argsort(-sizes[first:end], kind="stable"):
            owner[part] = np.argmin(load)
            load[owner[part]] += sizes[part]
    return owner


def _slots(starts: Index, columns: Index, part_of: Index, phase_of: Index) -> tuple[Index, Index, Index]:
    """Where each block's push goes, the contacts of the slots, and the first slot of each phase."""
    n, parts = len(part_of), len(phase_of)
    source = np.repeat(part_of, np.diff(starts))
    across = np.flatnonzero(source != part_of[columns])
    key = (phase_of[source[across]].astype(np.int64) * n + columns[across]) * parts + source[across]
    found, which = np.unique(key, return_inverse=True)  # pushes of a part on a contact, phase by phase
    meeting = found // parts
    several = np.zeros(len(found), dtype=bool)
    same = meeting[1:] == meeting[:-1]
    several[1:], several[:-1] = same, several[:-1] | same
    number = np.cumsum(several) - 1
    targets = columns.astype(np.int32, copy=True)
    slotted = several[which]
    targets[across[slotted]] = n + number[which[slotted]]
    kept = meeting[several]
    phases = int(phase_of[-1]) + 1
    flushes = np.searchsorted(kept // n, np.arange(phases + 1)).astype(np.int32)
    return targets, (kept % n).astype(np.int32), flushes
