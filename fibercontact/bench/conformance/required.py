"""What the contract requires of a local solver: one function a check.

A check takes the solver as a `Subject`, returns what it saw in a sentence, and raises `Broken` with the first contact
that breaks the contract. Nothing here protects itself from a kernel that hangs or crashes: see `apart`.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numba.core import config
from numpy.typing import NDArray

from fibercontact.bench.conformance.contacts import (
    FRICTIONLESS,
    SLIP,
    STICK,
    TAKE_OFF,
    Case,
    Contact,
    hard,
    kind,
    listed,
    ordinary,
    posed,
    scaled,
    spoilable,
    spoilt_data,
    spoilt_starts,
    turned,
)
from fibercontact.bench.conformance.subject import (
    NOTHING,
    Broken,
    Subject,
    Unasked,
    distance,
    shown,
    status_name,
)
from fibercontact.local.contract import HONEST, Status
from fibercontact.local.registry import SolverError
from fibercontact.local.several import solve_several
from fibercontact.problem.cone import COULOMB, Vector, project

__all__ = ["REQUIRED", "Check", "answers"]

Array = NDArray[np.float64]
Check = Callable[[Subject], str]
Relation = Callable[[Contact], tuple[Contact, Array]]  # another contact, and the map of the impulses

NEAR = 1e-5
"""How far an answer may be from an exact one, in velocity units relative to b."""
FEW = 24
"""Contacts of checks that solve each several times."""


def declared(subject: Subject) -> str:
    """Its module has a docstring, each option says what it does."""
    entry = subject.local.registered
    if not entry.documentation.strip():
        raise Broken("the module has no docstring")
    for name, option in entry.solver.options.items():
        if not option.meaning.strip():
            raise Broken(f"option {name!r} has no meaning")
    law = f"pyramid with {subject.facets} facets" if subject.facets else "Coulomb"
    return f"{'exact solver' if subject.exact else 'step'}, {law}, {len(entry.solver.options)} option(s)"


def compiles(subject: Subject) -> str:
    """Its kernel compiles to `kernel(W, b, mu, r, options) -> (status, r, iterations)`."""
    try:
        subject.local.kernel()
    except SolverError as fault:
        raise Broken(str(fault), detail=str(fault.__cause__)) from fault
    except Exception as fault:  # whatever else the compiler stumbles over
        raise Broken(f"{type(fault).__name__}: {fault}") from fault
    return "to the signature of the contract"


def returns(subject: Subject) -> str:
    """A known status, iterations >= 0; no `CONVERGED` with an impulse that is not finite."""
    for contact in ordinary():
        answer = subject.visit(contact)
        if answer.status not in set(Status):
            raise Broken(f"status {answer.status} is no Status", contact)
        if answer.iterations < 0:
            raise Broken(f"{answer.iterations} iterations", contact)
        if answer.status == Status.CONVERGED and not _finite(answer.r):
            raise Broken(f"CONVERGED with the impulse {shown(answer.r)}", contact)
    return f"{len(ordinary())} contacts"


def take_off(subject: Subject) -> str:
    """Contacts that part are left alone."""
    return _exact_answers(subject, TAKE_OFF)


def stick(subject: Subject) -> str:
    """Contacts that friction can hold are held."""
    return _exact_answers(subject, STICK)


def slip(subject: Subject) -> str:
    """Contacts that friction cannot hold slide against it."""
    return _exact_answers(subject, SLIP)


def frictionless(subject: Subject) -> str:
    """Without friction the normal impulse alone."""
    return _exact_answers(subject, FRICTIONLESS)


def _exact_answers(subject: Subject, cases: Sequence[Case]) -> str:
    worst, count = 0.0, 0
    for contact, wanted in posed(cases):
        r = subject.solve(contact)
        if subject.facets == COULOMB:
            error, what = (
                distance(contact, r, wanted),
                f"{shown(wanted)} is the answer, not {shown(r)}: off by",
            )
        else:
            error, what = subject.residual(contact, r), "the residual of its own law is"
        if not error <= NEAR:
            raise Broken(f"{what} {error:.1e}", contact)
        worst, count = max(worst, error), count + 1
    return f"{count} contacts, {'exact answer' if subject.facets == COULOMB else 'own law'} to {worst:.0e}"


def cone(subject: Subject) -> str:
    """Impulses lie in the cone of its law."""
    claims = 0
    for contact in ordinary():
        answer = subject.visit(contact)
        if answer.status != Status.CONVERGED:
            continue
        claims += 1
        outside = distance(contact, answer.r, project(answer.r, contact.mu, subject.facets))
        if not outside <= HONEST:
            raise Broken(f"{shown(answer.r)} is outside, by {outside:.1e} relative to b", contact)
    return f"{claims} impulses"


def honest(subject: Subject) -> str:
    """`CONVERGED` only with a residual of at most 1e-6 (and rounding), whatever the contact."""
    if not subject.exact:
        raise Unasked("a step claims nothing")
    known = [_triple(answer) for answer in hard().answer]
    claims = [_honest_claim(subject, contact) for contact in ordinary()]
    claims += [_honest_claim(subject, *posed) for posed in zip(listed(hard()), known, strict=True)]
    return f"{sum(claims)} claims in {len(claims)} contacts, all true"


def _honest_claim(subject: Subject, contact: Contact, known: Vector = NOTHING) -> bool:
    """Whether it claims an answer, which must be one."""
    answer = subject.visit(contact)
    if answer.status != Status.CONVERGED:
        return False
    if not _finite(answer.r):
        raise Broken(f"CONVERGED with the impulse {shown(answer.r)}", contact)
    if why := subject.denies(contact, answer.r, known):
        raise Broken(f"claimed, but {why}", contact)
    return True


def rotation(subject: Subject) -> str:
    """Turned tangents, turned answer; for a polygon, by its own symmetry."""
    sector = 2.0 * math.pi / subject.facets if subject.facets else 1.0
    return _related(subject, [partial(turned, angle=k * sector) for k in (1, 2, 3)])


def scaling(subject: Subject) -> str:
    """Other units, same answer: `W -> sW`, `b -> tb` gives `r t/s`."""
    factors = ((2.0**30, 1.0), (2.0**-30, 1.0), (1.0, 2.0**30), (1.0, 2.0**-30))
    return _related(subject, [partial(scaled, s=s, t=t) for s, t in factors])


def _related(subject: Subject, relations: Sequence[Relation]) -> str:
    """The answer to a transformed contact is the transformed answer, and there is one if there was."""
    for contact in kind(FEW):
        solved, r = subject.settle(contact)
        for relation in relations:
            other, map_ = relation(contact)
            also, found = subject.settle(other)
            if solved != also:
                raise Broken(
                    f"{'not ' * also}solved before the transformation, {'not ' * solved}after", other
                )
            wanted = _triple(map_ @ np.array(r))
            if solved and not distance(other, found, wanted) <= NEAR:
                raise Broken(f"the answer is {shown(found)}, not the transformed one {shown(wanted)}", other)
    return f"{FEW} contacts, {len(relations)} transformations each"


def _triple(x: Array) -> Vector:
    return (float(x[0]), float(x[1]), float(x[2]))


def fixed_point(subject: Subject) -> str:
    """Started from a solution it stays there."""
    count = 0
    for contact in kind(FEW):
        solved, r = subject.settle(contact)
        if solved:
            _stays(subject, contact._replace(r=r))
            count += 1
    if subject.facets == COULOMB:
        for contact, r in posed([*TAKE_OFF, *STICK, *SLIP, *FRICTIONLESS]):
            _stays(subject, contact._replace(r=r))
            count += 1
    return f"{count} solutions"


def _stays(subject: Subject, start: Contact) -> None:
    again = subject.visit(start)
    if subject.exact and again.status != Status.CONVERGED:
        raise Broken(f"not solved from its solution: {status_name(again.status)}", start)
    if not distance(start, again.r, start.r) <= NEAR:
        raise Broken(f"left the solution for {shown(again.r)}", start)


def deterministic(subject: Subject) -> str:
    """The same input, the same bits: twice, and in another order."""
    contacts = ordinary()
    first, second = answers(subject), answers(subject, reverse=True)
    differs = first.view(np.uint64) != second.view(np.uint64)
    if differs.any():
        at = int(np.argmax(differs.any(axis=1)))
        raise Broken(f"{first[at].tolist()} once, {second[at].tolist()} later", contacts[at])
    return f"{len(contacts)} contacts"


def answers(subject: Subject, reverse: bool = False) -> Array:
    """What it answers to the wild and kind contacts: status, impulse and iterations, a row each."""
    contacts = ordinary()
    rows = np.empty((len(contacts), 5))
    for k in reversed(range(len(contacts))) if reverse else range(len(contacts)):
        answer = subject.visit(contacts[k])
        rows[k] = (answer.status, *answer.r, answer.iterations)
    return rows


def options_kept(subject: Subject) -> str:
    """The options are read, not written."""
    options = subject.local.options.copy()
    for contact in ordinary():
        subject.visit(contact, options)
        if options.tobytes() != subject.local.options.tobytes():
            raise Broken(f"the options were changed to {options.tolist()}", contact)
    return f"{len(options)} option(s)"


def not_finite(subject: Subject) -> str:
    """NaN and infinity: a status that is not `CONVERGED`, unless they are in the start only."""
    count = 0
    for good in spoilable():
        for contact in spoilt_data(good):
            count += 1
            if subject.visit(contact).status == Status.CONVERGED:
                raise Broken("CONVERGED", contact)
        for contact in spoilt_starts(good):
            count += 1
            _not_passed_on(subject, contact)
    return f"{count} inputs"


def _not_passed_on(subject: Subject, contact: Contact) -> None:
    """A start that is not finite may be ignored, but not end in a claim of nonsense."""
    if subject.exact:
        _honest_claim(subject, contact)
        return
    answer = subject.visit(contact)
    if answer.status == Status.CONVERGED and not _finite(answer.r):
        raise Broken(f"CONVERGED with the impulse {shown(answer.r)}", contact)


def several(subject: Subject) -> str:
    """Several contacts at once: what is done has the bits of the kernel's answer."""
    local, contacts = subject.local, ordinary()
    if local.registered.solver.several is None:
        raise Unasked("it takes one contact at a time")
    if config.DISABLE_JIT:
        raise Unasked("without a compiler there is one at a time")
    try:
        done, found, iterations = solve_several(
            local, *(np.array([getattr(c, name) for c in contacts]) for name in ("W", "b", "mu", "r"))
        )
    except SolverError as fault:
        raise Broken(str(fault), detail=str(fault.__cause__)) from fault
    for k in map(int, np.flatnonzero(done)):
        answer = subject.visit(contacts[k])
        if answer != (Status.CONVERGED, tuple(found[k].tolist()), iterations[k]):
            raise Broken(
                f"{shown(_triple(found[k]))} after {iterations[k]} iterations, the kernel has "
                f"{shown(answer.r)} after {answer.iterations}: {status_name(answer.status)}",
                contacts[k],
            )
    return f"{np.count_nonzero(done)} of {len(contacts)} contacts done"


def _finite(r: Vector) -> bool:
    return math.isfinite(r[0]) and math.isfinite(r[1]) and math.isfinite(r[2])


def _named(*checks: Check) -> dict[str, Check]:
    return {check.__name__.replace("_", " "): check for check in checks}


REQUIRED = _named(
    declared, compiles, returns, take_off, stick, slip, frictionless, cone, honest, rotation, scaling,
    fixed_point, deterministic, options_kept, not_finite, several,
)  # fmt: skip
"""The checks by name, in the order of the card."""
