"""`fibercontact render`: pictures of scenes and problems."""

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.screen import progress_bar
from fibercontact.errors import UserError

if TYPE_CHECKING:
    from fibercontact.bench.problem_set import Entry
    from fibercontact.simulation.pictures.animation import Picture
    from fibercontact.simulation.pictures.problem import Answered
    from fibercontact.simulation.pictures.shown import Shown
    from fibercontact.simulation.scene import Scene
    from fibercontact.simulation.step import Step

__all__ = ["render"]

STILLS, FILMS = (".png", ".html"), (".gif", ".mp4")
PROBLEMS = (".hdf5", ".h5")
FRAMES = 80  # of an animation, about, unless asked otherwise
TOLERANCE, MAX_SWEEPS = 1e-4, 2000  # of an answer that is computed to be drawn

WHAT_HELP = "A scene (`fibercontact simulate list`), an FCLIB file, or a problem of a set by its name."
OUT_HELP = (
    "By its suffix a .png, an .html to turn about, a .gif or .mp4 of the run; can be repeated. "
    "NAME.png and NAME.html by default."
)


class Look(NamedTuple):
    """How the pictures are to look: pixels, degrees, pictures a second."""

    size: int
    turn: float
    tilt: float
    fps: float


class Footage(NamedTuple):
    """What was run of a scene: the pictures of its animation, its last step, whether it was run to the end."""

    scene: "Scene"
    frames: list["Shown"]
    step: "Step"
    whole: bool


def render(
    what: Annotated[str, typer.Argument(metavar="SCENE|PROBLEM", help=WHAT_HELP)],
    out: Annotated[list[Path] | None, typer.Option(metavar="FILE", help=OUT_HELP)] = None,
    step: Annotated[int | None, typer.Option(help="Step to draw; the last by default.", min=0)] = None,
    time: Annotated[float | None, typer.Option(help="Time to draw instead, s.", min=0.0)] = None,
    rods: Annotated[bool, typer.Option("--rods", help="Draw the scene that a problem is from.")] = False,
    size: Annotated[int, typer.Option(help="Pixels of the longer side.", min=100, max=4000)] = 900,
    turn: Annotated[float, typer.Option(help="Turn of the camera about the vertical, degrees.")] = -30.0,
    tilt: Annotated[float, typer.Option(help="Degrees that it looks down.", min=-90, max=90)] = 20.0,
    every: Annotated[
        int | None,
        typer.Option(help=f"Steps between two pictures of an animation; some {FRAMES} in all.", min=1),
    ] = None,
    fps: Annotated[float, typer.Option(help="Pictures of an animation a second.", min=1, max=50)] = 20.0,
) -> None:
    """Draw a scene or a problem: rods, contacts by regime, forces.

    A scene is run up to the step that is drawn. A problem's file does not hold where its contacts are: its
    impulses are drawn in their friction cones, and with --rods the scene that the manifest beside it names is
    run up to its step. Ctrl-C keeps what was run, and of an animation what was drawn.

    Example: fibercontact render twist-wavy-48-mu0.4 --step 150

    Example: fibercontact render head-curly-96-mu0.6 --out head.gif --size 480

    Example: fibercontact render comb-wavy-61-mu0.5-249 --rods --out comb.png
    """
    with user_errors():
        from fibercontact.bench.problem_set import Entry, origin

        found = _named(what)
        problem = found if isinstance(found, Entry) else None
        files = out or [Path(found.name + suffix) for suffix in STILLS]
        _check_files(files)
        _check_options(problem is not None, rods, step is not None, time is not None)
        if problem and not rods:
            _draw_problem(problem, files)
            return
        if isinstance(found, Entry):
            name, step = origin(found)
            found = _scene(name)
        scene = found
        last = _last(scene, step, time)
        films = any(_suffix(file) in FILMS for file in files)
        footage = _run(scene, last, (every or math.ceil((last + 1) / FRAMES)) if films else 0)
        if problem:
            _compare(problem, footage.step)
        whole = [_draw_scene(file, footage, Look(size, turn, tilt, fps)) for file in files]
    raise typer.Exit(0 if footage.whole and all(whole) else 130)


def _suffix(file: Path) -> str:
    return file.suffix.lower()


def _named(what: str) -> "Entry | Scene":
    """The problem of an FCLIB file or of a set, or a scene."""
    from fibercontact.bench.problem_set import find_problem
    from fibercontact.bench.protocol import BenchError

    if Path(what).suffix.lower() in PROBLEMS:
        return find_problem(what)
    if Path(what).is_file():
        return _scene(what)
    try:
        return find_problem(what)
    except BenchError as no_problem:
        try:
            return _scene(what)
        except UserError as no_scene:
            raise UserError(f"{no_scene}; {no_problem}") from None


def _scene(name: str) -> "Scene":
    from fibercontact.simulation.scene_file import open_scene

    return open_scene(name)


def _check_files(files: Sequence[Path]) -> None:
    """Refuse what cannot be written, before anything is computed."""
    from fibercontact.simulation.pictures.animation import ffmpeg

    for file in files:
        if _suffix(file) not in STILLS + FILMS:
            raise UserError(f"{file}: pictures end in {', '.join(STILLS + FILMS)}")
        if not file.parent.is_dir():
            raise UserError(f"{file}: no such folder as {file.parent}")
        if file.is_dir() or not os.access(file if file.exists() else file.parent, os.W_OK):
            raise UserError(f"{file}: cannot be written")
        if _suffix(file) == ".mp4":
            ffmpeg()


