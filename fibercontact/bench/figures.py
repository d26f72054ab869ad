"""The two figures of a table: performance profile, and failure rate against time."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import Bbox

from fibercontact.bench.protocol import PUBLISHED
from fibercontact.files import replacing

__all__ = ["COLOURS", "DASHES", "MARKERS", "draw_failures", "draw_profile", "save", "style_of"]

COLOURS = ("#000000", "#e69f00", "#56b4e9", "#009e73", "#0072b2", "#d55e00", "#cc79a7", "#8c6d31")
"""Okabe and Ito's palette, to be told apart by colour-blind readers (its yellow replaced by a brown)."""
DASHES = ("-", "--", "-.", ":")
MARKERS = "osD^vP*X"

LABEL_SHIFTS = [(9, y) for y in (-3, 6, -12, 16, -22, *range(26, 160, 10))]
"""Where a point's name may stand, in points from it, best first."""

REFERENCE = ("hybrid", "mfb", "dac", "pac", "enum-quartic", "enum-companion", "pyramid")
"""The solver whose published time is laid on ours: the first of these in the table."""


def draw_profile(ratios: pd.DataFrame, title: str) -> Figure:
    """Dolan–Moré profile: share of the problems solved within a factor of the best time."""
    figure, axes = _canvas(title)
    finite = ratios.to_numpy()[np.isfinite(ratios.to_numpy())]
    end = 1.3 * max(float(finite.max(initial=1.0)), 2.0)
    for k, solver in enumerate(ratios.columns):
        at = np.sort(ratios[solver].to_numpy())
        at = at[np.isfinite(at)]
        share = np.arange(1, len(at) + 1) / max(len(ratios), 1)
        axes.step(
            [1.0, *at, end],
            [0.0, *share, share[-1] if len(share) else 0.0],
            where="post",
            color=style_of(k).colour,
            linestyle=style_of(k).dash,
            linewidth=1.8,
            label=solver,
        )
    _log_axis(axes, 1.0, end)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("time / best time on the problem")
    axes.set_ylabel(f"share of the {len(ratios)} problems solved")
    axes.legend(loc="lower right", fontsize=9)
    return figure


def draw_failures(table: pd.DataFrame, title: str) -> Figure:
    """Failure rate against time, the published figures as hollow markers."""
    figure, axes = _canvas(title)
    points = [*_our_points(table), *_published_points(table)]
    for point in points:
        axes.plot(
            point.x, point.y, point.marker, markersize=8, color=point.colour, markerfacecolor=point.face
        )
    times = [point.x for point in points]
    _log_axis(axes, 0.8 * min(times, default=1.0), 1.8 * max(times, default=10.0))
    axes.set_yscale("symlog", linthresh=1.0, linscale=0.6)
    axes.set_ylim(-0.3, 130.0)
    ticks = [0.0, 1.0, 3.0, 10.0, 30.0, 100.0]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("geometric mean time on the common problems (ms)" + _published_note(table))
    axes.set_ylabel("failure rate (%)")
    _label(figure, axes, points)
    return figure


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as SVG and PNG, the same bytes for the same figure."""
    with matplotlib.rc_context({"svg.hashsalt": "fibercontact", "svg.fonttype": "none"}):
        with replacing(folder / f"{name}.svg") as draft:
            figure.savefig(draft, metadata={"Date": None})
        with replacing(folder / f"{name}.png") as draft:
            figure.savefig(draft, dpi=150)


def _canvas(title: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7.5, 5.0), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=11)
    axes.grid(which="major", color="0.9")
    axes.set_axisbelow(True)
    return figure, axes


def _log_axis(axes: Axes, low: float, high: float) -> None:
    """A logarithmic x axis with plain numbers at its ticks."""
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    steps = (1.0, 2.0, 5.0) if high / low < 300.0 else (1.0,)
    axes.xaxis.set_major_locator(LogLocator(subs=steps))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


class Style(NamedTuple):
    """How a solver is drawn."""

    colour: str
    dash: str
    marker: str


def style_of(k: int) -> Style:
    """The style of the k-th solver: no two alike among the first `len(COLOURS) * len(DASHES)`."""
    turn = k + k // len(COLOURS)
    return Style(COLOURS[k % len(COLOURS)], DASHES[turn % len(DASHES)], MARKERS[turn % len(MARKERS)])


class Point(NamedTuple):
    """A marker of the figure of failures, with its name."""

    name: str
    x: float
    y: float
    marker: str
    colour: str
    face: str
    published: bool


def _our_points(table: pd.DataFrame) -> Iterator[Point]:
    for k, (solver, line) in enumerate(table.iterrows()):
        if np.isfinite(line["time_geo_ms"]):
            colour, _, marker = style_of(k)
            yield Point(
                str(solver), line["time_geo_ms"], line["failure_percent"], marker, colour, colour, False
            )


def _published_points(table: pd.DataFrame) -> Iterator[Point]:
    """The talk's points, each once, in the style of the first of our solvers that it belongs to."""
    reference, drawn = _reference(table), set()
    if reference is None:
        return
    scale = float(table["time_geo_ms"][reference]) / PUBLISHED[reference].milliseconds
    for k, solver in enumerate(table.index):
        published = PUBLISHED.get(str(solver))
        if published is not None and published not in drawn:
            drawn.add(published)
            colour, _, marker = style_of(k)
            x, y = scale * published.milliseconds, published.failure_percent
            yield Point(published.name, x, y, marker, colour, "none", True)


def _reference(table: pd.DataFrame) -> str | None:
    timed = table.index[np.isfinite(table["time_geo_ms"])]
    return next((name for name in REFERENCE if name in timed), None)


def _published_note(table: pd.DataFrame) -> str:
    reference = _reference(table)
    if reference is None:
        return ""
    name = PUBLISHED[reference].name
    return f"\nhollow: the 2014 talk (arithmetic means), times scaled so that {name} lies at {reference}"


def _label(figure: Figure, axes: Axes, points: Sequence[Point]) -> None:
    """Name the points, each at the nearest place where its name covers no other name and no marker."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw_without_rendering()
    centres = [axes.transData.transform((point.x, point.y)) for point in points]
    taken = [Bbox.from_bounds(x - 6, y - 6, 12, 12) for x, y in centres]
    for point in sorted(points, key=lambda point: (point.published, -point.x)):
        text = axes.annotate(
            point.name,
            (point.x, point.y),
            xytext=LABEL_SHIFTS[0],
            textcoords="offset points",
            fontsize=8 if point.published else 9,
            color="0.4" if point.published else "black",
            style="italic" if point.published else "normal",
            arrowprops={"arrowstyle": "-", "color": "0.7", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 4},
        )
        text.set_in_layout(False)
        boxes = ((shift, _box_at(text, shift, renderer)) for shift in LABEL_SHIFTS)
        free = ((shift, box) for shift, box in boxes if not any(box.overlaps(other) for other in taken))
        shift, box = next(free, (LABEL_SHIFTS[0], _box_at(text, LABEL_SHIFTS[0], renderer)))
        text.set_position(shift)
        taken.append(box)


def _box_at(text: Annotation, shift: tuple[int, int], renderer: RendererBase) -> Bbox:
    """What a name covers, in pixels, when it is moved there; the line to its point does not count."""
    text.set_position(shift)
    text.update_positions(renderer)
    return Text.get_window_extent(text)
