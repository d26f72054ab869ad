"""A picture of a scene at a step: rods and obstacles, contacts by regime, forces, scales."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fibercontact.files import replacing
from fibercontact.simulation.pictures.camera import TILT, TURN, Camera, framed, view_axes
from fibercontact.simulation.pictures.raster import Raster
from fibercontact.simulation.pictures.shown import REGIMES, Shown, force_scale, held, show
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import Step

__all__ = ["SIZE", "caption", "draw", "draw_shown", "pixels"]

Array = NDArray[np.float64]

SIZE = 900  # pixels
DPI = 100
DARK, FAIR = np.array([0.56, 0.46, 0.38]), np.array([0.93, 0.84, 0.72])  # of the fibres
LETTERS = (9.0, 16.0)  # pixels, smallest and largest
BAR = 0.2  # of the picture's width: a scale bar at most


def draw(
    scene: Scene, step: Step, file: Path, size: int = SIZE, turn: float = TURN, tilt: float = TILT
) -> None:
    """Draw a step of a scene into a PNG file, `size` pixels at the longer side of its picture."""
    shown = show(scene, step)
    camera = framed(view_axes(turn, tilt), held(shown), size)
    newton = force_scale([shown], camera.width / camera.scale)
    with replacing(file) as draft:
        draw_shown(shown, camera, newton, caption(scene, shown)).savefig(draft, dpi=DPI)


def caption(scene: Scene, shown: Shown, more: str = "") -> tuple[str, str]:
    """Which scene; when, and how much of it."""
    counts = f"{len(shown.fibres)} fibres, {len(shown.points)} contacts"
    return scene.name, f"step {shown.index}, {shown.time:.2f} s{more}: {counts}"


def draw_shown(shown: Shown, camera: Camera, newton: float, title: Sequence[str]) -> Figure:
    """The picture: title above, contacts by regime and forces, `newton` metres for a newton, legend below."""
    letter = float(np.clip(camera.width / 32, *LETTERS))
    strip = 2 * round(2.1 * letter)
    height = camera.height + 2 * strip
    figure = Figure(figsize=(camera.width / DPI, height / DPI), dpi=DPI)
    with rc_context({"font.size": letter * 72 / DPI, "text.parse_math": False}):
        figure.text(0.5, 1.0 - 0.5 * strip / height, "\n".join(title), ha="center", va="center")
        axes = _panel(figure, strip / height, camera.height / height, camera.width, camera.height)
        axes.imshow(_image(shown, camera), extent=(0, camera.width, camera.height, 0))
        _contacts(axes, shown, camera, newton)
        _legend(_panel(figure, 0.0, strip / height, camera.width, strip), shown, camera, newton, letter)
    return figure


def _panel(figure: Figure, bottom: float, share: float, width: float, height: float) -> Axes:
    """Axes without lines over the whole width, in pixels, downwards."""
    axes = figure.add_axes((0.0, bottom, 1.0, share))
    axes.set_axis_off()
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    axes.set_autoscale_on(False)
    return axes


def pixels(figure: Figure) -> NDArray[np.uint8]:
    """The picture (height, width, 3)."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _image(shown: Shown, camera: Camera) -> Array:
    raster = Raster(camera)
    for obstacle in shown.obstacles:
        raster.obstacle(obstacle)
    shade = np.random.default_rng(0).uniform(size=(len(shown.fibres), 1))
    raster.tubes(shown.fibres, shown.radius, (1.0 - shade) * DARK + shade * FAIR)
    return raster.image()


def _contacts(axes: Axes, shown: Shown, camera: Camera, newton: float) -> None:
    """Dots and lines over everything: most contacts are inside of a bundle."""
    dots = camera.project(shown.points)
    ends = camera.project(shown.points + newton * shown.force)
    side = max(camera.width, camera.height)
    for kind, regime in reversed(REGIMES.items()):
        mine = shown.regime == kind
        lines = np.stack([dots[mine], ends[mine]], axis=1)
        axes.add_collection(LineCollection(list(lines), colors=regime.colour, linewidths=side / 900))
        axes.scatter(dots[mine, 0], dots[mine, 1], s=(1.4 + side / 400) ** 2, c=regime.colour, edgecolors=regime.edge,
                     linewidths=side / 1800, zorder=3)  # fmt: skip


def _legend(axes: Axes, shown: Shown, camera: Camera, newton: float, letter: float) -> None:
    """Regimes, then scales; places are the same whatever the numbers are: nothing jumps in an animation."""
    for column, (kind, regime) in enumerate(REGIMES.items()):
        at = (0.06 + 0.32 * column) * camera.width
        axes.scatter(
            [at], [letter], s=(0.5 * letter) ** 2, c=regime.colour, edgecolors=regime.edge, linewidths=0.8
        )
        axes.text(at + letter, letter, f"{shown.count(kind)} {regime.name}", va="center_baseline")
    scales = [(camera.scale, "m", "black")] + [(newton * camera.scale, "N", "0.55")] * (newton > 0.0)
    for column, (unit, name, colour) in enumerate(scales):
        at, length = (0.05 + 0.48 * column) * camera.width, _round_number(BAR * camera.width / unit)
        axes.plot([at, at + unit * length], [2.8 * letter] * 2, color=colour, linewidth=0.15 * letter,
                  solid_capstyle="butt")  # fmt: skip
        axes.text(
            at + unit * length + 0.6 * letter, 2.8 * letter, _quantity(length, name), va="center_baseline"
        )


def _round_number(most: float) -> float:
    """The largest of 1, 2, 5, 10 … that is not above `most`."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (0.5, 1.0, 2.0, 5.0) if step * power <= most))


def _quantity(value: float, unit: str) -> str:
    """A number below 1 with its unit, in thousandths or millionths where that is shorter."""
    for prefix, factor in (("", 1.0), ("m", 1e3), ("µ", 1e6)):
        if value * factor >= 0.999:
            return f"{value * factor:.0f} {prefix}{unit}"
    return f"{value:.0e} {unit}"