def _check_options(problem: bool, rods: bool, step: bool, time: bool) -> None:
    if step and time:
        raise UserError("--step or --time, not both")
    if problem and (step or time):
        raise UserError("--step and --time are for scenes; a problem is one step of one")
    if rods and not problem:
        raise UserError("--rods is for problems; a scene is drawn with its rods anyway")


def _last(scene: "Scene", step: int | None, time: float | None) -> int:
    """The step to draw; the first that ends at the time or after it."""
    if time is not None:
        step = max(0, math.ceil(time / scene.dt - 1e-9) - 1)
    if step is None:
        return scene.steps - 1
    if step >= scene.steps:
        asked = f"step {step}" if time is None else f"{time:g} s"
        end = f"its last step, {scene.steps - 1}, ends at {scene.steps * scene.dt:g} s"
        raise UserError(f"{scene.name}: {asked} is beyond its end: {end}")
    return step


def _run(scene: "Scene", last: int, every: int) -> Footage:
    """Run a scene up to a step; every so many steps, counted from the last, are kept for an animation."""
    from fibercontact.simulation.pictures.shown import show
    from fibercontact.simulation.step import simulate

    frames, step = [], None
    try:
        with progress_bar(scene.name, last + 1) as advance:
            for step in simulate(scene):
                advance()
                if every and (last - step.index) % every == 0:
                    frames.append(show(scene, step))
                if step.index == last:
                    break
    except KeyboardInterrupt:
        if step is None:
            raise typer.Exit(130) from None
        typer.echo(f"stopped after step {step.index}", err=True)
    assert step is not None
    return Footage(scene, frames or [show(scene, step)], step, step.index == last)


def _compare(entry: "Entry", step: "Step") -> None:
    """Say whether the scene, run again, poses the problem of the file: motions part where rounding differs."""
    from fibercontact.bench.problem_set import content_hash
    from fibercontact.problem.fclib import read

    there = read(entry.file).problem
    if step.problem is None or content_hash(step.problem) != content_hash(there):
        found = f"{len(step.contacts.gap)} contacts where the file has {there.n}"
        typer.echo(f"warning: the scene, run again, does not pose this very problem: {found}", err=True)


def _draw_scene(file: Path, footage: Footage, look: Look) -> bool:
    """Write one picture; whether it is whole."""
    suffix = _suffix(file)
    if suffix in FILMS:
        count = _draw_film(file, footage, look)
        typer.echo(f"wrote {file}: {count} of {len(footage.frames)} pictures")
        return count == len(footage.frames)
    if suffix == ".html":
        _draw_page(file, footage, look)
    else:
        from fibercontact.simulation.pictures.still import draw

        draw(footage.scene, footage.step, file, look.size, look.turn, look.tilt)
    typer.echo(f"wrote {file}")
    return True


def _draw_film(file: Path, footage: Footage, look: Look) -> int:
    from fibercontact.simulation.pictures.animation import gif_rate, images, write_gif, write_mp4

    gif = _suffix(file) == ".gif"
    fps, write = (gif_rate(look.fps), write_gif) if gif else (look.fps, write_mp4)

    def drawn() -> "Iterator[Picture]":
        for picture in images(footage.scene, footage.frames, fps, look.size, look.turn, look.tilt):
            yield picture
            advance()

    with progress_bar(file.name, len(footage.frames)) as advance:
        return write(file, drawn(), fps)


def _draw_page(file: Path, footage: Footage, look: Look) -> None:
    from fibercontact.simulation.pictures.page import write_page
    from fibercontact.simulation.pictures.scene_page import scene_page
    from fibercontact.simulation.pictures.shown import show
    from fibercontact.simulation.pictures.still import caption

    scene, step = footage.scene, footage.step
    shown = show(scene, step)
    name, words = caption(scene, shown)
    write_page(scene_page(shown, step, look.turn, look.tilt), name, words, file)


def _draw_problem(entry: "Entry", files: Sequence[Path]) -> None:
    from fibercontact.files import replacing
    from fibercontact.simulation.pictures.page import write_page
    from fibercontact.simulation.pictures.problem import problem_figure, problem_page

    for file in files:
        if _suffix(file) in FILMS:
            raise UserError(f"{file}: a problem does not move; with --rods its scene does")
    answer = _answer(entry)
    for file in files:
        if _suffix(file) == ".html":
            write_page(problem_page(answer), answer.title, answer.words, file)
        else:
            with replacing(file) as draft:
                problem_figure(answer).savefig(draft)
        typer.echo(f"wrote {file}")


def _answer(entry: "Entry") -> "Answered":
    """The file's own solution if it is one, otherwise one that is computed here."""
    from fibercontact.gauss_seidel.solver import GaussSeidel
    from fibercontact.local.registry import configure, registered
    from fibercontact.problem.fclib import read
    from fibercontact.problem.incremental import IncrementalProblem
    from fibercontact.problem.measure import measure
    from fibercontact.simulation.pictures.problem import answered

    found = read(entry.file)
    posed = found.problem
    problem = posed if isinstance(posed, IncrementalProblem) else posed.condense()
    given = found.solution.r if found.solution else None
    if given is not None and measure(problem, given).residual <= TOLERANCE:
        return answered(entry.name, problem, given, "the file's solution")
    run = GaussSeidel(configure("secular", registered()), TOLERANCE, MAX_SWEEPS).solve(problem)
    return answered(
        entry.name, problem, run.r, "solved by secular" if run.claimed else "secular's best, not solved"
    )
