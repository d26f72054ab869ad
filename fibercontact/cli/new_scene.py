"""`fibercontact new-scene`: a scene to start from."""

from pathlib import Path
from typing import Annotated

import typer

from fibercontact.cli.errors import user_errors

__all__ = ["new_scene"]


def new_scene(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Where to write it.")],
) -> None:
    """Write a scene to start from: one TOML file, working and commented.

    Example: fibercontact new-scene my_scene.toml
    """
    with user_errors():
        from fibercontact.simulation import scene_file

        if file.suffix != ".toml":
            raise scene_file.SceneError(f"{file}: the file of a scene ends in .toml")
        template = Path(scene_file.__file__).with_name("template.toml").read_text(encoding="utf-8")
        with file.open("x", encoding="utf-8") as stream:
            stream.write(template)
    typer.echo(f"{file} written; it works as it is. Next:")
    typer.echo(f"  fibercontact simulate {file} --dump every=10 --min-contacts 50 --out runs/{file.stem}")
