"""Why a run failed or was slow: the facts, measured on its visit log, every threshold named.

`explain_words` says them, `explain_figure` shows them. Impulses are compared as `sigma_i r_i`, in the unit of b, so
that no fact depends on units.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from fibercontact.bench.passes import Laid, gauss_seidel
from fibercontact.bench.protocol import Limits
from fibercontact.bench.visits import VisitRecord
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.local.algebra import law_residual
from fibercontact.local.contract import Status
from fibercontact.local.registry import Configured
from fibercontact.problem.cone import COULOMB, natural_map
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

__all__ = [
    "Attempt", "Change", "Decay", "Facts", "Failures", "Fallback", "Growth", "Motion", "attempts",
    "contact_properties", "decay_of", "examine", "failures_of", "fallback_of", "fewest", "growth_of", "motion_of",
    "next_change", "periods_of", "residual_by_contact", "telling",
]  # fmt: skip

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

STALLED = 0.9
"""A run has stalled when the least residual of its second half is above this share of the first half's."""
HELD = 0.9
"""What is said to sit on some contacts sits there by this share: on the fewest that hold it."""
TELLS, CERTAIN = 0.8, 3.3
"""A property tells a group of contacts from the others when it is larger (or smaller) in this share of the pairs, and
when the rank sum lies this many standard deviations from chance."""
RETURNS = 0.1
"""The impulses cycle with period p when they come back within this share of how far they went in between."""
LONGEST_PERIOD = 32
EMPTY = 0.01
"""A contact is left empty by an impulse below this share of the one that it needs."""
STRAIGHT = 0.9
"""They drift when the way from first to last is this share of the path at least."""
INSIDE = 1e-6
"""A contact sticks when `mu r_N - |r_T|` is above this share of `mu r_N`."""
NEGLIGIBLE = 0.01
"""Share of the tolerance by which an impulse may change and count as still."""
LARGE, GROWING = 10.0, 1.05
"""Impulses are growing without bound in sight above this size, in b, and this growth over the second half."""


@dataclass(frozen=True)
class Decay:
    """How the residual went in the second half of a run.

    `kind` is `geometric` (a factor `rate` a sweep), `algebraic` (like sweeps to the power `-rate`), `stalled`,
    `uneven` (it fell, and rose again) or `short` (too few sweeps to tell). `to_go` sweeps more would meet the
    tolerance.
    """

    kind: str
    rate: float
    first: int
    last: int
    to_go: float


@dataclass(frozen=True)
class Growth:
    """Root mean square of `sigma_i r_i` at the end, in b; how many times that of half-way; as a power of sweeps."""

    size: float
    factor: float
    power: float

    @property
    def unbounded(self) -> bool:
        """Whether no bound is in sight."""
        return not (self.size < LARGE or self.factor < GROWING)


class Change(NamedTuple):
    """The next change of regime if the impulses go on along their line: which contact, into what, sweeps from now."""

    contact: int
    regime: str
    sweeps: float


@dataclass(frozen=True)
class Motion:
    """What the impulses did over the last sweeps: `still`, `cycle` (with its period), `drift`, `wander`, or `short`.

    `contacts` moved more than `NEGLIGIBLE` of the tolerance, `periods[k]` is that of `contacts[k]` alone, 0 without
    one; `movers` are the fewest that hold `HELD` of the squared movement. A drift leads to `change`, if to any.
    """

    kind: str
    sweeps: int
    period: int
    straightness: float
    contacts: Counts
    periods: Counts
    movers: Counts
    change: Change | None = None


@dataclass(frozen=True)
class Failures:
    """The local solves that failed: how many by status, on which contacts, and what became of the sampled ones."""

    by_status: Mapping[Status, int]
    visits: int
    by_contact: Counts
    holders: Counts  # the fewest contacts with HELD of them, most first
    sampled: int
    solvable: int  # of the sampled, by secular
    empty: int  # of these, left without the impulse that they need
    restarted: int  # of these, by the solver itself from the impulse without friction
    left: float  # median residual that was left at them, relative to the local b
    secular_left: float  # largest residual of secular's answers to them

    @property
    def total(self) -> int:
        """How many there were."""
        return sum(self.by_status.values())


@dataclass(frozen=True)
class Fallback:
    """How often the solver's fall-back was used among the sampled visits; `exact` when they are all."""

    sampled: int
    used: int
    exact: bool


@dataclass(frozen=True)
class Attempt:
    """Another run on the same problem from the same start; `history` as in `Run`."""

    solver: str
    outer: str
    facets: int
    solved: bool
    sweeps: int
    residual: float
    history: Array


