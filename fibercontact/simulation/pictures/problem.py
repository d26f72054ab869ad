"""An incremental problem and its answer as a figure, without its geometry, which files do not hold.

Four panels: how the contacts act on each other, how strong the normal impulses are, where the impulses lie in
their friction discs, and Coulomb's law itself, which an answer is to lie on.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from fibercontact.local.algebra import OPEN
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure
from fibercontact.simulation.pictures.page import contact_rows, contact_trace, lay_out
from fibercontact.simulation.pictures.shown import REGIMES, regimes

if TYPE_CHECKING:
    from plotly.graph_objects import Figure as Page

__all__ = ["Answered", "answered", "problem_figure", "problem_page"]

Array = NDArray[np.float64]

CELLS = 400  # of the picture of W along a side, at most
BINS = 40


@dataclass(frozen=True)
class Answered:
    """A problem with an answer."""

    title: str
    problem: IncrementalProblem
    r: Array  # (n, 3) N·s
    u: Array  # (n, 3) m/s
    regime: NDArray[np.int64]  # (n,)
    residual: float
    source: str  # whose answer it is

    @property
    def words(self) -> str:
        """Size, whose answer, and how good it is."""
        counts = ", ".join(f"{int((self.regime == k).sum())} {regime.name}" for k, regime in REGIMES.items())
        return f"{self.problem.n} contacts ({counts}); {self.source}, residual {self.residual:.1e}"


def answered(title: str, problem: IncrementalProblem, r: Array, source: str) -> Answered:
    """Measure an answer `r` (3n,) and tell its regimes."""
    u = problem.W @ r + problem.b
    return Answered(
        title, problem, r.reshape(-1, 3), u.reshape(-1, 3), regimes(r, problem.mu),
        measure(problem, r).coulomb, source,
    )  # fmt: skip


def problem_figure(a: Answered) -> Figure:
    """The four panels."""
    figure = Figure(figsize=(10.0, 9.6), dpi=100, layout="constrained")
    figure.suptitle(f"{a.title}\n{a.words}", fontsize=11, parse_math=False)
    panels = figure.subplots(2, 2)
    _coupling(figure, panels[0, 0], a)
    _strengths(panels[0, 1], a)
    _disc(panels[1, 0], a)
    _law(panels[1, 1], a)
    for axes in panels.flat:
        axes.set_box_aspect(1.0)
        axes.set_axisbelow(True)
        axes.title.set_fontsize(10)
    return figure


def _coupling(figure: Figure, axes: Axes, a: Answered) -> None:
    """`‖W_ij‖`, relative to the diagonal blocks, contacts in the file's order; the largest of each cell."""
    axes.set_title("how contacts act on each other")
    W = a.problem.W
    row, column = np.repeat(np.arange(a.problem.n), np.diff(W.indptr)), W.indices
    size = np.linalg.norm(W.data, axis=(1, 2))
    own = np.linalg.norm(a.problem.diagonal, axis=(1, 2))
    cells = min(a.problem.n, CELLS)
    picture = np.zeros((cells, cells))
    at = (row * cells // a.problem.n, column * cells // a.problem.n)
    np.maximum.at(picture, at, size / np.sqrt(own[row] * own[column]))
    ends = (-0.5, a.problem.n - 0.5)
    shown = axes.imshow(
        np.ma.masked_equal(picture, 0.0), extent=(*ends, *ends[::-1]), cmap="cividis_r", vmin=0.0, vmax=1.0,
        interpolation="nearest",
    )  # fmt: skip
    figure.colorbar(shown, ax=axes, shrink=0.8, label="‖W_ij‖ / √(‖W_ii‖ ‖W_jj‖)")
    axes.set_xlabel("contact j")
    axes.set_ylabel("contact i")


def _strengths(axes: Axes, a: Answered) -> None:
    axes.set_title("normal impulses")
    strength = a.r[:, 0]
    pushing = a.regime != OPEN
    if not pushing.any():
        axes.text(0.5, 0.5, "all contacts take off", transform=axes.transAxes, ha="center", color="0.5")
        return
    low, high = np.log10([0.999 * strength[pushing].min(), 1.001 * strength[pushing].max()])
    bins = np.logspace(low, high, BINS + 1)
    kinds = [k for k in REGIMES if k != OPEN]
    axes.hist(
        [strength[a.regime == k] for k in kinds], bins=list(bins), stacked=True,
        color=[REGIMES[k].colour for k in kinds], label=[_label(a, k) for k in kinds],
    )  # fmt: skip
    axes.plot([], [], " ", label=f"{_label(a, OPEN)}: r = 0")
    axes.set_xscale("log")
    axes.set_xlabel("r_N (N·s)")
    axes.set_ylabel("contacts")
    axes.legend(fontsize=8)


def _disc(axes: Axes, a: Answered) -> None:
    """`r_T / (mu r_N)`: stick within the unit circle, slip on it."""
    axes.set_title("tangential impulses in the friction disc")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_ticks([-1.0, -0.5, 0.0, 0.5, 1.0])
    axes.set_xlim(-1.1, 1.1)
    axes.set_ylim(-1.1, 1.1)
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=1.0)
    share = _share(a)
    for kind in (k for k in REGIMES if k != OPEN):
        mine = (a.regime == kind) & np.isfinite(share[:, 0])
        axes.plot(*share[mine].T, "o", color=REGIMES[kind].colour, markersize=4, alpha=0.7, markeredgewidth=0)
    if frictionless := int(((a.regime != OPEN) & (a.problem.mu == 0.0)).sum()):
        axes.text(0.0, 0.0, f"{frictionless} without friction: not shown", ha="center", color="0.5")
    axes.set_xlabel("r_T1 / (mu r_N)")
    axes.set_ylabel("r_T2 / (mu r_N)")


