"""The page: what the template and the script are given, and the one file that they become.

A stranger's text reaches the page in two ways: through jinja2, which escapes it, and as JSON, which the script puts
into text nodes or, escaped once more, into plotly. The content security policy allows the page's own two scripts by
their hashes, and nothing from the network.
"""

import base64
import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fibercontact
from fibercontact.bench.html_report.choice import RULE
from fibercontact.bench.html_report.figures import (
    UNSAID,
    Style,
    accuracies_figure,
    convergence_figure,
    profile_figure,
    reasons_figure,
    rounded,
    styles,
    within_figure,
)
from fibercontact.bench.html_report.limitations import limitations
from fibercontact.bench.html_report.portraits import Portrait
from fibercontact.bench.html_report.runs import RunRead
from fibercontact.bench.html_report.tables import differing, headline_table, overview, side_by_side
from fibercontact.bench.protocol import ACCURACIES, BenchError
from fibercontact.bench.report import View, environment, number
from fibercontact.bench.rows import TIMED
from fibercontact.files import replace_file

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

__all__ = ["LARGEST", "Shown", "as_json", "page", "page_data", "write_page"]

LARGEST = 8_000_000
"""Bytes of a page, at most."""
STRATA = ("failure_percent", "sweeps_mean", "time_geo_ms")


@dataclass(frozen=True)
class Shown:
    """A run, and the problems of it that are looked at closely."""

    run: RunRead
    portraits: Sequence[Portrait]


def write_page(shown: Sequence[Shown], file: Path) -> int:
    """Write the page, whole or not at all; returns its bytes. Raises `BenchError` when it would be too large."""
    text = page(shown).encode("utf-8")
    if len(text) > LARGEST:
        raise BenchError(
            f"{file}: the page would have {len(text) / 1e6:.1f} MB, more than {LARGEST / 1e6:.0f}: "
            "ask for fewer runs, --curves or --rods"
        )
    replace_file(file, text)
    return len(text)


def page(shown: Sequence[Shown]) -> str:
    """The page's text."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup
    from plotly.offline import get_plotlyjs

    jinja = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates = files(__package__) / "templates"
    script = (templates / "page.js").read_text(encoding="utf-8")
    plotly = get_plotlyjs()
    jinja.filters["said"] = _said
    runs = [_for_template(one) for one in shown]
    read = [one.run for one in shown]
    return jinja.get_template("page.html").render(
        policy=policy(plotly, script),
        style=Markup((templates / "page.css").read_text(encoding="utf-8")),
        plotly=Markup(plotly),
        script=Markup(script),
        data=Markup(as_json(page_data(shown))),
        version=fibercontact.__version__,
        runs=runs,
        environment_keys=list(dict.fromkeys(key for run in runs for key in run["environment"])),
        overview=overview(read),
        beside=side_by_side(read),
        differing=differing(read),
        rule=RULE,
    )


def _said(value: Any) -> str:
    """A value of an environment in words."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {_said(inner)}" for name, inner in value.items())
    if isinstance(value, list):
        return ", ".join(map(_said, value))
    return number(value) if isinstance(value, float) else str(value)


def policy(*scripts: str) -> str:
    """A content security policy that allows these scripts, styles, and nothing from the network."""
    hashes = (hashlib.sha256(script.encode("utf-8")).digest() for script in scripts)
    allowed = " ".join(f"'sha256-{base64.b64encode(digest).decode()}'" for digest in hashes)
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def as_json(data: Any) -> str:
    """JSON that no HTML parser sees a tag in, nor a JavaScript parser a line end; what is not finite is null."""
    text = json.dumps(_finite(data), allow_nan=False, separators=(",", ":"))  # ASCII: U+2028 is escaped
    return text.replace("&", r"\u0026").replace("<", r"\u003c").replace(">", r"\u003e")


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, dict):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list) else data


def _for_template(one: Shown) -> dict[str, Any]:
    """A run as the template lays it out."""
    run = one.run
    return {
        "name": run.name,
        "remarks": run.remarks,
        "views": [
            {"view": view, "timed": view.mode == TIMED, "table": headline_table(view, run.solvers)}
            for view in run.views
        ],
        "environment": environment(run.rows),
        "limitations": limitations(run),
    }


