"""`fibercontact solve`: one problem, one solver."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fibercontact.bench.protocol import ACCURACIES, LOGS
from fibercontact.cli.errors import check_known, user_errors
from fibercontact.cli.options import Accuracy, MaxSeconds, Outer, Plugins, Start, check_protocol

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fibercontact.bench.passes import Laid
    from fibercontact.bench.plan import Unit
    from fibercontact.bench.protocol import Limits
    from fibercontact.gauss_seidel.solver import GaussSeidel
    from fibercontact.global_methods.registry import ConfiguredMethod
    from fibercontact.local.registry import Configured
    from fibercontact.problem.fclib import FclibFile
    from fibercontact.problem.incremental import IncrementalProblem

__all__ = ["solve"]


def solve(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An FCLIB file (HDF5).")],
    solver: Annotated[
        str, typer.Option(metavar="NAME", help="Local solver or global method, `NAME[:option=value,...]`.")
    ],
    accuracy: Accuracy = "mid",
    start: Start = "cold",
    outer: Outer = "plain",
    plugin: Plugins = None,
    max_sweeps: Annotated[int, typer.Option(help="Sweeps, or iterations, at most.", min=0)] = 5000,
    max_seconds: MaxSeconds = 30.0,
    out: Annotated[
        Path | None, typer.Option(metavar="ANSWER.hdf5", help="Write problem and answer here.")
    ] = None,
    log: Annotated[
        str | None,
        typer.Option(metavar="visits", help="Log every visit; the time is then not a measurement."),
    ] = None,
    log_file: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG.hdf5", help="Where; PROBLEM.SOLVER.ACCURACY.KEY.hdf5 in visits/ by default."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, for scripts.")] = False,
) -> None:
    """Solve the problem in an FCLIB file and measure the answer.

    The exit code is 0 only when the residual, recomputed from the answer, meets the accuracy's tolerance; 1
    when it does not; 2 for an error.

    Example: fibercontact solve FILE.hdf5 --solver hybrid --accuracy high --out ANSWER.hdf5
    """
    with user_errors():
        check_protocol([accuracy], start, outer)
        check_known("log", [log] if log else [], LOGS)
        _check_output(file, out)
        _check_output(file, log_file)
        from fibercontact.bench.passes import gauss_seidel, lay_out, starting_impulse
        from fibercontact.bench.protocol import BenchError, Limits
        from fibercontact.global_methods.registry import ConfiguredMethod
        from fibercontact.peers.registry import configure, registered
        from fibercontact.problem.fclib import read

        chosen = configure(solver, registered(plugin or []))
        found = read(file)
        first = starting_impulse(found, start)
        laid = lay_out(found.problem)
        limits = Limits(max_sweeps, max_seconds)
        if not isinstance(chosen, ConfiguredMethod):
            unit = _unit_to_log(file, chosen, accuracy, start, outer, limits) if log or log_file else None
            loop = gauss_seidel(chosen, ACCURACIES[accuracy], outer, limits)
            said = _by_sweeps(loop, laid, first, unit, log_file)
        elif log or log_file:
            raise BenchError(f"{solver} takes the whole problem: there are no visits to log")
        else:
            said = _globally(chosen, laid, first, accuracy, limits)
        r = said.pop("r")
        answer = {
            "file": str(file), "solver": solver, "accuracy": accuracy, "tolerance": ACCURACIES[accuracy],
            "contacts": laid.problem.n,
        } | said  # fmt: skip
        if out is not None:
            _write_answer(out, found, laid.problem, r)
        typer.echo(json.dumps(answer) if as_json else _lines(answer))
    raise typer.Exit(0 if answer["solved"] else 1)


def _unit_to_log(
    file: Path, local: "Configured", accuracy: str, start: str, outer: str, limits: "Limits"
) -> "Unit":
    from fibercontact.bench.plan import single
    from fibercontact.bench.problem_set import entry_of
    from fibercontact.bench.visits import check_sweeps

    check_sweeps(limits.sweeps)
    return single(entry_of(file), local, accuracy, start, outer, limits)


def _by_sweeps(
    loop: "GaussSeidel",
    laid: "Laid",
    first: "NDArray[Any] | None",
    unit: "Unit | None",
    log_file: Path | None,
) -> dict[str, Any]:
    """Solve by sweeps, the visits logged when the unit to log is given."""
    from fibercontact.bench.passes import judge, logged
    from fibercontact.bench.run import VISITS
    from fibercontact.bench.visits import log_file as default_log
    from fibercontact.bench.visits import write_log
    from fibercontact.problem.measure import measure

    if unit is not None:
        run, measured, record = logged(loop, laid, first, unit.about())
        log_file = log_file or default_log(Path(VISITS), unit.entry, unit.key)
        write_log(log_file, record)
    else:
        run = loop.solve_system(laid.system, laid.problem.b_ref, first)
        measured = measure(laid.problem, run.r, loop.local.facets)
    verdict = judge(run, measured, loop.tolerance)
    return {
        "r": run.r, "solved": verdict["solved"], "status": run.outcome.name.lower(),
        "message": run.outcome.sentence, "reason": verdict["reason"], "detail": verdict["detail"],
        "residual": measured.residual, "coulomb_residual": measured.coulomb,
        "sweeps": run.sweeps, "seconds": run.seconds, "log": str(log_file) if log_file else None,
    }  # fmt: skip


def _globally(
    method: "ConfiguredMethod", laid: "Laid", first: "NDArray[Any] | None", accuracy: str, limits: "Limits"
) -> dict[str, Any]:
    """Solve by a global method."""
    from fibercontact.bench.passes import solve_globally
    from fibercontact.bench.protocol import BenchError

    method.prepare()
    row = solve_globally(method, laid, first, ACCURACIES[accuracy], limits)
    if "r" not in row:
        raise BenchError(f"{method.label}: {row['detail']}")
    said = (
        "its residual met the tolerance, it says" if row["claimed"] else row["detail"] or "nothing is claimed"
    )
    kept = ("r", "solved", "reason", "detail", "residual", "sweeps", "seconds")
    return {name: row[name] for name in kept} | {
        "status": row["outcome"], "message": said, "coulomb_residual": row["coulomb"], "log": None
    }  # fmt: skip


def _lines(answer: dict[str, Any]) -> str:
    why = answer["detail"] or ("no local failure" if answer["reason"] == "outer" else "")
    solved = "solved" if answer["solved"] else f"not solved ({answer['reason']}{': ' if why else ''}{why})"
    return "\n".join(
        f"{name:<10}{text}"
        for name, text in (
            ("status", f"{solved}; {answer['message']}"),
            ("residual", f"{answer['residual']:.3e} (tolerance {answer['tolerance']:.0e})"),
            ("Coulomb", f"{answer['coulomb_residual']:.3e}"),
            ("sweeps", answer["sweeps"]),
            ("time", f"{1e3 * answer['seconds']:.3g} ms" + (" (visits logged)" if answer["log"] else "")),
            ("log", answer["log"]),
        )
        if text is not None
    )


def _check_output(file: Path, out: Path | None) -> None:
    """Refuse to write over the problem, or where nothing can be written, before anything is computed."""
    from fibercontact.bench.protocol import BenchError

    if out is None:
        return
    if out.exists() and file.exists() and out.samefile(file):
        raise BenchError(f"{out}: is the problem itself; give the answer another name")
    if not out.parent.is_dir():
        raise BenchError(f"{out}: no such folder")


def _write_answer(out: Path, found: "FclibFile", problem: "IncrementalProblem", r: "NDArray[Any]") -> None:
    """Write the problem with its guesses and the answer in the `solution` group."""
    from fibercontact.problem.fclib import Solution, write
    from fibercontact.problem.step import StepProblem

    v = found.problem.velocities(r) if isinstance(found.problem, StepProblem) else None
    guesses = [Solution(v=g.v if v is not None else None, u=g.u, r=g.r) for g in found.guesses]
    write(
        out,
        found.problem,
        title=found.title,
        description=found.description,
        math_info=found.math_info,
        guesses=guesses,
        solution=Solution(v=v, u=problem.W @ r + problem.b, r=r),
    )
