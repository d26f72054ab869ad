"""The corpus: which steps of the scenes become problems, and how they are written.

The rule, fixed before any local solver was run on the problems: of each scene, the steps with 20 to 3000
contacts are eligible; 17 of them are taken, evenly spaced in the order of time, the first and the last
included. Eighteen scenes give 306 problems.
"""

import csv
import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from fibercontact.problem.fclib import Solution, write
from fibercontact.problem.step import StepProblem
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.scene import Scene, SceneError
from fibercontact.simulation.scenes import SCENES, build
from fibercontact.simulation.step import Step, simulate

__all__ = ["COLUMNS", "CORPUS", "PER_SCENE", "dump_corpus", "dump_scene", "evenly_spaced", "write_manifest"]

CORPUS = "core306"
PER_SCENE = 17
FEWEST, MOST = 20, 3000  # contacts
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
    count: int = PER_SCENE,
    fewest: int = FEWEST,
    most: int = MOST,
    progress: Callable[[Step], None] = lambda step: None,
) -> list[Row]:
    """Run a scene and write `count` of its problems as FCLIB files; returns their manifest rows.

    Raises `SceneError` when fewer steps than that have `fewest` to `most` contacts.
    """
    folder.mkdir(parents=True, exist_ok=True)
    steps: dict[int, Step] = {}
    for step in simulate(scene):
        progress(step)
        if step.problem is not None and fewest <= step.problem.n <= most:
            steps[step.index] = step
    try:
        chosen = evenly_spaced(list(steps), count)
    except SceneError as error:
        raise SceneError(f"{scene.name}: {error} with {fewest} to {most} contacts") from None
    return [_write_step(scene, steps[index], folder) for index in chosen]


def dump_corpus(
    folder: Path, progress: Callable[[str, Step], None] = lambda scene, step: None
) -> Iterator[tuple[str, list[Row]]]:
    """Write the corpus scene by scene, yielding each scene's manifest rows; its manifest comes last."""
    rows: list[Row] = []
    for name in SCENES:

        def of_scene(step: Step, name: str = name) -> None:
            progress(name, step)

        new = dump_scene(build(name), folder, progress=of_scene)
        rows += new
        yield name, new
    write_manifest(folder, rows)


def write_manifest(folder: Path, rows: Sequence[Row]) -> None:
    """Write `manifest.csv` whole or not at all."""
    draft = folder / ".manifest.csv"
    with draft.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    draft.replace(folder / "manifest.csv")


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