def page_data(shown: Sequence[Shown]) -> dict[str, Any]:
    """What the script draws; solvers are numbered as on the page."""
    solvers = list(dict.fromkeys(solver for one in shown for solver in one.run.solvers))
    known = styles(solvers)
    return {
        "solvers": [
            {"name": name, "colour": style.colour, "dash": style.dash} for name, style in known.items()
        ],
        "runs": [_run(one, known) for one in shown],
    }


def _run(one: Shown, known: dict[str, Style]) -> dict[str, Any]:
    run = one.run
    marked = {portrait.problem_hash: k for k, portrait in enumerate(one.portraits)}
    accuracies = accuracies_figure(run.views, known)
    return {
        "name": run.name,
        "solvers": [known[name].number for name in run.solvers],
        "accuracies": _drawn(accuracies) if accuracies else None,
        "views": [_view(view, known, marked) for view in run.views],
        "portraits": [_portrait(portrait, known) for portrait in one.portraits],
    }


def _view(view: View, known: dict[str, Style], marked: dict[str, int]) -> dict[str, Any]:
    reasons = reasons_figure(view, known)
    timed = view.mode == TIMED
    return {
        "title": f"{view.accuracy} ({ACCURACIES[view.accuracy]:.0e}), {'timed' if timed else 'rates only'}",
        "timed": timed,
        "profile": _drawn(profile_figure(view, known)) if timed else None,
        "within": _drawn(within_figure(view, known)),
        "reasons": _drawn(reasons) if reasons else None,
        "strata": _strata(view, known),
        "problems": _problems(view, known, marked),
    }


def _drawn(figure: "Figure") -> dict[str, Any]:
    """Traces and layout, arrays packed as plotly packs them."""
    found: dict[str, Any] = json.loads(figure.to_json())
    found["layout"].pop("template", None)
    return {"data": found["data"], "layout": found["layout"]}


def _strata(view: View, known: dict[str, Style]) -> list[dict[str, Any]]:
    """By each kind of stratum, by stratum, by figure: a number a solver."""
    lines = []
    for (by, stratum), group in view.strata.groupby(["by", "stratum"], sort=False):
        mine = group.set_index("solver")
        at = {known[str(name)].number: name for name in mine.index}
        figures = {
            name: {number: rounded([mine.loc[solver, name]])[0] for number, solver in at.items()}
            for name in STRATA
        }
        lines.append({"by": by, "stratum": stratum, "problems": int(mine["problems"].max()), **figures})
    return lines


def _problems(view: View, known: dict[str, Style], marked: dict[str, int]) -> list[dict[str, Any]]:
    """A line a problem: what it is, and of each solver what came out."""
    lines = []
    for digest, group in view.rows.groupby("problem_hash", sort=False):
        row = group.iloc[0]
        lines.append(
            {
                "problem": row["problem"],
                "scene": row["scene"],
                "contacts": int(row["contacts"]),
                "mu": rounded([row["mu_max"]])[0],
                "existence": row["existence"],
                "portrait": marked.get(str(digest)),
                "runs": {known[run["solver"]].number: _outcome(run) for run in group.to_dict("records")},
            }
        )
    return lines


def _outcome(row: dict[Any, Any]) -> list[Any]:
    """Reason (empty: solved), time in ms, sweeps, residual of its own law, of Coulomb's, whether a false success."""
    time, sweeps, residual, coulomb = rounded(
        [1e3 * row["time_median"], row["sweeps"], row["residual"], row["coulomb"]]
    )
    reason = "" if row["solved"] else row["reason"] or UNSAID
    return [reason, time, sweeps, residual, coulomb, int(row["false_success"])]


def _portrait(portrait: Portrait, known: dict[str, Style]) -> dict[str, Any]:
    tolerance = ACCURACIES[portrait.accuracy]
    curves = _drawn(convergence_figure(portrait.curves, tolerance, known)) if portrait.curves else None
    rods = portrait.rods.figure
    return {
        "problem": portrait.problem,
        "words": f"{portrait.scene}, {portrait.contacts} contacts; accuracy {portrait.accuracy} ({tolerance:.0e})",
        "curves": curves,
        "notes": list(portrait.notes),
        "rods": _drawn(rods) if rods else None,
        "rods_words": portrait.rods.words,
    }
