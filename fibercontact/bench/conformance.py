"""Whether a local solver keeps the contract (`fibercontact.local.contract`): one function a check.

A check takes the solver as a `Subject`, returns what it saw in a sentence, and raises `Broken` with the first contact
that breaks the contract. Nothing here protects itself from a kernel that hangs or crashes: see `bench.examination`.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.local.algebra import affine
from fibercontact.local.contract import HONEST, Matrix, Status
from fibercontact.local.registry import Configured, SolverError
from fibercontact.problem.cone import COULOMB, Vector, natural_map, norm, project

__all__ = [
    "CHECKS", "PAGE", "Check", "Contact", "Outcome", "Subject", "Table", "Verdict", "answers", "asks", "examine", "from_page", "literals",
    "ordinary",
]  # fmt: skip

Array = NDArray[np.float64]

NEAR = 1e-5
"""How far an answer may be from an exact one, in velocity units relative to b."""
VISITS = 1000
"""Visits in which a step must come to the solution of a kind contact."""
SETTLED = 1e-10
"""Residual at which a step is not visited again."""


class Outcome(StrEnum):
    """What became of a check."""

    PASS = "pass"
    FAIL = "FAIL"
    REPORTED = "reported"
    NOT_ASKED = "not asked"
    NOT_RUN = "not run"


class Contact(NamedTuple):
    """The input of a kernel: a contact and the impulse to start from."""

    W: Matrix
    b: Vector
    mu: float
    r: Vector = (0.0, 0.0, 0.0)


PAGE = 16
"""Numbers in a contact."""


class Table(NamedTuple):
    """Figures of a report, as they are shown."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Verdict:
    """One line of the report card; `counterexample` is the first contact that breaks the contract, as Python."""

    check: str
    outcome: str
    sentence: str
    counterexample: str = ""
    table: Table | None = None


class Broken(Exception):
    """The contract is broken; by this contact, if it takes one to see it."""

    def __init__(self, reason: str, contact: Contact | None = None) -> None:
        super().__init__(reason)
        self.reason, self.contact = reason, contact


class Unasked(Exception):  # noqa: N818
    """The contract does not ask this of such a solver; the message says why."""


class Answer(NamedTuple):
    """What a kernel returned."""

    status: int
    r: Vector
    iterations: int


class Subject:
    """The solver under examination. `page` (16,) holds the input that its kernel got last, come what may."""

    def __init__(self, local: Configured, page: Array | None = None) -> None:
        self.local, self.page = local, np.zeros(PAGE) if page is None else page
        self.exact, self.facets = local.registered.solver.exact, local.facets

    def visit(self, contact: Contact, options: Array | None = None) -> Answer:
        """Call the kernel, with a copy of the options unless they are given."""
        self.page[:] = _numbers(contact)
        kernel = self.local.kernel()
        try:
            answer = kernel(*contact, self.local.options.copy() if options is None else options)
            return Answer(*answer)
        except Exception as fault:
            raise Broken(f"raised {type(fault).__name__}: {fault}", contact) from fault

    def residual(self, contact: Contact, r: Vector) -> float:
        """Natural map of the solver's law relative to b (absolute when b = 0), as the harness measures it."""
        W, b, mu, _ = contact
        size = norm(natural_map(affine(W, r, b), r, mu, _sigma(W), self.facets))
        return size / (norm(b) or 1.0) if math.isfinite(size) else math.inf

    def settle(self, contact: Contact) -> tuple[bool, Vector]:
        """The answer, and whether it is one: of one visit, or of as many as a step needs."""
        answer = self.visit(contact)
        if self.exact:
            return answer.status == Status.CONVERGED, answer.r
        for _ in range(VISITS):
            if not self.residual(contact, answer.r) > SETTLED:
                break
            answer = self.visit(contact._replace(r=answer.r))
        return self.residual(contact, answer.r) <= HONEST, answer.r

    def solve(self, contact: Contact) -> Vector:
        """The answer to a contact that must be solved."""
        solved, r = self.settle(contact)
        if not solved and self.exact:
            raise Broken(f"not solved: {_status(self.visit(contact).status)}", contact)
        if not solved:
            left = self.residual(contact, r)
            raise Broken(f"not solved by {VISITS} visits: the residual is {left:.1e}", contact)
        return r


def _sigma(W: Matrix) -> float:
    return (W[0][0] + W[1][1] + W[2][2]) / 3.0


