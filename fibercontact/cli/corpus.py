"""`fibercontact corpus`: the sets of problems that the project makes from its own scenes."""

from pathlib import Path
from typing import Annotated

import typer

from fibercontact.cli.errors import user_errors

__all__ = ["corpus"]

corpus = typer.Typer(no_args_is_help=True, help="Make the sets of problems again from their scenes.")


@corpus.command("build")
def build(
    name: Annotated[
        str, typer.Argument(metavar="SET", help="Which set; `fibercontact corpus list` lists them.")
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder for the problems and their manifest; build/SET by default.")
    ] = None,
) -> None:
    """Run the scenes of a set and write its problems as FCLIB files, with starting guesses and a manifest.

    After an interruption the same command goes on with the next scene.

    Example: fibercontact corpus build rods102 --out build/rods102
    """
    with user_errors():
        from fibercontact.cli.simulate import progress_of
        from fibercontact.simulation.corpus import SETS, dump_set
        from fibercontact.simulation.scene import SceneError
        from fibercontact.simulation.scenes import build as build_scene

        if name not in SETS:
            raise SceneError(f"unknown set {name!r} (known: {', '.join(SETS)})")
        folder, problems = out or Path("build") / name, SETS[name]
        with progress_of(name, sum(build_scene(p).steps for p in problems.scenes)) as show:
            try:
                for scene, rows in dump_set(problems, folder, lambda _, step: show(step)):
                    typer.echo(f"{scene}: {len(rows)} problems")
            except KeyboardInterrupt:
                typer.echo("interrupted; the same command goes on with the next scene", err=True)
                raise typer.Exit(130) from None
    typer.echo(f"wrote {folder}, with manifest.csv")
    typer.echo(f"  fibercontact table --set {folder}")


@corpus.command("list")
def list_sets() -> None:
    """List the sets.

    Example: fibercontact corpus list
    """
    with user_errors():
        from fibercontact.simulation.corpus import SETS

        for problems in SETS.values():
            count = problems.per_scene * len(problems.scenes)
            typer.echo(
                f"{problems.name:<10}{count:>4} problems of {problems.fewest} to {problems.most} contacts "
                f"from {len(problems.scenes)} scenes"
            )
