"""`fibercontact table`: the comparison table, regenerated."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.bench.protocol import ACCURACIES, DEFAULT_SOLVERS, LOGS, BenchError
from fibercontact.cli.errors import check_known, user_errors
from fibercontact.cli.level1 import one_contact_table
from fibercontact.cli.options import (
    Dask,
    Limit,
    MaxSeconds,
    Memory,
    Outer,
    Plugins,
    Start,
    check_protocol,
    in_bytes,
    split_solvers,
    with_plugins,
)
from fibercontact.cli.screen import print_notes, print_table, screen

if TYPE_CHECKING:
    from fibercontact.bench.plan import Plan
    from fibercontact.bench.report import Report
    from fibercontact.bench.rows import Row, RowFile
    from fibercontact.global_methods.registry import AnyConfigured
    from fibercontact.local.registry import Configured

__all__ = ["table"]


def table(
    problems: Annotated[
        str | None,
        typer.Option(
            "--set", metavar="SET", help="core306, sample, or a folder of FCLIB files; a file of level 1."
        ),
    ] = None,
    solvers: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Local solvers or global methods, `NAME[:option=value,...]`; all local ones by default.",
        ),
    ] = None,
    all_global: Annotated[
        bool, typer.Option("--global", help="And all global methods: what one might use instead of sweeps.")
    ] = False,
    peers: Annotated[
        str | None,
        typer.Option(
            metavar="siconos,pinocchio", help="And other people's solvers, where they are installed."
        ),
    ] = None,
    plugin: Plugins = None,
    level: Annotated[
        int, typer.Option(help="3: whole problems. 1: one-contact problems, each solved once.", min=1, max=3)
    ] = 3,
    accuracy: Annotated[
        list[str] | None,
        typer.Option(metavar="LEVEL", help=f"Time at this accuracy: {', '.join(ACCURACIES)}; repeatable."),
    ] = None,
    rates: Annotated[
        list[str] | None,
        typer.Option(metavar="LEVEL", help="Failure rates only at this one, in parallel; repeatable."),
    ] = None,
    start: Start = "cold",
    outer: Outer = "plain",
    repetitions: Annotated[int, typer.Option(help="Timed passes.", min=3)] = 3,
    jobs: Annotated[int, typer.Option(help="Processes for the rates; 0: one a core.", min=0)] = 0,
    limit: Limit = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Run folder; runs/SET by default.")
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Start over; an earlier run is moved aside.")
    ] = False,
    max_sweeps: Annotated[int, typer.Option(help="Sweeps, or iterations, a problem at most.", min=1)] = 5000,
    max_seconds: MaxSeconds = 30.0,
    log: Annotated[
        str | None,
        typer.Option(
            metavar="visits", help="Log the visits of the passes that are not timed, in FOLDER/visits."
        ),
    ] = None,
    memory: Memory = None,
    dask: Dask = None,
) -> None:
    """Replay a set of problems through the solvers: failure rates, sweeps and times, in one table.

    Times are taken one after the other on one core, at low accuracy by default. Each result is written as it
    comes: the same command continues a run that was interrupted. The run folder gets the rows, the table
    (CSV, Markdown, LaTeX), figures by stratum, a performance profile and a plot of failures against time.

    For example:

    fibercontact table --rates mid

    fibercontact table --set my_problems/ --solvers hybrid,secular,pyramid:facets=8

    fibercontact table --plugin my_solver.py --limit 20

    fibercontact table --solvers secular --global --accuracy mid

    fibercontact table --solvers secular --peers siconos,pinocchio --accuracy mid

    fibercontact table --dask tcp://scheduler:8786 --rates mid

    fibercontact table --level 1
    """
    with user_errors():
        check_protocol([*(accuracy or []), *(rates or [])], start, outer)
        check_known("level", [str(level)], ["1", "3"])
        check_known("log", [log] if log else [], LOGS)
        if level == 1:
            if accuracy or rates or log or all_global or peers or dask or memory:
                raise BenchError(
                    "--accuracy, --rates, --log, --peers, --dask, --memory and --global belong to level 3: "
                    "at level 1 each contact is solved once"
                )
            one_contact_table(
                problems, _local(solvers, plugin or []), plugin or [], repetitions, limit, out, max_seconds
            )
            return
        from fibercontact.bench.environment import usable_cores
        from fibercontact.bench.plan import Plan
        from fibercontact.bench.problem_set import find_set, limited, load_set
        from fibercontact.bench.protocol import Limits
        from fibercontact.bench.rows import RowFile, move_away
        from fibercontact.bench.visits import check_sweeps

        if log:
            check_sweeps(max_sweeps)
        if dask:
            _check_cluster(accuracy, log)
            rates = rates or ["low"]
        folder = find_set(problems or "core306")
        entries = limited(load_set(folder), limit)
        plan = Plan(
            entries,
            _configured(solvers, plugin or [], all_global, _of_peers(peers)),
            timed=_ordered(accuracy if accuracy or rates else ["low"]),
            rates=_ordered([level for level in rates or [] if level not in (accuracy or [])]),
            start=start,
            outer=outer,
            repetitions=repetitions,
            jobs=jobs or len(usable_cores()),
            limits=Limits(max_sweeps, max_seconds),
            plugins=plugin or [],
            visits=log is not None,
            memory=in_bytes(memory),
        )
        run_folder = out or Path("runs") / folder.resolve().name
        if fresh and (moved := move_away(run_folder)):
            typer.echo(f"the earlier run is in {moved} now")
        faults = _run(plan, RowFile(run_folder), dask)
        _finish(plan, RowFile(run_folder), run_folder, faults)


def _check_cluster(accuracy: Sequence[str] | None, log: str | None) -> None:
    """Raise `BenchError` on what is not done on a cluster."""
    if accuracy:
        raise BenchError(
            "times are not taken on a cluster: ask for --rates there; the same command without --dask and with "
            "--accuracy then takes the times here, in the same folder"
        )
    if log:
        raise BenchError("visits are not logged on a cluster: --log and --dask do not go together")


def _ordered(levels: Sequence[str] | None) -> list[str]:
    """Accuracies from low to full, each once."""
    return [level for level in ACCURACIES if level in (levels or [])]


def _local(solvers: str | None, plugins: Sequence[Path]) -> "list[Configured]":
    """The local solvers asked for, by default all, the talk's first; those of plugins always."""
    from fibercontact.local.registry import configure, registered

    known = registered(plugins)
    given = split_solvers(solvers) if solvers is not None else [*DEFAULT_SOLVERS, *known]
    return [configure(text, known) for text in with_plugins(given, known, plugins)]