@dataclass(frozen=True)
class Facts:
    """All that is said and drawn of a run."""

    record: VisitRecord
    b_ref: float
    properties: Mapping[str, Array]  # of the contacts, by name
    decay: Decay
    growth: Growth
    motion: Motion
    failures: Failures
    fallback: Fallback | None
    residual: Array  # (n,) share of the squared residual of the answer
    attempts: Sequence[Attempt] = ()

    @property
    def holders(self) -> Counts:
        """The fewest contacts that hold most of the squared residual, most first."""
        return fewest(self.residual)

    def telling(self, group: Counts) -> tuple[str, Counts, float]:
        """The property that tells a group from the other contacts that carry an impulse, these, and its share."""
        carries = self.record.answer.reshape(-1, 3).any(axis=1)
        others = np.setdiff1d(np.flatnonzero(carries), group)
        name, share = telling(self.properties, group, others)
        return name, others, share


def examine(
    record: VisitRecord, laid: Laid, local: Configured, secular: Configured, tried: Sequence[Attempt] = ()
) -> Facts:
    """Gather the facts of a recorded run of `local` on the problem."""
    problem, tolerance = laid.problem, float(record.about["tolerance"])
    return Facts(
        record,
        problem.b_ref,
        contact_properties(problem),
        decay_of(record.sweeps, record.residual, tolerance),
        growth_of(record.sweeps, record.size),
        motion_of(record, problem.sigma / (problem.b_ref or 1.0), problem.mu, tolerance),
        failures_of(record, local, secular),
        fallback_of(record, local),
        residual_by_contact(problem, record.answer, local.facets),
        tried,
    )


def fewest(weights: NDArray[Any], share: float = HELD) -> Counts:
    """The fewest indices that hold a share of the sum of non-negative weights, largest first; none of nothing."""
    order = np.argsort(-weights, kind="stable")
    total = weights.sum()
    if not total > 0:
        return order[:0]
    return order[: int(np.searchsorted(np.cumsum(weights[order]), share * total * (1 - 1e-12))) + 1]


# How the residual went


