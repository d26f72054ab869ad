"""Sets of problems: which steps of which scenes become problems, and how they are written.

The rule of `core306`, fixed before any local solver was run on the problems: of each scene, the steps with 20 to
3000 contacts are eligible; 17 of them are taken, evenly spaced in the order of time, the first and the last
included. Eighteen scenes give 306 problems. Other sets have other scenes and numbers.
"""

import csv
import hashlib
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

import fibercontact
from fibercontact.files import replace_file
from fibercontact.jit import content_key
from fibercontact.problem.fclib import Solution, write
from fibercontact.problem.step import StepProblem
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.scene import Scene, SceneError
from fibercontact.simulation.scenes import COMPARED, HEADS, SCENES, Parameters, build
from fibercontact.simulation.step import Step, World, simulate, start
from fibercontact.simulation.strands import MODELS

__all__ = ["CORE", "SETS", "Dump", "ProblemSet", "dump_scene", "dump_set", "evenly_spaced", "write_manifest"]


class ProblemSet(NamedTuple):
    """A set of problems: `per_scene` steps of each scene, of those with `fewest` to `most` contacts."""

    name: str
    scenes: Sequence[Parameters]
    per_scene: int
    fewest: int
    most: int


CORE = ProblemSet("core306", tuple(SCENES.values()), per_scene=17, fewest=20, most=3000)

RODS = ProblemSet(
    "rods102",
    tuple(replace(scene, model=model) for model in MODELS for scene in COMPARED.values()),
    per_scene=17,
    fewest=20,
    most=3000,
)

LARGE = ProblemSet("large", tuple(HEADS.values()), per_scene=4, fewest=3000, most=30_000)
"""From heads of up to four thousand fibres: some 250 MB and half an hour, so made where it is wanted."""

SETS = {problems.name: problems for problems in (CORE, RODS, LARGE)}
"""The sets by name."""

MANIFEST = "manifest.csv"
COLUMNS = ("file", "scene", "step", "contacts", "dofs", "mu_min", "mu_max", "bytes", "hash")
"""Columns of the manifest; `hash` is the SHA-256 of the file."""

Row = dict[str, object]


def evenly_spaced(eligible: Sequence[int], count: int) -> list[int]:
    """`count` of the eligible steps, evenly spaced by rank, first and last included.

    >>> evenly_spaced([3, 4, 5, 6, 7], 3)
    [3, 5, 7]
    """
    if len(eligible) < count:
        raise SceneError(f"only {len(eligible)} eligible steps, {count} are needed")
    ranks = np.round(np.linspace(0, len(eligible) - 1, count)).astype(int)
    return [eligible[rank] for rank in ranks]


def dump_scene(
    scene: Scene,
    folder: Path,
    *,
    count: int = CORE.per_scene,
    fewest: int = CORE.fewest,
    most: int = CORE.most,
    progress: Callable[[Step], None] = lambda step: None,
) -> list[Row]:
    """Run a scene and write `count` of its problems as FCLIB files; returns their manifest rows.

    Which steps they are is known at the end only. Until then the worlds before the eligible steps are kept,
    far smaller than the problems, and the chosen steps are taken again. Raises `SceneError` when fewer steps
    than `count` have `fewest` to `most` contacts.
    """
    folder.mkdir(parents=True, exist_ok=True)
    before: dict[int, World] = {}
    world = start(scene)
    for step in simulate(scene):
        progress(step)
        if step.problem is not None and fewest <= step.problem.n <= most:
            before[step.index] = world
        world = step.world
    try:
        chosen = evenly_spaced(list(before), count)
    except SceneError as error:
        raise SceneError(f"{scene.name}: {error} with {fewest} to {most} contacts") from None
    again = (next(simulate(scene, before[index], index)) for index in chosen)
    return [_write_step(scene, step, folder) for step in again]


def dump_set(
    problems: ProblemSet, folder: Path, progress: Callable[[str, Step], None] = lambda scene, step: None
) -> Iterator[tuple[str, list[Row]]]:
    """Write a set scene by scene, yielding each scene's name and manifest rows; its manifest comes last.

    What an interrupted call with the same sources has written into the folder is not made again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    draft = folder / f".{_sources()}.csv"
    rows: list[Row] = [row for row in _read_manifest(draft) if (folder / str(row["file"])).is_file()]
    for scene in map(build, problems.scenes):
        if sum(row["scene"] == scene.name for row in rows) == problems.per_scene:
            continue

        def of_scene(step: Step, name: str = scene.name) -> None:
            progress(name, step)

        new = dump_scene(
            scene,
            folder,
            count=problems.per_scene,
            fewest=problems.fewest,
            most=problems.most,
            progress=of_scene,
        )
        rows += new
        _write_rows(draft, rows)
        yield scene.name, new
    write_manifest(folder, rows)
    draft.unlink(missing_ok=True)


def _sources() -> str:
    """Key of the sources of this package: with others, other problems might come out."""
    return content_key(Path(fibercontact.__file__).parent.rglob("*.py"))


class Dump:
    """Writes every so-manieth step of a run as a problem, as the run goes on, and a manifest after each.

    Steps with fewer than `fewest` or more than `most` contacts are left out. A run that is taken up at the step
    `first` goes on with the manifest. Raises `SceneError` when a run from the start finds problems in the folder.
    """

    def __init__(
        self, scene: Scene, folder: Path, every: int, fewest: int, most: int, first: int = 0
    ) -> None:
        if first == 0 and folder.is_dir() and any(folder.glob("*.hdf5")):
            raise SceneError(f"{folder}: has problems already; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        self.scene, self.folder = scene, folder
        self.every, self.fewest, self.most = every, fewest, most
        self.rows: list[Row] = [
            row for row in _read_manifest(folder / MANIFEST) if int(str(row["step"])) < first
        ]

    def add(self, step: Step) -> None:
        """Write the problem of a step if it is one of those asked for."""
        if step.problem is None or step.index % self.every:
            return
        if self.fewest <= step.problem.n <= self.most:
            self.rows.append(_write_step(self.scene, step, self.folder))
            write_manifest(self.folder, self.rows)


def _read_manifest(file: Path) -> list[Row]:
    if not file.is_file():
        return []
    with file.open(newline="", encoding="utf-8") as stream:
        return [dict(row) for row in csv.DictReader(stream)]


def write_manifest(folder: Path, rows: Sequence[Row]) -> None:
    """Write `manifest.csv`, whole or not at all."""
    _write_rows(folder / MANIFEST, rows)


def _write_rows(file: Path, rows: Sequence[Row]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    replace_file(file, text.getvalue().encode())


def _write_step(scene: Scene, step: Step, folder: Path) -> Row:
    assert step.problem is not None
    problem = step.problem
    file = folder / f"{scene.name}-{step.index:03d}.hdf5"
    write(
        file,
        problem if isinstance(problem, StepProblem) else problem.condense(),
        title=f"{scene.name}, step {step.index}",
        description=f"{scene.description} Step of {scene.dt:g} s; the guess is the impulse of the step before.",
        math_info=rod_model(scene.rods).title,
        guesses=[Solution(r=step.guess)],
    )
    content = file.read_bytes()
    return {
        "file": file.name,
        "scene": scene.name,
        "step": step.index,
        "contacts": problem.n,
        "dofs": problem.d,
        "mu_min": problem.mu.min(),
        "mu_max": problem.mu.max(),
        "bytes": len(content),
        "hash": hashlib.sha256(content).hexdigest(),
    }