def _numbers(contact: Contact) -> list[float]:
    W, b, mu, r = contact
    return [*W[0], *W[1], *W[2], *b, mu, *r]


def from_page(page: Array) -> Contact:
    """The contact that was written on a page."""
    x = [float(value) for value in page]
    W = ((x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7], x[8]))
    return Contact(W, (x[9], x[10], x[11]), x[12], (x[13], x[14], x[15]))


def literals(contact: Contact, local: Configured) -> str:
    """The input of the kernel as Python statements."""
    lines = [f"{name} = {value!r}" for name, value in zip(("W", "b", "mu", "r"), contact, strict=True)]
    lines.append(f"options = np.array({local.options.tolist()!r})")
    text = "\n".join(lines)
    return f"from math import inf, nan\n{text}" if "inf" in text or "nan" in text else text


def _status(status: int) -> str:
    return Status(status).name if status in set(Status) else str(status)


def _distance(contact: Contact, r: Vector, wanted: Vector) -> float:
    """Between two impulses, in velocity units relative to b."""
    return _sigma(contact.W) * math.dist(r, wanted) / (norm(contact.b) or 1.0)


# Contacts


def _contact(W: Array, b: Any, mu: float, r: Any = (0.0, 0.0, 0.0)) -> Contact:
    """A contact from arrays."""
    return from_page(
        np.concatenate([W.ravel(), np.asarray(b, dtype=float), [mu], np.asarray(r, dtype=float)])
    )


def _definite(rng: np.random.Generator, condition: float) -> Array:
    """A random SPD matrix with extreme eigenvalues 1 and 1/condition, 0 when the condition is infinite."""
    Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    W = Q * np.array([1.0, 1.0 / condition, rng.uniform(1.0 / condition, 1.0)]) @ Q.T
    return 0.5 * (W + W.T)


@cache
def kind(count: int = 60) -> Sequence[Contact]:
    """Well-conditioned contacts with little friction: one solution each, which no method should miss."""
    rng, contacts = np.random.default_rng(1), []
    for k in range(count):
        b = rng.standard_normal(3)
        b[0] = abs(b[0]) if k % 6 == 0 else -abs(b[0])
        contacts.append(_contact(_definite(rng, rng.uniform(1.0, 4.0)), b, rng.uniform(0.05, 0.5)))
    return contacts


@cache
def wild(count: int = 300) -> Sequence[Contact]:
    """Condition numbers up to 1e6, singular ones in between, friction up to 10, any start."""
    rng, contacts = np.random.default_rng(2), []
    for k in range(count):
        condition = math.inf if k % 8 == 0 else 10.0 ** rng.uniform(0.0, 6.0)
        b = rng.standard_normal(3) * (-(10.0 ** rng.uniform(-3.0, 1.0)), 1.0, 1.0)
        start = rng.standard_normal(3) * rng.integers(0, 2)
        contacts.append(_contact(_definite(rng, condition), b, 10.0 ** rng.uniform(-2.0, 1.0), start))
    return contacts


@cache
def ordinary() -> Sequence[Contact]:
    """What most checks look at."""
    return [*kind(), *wild()]


OPERATORS = (
    np.array([[2.0, 0.2, -0.1], [0.2, 1.0, 0.1], [-0.1, 0.1, 1.5]]),
    np.array([[2.0, 0.0, 0.0], [0.0, 1.0, 0.3], [0.0, 0.3, 1.5]]),  # normal and tangents uncoupled
    0.75 * np.eye(3),
)

Case = tuple[float, Vector, Vector]  # mu, r and u that obey the law