def _law(axes: Axes, a: Answered) -> None:
    """Sliding speed and friction used: an answer lies on the two lines."""
    axes.set_title("Coulomb's law: stick below, slip along the upper line")
    share = np.linalg.norm(_share(a), axis=1)
    speed = np.linalg.norm(a.u[:, 1:], axis=1)
    shown = (a.regime != OPEN) & np.isfinite(share)
    least = max(a.residual, 1e-12) * (a.problem.b_ref or 1.0)
    end = max(float(speed[shown].max(initial=0.0)), 10.0 * least)
    axes.plot([0.0, 0.0, 2.0 * end], [0.0, 1.0, 1.0], color="0.6", linewidth=1.0)
    for kind in (k for k in REGIMES if k != OPEN):
        mine = shown & (a.regime == kind)
        axes.plot(speed[mine], share[mine], "o", color=REGIMES[kind].colour, markersize=4, alpha=0.7,
                  markeredgewidth=0)  # fmt: skip
    axes.set_xscale("symlog", linthresh=least, linscale=1.0)
    axes.set_xticks(
        [0.0, *10.0 ** np.arange(math.ceil(math.log10(least)), math.floor(math.log10(2.0 * end)) + 1)]
    )
    axes.set_xlim(-0.2 * least, 2.0 * end)
    axes.set_ylim(-0.05, 1.1)
    axes.set_xlabel("‖u_T‖ (m/s), to scale below residual times b")
    axes.set_ylabel("‖r_T‖ / (mu r_N)")


def _share(a: Answered) -> Array:
    """`r_T / (mu r_N)` (n, 2), NaN without a normal impulse or without friction."""
    most = a.problem.mu * a.r[:, 0]
    return a.r[:, 1:] / np.where(most > 0.0, most, np.nan)[:, None]


def _label(a: Answered, kind: int) -> str:
    return f"{int((a.regime == kind).sum())} {REGIMES[kind].name}"


def problem_page(a: Answered) -> "Page":
    """The impulses in their friction cone, made one for all contacts by drawing `r_T / mu`."""
    from plotly.graph_objects import Figure as Page
    from plotly.graph_objects import Surface

    top = float(a.r[:, 0].max(initial=0.0)) or 1.0
    turn, height = np.linspace(0.0, 2.0 * np.pi, 73), np.array([[0.0], [top]])
    cone = Surface(
        x=height * np.cos(turn), y=height * np.sin(turn), z=height + 0.0 * turn, opacity=0.25,
        colorscale=[[0.0, "#999999"], [1.0, "#999999"]], showscale=False, hoverinfo="skip",
        name="friction cone", showlegend=True,
    )  # fmt: skip
    figure = Page([cone])
    rows = contact_rows([f"contact {i}" for i in range(a.problem.n)], a.problem.mu, a.r, a.u)
    points = np.column_stack(
        [a.r[:, 1:] / np.where(a.problem.mu > 0.0, a.problem.mu, 1.0)[:, None], a.r[:, 0]]
    )
    for kind in REGIMES:
        mine = np.flatnonzero(a.regime == kind)
        figure.add_trace(contact_trace(kind, points[mine], [rows[i] for i in mine]))
    lay_out(figure, titles=("r_T1 / mu (N·s)", "r_T2 / mu (N·s)", "r_N (N·s)"))
    return figure
