"""The report card of a local solver: what the contract asks, what was seen, the contact that breaks it."""

from collections.abc import Iterator, Sequence

from fibercontact.bench.conformance.suite import Outcome, Verdict, asks, holds
from fibercontact.bench.environment import cpu_model, versions
from fibercontact.bench.markdown import grid
from fibercontact.bench.passes import options_text
from fibercontact.local.registry import Configured

__all__ = ["COLUMNS", "headline", "lines_of", "markdown"]

COLUMNS = ("check", "outcome", "the contract asks", "seen")


def headline(local: Configured, verdicts: Sequence[Verdict]) -> str:
    """The verdict in one line."""
    failed = [verdict.check for verdict in verdicts if verdict.outcome == Outcome.FAIL]
    return f"{local.label}: " + (
        "the contract holds" if holds(verdicts) else f"the contract is broken: {', '.join(failed)}"
    )


def lines_of(verdicts: Sequence[Verdict]) -> Iterator[tuple[str, str, str, str]]:
    """The card's lines, in the order of `COLUMNS`."""
    for verdict in verdicts:
        yield verdict.check, verdict.outcome, asks(verdict.check), verdict.sentence


def markdown(local: Configured, verdicts: Sequence[Verdict]) -> str:
    """The whole card."""
    parts = [f"# {headline(local, verdicts)}", _subject(local)]
    parts.append("\n".join(grid(COLUMNS, lines_of(verdicts))))
    for verdict in verdicts:
        if verdict.detail:
            parts += [
                f"## {verdict.check}: what breaks the contract",
                verdict.sentence,
                f"```\n{verdict.detail}\n```",
            ]
        if verdict.table:
            parts += [f"## {verdict.check}", verdict.sentence, "\n".join(grid(*verdict.table))]
    return "\n\n".join(parts) + "\n"


def _subject(local: Configured) -> str:
    """What was examined, and with what."""
    entry = local.registered
    facts = {
        "solver": entry.summary,
        "from": f"{entry.origin} ({entry.fingerprint})",
        "options": options_text(local) or "none",
        "versions": ", ".join(f"{name} {value}" for name, value in versions().items()),
        "cpu": cpu_model(),
    }
    return "\n".join(f"* {name}: {value}" for name, value in facts.items())