TAKE_OFF: Sequence[Case] = (
    (0.4, (0.0, 0.0, 0.0), (0.3, 0.5, -1.0)),
    (0.4, (0.0, 0.0, 0.0), (0.3, 0.0, 0.0)),
    (0.4, (0.0, 0.0, 0.0), (0.0, 0.5, -1.0)),  # grazing
    (0.4, (0.0, 0.0, 0.0), (-0.0, 0.5, -1.0)),
    (0.4, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
)
STICK: Sequence[Case] = (
    (0.4, (1.0, 0.1, -0.2), (0.0, 0.0, 0.0)),
    (0.4, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)),  # no tangential load
    (0.5, (2.0, 0.6, 0.8), (0.0, 0.0, 0.0)),  # on the edge of the cone
)
SLIP: Sequence[Case] = (
    (0.5, (2.0, 0.6, -0.8), (0.0, -3.0, 4.0)),
    (0.5, (2.0, 0.6, 0.8), (0.0, -3e-9, -4e-9)),  # hardly
    (0.5, (2.0, -1.0, 0.0), (0.0, 0.1, 0.0)),  # along T1
    (1e-4, (2.0, 1.2e-4, 1.6e-4), (0.0, -3.0, -4.0)),  # little friction
)
FRICTIONLESS: Sequence[Case] = (
    (0.0, (2.0, 0.0, 0.0), (0.0, 3.0, 4.0)),
    (0.0, (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    (0.0, (0.0, 0.0, 0.0), (1.0, 3.0, 4.0)),
)


def _posed(cases: Sequence[Case]) -> Iterator[tuple[Contact, Vector]]:
    """Contacts with their exact answers: `b = u - W r`."""
    for mu, r, u in cases:
        for W in OPERATORS:
            yield _contact(W, np.array(u) - W @ r if any(r) else u, mu), r


# The checks that the contract requires


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
        raise Broken(str(fault)) from fault
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
            raise Broken(f"CONVERGED with the impulse {answer.r}", contact)
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
    worst, posed = 0.0, list(_posed(cases))
    for contact, wanted in posed:
        r = subject.solve(contact)
        if subject.facets == COULOMB:
            error, what = _distance(contact, r, wanted), f"{wanted} is the answer, not {r}: off by"
        else:
            error, what = subject.residual(contact, r), "the residual of its own law is"
        if not error <= NEAR:
            raise Broken(f"{what} {error:.1e}", contact)
        worst = max(worst, error)
    measure = "exact answer" if subject.facets == COULOMB else "own law"
    return f"{len(posed)} contacts, {measure} to {worst:.0e}"


def cone(subject: Subject) -> str:
    """Impulses lie in the cone of its law."""
    claims = 0
    for contact in ordinary():
        answer = subject.visit(contact)
        if answer.status != Status.CONVERGED:
            continue
        claims += 1
        outside = _distance(contact, answer.r, project(answer.r, contact.mu, subject.facets))
        if not outside <= HONEST:
            raise Broken(f"{answer.r} is outside, by {outside:.1e} relative to b", contact)
    return f"{claims} impulses"


def honest(subject: Subject) -> str:
    """`CONVERGED` only with a residual of at most 2e-6, whatever the contact."""
    if not subject.exact:
        raise Unasked("a step claims nothing")
    claims, worst, contacts = 0, 0.0, ordinary()
    for contact in contacts:
        answer = subject.visit(contact)
        if answer.status != Status.CONVERGED:
            continue
        residual = subject.residual(contact, answer.r)
        if not residual <= HONEST:
            raise Broken(f"claims the answer {answer.r}, whose residual is {residual:.1e}", contact)
        claims, worst = claims + 1, max(worst, residual)
    return f"{claims} claims in {len(contacts)} contacts, the largest residual {worst:.0e}"


def rotation(subject: Subject) -> str:
    """Turned tangents, turned answer; for a polygon, by its own symmetry."""
    sector = 2.0 * math.pi / subject.facets if subject.facets else 1.0
    return _related(subject, [partial(_turned, angle=k * sector) for k in (1, 2, 3)])


def scaling(subject: Subject) -> str:
    """Other units, same answer: `W -> sW`, `b -> tb` gives `r t/s`."""
    factors = ((2.0**30, 1.0), (2.0**-30, 1.0), (1.0, 2.0**30), (1.0, 2.0**-30))
    return _related(subject, [partial(_scaled, s=s, t=t) for s, t in factors])


Relation = Callable[[Contact], tuple[Contact, Array]]  # another contact, and the map of the impulses


def _related(subject: Subject, relations: Sequence[Relation]) -> str:
    """The answer to a transformed contact is the transformed answer, and there is one if there was."""
    for contact in kind():
        solved, r = subject.settle(contact)
        for relation in relations:
            other, map_ = relation(contact)
            also, found = subject.settle(other)
            if solved != also:
                raise Broken(
                    f"{'not ' * also}solved before the transformation, {'not ' * solved}after", other
                )
            wanted = _triple(map_ @ np.array(r))
            if solved and not _distance(other, found, wanted) <= NEAR:
                raise Broken(f"the answer is {found}, not the transformed one {wanted}", other)
    return f"{len(kind())} contacts, {len(relations)} transformations each"


def _turned(contact: Contact, angle: float) -> tuple[Contact, Array]:
    c, s = math.cos(angle), math.sin(angle)
    Q = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    W = Q @ np.array(contact.W) @ Q.T
    return _contact(0.5 * (W + W.T), Q @ contact.b, contact.mu, Q @ contact.r), Q


def _scaled(contact: Contact, s: float, t: float) -> tuple[Contact, Array]:
    W, b, r = np.array(contact.W), np.array(contact.b), np.array(contact.r)
    return _contact(s * W, t * b, contact.mu, t / s * r), t / s * np.eye(3)


def _triple(x: Array) -> Vector:
    return (float(x[0]), float(x[1]), float(x[2]))


def fixed_point(subject: Subject) -> str:
    """Started from the solution it stays there."""
    count = 0
    for contact in kind():
        solved, r = subject.settle(contact)
        if not solved:
            continue
        start = contact._replace(r=r)
        again, count = subject.visit(start), count + 1
        if subject.exact and again.status != Status.CONVERGED:
            raise Broken(f"the answer it gave is not one as a start: {_status(again.status)}", start)
        if not _distance(contact, again.r, r) <= NEAR:
            raise Broken(f"left the answer for {again.r}", start)
    return f"{count} solutions"


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
    spoiled = [(at, value) for at in range(10) for value in (math.nan, math.inf, -math.inf)]
    count = 0
    for good in _spoilable():
        for at, value in spoiled:
            contact, count = _spoil(good, at, value), count + 1
            if subject.visit(contact).status == Status.CONVERGED:
                raise Broken("CONVERGED", contact)
        for value in (math.nan, math.inf):
            for k in range(3):
                _check_start(subject, good._replace(r=_with(good.r, k, value)))
                count += 1
    return f"{count} inputs"


def _spoilable() -> Iterator[Contact]:
    for b_N in (-1.0, 1.0):
        for mu in (0.5, 0.0):
            yield _contact(OPERATORS[0], (b_N, 2.0, 0.5), mu, (1.0, 0.2, -0.1))


def _spoil(contact: Contact, at: int, value: float) -> Contact:
    """Put a value into one of the six entries of `W`, into one of `b`, or into `mu`."""
    if at == 9:
        return contact._replace(mu=value)
    if at >= 6:
        return contact._replace(b=_with(contact.b, at - 6, value))
    i, j = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))[at]
    W = np.array(contact.W)
    W[i, j] = W[j, i] = value
    return _contact(W, contact.b, contact.mu, contact.r)


