"""The facts of a run in words: one paragraph a subject, each sentence a measured number."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fibercontact.bench.explain import EMPTY, HELD, LARGE, NEGLIGIBLE, Attempt, Counts, Facts
from fibercontact.bench.report import number
from fibercontact.local.contract import SENTENCES

__all__ = ["title", "words"]

FEW = 6
"""Contacts that are named one by one."""
SINGLE = 2
"""Contacts whose properties are told one by one."""
FASTER = 0.8
"""Another run is worth a try when it takes at most this share of the sweeps."""

REASONS = {
    "local": ", and local solves failed",
    "outer": ", although every local solve succeeded",
    "time": ": the time was exhausted",
    "not finite": ": then it is no longer finite",
    "false success": ", although the solver claims success",
}


def title(facts: Facts) -> str:
    """What was run."""
    about = facts.record.about
    return (
        f"{about['problem']} ({facts.record.n} contacts), {about['solver']} at {about['accuracy']} "
        f"(residual {about['tolerance']:.0e} relative to b), {about['outer']} outer loop, {about['start']} start"
    )


def words(facts: Facts) -> list[tuple[str, str]]:
    """Paragraphs, each with its subject."""
    paragraphs = (
        ("verdict", _verdict(facts)),
        ("residual", [*_decay(facts), *_holders(facts)]),
        ("local solves", [*_failures(facts), *_fallback(facts)]),
        ("impulses", [*_growth(facts), *_motion(facts)]),
        ("regimes", _regimes(facts)),
        ("other runs", _attempts(facts)),
        ("what to try", _advice(facts)),
    )
    return [(subject, " ".join(sentences)) for subject, text in paragraphs if (sentences := list(text))]


def _verdict(facts: Facts) -> Iterator[str]:
    about, record = facts.record.about, facts.record
    sweeps, tolerance = _count(int(record.sweeps[-1]), "sweep"), f"the tolerance {about['tolerance']:.0e}"
    if about["solved"]:
        yield f"Solved after {sweeps}: the residual is {about['residual']:.1e}, {tolerance}."
        return
    why = REASONS.get(str(about["reason"]), f": {about['reason']}")
    yield f"Not solved: after {sweeps} the residual is {about['residual']:.1e}, {tolerance}{why}."
    best = int(record.sweeps[np.nanargmin(record.residual)])
    if record.residual[-1] > 1.1 * about["residual"]:
        yield f"The best residual is that of sweep {best}; the last one is {record.residual[-1]:.1e}."


def _decay(facts: Facts) -> Iterator[str]:
    decay, solved = facts.decay, facts.record.about["solved"]
    over = f"over sweeps {decay.first} to {decay.last}"
    if decay.kind == "geometric":
        yield f"It fell by a factor {_factor(decay.rate)} a sweep {over}" + _further(decay.to_go, solved)
    elif decay.kind == "algebraic":
        yield f"It fell like sweeps^-{decay.rate:.2g} {over}" + _further(decay.to_go, solved)
    elif decay.kind == "stalled":
        yield f"It has stalled: {over} its least value fell by less than a tenth."
    elif decay.kind == "uneven":
        yield f"It fell and rose again {over}."
    if cured := int(facts.record.about["proximal_from"]):
        yield f"The run cycled: a proximal term is in force since sweep {cured}."


def _further(sweeps: float, solved: bool) -> str:
    if solved:
        return "."
    return f"; going on so, it would take {number(_two_digits(sweeps))} sweeps more."


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


def _factor(rate: float) -> str:
    """A contraction factor with two digits of what it lacks to 1."""
    digits = max(2, 1 - math.floor(math.log10(max(1.0 - rate, 1e-9))))
    return f"{rate:.{digits}f}"


def _holders(facts: Facts) -> Iterator[str]:
    holders = facts.holders
    if facts.record.about["solved"] or not len(holders):
        return
    yield f"{_percent(HELD)} of its square sits on {_of(holders, facts)}."
    if facts.failures.total:
        on_failing = facts.residual[facts.failures.by_contact > 0].sum()
        yield f"Contacts with failed local solves hold {_percent(on_failing)} of it."


def _failures(facts: Facts) -> Iterator[str]:
    failures = facts.failures
    if not failures.total:
        yield f"All {failures.visits} succeeded."
        return
    yield f"{failures.total} of {failures.visits} failed ({_percent(failures.total / failures.visits)}):"
    yield "; ".join(f"{SENTENCES[status]} ({count})" for status, count in failures.by_status.items()) + "."
    held = failures.by_contact[failures.holders].sum() / failures.by_contact.sum()
    yield f"Of the failures {_percent(held)} sit on {_of(failures.holders, facts)}."
    yield from _telling(facts, failures.holders)
    yield from _replayed(facts)


def _telling(facts: Facts, group: Counts) -> Iterator[str]:
    """What tells some contacts from the others; what there is to say of a few ones."""
    name, others, share = facts.telling(group)
    if name:
        values = facts.properties[name]
        yield (
            f"What tells them best from the other contacts with an impulse is {name}: "
            f"{number(np.median(values[group]))} against {number(np.median(values[others]))} (medians), "
            f"{'larger' if share > 0.5 else 'smaller'} in {_percent(max(share, 1 - share))} of the pairs."
        )
    elif len(group) <= SINGLE:
        for contact in group:
            said = (f"{name} {number(x[contact])}" for name, x in facts.properties.items())
            yield f"Contact {contact}: {', '.join(said)}."
    else:
        yield f"None of {', '.join(facts.properties)} tells them from the other contacts with an impulse."


def _replayed(facts: Facts) -> Iterator[str]:
    """What became of the sampled failures."""
    failures, solver = facts.failures, facts.record.about["solver"]
    if not failures.sampled:
        return
    yield f"Of {failures.sampled} sampled ones secular solves {failures.solvable}, to a residual of at most"
    yield f"{number(failures.secular_left)} of the local b; {number(failures.left)} was left (median)."
    yield f"From the impulse without friction {solver} itself solves {failures.restarted}."
    if failures.empty:
        yield f"In {failures.empty} the contact was left with less than {_percent(EMPTY)} of the impulse it needs."


def _fallback(facts: Facts) -> Iterator[str]:
    fallback = facts.fallback
    if fallback is None or not fallback.sampled:
        return
    share = fallback.used / fallback.sampled
    margin = 0.0 if fallback.exact else 2 * math.sqrt(max(share, 1 / fallback.sampled) / fallback.sampled)
    sampled = "visits" if fallback.exact else "sampled visits"
    yield (
        f"The fall-back was used in {fallback.used} of {fallback.sampled} {sampled}"
        + ("." if fallback.exact else f" ({100 * share:.2g} ± {100 * margin:.1g} % of all).")
    )


def _growth(facts: Facts) -> Iterator[str]:
    growth = facts.growth
    if not math.isfinite(growth.size):
        return
    settled = abs(growth.factor - 1) < 0.01
    change = "as half-way" if settled else f"{growth.factor:.3g} times that of half-way"
    size = f"The root mean square of sigma_i r_i is {number(growth.size)} b, {change}"
    if growth.unbounded and not facts.record.about["solved"]:
        yield f"{size} (like sweeps^{growth.power:.2g}): above {LARGE:g} b and still growing, as in a jam."
    else:
        yield f"{size}."


def _motion(facts: Facts) -> Iterator[str]:
    motion, tolerance = facts.motion, float(facts.record.about["tolerance"])
    least, moving = f"{NEGLIGIBLE * tolerance:.0e} b", len(motion.contacts)
    over = f"over the last {_count(motion.sweeps, 'sweep')}"
    if facts.record.about["solved"] or motion.kind == "short":
        return
    if motion.kind == "still":
        yield f"None has moved by more than {least} {over}: the run stands still, and more sweeps change nothing."
        return
    what = {
        "cycle": f"The impulses cycle with period {motion.period}",
        "drift": f"The impulses drift along a straight line (way over path {motion.straightness:.2f})",
        "wander": f"The impulses wander without a period up to 32 (way over path {motion.straightness:.2f})",
    }[motion.kind]
    yield f"{what} {over}; {_count(moving, 'contact')} moved by more than {least},"
    yield f"{_percent(HELD)} of the squared movement on {_of(motion.movers, facts)}."
    if motion.change is not None:
        contact, regime, sweeps = motion.change
        does = {"open": "opens", "slip": "begins to slip"}[regime]
        yield f"Going on so, contact {contact} {does} in {number(_two_digits(sweeps))} sweeps."
    if motion.kind == "cycle":
        found, counts = np.unique(motion.periods[motion.periods > 0], return_counts=True)
        alone = ", ".join(f"{period} ({count})" for period, count in zip(found, counts, strict=True))
        yield f"Periods of single contacts: {alone}."


def _regimes(facts: Facts) -> Iterator[str]:
    record = facts.record
    counts = record.counts[-1]
    if not (visits := counts[:3].sum()):
        return
    shares = ", ".join(
        f"{_percent(c / visits)} {name}" for c, name in zip(counts, ("open", "stick", "slip"), strict=False)
    )
    half = 2 * record.sweeps > record.sweeps[-1]
    rate = record.counts[half, 5].sum() / (record.counts[half, :3].sum() / record.n)
    yield f"In the last sweep {shares}; in the second half of the run {number(float(rate))} changes a sweep."


def _attempts(facts: Facts) -> Iterator[str]:
    for a in facts.attempts:
        law = f", by its own law with {a.facets} facets" if a.facets else ""
        name = f"{a.solver}, {a.outer} outer loop{law}"
        yield (
            f"{name}: solved in {_count(a.sweeps, 'sweep')}."
            if a.solved
            else f"{name}: residual {a.residual:.1e} after {_count(a.sweeps, 'sweep')}."
        )


def _advice(facts: Facts) -> Iterator[str]:
    solved, sweeps = facts.record.about["solved"], int(facts.record.sweeps[-1])
    solving = [a for a in facts.attempts if a.solved and (not solved or a.sweeps <= FASTER * sweeps)]
    if solving:
        best = min(solving, key=lambda a: a.sweeps)
        yield f"{best.solver} by the {best.outer} outer loop: {_count(best.sweeps, 'sweep')}."
        if not solved:
            yield _difference(facts, solving)
    elif facts.attempts and solved:
        yield "Nothing that was tried takes clearly fewer sweeps."
    elif facts.attempts:
        best = min(facts.attempts, key=lambda a: a.residual)
        yield "Nothing that was tried solves the problem within the limits; the least residual is"
        yield f"{best.residual:.1e}, of {best.solver} by the {best.outer} outer loop."


def _difference(facts: Facts, solving: Sequence[Attempt]) -> str:
    """What has to be changed for the problem to be solved."""
    about = facts.record.about
    other_solver = any(a.outer == about["outer"] for a in solving)
    other_loop = any(a.solver == about["solver"] for a in solving)
    if other_solver and other_loop:
        return "Another local solver is enough, and so is the other outer loop."
    if other_solver:
        return "Another local solver is enough; the other outer loop alone is not."
    if other_loop:
        return "The other outer loop is enough, by itself."
    return "It takes another local solver and the other outer loop."


def _of(contacts: Counts, facts: Facts) -> str:
    """`3 of 40 contacts (17, 4, 9)`; named when they are few."""
    named = f" ({', '.join(map(str, contacts))})" if len(contacts) <= FEW else ""
    return f"{len(contacts)} of {facts.record.n} contacts{named}"


def _percent(share: float) -> str:
    """A share that is neither 0 nor 1 is never written as if it were."""
    if 0 < share < 0.001:
        return f"{100 * share:.1g} %"
    if 0.999 < share < 1:
        return "more than 99.9 %"
    return f"{100 * share:.3g} %"


def _count(number: int, unit: str) -> str:
    return f"{number} {unit}{'' if number == 1 else 's'}"
