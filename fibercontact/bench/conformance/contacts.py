"""The contacts that a local solver is checked with."""

import math
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import cache_folder
from fibercontact.local.contract import Matrix
from fibercontact.local.hard_set import hard_set
from fibercontact.local.one_contact import OneContacts, read, write
from fibercontact.problem.cone import Vector

__all__ = [
    "FRICTIONLESS", "PAGE", "SLIP", "STICK", "TAKE_OFF", "Case", "Contact", "from_page", "hard", "kind", "listed",
    "numbers", "ordinary", "posed", "scaled", "set_of", "spoilable", "spoilt_data", "spoilt_starts", "turned",
]  # fmt: skip

Array = NDArray[np.float64]


class Contact(NamedTuple):
    """The input of a kernel: a contact and the impulse to start from."""

    W: Matrix
    b: Vector
    mu: float
    r: Vector = (0.0, 0.0, 0.0)


PAGE = 16
"""Numbers in a contact."""


def numbers(contact: Contact) -> list[float]:
    """A contact as it is written on a page."""
    W, b, mu, r = contact
    return [*W[0], *W[1], *W[2], *b, mu, *r]


def from_page(page: Array) -> Contact:
    """The contact that was written on a page."""
    x = [float(value) for value in page]
    W = ((x[0], x[1], x[2]), (x[3], x[4], x[5]), (x[6], x[7], x[8]))
    return Contact(W, (x[9], x[10], x[11]), x[12], (x[13], x[14], x[15]))


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


@cache
def hard() -> OneContacts:
    """The hard set, kept beside the compiled kernels: its exact answers take seconds."""
    folder = cache_folder()
    if folder is None:
        return hard_set()
    file = folder / "hard_set.h5"
    if not file.is_file():
        write(file, hard_set())
    return read(file)


def set_of(contacts: Sequence[Contact]) -> OneContacts:
    """Contacts as a set for replay, without family and known answer."""
    W, b, mu, start = (np.array(column) for column in zip(*contacts, strict=True))
    return OneContacts(W, b, mu, start, np.full(len(contacts), ""), np.full((len(contacts), 3), np.nan))


def listed(contacts: OneContacts) -> Iterator[Contact]:
    """The contacts of a set one by one."""
    for W, b, mu, r in zip(contacts.W, contacts.b, contacts.mu, contacts.start, strict=True):
        yield _contact(W, b, mu, r)


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


def posed(cases: Sequence[Case]) -> Iterator[tuple[Contact, Vector]]:
    """Contacts with their exact answers: `b = u - W r`."""
    for mu, r, u in cases:
        for W in OPERATORS:
            yield _contact(W, np.array(u) - W @ r if any(r) else u, mu), r


def turned(contact: Contact, angle: float) -> tuple[Contact, Array]:
    """The contact with its tangents turned, and the map of its impulses."""
    c, s = math.cos(angle), math.sin(angle)
    Q = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    W = Q @ np.array(contact.W) @ Q.T
    return _contact(0.5 * (W + W.T), Q @ contact.b, contact.mu, Q @ contact.r), Q


def scaled(contact: Contact, s: float, t: float) -> tuple[Contact, Array]:
    """The contact in other units, `sW` and `tb`, and the map of its impulses."""
    W, b, r = np.array(contact.W), np.array(contact.b), np.array(contact.r)
    return _contact(s * W, t * b, contact.mu, t / s * r), t / s * np.eye(3)


# Data that are not finite


def spoilable() -> Iterator[Contact]:
    """Contacts to put a NaN or an infinity into: pressed and open, with and without friction."""
    for b_N in (-1.0, 1.0):
        for mu in (0.5, 0.0):
            yield _contact(OPERATORS[0], (b_N, 2.0, 0.5), mu, (1.0, 0.2, -0.1))


def spoilt_data(good: Contact) -> Iterator[Contact]:
    """The contact with a value that is not finite in one of the six entries of `W`, in one of `b`, or in `mu`."""
    for value in (math.nan, math.inf, -math.inf):
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            W = np.array(good.W)
            W[i, j] = W[j, i] = value
            yield _contact(W, good.b, good.mu, good.r)
        for k in range(3):
            yield good._replace(b=_with(good.b, k, value))
        yield good._replace(mu=value)


def spoilt_starts(good: Contact) -> Iterator[Contact]:
    """The contact with a value that is not finite in its start alone."""
    for value in (math.nan, math.inf, -math.inf):
        for k in range(3):
            yield good._replace(r=_with(good.r, k, value))


def _with(x: Vector, k: int, value: float) -> Vector:
    return tuple(value if j == k else x[j] for j in range(3))  # type: ignore[return-value]