def decay_of(sweeps: Counts, residual: Array, tolerance: float) -> Decay:
    """Fit the second half of a run by a factor a sweep and by a power of the sweeps; the better fit is kept."""
    last = int(sweeps[-1])
    late = (2 * sweeps >= last) & (residual > 0) & np.isfinite(residual)
    early = (2 * sweeps < last) & np.isfinite(residual)
    k, logs = sweeps[late].astype(float), np.log(residual[late])
    if len(k) < 4 or not early.any():
        return Decay("short", math.nan, last, last, math.nan)
    first = int(k[0])
    if residual[late].min() > max(STALLED * residual[early].min(), tolerance):
        return Decay("stalled", math.nan, first, last, math.inf)
    fits = {kind: _line(x, logs) for kind, x in (("geometric", k), ("algebraic", np.log(k)))}
    kind = min(fits, key=lambda kind: fits[kind][1])
    slope = fits[kind][0]
    fall = max(0.0, logs[-1] - math.log(tolerance))
    if slope >= 0.0:
        return Decay("uneven", math.nan, first, last, math.inf)
    to_go = fall / -slope if kind == "geometric" else last * math.expm1(min(fall / -slope, 700.0))
    return Decay(kind, math.exp(slope) if kind == "geometric" else -slope, first, last, to_go)


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope of the least-squares line, and the sum of squares that it leaves."""
    dx, dy = x - x.mean(), y - y.mean()
    slope = float(dx @ dy / (dx @ dx))
    return slope, float(((dy - slope * dx) ** 2).sum())


def growth_of(sweeps: Counts, size: Array) -> Growth:
    """Compare the size of the impulses at the end with that of half-way."""
    half = int(np.searchsorted(sweeps, sweeps[-1] / 2))
    end, before = float(size[-1]), float(size[half])
    if len(size) < 5 or not before > 0.0:
        return Growth(end, 1.0, 0.0)
    factor = end / before
    return Growth(end, factor, math.log(max(factor, 1e-300)) / math.log(sweeps[-1] / sweeps[half]))


# What the impulses did last


def motion_of(record: VisitRecord, scale: Array, mu: Array, tolerance: float) -> Motion:
    """Look for a cycle or a drift in the impulses of the last sweeps; `scale` puts them in the unit of b."""
    amplitude = record.amplitude[record.moving]
    moves = amplitude > NEGLIGIBLE * tolerance
    contacts = record.moving[moves]
    x = record.recent[:, moves] * scale[contacts][:, None]
    movers = contacts[fewest(amplitude[moves] ** 2)]
    if len(contacts) == 0 or len(x) < 4:
        kind, none = "short" if len(x) < 4 else "still", np.zeros(len(contacts), dtype=np.int64)
        return Motion(kind, len(x), 0, math.nan, contacts, none, movers)
    (period,) = periods_of(x.reshape(len(x), 1, -1))
    path = np.sqrt((np.diff(x, axis=0) ** 2).sum(axis=(1, 2))).sum()
    straightness = float(np.linalg.norm(x[-1] - x[0]) / path) if path > 0 else math.nan
    kind = "cycle" if period else "drift" if straightness >= STRAIGHT else "wander"
    change = next_change(x, contacts, mu[contacts]) if kind == "drift" else None
    return Motion(kind, len(x), int(period), straightness, contacts, periods_of(x), movers, change)


def next_change(x: Array, contacts: Counts, mu: Array) -> Change | None:
    """When impulses x (sweeps, k, 3) that go on as over the last half first leave their regime: open, or slip."""
    half = len(x) // 2
    r, speed = x[-1], (x[-1] - x[-1 - half]) / half
    size = np.hypot(r[:, 1], r[:, 2])
    margin = mu * r[:, 0] - size
    with np.errstate(divide="ignore", invalid="ignore"):
        closing = (r[:, 1] * speed[:, 1] + r[:, 2] * speed[:, 2]) / size - mu * speed[:, 0]
        opens = np.where((r[:, 0] > 0) & (speed[:, 0] < 0), r[:, 0] / -speed[:, 0], np.inf)
        slips = np.where((margin > INSIDE * mu * r[:, 0]) & (closing > 0), margin / closing, np.inf)
    k = int(np.minimum(opens, slips).argmin())
    if not math.isfinite(min(opens[k], slips[k])):
        return None
    return Change(
        int(contacts[k]), "open" if opens[k] <= slips[k] else "slip", float(min(opens[k], slips[k]))
    )


def periods_of(x: Array) -> Counts:
    """The period of each column of x (sweeps, columns, components): the shortest p ≥ 2 at which it comes back, or 0.

    Coming back: the root mean square of `x_k - x_{k-p}` over the last half is at most `RETURNS` of the largest one
    at a smaller distance.
    """
    longest = min(LONGEST_PERIOD, len(x) // 2)
    late = len(x) - longest
    far = np.zeros(x.shape[1])
    found = np.zeros(x.shape[1], dtype=np.int64)
    for p in range(1, longest + 1):
        step = np.sqrt(((x[longest:] - x[longest - p : len(x) - p]) ** 2).sum(axis=2).sum(axis=0) / late)
        found[(found == 0) & (p > 1) & (step <= RETURNS * far) & (far > 0)] = p
        far = np.maximum(far, step)
    return found


# Where something sits


def contact_properties(problem: IncrementalProblem) -> dict[str, Array]:
    """What may tell a contact from the others; a property that is the same for all tells nothing and is left out."""
    D = problem.diagonal
    eigenvalues = np.linalg.eigvalsh(D)
    with np.errstate(divide="ignore"):
        condition = eigenvalues[:, 2] / np.maximum(eigenvalues[:, 0], 0.0)
    found = {
        "condition of W_ii": condition,
        "sigma_i (1/kg)": problem.sigma,
        "mu |W_TN| / W_NN": problem.mu * np.hypot(D[:, 1, 0], D[:, 2, 0]) / D[:, 0, 0],
        "blocks in the row of W": np.diff(problem.W.indptr).astype(float),
        "mu": problem.mu,
    }
    return {name: values for name, values in found.items() if problem.n and values.min() < values.max()}


def telling(properties: Mapping[str, Array], group: Counts, others: Counts) -> tuple[str, float]:
    """The property that tells a group of contacts best from others; the share of pairs in which it is larger there.

    A pair is one contact of the group and one of the others; ties count half (the statistic of Mann and Whitney, Ann.
    Math. Statist. 18, 1947). An empty name when nothing tells them from the others, see `TELLS`.
    """
    best, pairs = ("", 0.5), len(group) * len(others)
    for name, values in properties.items() if pairs else ():
        ranks = rankdata(values[np.concatenate([group, others])])[: len(group)]
        share = float(ranks.sum() - len(group) * (len(group) + 1) / 2) / pairs
        deviation = math.sqrt((len(group) + len(others) + 1) / (12 * pairs))
        if abs(share - 0.5) > max(TELLS - 0.5 - 1e-12, CERTAIN * deviation, abs(best[1] - 0.5)):
            best = (name, share)
    return best


def residual_by_contact(problem: IncrementalProblem, r: Array, facets: int) -> Array:
    """Each contact's share of the squared natural-map residual (THEORY §2), (n,); zeros at an exact solution."""
    u = (problem.W @ r + problem.b).reshape(-1, 3).tolist()
    rows = zip(u, r.reshape(-1, 3).tolist(), problem.mu.tolist(), problem.sigma.tolist(), strict=True)
    e = np.array([natural_map(tuple(u), tuple(r), mu, sigma, facets) for u, r, mu, sigma in rows])
    squares = (e.reshape(-1, 3) ** 2).sum(axis=1)
    return squares / squares.sum() if squares.sum() > 0 else squares


