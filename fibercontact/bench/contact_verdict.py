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

from fibercontact.local.contract import HONEST, Status
from fibercontact.local.one_contact import OneContacts, Replay, residuals
from fibercontact.problem.cone import COULOMB

__all__ = ["INACCURATE_ANSWER", "Verdict", "judge", "load_size", "reason_of", "tolerances", "velocities"]

F64 = NDArray[np.float64]

LARGEST = 1e10
"""Impulse relative to b, in velocity units, up to which rounding is granted."""
INACCURATE_ANSWER = "inaccurate answer"
"""The reason of a false success: claimed, and denied by the residual."""
FALSE_SUCCESS = -(2**62)


class Verdict(NamedTuple):
    """Of each contact: a code (0 solved, a failed status, or `FALSE_SUCCESS`), and the residuals of two laws.

    `residual` is of the solver's own law, `coulomb` of Coulomb's.
    """

    code: NDArray[np.int64]
    residual: F64
    coulomb: F64

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the solver claims an answer and is right."""
        return np.equal(self.code, int(Status.CONVERGED))

    @property
    def reasons(self) -> NDArray[np.object_]:
        """Why each contact failed, in words; '' where it is solved."""
        codes, index = np.unique(self.code, return_inverse=True)
        return np.array([reason_of(int(code)) for code in codes], dtype=object)[index]


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
    return HONEST + granted


def judge(contacts: OneContacts, found: Replay, facets: int) -> Verdict:
    """Judge a replay by the law with that many facets."""
    finite = np.isfinite(np.abs(found.r).max(axis=1))
    r = np.where(finite[:, None], found.r, 0.0)
    own = np.where(finite, residuals(contacts, r, facets), np.inf)
    coulomb = own if facets == COULOMB else np.where(finite, residuals(contacts, r, COULOMB), np.inf)
    claimed = np.equal(found.status, int(Status.CONVERGED))
    wrong = own > tolerances(contacts, r)
    return Verdict(np.where(claimed & wrong, FALSE_SUCCESS, found.status), own, coulomb)


def reason_of(code: int) -> str:
    """A verdict's code in words, '' for solved."""
    known = {int(s): s.name.lower().replace("_", " ") for s in Status}
    known |= {int(Status.CONVERGED): "", FALSE_SUCCESS: INACCURATE_ANSWER}
    return known.get(code, f"status {code}")


def velocities(contacts: OneContacts, r: F64) -> F64:
    """`W r / |b|`, (m, 3): answers are compared by it, impulses need not be unique."""
    return np.einsum("kij,kj->ki", contacts.W, r) / load_size(contacts)[:, None]
