"""The rods and contacts of a problem: its scene, run again up to its step."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from fibercontact.bench.problem_set import Entry, content_hash, origin
from fibercontact.errors import UserError
from fibercontact.problem.fclib import read
from fibercontact.simulation.pictures.scene_page import scene_page
from fibercontact.simulation.pictures.shown import show
from fibercontact.simulation.pictures.still import caption
from fibercontact.simulation.scenes import NAMED, build
from fibercontact.simulation.step import Step, simulate

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

__all__ = ["Rods", "rods_of"]

DIAGONAL = 1.9
"""Of a box that just fits into an orthographic view of plotly's, in its units."""


class Rods(NamedTuple):
    """A figure, where there is one, and words on it, or on why there is none."""

    figure: "Figure | None"
    words: str


def rods_of(entry: Entry) -> Rods:
    """Run the scene that the manifest beside the problem names, if it is one of the project's own, and draw it.

    A scene's file is not opened: it may be a stranger's program.
    """
    try:
        name, index = origin(entry)
        if name.partition("@")[0] not in {known.partition("@")[0] for known in NAMED}:
            return Rods(None, f"Its rods are not known: the scene {name!r} is none of the project's own.")
        scene = build(name)
        if index >= scene.steps:
            return Rods(None, f"Its rods are not known: {name} has no step {index}.")
        step = next(step for step in simulate(scene) if step.index == index)
    except UserError as fault:
        return Rods(None, f"Its rods are not known: {fault}.")
    shown = show(scene, step)
    doubt = "" if _poses(step, entry) else " Run again here, the scene does not pose this very problem."
    figure = scene_page(shown, step, most_tubes=0)
    _fit(figure)
    return Rods(figure, f"{', '.join(caption(scene, shown))}.{doubt}")


def _fit(figure: "Figure") -> None:
    """Scale the box of what is drawn, its sides kept in proportion, so that it is seen whole from any side."""
    extent = np.array(
        [np.ptp([ends for t in figure.data for ends in (np.nanmin(t[x]), np.nanmax(t[x]))]) for x in "xyz"]
    )
    extent = np.maximum(extent, 1e-3 * extent.max())
    ratio = DIAGONAL * extent / np.linalg.norm(extent)
    figure.update_layout(scene={"aspectmode": "manual", "aspectratio": dict(zip("xyz", ratio, strict=True))})


def _poses(step: Step, entry: Entry) -> bool:
    """Whether a step poses the problem of the file: motions part where rounding differs."""
    return step.problem is not None and content_hash(step.problem) == content_hash(read(entry.file).problem)
