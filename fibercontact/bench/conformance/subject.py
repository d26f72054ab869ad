"""The solver under examination, and what it means to break the contract."""

import math
import sys
from typing import Any, NamedTuple

import numpy as np
from numba.core import config
from numpy.typing import NDArray

from fibercontact.bench.conformance.contacts import PAGE, Contact, numbers
from fibercontact.local.algebra import LARGEST, affine
from fibercontact.local.contract import HONEST, Matrix, Status
from fibercontact.local.registry import Configured
from fibercontact.problem.cone import Vector, natural_map, norm

__all__ = ["NOTHING", "VISITS", "Answer", "Broken", "Subject", "Unasked", "distance", "shown", "status_name"]

Array = NDArray[np.float64]

VISITS = 1000
"""Visits in which a step must come to the solution of a kind contact."""
SETTLED = 1e-10
"""Residual at which a step is not visited again."""
NOTHING = (0.0, 0.0, 0.0)


class Broken(Exception):
    """The contract is broken; by this contact, or with this to say about it."""

    def __init__(self, reason: str, contact: Contact | None = None, detail: str = "") -> None:
        super().__init__(reason)
        self.reason, self.contact, self.detail = reason, contact, detail


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
        self.page[:] = numbers(contact)
        kernel, options = self.local.kernel(), self.local.options.copy() if options is None else options
        try:
            if config.DISABLE_JIT:
                return _interpreted(kernel, contact, options)
            return Answer(*kernel(*contact, options))
        except Exception as fault:
            raise Broken(f"raised {type(fault).__name__}: {fault}", contact) from fault

    def residual(self, contact: Contact, r: Vector) -> float:
        """Natural map of the solver's law relative to b (absolute when b = 0), as the harness measures it."""
        W, b, mu, _ = contact
        size = norm(natural_map(affine(W, r, b), r, mu, _sigma(W), self.facets))
        return size / (norm(b) or 1.0) if math.isfinite(size) else math.inf

    def denies(self, contact: Contact, r: Vector, known: Vector = NOTHING) -> str:
        """Why `r` is no answer, '' if it is one. What rounding leaves of a residual is granted.

        `r` in doubles and `W r + b` evaluated in doubles leave `6 (1 + mu) eps sigma |r|`. An impulse cannot buy
        itself tolerance by being huge: `LARGEST` times b counts at most, or a `known` answer that is larger.
        """
        size = min(distance(contact, r, NOTHING), max(LARGEST, distance(contact, known, NOTHING)))
        residual, granted = (
            self.residual(contact, r),
            6.0 * (1.0 + contact.mu) * sys.float_info.epsilon * size,
        )
        return "" if residual <= HONEST + granted else f"the residual of {shown(r)} is {residual:.1e}"

    def settle(self, contact: Contact) -> tuple[bool, Vector]:
        """The answer, and whether it is one: of one visit, or of as many as a step needs."""
        answer = self.visit(contact)
        if self.exact:
            return answer.status == Status.CONVERGED, answer.r
        before = contact.r
        for _ in range(VISITS):
            if answer.r == before or not self.residual(contact, answer.r) > SETTLED:
                break
            before = answer.r
            answer = self.visit(contact._replace(r=before))
        return self.residual(contact, answer.r) <= HONEST, answer.r

    def solve(self, contact: Contact) -> Vector:
        """The answer to a contact that must be solved."""
        solved, r = self.settle(contact)
        if not solved and self.exact:
            raise Broken(f"not solved: {status_name(self.visit(contact).status)}", contact)
        if not solved:
            left = self.residual(contact, r)
            raise Broken(f"{VISITS} visits do not solve it: the residual is {left:.1e}", contact)
        return r


def _interpreted(kernel: Any, contact: Contact, options: Array) -> Answer:
    """Call a kernel that is not compiled, with numbers whose division by zero is an infinity as if it were."""
    x = np.array(numbers(contact))
    with np.errstate(all="ignore"):
        status, r, iterations = kernel(
            (tuple(x[:3]), tuple(x[3:6]), tuple(x[6:9])), tuple(x[9:12]), x[12], tuple(x[13:]), options
        )
    return Answer(status, (float(r[0]), float(r[1]), float(r[2])), iterations)


def _sigma(W: Matrix) -> float:
    return (W[0][0] + W[1][1] + W[2][2]) / 3.0


def status_name(status: int) -> str:
    """Name of a status, or the number that is none."""
    return Status(status).name if status in set(Status) else str(status)


def shown(r: Vector) -> str:
    """An impulse to six digits."""
    return f"({r[0]:.6g}, {r[1]:.6g}, {r[2]:.6g})"


def distance(contact: Contact, r: Vector, wanted: Vector) -> float:
    """Between two impulses, in velocity units relative to b."""
    return _sigma(contact.W) * math.dist(r, wanted) / (norm(contact.b) or 1.0)