def _configured(
    solvers: str | None, plugins: Sequence[Path], all_global: bool, of_peers: Sequence[str]
) -> "list[AnyConfigured]":
    """The solvers asked for, by default all local ones, the talk's first; those of plugins always."""
    from fibercontact.global_methods.registry import is_global
    from fibercontact.peers.registry import configure, registered

    known = registered(plugins)
    local = [name for name in known if not is_global(known[name])]
    given = split_solvers(solvers) if solvers is not None else [*DEFAULT_SOLVERS, *local]
    methods = [name for name in known if is_global(known[name]) and known[name].origin == "built in"]
    given += methods if all_global else []
    return [configure(text, known) for text in with_plugins([*given, *of_peers], known, plugins)]


def _of_peers(names: str | None) -> list[str]:
    """Specifications of the solvers of the peers that are here, and a line for each that is not."""
    from fibercontact.peers.catalogue import PEERS, specifications
    from fibercontact.peers.peer import Missing

    found: list[str] = []
    given = split_solvers(names or "")
    check_known("peer", given, list(PEERS))
    for name in given:
        try:
            PEERS[name].find()
        except Missing as missing:
            typer.echo(f"skipped: {missing}", err=True)
        else:
            found += specifications(name)
    return found


def _run(plan: "Plan", rows: "RowFile", dask: str | None) -> list[str]:
    from fibercontact.bench.run import run
    from fibercontact.cli.progress import listening

    units = plan.work()
    try:
        with listening(units, rows) as listener:
            return run(plan, rows, listener, dask)
    except KeyboardInterrupt:
        typer.echo(f"interrupted; the same command continues from {rows.path}", err=True)
        raise typer.Exit(130) from None


def _finish(plan: "Plan", rows: "RowFile", folder: Path, faults: Sequence[str]) -> None:
    """Aggregate, print, write; exit code 2 when there were problems that could not be read."""
    from fibercontact.bench.report import make_report, write_report

    mine = _of_plan(plan, rows.read())
    if mine:
        report = make_report(mine, [solver.label for solver in plan.solvers])
        files = write_report(report, folder)
        _print(report)
        typer.echo(f"{folder}: {', '.join(file.name for file in files)}")
    for fault in faults:
        typer.echo(f"error: {fault}", err=True)
    if faults or not mine:
        raise typer.Exit(2)


def _of_plan(plan: "Plan", rows: "Sequence[Row]") -> "list[Row]":
    """The rows of this plan, with what the manifest says today."""
    from fibercontact.bench.rows import Key

    entries = {unit.key: unit.entry for unit in plan.units()}
    found = {key: row for row in rows if (key := Key.of(row)) in entries}
    return [
        row | {"existence": entries[key].existence, "scene": entries[key].scene, "problem": entries[key].name}
        for key, row in found.items()
    ]


def _print(report: "Report") -> None:
    from fibercontact.bench.report import BY_RODS, by_rods, display

    console = screen()
    for view in report.views:
        print_table(console, view.title, display(view).reset_index(), texts=("solver", "reasons"))
        print_notes(console, view.notes)
        if len(models := by_rods(view)):
            print_table(console, BY_RODS, models.reset_index(), texts=("solver",))
