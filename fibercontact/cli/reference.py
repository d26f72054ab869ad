"""`fibercontact reference`: ground truth for every problem of a set."""

from pathlib import Path
from typing import Annotated

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.options import Dask, Limit, Memory, in_bytes
from fibercontact.cli.screen import print_notes, print_table, progress_bar, screen

__all__ = ["reference"]


def reference(
    problems: Annotated[
        str, typer.Argument(metavar="SET", help="core306, sample, or a folder of FCLIB files.")
    ],
    jobs: Annotated[int, typer.Option(help="Processes; 0: one a core.", min=0)] = 0,
    bar: Annotated[
        float, typer.Option(help="Residual that a reference must meet.", min=1e-15, max=1.0)
    ] = 1e-10,
    max_seconds: Annotated[
        float, typer.Option(help="Seconds to look for one reference.", min=0.1, max=1e5)
    ] = 120.0,
    starts: Annotated[int, typer.Option(help="Other starts to look for other solutions from.", min=0)] = 2,
    limit: Limit = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="SET.references.hdf5 beside the set by default.")
    ] = None,
    memory: Memory = None,
    dask: Dask = None,
) -> None:
    """Find and store the truth about every problem of a set; the problems' own files are never touched.

    For each: whether it has a solution, with a certificate that is checked apart; a reference solution, accepted by
    its residual alone; the solution of the associated (convexified) law and how far it is from Coulomb's; and whether
    other starts lead to other velocities. Each is stored as it comes: the same command continues a run that
    was interrupted. The table goes to a CSV file beside the references.

    For example:

    fibercontact reference core306 --jobs 2

    fibercontact reference my_problems/ --limit 10 --max-seconds 20

    fibercontact reference my_problems/ --dask tcp://scheduler:8786
    """
    with user_errors():
        from fibercontact.bench.environment import usable_cores
        from fibercontact.bench.problem_set import find_set, limited, load_set
        from fibercontact.bench.references import (
            find_references,
            reference_frame,
            reference_notes,
            summary,
        )
        from fibercontact.bench.rows import Row
        from fibercontact.files import replace_file
        from fibercontact.reference.ground_truth import Search
        from fibercontact.reference.store import references_file
        from fibercontact.reference.truth import NONE

        folder = find_set(problems)
        entries = limited(load_set(folder), limit)
        file = out or references_file(folder)
        found = 0

        def listen(row: Row) -> None:
            nonlocal found
            found += row["reference"] != NONE
            show(f"{found} references  {row['problem']}")

        try:
            with progress_bar("reference", len(entries)) as show:
                search = Search(bar, max_seconds, starts)
                rows, faults = find_references(
                    entries, file, search, jobs or len(usable_cores()), listen, dask, in_bytes(memory)
                )
        except KeyboardInterrupt:
            typer.echo(
                f"interrupted; the same command continues from {file.with_name(file.stem)}.parts", err=True
            )
            raise typer.Exit(130) from None
        frame = reference_frame(rows)
        if rows:
            replace_file(file.with_suffix(".csv"), frame.to_csv(index=False).encode())
            console = screen()
            print_table(console, "references", summary(frame))
            print_notes(console, reference_notes(frame))
            typer.echo(f"{file}, {file.with_suffix('.csv').name}")
        for fault in faults:
            typer.echo(f"error: {fault}", err=True)
        if faults:
            raise typer.Exit(2)
