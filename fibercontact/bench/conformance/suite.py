"""The suite: every check by its name, run in this process."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fibercontact.bench.conformance.contacts import Contact
from fibercontact.bench.conformance.reports import REPORTS, Report, Table
from fibercontact.bench.conformance.required import REQUIRED
from fibercontact.bench.conformance.subject import Broken, Subject, Unasked
from fibercontact.local.registry import Configured

__all__ = ["CHECKS", "Outcome", "Verdict", "asks", "examine", "failed", "holds"]


class Outcome(StrEnum):
    """What became of a check."""

    PASS = "pass"
    FAIL = "FAIL"
    REPORTED = "reported"
    NOT_ASKED = "not asked"
    NOT_RUN = "not run"


@dataclass(frozen=True)
class Verdict:
    """One line of the report card; `detail` is the first input that breaks the contract, as Python."""

    check: str
    outcome: Outcome
    sentence: str
    detail: str = ""
    table: Table | None = None


CHECKS: dict[str, Callable[[Subject], str | Report]] = {**REQUIRED, **REPORTS}


def asks(check: str) -> str:
    """What is asked, in a sentence."""
    return (CHECKS[check].__doc__ or "").strip().splitlines()[0]


def examine(local: Configured, check: str, page: NDArray[np.float64] | None = None) -> Verdict:
    """Run one check; `page` as in `Subject`."""
    try:
        found = CHECKS[check](Subject(local, page))
    except Unasked as reason:
        return Verdict(check, Outcome.NOT_ASKED, str(reason))
    except Broken as fault:
        verdict = failed(local, check, fault.reason, fault.contact)
        return replace(verdict, detail=fault.detail) if fault.detail else verdict
    if isinstance(found, Report):
        return Verdict(check, Outcome.REPORTED, found.sentence, table=found.table)
    return Verdict(check, Outcome.PASS, found)


def failed(local: Configured, check: str, reason: str, contact: Contact | None = None) -> Verdict:
    """The verdict on a breach, with the contact that shows it."""
    return Verdict(check, Outcome.FAIL, reason, _literals(contact, local) if contact else "")


def _literals(contact: Contact, local: Configured) -> str:
    """The input of the kernel as Python statements."""
    lines = [f"{name} = {value!r}" for name, value in zip(("W", "b", "mu", "r"), contact, strict=True)]
    text = "\n".join([*lines, f"options = {local.options.tolist()!r}"])
    return f"from math import inf, nan\n{text}" if "inf" in text or "nan" in text else text


def holds(verdicts: Sequence[Verdict]) -> bool:
    """Whether the contract holds: nothing failed and nothing was left out."""
    return not any(verdict.outcome in (Outcome.FAIL, Outcome.NOT_RUN) for verdict in verdicts)
