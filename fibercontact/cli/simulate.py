"""`fibercontact simulate` and `fibercontact dump`: run a scene, and write its problems."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors

if TYPE_CHECKING:
    from fibercontact.simulation.step import Step

__all__ = ["dump", "simulate"]

SCENE_HELP = "Name of a scene; `list` lists them. NAME@clothoid, NAME@discrete: with other rods."


def simulate(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP)],
    steps: Annotated[
        int | None, typer.Option(help="Steps to run; all of the scene's by default.", min=1)
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for steps.csv and a picture of the last step.")
    ] = None,
    penalty: Annotated[
        float | None,
        typer.Option(help="Explicit penalty contact of this STIFFNESS, N/m.", metavar="STIFFNESS"),
    ] = None,
) -> None:
    """Run a scene: rods, contact, friction.

    Prints what happened; with --out also writes one row a step (contacts, sweeps, residual, energy, seconds)
    and a picture of the last step. Ctrl-C keeps what was run.

    Example: fibercontact simulate twist-wavy-48-mu0.4 --steps 100 --out runs/twist
    """
    with user_errors():
        if scene == "list":
            _list_scenes()
            return
        from dataclasses import replace

        from fibercontact.simulation.penalty import penalty_for
        from fibercontact.simulation.record import Recorder
        from fibercontact.simulation.scenes import build
        from fibercontact.simulation.step import simulate as run

        built = build(scene)
        built = replace(built, steps=min(steps or built.steps, built.steps))
        springs = None if penalty is None else penalty_for(built, penalty)
        recorder = Recorder(built)
        interrupted = False
        try:
            with _progress(scene, built.steps) as show:
                for step in run(built, penalty=springs):
                    recorder.add(step)
                    show(step)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if out is not None and recorder.rows:
                recorder.write(out)
                typer.echo(f"wrote {out / 'steps.csv'} and {out / 'last.png'}")
        typer.echo(recorder.summary())
    raise typer.Exit(130 if interrupted else 0)


def dump(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP + " `core306`: the whole corpus.")],
    out: Annotated[Path, typer.Option(help="Folder that the problems and their manifest go to.")],
    count: Annotated[
        int, typer.Option(help="Problems taken, evenly spaced among the eligible steps.", min=1)
    ] = 17,
    min_contacts: Annotated[int, typer.Option(help="Fewest contacts of an eligible step.", min=1)] = 20,
    max_contacts: Annotated[int, typer.Option(help="Most contacts of an eligible step.", min=1)] = 3000,
) -> None:
    """Write incremental problems of a scene as FCLIB files, with their starting guesses and a manifest.

    Example: fibercontact dump comb-wavy-61-mu0.5 --count 5 --out my_set
    """
    with user_errors():
        if scene == "list":
            _list_scenes()
            return
        from fibercontact.simulation.corpus import CORPUS, dump_corpus, dump_scene, write_manifest
        from fibercontact.simulation.scenes import SCENES, build

        if scene == CORPUS:
            with _progress(CORPUS, sum(build(name).steps for name in SCENES)) as show:
                total = sum(len(rows) for _, rows in dump_corpus(out, lambda _, step: show(step)))
        else:
            built = build(scene)
            with _progress(scene, built.steps) as show:
                rows = dump_scene(
                    built, out, count=count, fewest=min_contacts, most=max_contacts, progress=show
                )
            write_manifest(out, rows)
            total = len(rows)
        typer.echo(f"wrote {total} problems and manifest.csv to {out}")


def _list_scenes() -> None:
    from fibercontact.simulation.scenes import KINDS, SCENES

    for name, parameters in SCENES.items():
        documentation = (KINDS[parameters.kind].__doc__ or "").strip()
        typer.echo(f"{name:<28}{documentation}")


@contextmanager
def _progress(title: str, steps: int) -> Iterator[Callable[["Step"], None]]:
    """A bar over the steps, with the contacts of the last one."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=steps)

        def show(step: "Step") -> None:
            progress.update(task, advance=1, description=f"{title}: {len(step.contacts.gap)} contacts")

        yield show
