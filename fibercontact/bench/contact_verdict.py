"""The verdict on a local solver's answers to one-contact problems: level 1 of the protocol.

An answer is right when its natural map, computed here, is at most `1e-6 |b|` and what rounding must be granted:
`r` in doubles, and `W r + b` evaluated in doubles, leave `6 (1 + mu) eps sigma |r|` of it, so that an exact answer
rounded to doubles always passes. An impulse cannot buy itself tolerance by being huge: `sigma |r|` counts up to
`1e10 |b|`, or up to the known answer where that is larger. With mu up to 10 and no such answer the tolerance is below
`2e-4 |b|`, and it is `1e-6 |b|` but for a per cent while `sigma |r|` is below `1e5 |b|`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.local.contract import Status
from fibercontact.local.one_contact import OneContacts, Replay, residuals
from fibercontact.problem.cone import COULOMB

__all__ = ["ACCEPTED", "INACCURATE_ANSWER", "Verdict", "judge", "load_size", "tolerances", "velocity_gap"]

F64 = NDArray[np.float64]

ACCEPTED = 1e-6
"""Residual relative to b."""
LARGEST = 1e10
"""Impulse relative to b, in velocity units, up to which rounding is granted."""
INACCURATE_ANSWER = "inaccurate answer"
"""The reason of a false success: claimed, and denied by the residual."""


class Verdict(NamedTuple):
    """Of each contact: why it failed ('' where it is solved), the residuals of the own law and of Coulomb's."""

    reason: NDArray[np.str_]
    residual: F64
    coulomb: F64

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the solver claims an answer and is right."""
        return self.reason == ""


def load_size(contacts: OneContacts) -> F64:
    """`|b|`, 1 where b = 0: what residuals and velocities are relative to."""
    size: F64 = np.linalg.norm(contacts.b, axis=1)
    return np.where(size > 0.0, size, 1.0)


def tolerances(contacts: OneContacts, r: F64) -> F64:
    """The residual that an answer must meet, (m,), relative to b."""

    def relative(x: F64) -> F64:
        return contacts.sigma * np.linalg.norm(x, axis=1) / load_size(contacts)

    bound = np.fmax(LARGEST, relative(contacts.answer))
    granted = 6.0 * (1.0 + contacts.mu) * np.finfo(float).eps * np.minimum(relative(r), bound)
    return ACCEPTED + granted


def judge(contacts: OneContacts, found: Replay, facets: int) -> Verdict:
    """Judge a replay by the law with that many facets."""
    finite = np.isfinite(np.abs(found.r).max(axis=1))
    r = np.where(finite[:, None], found.r, 0.0)
    own, coulomb = (np.where(finite, residuals(contacts, r, law), np.inf) for law in (facets, COULOMB))
    names = {int(status): _name(int(status)) for status in np.unique(found.status)}
    reason = np.array([names[int(status)] for status in found.status], dtype=object)
    wrong = own > tolerances(contacts, r)
    reason[(found.status == int(Status.CONVERGED)) & wrong] = INACCURATE_ANSWER
    return Verdict(reason.astype(np.str_), own, coulomb)


def _name(status: int) -> str:
    if status == Status.CONVERGED:
        return ""
    known = {int(s): s.name.lower().replace("_", " ") for s in Status}
    return known.get(status, f"status {status}")


def velocity_gap(contacts: OneContacts, r: F64, other: F64) -> F64:
    """`|W (r - other)| / |b|`, (m,): how far two answers are from each other; impulses need not be unique."""
    return np.linalg.norm(np.einsum("kij,kj->ki", contacts.W, r - other), axis=1) / load_size(contacts)