def _with(x: Vector, k: int, value: float) -> Vector:
    return _triple(np.where(np.arange(3) == k, value, x))


def _check_start(subject: Subject, contact: Contact) -> None:
    """A start that is not finite may be ignored, but not passed on."""
    answer = subject.visit(contact)
    if answer.status != Status.CONVERGED:
        return
    if not _finite(answer.r):
        raise Broken(f"CONVERGED with the impulse {answer.r}", contact)
    if subject.exact and not subject.residual(contact, answer.r) <= HONEST:
        raise Broken(f"claims the answer {answer.r}", contact)


def _finite(r: Vector) -> bool:
    return math.isfinite(r[0]) and math.isfinite(r[1]) and math.isfinite(r[2])


# The suite

Check = Callable[[Subject], str]


def _named(*checks: Any) -> dict[str, Any]:
    return {check.__name__.replace("_", " "): check for check in checks}


REQUIRED: dict[str, Check] = _named(
    declared, compiles, returns, take_off, stick, slip, frictionless, cone, honest, rotation, scaling,
    fixed_point, deterministic, options_kept, not_finite,
)  # fmt: skip
CHECKS = REQUIRED


def asks(check: str) -> str:
    """What the contract asks, in a sentence."""
    return (CHECKS[check].__doc__ or "").strip().splitlines()[0]


def examine(local: Configured, name: str, page: Array | None = None) -> Verdict:
    """Run one check in this process."""
    subject = Subject(local, page)
    try:
        return Verdict(name, Outcome.PASS, CHECKS[name](subject))
    except Unasked as reason:
        return Verdict(name, Outcome.NOT_ASKED, str(reason))
    except Broken as fault:
        example = literals(fault.contact, local) if fault.contact else ""
        return Verdict(name, Outcome.FAIL, fault.reason, example)
