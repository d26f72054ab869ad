"""`fibercontact explain`: why a run failed or was slow."""

import shutil
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.bench.protocol import OUTERS
from fibercontact.cli.errors import user_errors
from fibercontact.cli.options import Accuracy, MaxSeconds, Outer, Plugins, Start, check_protocol

if TYPE_CHECKING:
    from fibercontact.bench.explain import Facts
    from fibercontact.bench.plan import Unit
    from fibercontact.bench.visits import VisitRecord

__all__ = ["explain"]

WIDTH = 100


def explain(
    context: typer.Context,
    problem: Annotated[
        str, typer.Argument(metavar="PROBLEM", help="An FCLIB file, or the name of a problem of a set.")
    ],
    solver: Annotated[str, typer.Argument(metavar="SOLVER", help="Local solver, `NAME[:option=value,...]`.")],
    accuracy: Accuracy = "mid",
    start: Start = "cold",
    outer: Outer = "plain",
    plugin: Plugins = None,
    max_sweeps: Annotated[int, typer.Option(help="Sweeps at most.", min=0)] = 5000,
    max_seconds: MaxSeconds = 30.0,
    log: Annotated[
        Path | None,
        typer.Option(metavar="LOG.hdf5", help="Explain this log of `--log visits`, at what it ran with."),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Where the figure goes, as PNG and SVG.")
    ] = Path("runs/explain"),
) -> None:
    """Say in words and one figure why a solver fails on a problem or is slow.

    The problem is solved with every visit logged, and again by `secular` and by the accelerated outer loop for
    comparison. All that is said is measured; docs/explain.md says how.

    Example: fibercontact explain comb-wavy-61-mu0.5-249 pac
    """
    with user_errors():
        check_protocol([accuracy], start, outer)
        _check_alone(context, log)
        from fibercontact.bench.explain_words import title, words
        from fibercontact.bench.plan import single
        from fibercontact.bench.problem_set import find_problem
        from fibercontact.bench.protocol import Limits
        from fibercontact.bench.visits import check_sweeps
        from fibercontact.local.registry import configure, registered

        check_sweeps(max_sweeps)
        local = configure(solver, registered(plugin or []))
        unit = single(find_problem(problem), local, accuracy, start, outer, Limits(max_sweeps, max_seconds))
        out.mkdir(parents=True, exist_ok=True)
        facts = _facts(unit, log, plugin or [])
        typer.echo(title(facts))
        for subject, text in words(facts):
            typer.echo(_paragraph(subject, text))
        typer.echo(f"figure        {_draw(facts, out)}")


def _paragraph(subject: str, text: str) -> str:
    """A text beside its subject; a number and its % stay together."""
    whole = text.replace(" %", "\N{NO-BREAK SPACE}%")
    width = min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)
    lines = textwrap.fill(whole, width, initial_indent=f"{subject:<14}", subsequent_indent=14 * " ")
    return lines.replace("\N{NO-BREAK SPACE}", " ")


def _check_alone(context: typer.Context, log: Path | None) -> None:
    """Refuse a log together with options that it answers."""
    from fibercontact.bench.protocol import BenchError

    for name in ("accuracy", "start", "outer", "max_sweeps", "max_seconds") if log else ():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise BenchError(f"--{name.replace('_', '-')} beside --log: a log says itself what it ran with")


def _facts(unit: "Unit", log: Path | None, plugins: list[Path]) -> "Facts":
    """Run or read the log, and run the others."""
    from fibercontact.bench.explain import attempts, examine
    from fibercontact.bench.passes import gauss_seidel, lay_out, logged, starting_impulse
    from fibercontact.local.registry import configure, registered
    from fibercontact.problem.fclib import read

    known = registered(plugins)
    local, secular = configure(unit.key.solver, known), configure("secular", known)
    file = read(unit.entry.file)
    laid = lay_out(file.problem)
    record = _logged_before(log, unit) if log else None
    about = record.about if record else unit.about()
    start = starting_impulse(file, str(about["start"]))
    if record is None:
        loop = gauss_seidel(local, float(about["tolerance"]), unit.key.outer, unit.key.limits)
        _, _, record = logged(loop, laid, start, about)
    mine = (local.label, about["outer"])
    others = [(solver, outer) for outer in OUTERS for solver in dict.fromkeys((local.label, "secular"))]
    tried = attempts(laid, start, about, [(configure(s, known), o) for s, o in others if (s, o) != mine])
    return examine(record, laid, local, secular, list(tried))


def _logged_before(log: Path, unit: "Unit") -> "VisitRecord":
    """A log from disk; raises `BenchError` when it is about another problem or solver."""
    from fibercontact.bench.protocol import BenchError
    from fibercontact.bench.visits import read_log

    record = read_log(log)
    asked = {"problem_hash": unit.key.problem_hash, "solver": unit.key.solver}
    for name, value in asked.items():
        if record.about[name] != value:
            found = f"{record.about['problem']} by {record.about['solver']}"
            raise BenchError(f"{log}: is about {found}, not {unit.entry.name} by {unit.key.solver}")
    if record.about["fingerprint"] != unit.key.fingerprint:
        typer.echo(f"warning: {log}: {unit.key.solver} has changed since", err=True)
    return record


def _draw(facts: "Facts", out: Path) -> Path:
    from fibercontact.bench.explain_figure import draw
    from fibercontact.bench.figures import save

    about = facts.record.about
    name = f"{about['problem']}.{about['solver']}.{about['accuracy']}".replace(":", "-").replace("/", "-")
    save(draw(facts), out, name)
    return out / f"{name}.png"
