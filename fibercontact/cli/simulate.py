"""`fibercontact simulate`: run a scene, look at it, and write its problems."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.screen import progress_bar

if TYPE_CHECKING:
    from fibercontact.simulation.scene import Scene
    from fibercontact.simulation.step import Step

__all__ = ["SCENE_HELP", "progress_of", "simulate"]

SCENE_HELP = (
    "A scene: one of those that `list` lists, or a TOML or Python file. With @clothoid or @discrete behind it: with "
    "other rods."
)
PROBLEMS = "problems"
"""Folder of the problems, in that of the run."""


def simulate(
    scene: Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP)],
    steps: Annotated[
        int | None, typer.Option(help="Steps to run; all of the scene's by default.", min=1)
    ] = None,
    dt: Annotated[
        float | None, typer.Option(help="Time step in s instead of the scene's.", metavar="SECONDS")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for steps.csv, a picture of the last step, and the problems."),
    ] = None,
    dump: Annotated[
        str | None,
        typer.Option(
            metavar="every=K",
            help="Write every K-th step as a problem (FCLIB) into OUT/problems, with a manifest.",
        ),
    ] = None,
    min_contacts: Annotated[
        int, typer.Option(help="Fewest contacts of a problem that is written.", min=1)
    ] = 20,
    max_contacts: Annotated[
        int, typer.Option(help="Most contacts of a problem that is written.", min=1)
    ] = 1_000_000,
    checkpoint_every: Annotated[
        int | None,
        typer.Option(metavar="K", help="Write OUT/checkpoint.h5 every K steps and at the end.", min=1),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Go on from OUT/checkpoint.h5, bit for bit.")
    ] = False,
    penalty: Annotated[
        float | None,
        typer.Option(help="Explicit penalty contact of this STIFFNESS, N/m.", metavar="STIFFNESS"),
    ] = None,
) -> None:
    """Run a scene: rods, contact, friction.

    Prints what happened; with --out also writes one row a step (contacts, sweeps, residual, energy, seconds)
    and a picture of the last step. Ctrl-C keeps what was run, and with --checkpoint-every or --restart writes a
    checkpoint too. `fibercontact new-scene` writes a scene to start from; docs/scenes.md says what can be in it.

    Example: fibercontact simulate my_scene.toml --dump every=10 --min-contacts 50 --out runs/mine
    """
    with user_errors():
        if scene == "list":
            _list_scenes()
            return
        from dataclasses import replace

        from fibercontact.simulation.checkpoint import CHECKPOINT, load_checkpoint, save_checkpoint
        from fibercontact.simulation.penalty import penalty_for
        from fibercontact.simulation.record import Recorder
        from fibercontact.simulation.scene import SceneError
        from fibercontact.simulation.scene_file import open_scene
        from fibercontact.simulation.step import simulate as run

        every = _every(dump)
        built = open_scene(scene)
        built = replace(built, steps=steps or built.steps, dt=built.dt if dt is None else dt)
        if penalty is not None and every:
            raise SceneError("--penalty: explicit contact poses no problem to --dump")
        springs = None if penalty is None else penalty_for(built, penalty)
        checkpoints = checkpoint_every is not None or restart
        if out is None and (every or checkpoints):
            out = Path("runs") / built.name
        first, world = load_checkpoint(out / CHECKPOINT, built) if restart and out else (0, None)
        recorder = Recorder(built, out, first)
        write = _writer(built, out, every, min_contacts, max_contacts, first)

        def save(folder: Path) -> None:
            recorder.write_rows(folder)
            if recorder.last is not None:
                save_checkpoint(folder / CHECKPOINT, built, recorder.last.index, recorder.last.world)

        interrupted = False
        try:
            with progress_of(built.name, built.steps, first) as show:
                for step in run(built, world, first, penalty=springs):
                    recorder.add(step)
                    write(step)
                    show(step)
                    if out is not None and checkpoint_every and (step.index + 1) % checkpoint_every == 0:
                        save(out)
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if out is not None and recorder.last is not None:
                recorder.write(out)
                typer.echo(f"wrote {out / 'steps.csv'} and {out / 'last.png'}")
                if checkpoints:
                    save(out)
                    typer.echo(f"wrote {out / CHECKPOINT}: --restart goes on from there")
        if interrupted:
            typer.echo("interrupted", err=True)
        typer.echo(recorder.summary())
        if every and out is not None:
            _say_problems(out / PROBLEMS)
    raise typer.Exit(130 if interrupted else 0)


def _every(dump: str | None) -> int:
    """The K of `every=K`; 0 when no problems are asked for."""
    from fibercontact.simulation.scene import SceneError

    if dump is None:
        return 0
    if not (found := re.fullmatch(r"every=([1-9]\d*)", dump)):
        raise SceneError(f"--dump {dump}: write every=K, for instance --dump every=10")
    return int(found[1])


def _writer(
    scene: "Scene", out: Path | None, every: int, fewest: int, most: int, first: int
) -> "Callable[[Step], None]":
    """What writes the problems of the steps, if any."""
    from fibercontact.simulation.corpus import Dump

    if not every or out is None:
        return lambda step: None
    return Dump(scene, out / PROBLEMS, every, fewest, most, first).add


def _say_problems(folder: Path) -> None:
    count = len(list(folder.glob("*.hdf5")))
    typer.echo(
        f"wrote {count} problems to {folder}" + ("" if count else ": no such step had as many contacts")
    )
    if count:
        typer.echo(f"  fibercontact table --set {folder}")


def _list_scenes() -> None:
    from fibercontact.simulation.scenes import KINDS, NAMED

    for name, parameters in NAMED.items():
        documentation = (KINDS[parameters.kind].__doc__ or "").strip()
        typer.echo(f"{name:<34}{documentation}")


@contextmanager
def progress_of(title: str, steps: int, done: int = 0) -> "Iterator[Callable[[Step], None]]":
    """A bar over the steps, with the contacts of the last one."""
    with progress_bar(title, steps, done) as show:
        yield lambda step: show(f"{title}: {len(step.contacts.gap)} contacts")