# The local solves


def failures_of(record: VisitRecord, local: Configured, secular: Configured) -> Failures:
    """Count the failed local solves, and solve the sampled ones again when Coulomb's law is meant."""
    by_contact = record.statuses[:, 1:].sum(axis=1)
    totals = record.statuses.sum(axis=0)
    again = record.failures if local.facets == COULOMB else record.failures[:0]
    answers = [secular.kernel()(*_local(visit), secular.options) for visit in again]
    solved = [k for k, (status, _, _) in enumerate(answers) if status == Status.CONVERGED]
    ours = [_local_residual(visit, r) for visit, (_, r, _) in zip(again, answers, strict=True)]
    return Failures(
        {status: int(totals[status]) for status in Status if status and totals[status]},
        int(totals.sum()),
        by_contact,
        fewest(by_contact),
        len(again),
        len(solved),
        sum(math.hypot(*again[k]["r"]) < EMPTY * math.hypot(*answers[k][1]) for k in solved),
        sum(_solves_without_friction(local, again[k]) for k in solved),
        float(np.median([_local_residual(visit, visit["r"]) for visit in again])) if len(again) else math.nan,
        max(ours, default=math.nan),
    )


def _solves_without_friction(local: Configured, visit: np.void) -> bool:
    """Whether the solver solves a sampled visit from the impulse that it would have without friction."""
    W, b, mu, _ = _local(visit)
    start = (max(0.0, -b[0] / W[0][0]), 0.0, 0.0)
    return bool(local.kernel()(W, b, mu, start, local.options)[0] == Status.CONVERGED)


def fallback_of(record: VisitRecord, local: Configured) -> Fallback | None:
    """Ask again what the solver tries first, at the sampled visits; None for a solver without a fall-back."""
    first = local.registered.solver.first
    if first is None:
        return None
    used = sum(first(*_local(visit), local.options)[0] != Status.CONVERGED for visit in record.visits)
    return Fallback(len(record.visits), int(used), len(record.visits) == record.statuses.sum())


def _local(visit: np.void) -> tuple[Any, ...]:
    """`(W, b, mu, start)` of a sampled visit, as a kernel takes them."""
    W = tuple(map(tuple, visit["W"].tolist()))
    return W, tuple(visit["b"].tolist()), float(visit["mu"]), tuple(visit["start"].tolist())


def _local_residual(visit: np.void, r: Any) -> float:
    """Residual of an answer to a sampled visit by Coulomb's law, relative to its b."""
    W, b, mu, _ = _local(visit)
    return float(law_residual(W, b, mu, tuple(float(x) for x in r))) / (math.hypot(*b) or 1.0)


# Other runs


def attempts(
    laid: Laid, start: Array | None, about: Mapping[str, Any], others: Sequence[tuple[Configured, str]]
) -> Iterator[Attempt]:
    """Solve the problem of a run otherwise, by (local solver, outer loop), within the same limits."""
    limits = Limits(int(about["max_sweeps"]), float(about["max_seconds"]))
    for local, outer in others:
        loop = gauss_seidel(local, float(about["tolerance"]), outer, limits)
        yield attempt(dataclasses.replace(loop, check_every=1), outer, laid, start)


def attempt(loop: GaussSeidel, outer: str, laid: Laid, start: Array | None) -> Attempt:
    """One run, measured."""
    run = loop.solve_system(laid.system, laid.problem.b_ref, start, history=True)
    residual = measure(laid.problem, run.r, loop.local.facets).residual
    solved = residual <= loop.tolerance
    return Attempt(loop.local.label, outer, loop.local.facets, solved, run.sweeps, residual, run.history)
