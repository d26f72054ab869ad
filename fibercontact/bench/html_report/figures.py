"""The figures of the page, in plotly; every name is plain text to it, and a solver has one colour everywhere.

The traces of a solver carry its number in `meta.solver`, so that the page can switch it off; where a trace has one
point a solver, their numbers are in `meta.solvers`.
"""

import html
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from fibercontact.bench.figures import DASHES, MARKERS, style_of
from fibercontact.bench.protocol import ACCURACIES
from fibercontact.bench.report import View
from fibercontact.bench.rows import TIMED
from fibercontact.bench.tables import performance_ratios, rated

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

__all__ = [
    "UNSAID", "Curve", "Style", "accuracies_figure", "convergence_figure", "plain", "profile_figure",
    "reasons_figure", "rounded", "styles", "within_figure",
]  # fmt: skip

Array = NDArray[np.float64]

DIGITS = 4
"""Significant digits of what is drawn."""
DASH = dict(zip(DASHES, ("solid", "dash", "dashdot", "dot"), strict=True))
SYMBOL = dict(
    zip(
        MARKERS,
        ("circle", "square", "diamond", "triangle-up", "triangle-down", "cross", "star", "x"),
        strict=True,
    )
)
UNSAID = "not said"
"""Reason of a failure without one."""
REASONS = ("#44aa99", "#882255", "#ddcc77", "#88ccee", "#aa4499", "#999933", "#332288", "#bbbbbb")
"""Tol's muted colours: not to be taken for those of the solvers."""


class Style(NamedTuple):
    """How a solver is drawn: its number on the page, colour, dashes and marker."""

    number: int
    colour: str
    dash: str
    symbol: str


class Curve(NamedTuple):
    """The residual after each of some sweeps, relative to b."""

    solver: str
    sweeps: Sequence[int]
    residual: Sequence[float]


def styles(solvers: Sequence[str]) -> dict[str, Style]:
    """A style for each solver, that of the run's other figures where these are all of its solvers."""
    return {
        name: Style(k, look.colour, DASH[look.dash], SYMBOL[look.marker])
        for k, name in enumerate(solvers)
        for look in [style_of(k)]
    }


def plain(text: str) -> str:
    """A stranger's text as plotly shows it literally: to it, `<` opens a tag, `&` an entity, `%{` a template."""
    return html.escape(text, quote=False).replace("%{", "%&#123;")


def rounded(values: Any) -> list[float | None]:
    """Numbers with a few significant digits, None for what is not finite."""
    return [float(f"{x:.{DIGITS}g}") if np.isfinite(x) else None for x in np.asarray(values, dtype=float)]


def profile_figure(view: View, known: dict[str, Style]) -> "Figure":
    """Dolan–Moré profile of the times: share of the problems solved within a factor of the best time."""
    ratios = performance_ratios(view.rows, list(view.table.index))
    finite = ratios.to_numpy()[np.isfinite(ratios.to_numpy())]
    end = 1.3 * max(float(finite.max(initial=1.0)), 2.0)
    figure = _figure("time / best time on the problem", f"share of the {len(ratios)} problems solved")
    figure.update_xaxes(_log_ticks(1.0, end))
    for solver in ratios.columns:
        _add_steps(figure, str(solver), ratios[solver].to_numpy(), len(ratios), (1.0, end), known)
    return figure


def within_figure(view: View, known: dict[str, Style]) -> "Figure":
    """Share of the problems brought to the accuracy within a time, or within sweeps where nothing was timed."""
    rows = rated(view.rows)
    timed = view.mode == TIMED
    cost = 1e3 * rows["time_median"] if timed else rows["sweeps"].clip(lower=1)
    cost = cost.where(rows["solved"].astype(bool), np.inf)
    finite = cost[np.isfinite(cost)]
    ends = (0.8 * float(finite.min()), 1.3 * float(finite.max())) if len(finite) else (1.0, 10.0)
    tolerance = f"{ACCURACIES[view.accuracy]:.0e}"
    figure = _figure(
        f"{'time (ms)' if timed else 'sweeps'} to residual {tolerance}", "share of the problems solved"
    )
    figure.update_xaxes(_log_ticks(*ends))
    for solver in view.table.index:
        mine = cost[rows["solver"] == solver].to_numpy()
        _add_steps(figure, str(solver), mine, len(mine), ends, known)
    return figure


def accuracies_figure(views: Sequence[View], known: dict[str, Style]) -> "Figure | None":
    """Geometric mean time against accuracy, each on its own common problems; None unless several were timed."""
    from plotly.graph_objects import Scatter

    timed = [view for view in views if view.mode == TIMED]
    if len(timed) < 2:
        return None
    figure = _figure("residual relative to b", "geometric mean time (ms)")
    figure.update_xaxes(autorange="reversed", exponentformat="power", dtick=2)
    figure.update_yaxes(type="log", autorange=True, exponentformat="none")
    for solver, style in known.items():
        mine = [view for view in timed if solver in view.table.index]
        if mine:
            figure.add_trace(
                Scatter(
                    x=[ACCURACIES[view.accuracy] for view in mine],
                    y=rounded([view.table.loc[solver, "time_geo_ms"] for view in mine]),
                    mode="lines+markers",
                    hovertemplate="%{x:.0e}: %{y:.3g} ms<extra>%{fullData.name}</extra>",
                    marker={"symbol": style.symbol, "size": 8, "color": style.colour},
                    **_line(solver, style),
                )
            )
    return figure


def reasons_figure(view: View, known: dict[str, Style]) -> "Figure | None":
    """Failures by solver and reason; None without failures."""
    from plotly.graph_objects import Bar

    rows = rated(view.rows)
    failed = rows[~rows["solved"].astype(bool)].replace({"reason": {"": UNSAID}})
    if failed.empty:
        return None
    solvers = [str(name) for name in view.table.index]
    figure = _figure("problems not solved", "")
    figure.update_layout(barmode="stack", bargap=0.35)
    figure.update_xaxes(type="linear", rangemode="tozero")
    figure.update_yaxes(range=None, tickformat="", autorange="reversed", automargin=True, type="category")
    counts = pd.crosstab(failed["reason"], failed["solver"]).reindex(columns=solvers, fill_value=0)
    for k, reason in enumerate(counts.sum(axis=1).sort_values(ascending=False, kind="stable").index):
        figure.add_trace(
            Bar(
                x=counts.loc[reason].tolist(),
                y=[plain(name) for name in solvers],
                orientation="h",
                name=plain(str(reason)),
                marker={"color": REASONS[k % len(REASONS)]},
                meta={"solvers": [known[name].number for name in solvers]},
                hovertemplate="%{y}: %{x}<extra>%{fullData.name}</extra>",
            )
        )
    return figure


def convergence_figure(curves: Sequence[Curve], tolerance: float, known: dict[str, Style]) -> "Figure":
    """Residual against sweeps, and the tolerance that the run asked for."""
    from plotly.graph_objects import Scatter

    figure = _figure("sweeps", "residual relative to b")
    figure.update_xaxes(_log_ticks(1.0, max((curve.sweeps[-1] for curve in curves), default=1)))
    figure.update_yaxes(type="log", range=None, tickformat="", exponentformat="power", dtick=1)
    figure.add_hline(y=tolerance, line={"color": "#888888", "width": 1, "dash": "dot"})
    for curve in curves:
        figure.add_trace(
            Scatter(
                x=list(curve.sweeps),
                y=rounded(curve.residual),
                mode="lines",
                hovertemplate="%{x} sweeps: %{y:.2e}<extra>%{fullData.name}</extra>",
                **_line(curve.solver, known[curve.solver]),
            )
        )
    return figure


def _add_steps(
    figure: "Figure",
    solver: str,
    cost: Array,
    problems: int,
    ends: tuple[float, float],
    known: dict[str, Style],
) -> None:
    """The distribution of a cost that is infinite where the solver failed, from one end of the axis to the other."""
    from plotly.graph_objects import Scatter

    at = np.sort(cost[np.isfinite(cost)])
    share = np.arange(1, len(at) + 1) / max(problems, 1)
    x = np.concatenate([ends[:1], at, ends[1:]])
    y = np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]])
    trace = Scatter(
        x=rounded(x),
        y=rounded(y),
        mode="lines",
        hovertemplate="%{x:.3g}: %{y:.1%}<extra>%{fullData.name}</extra>",
        **_line(solver, known[solver], shape="hv"),
    )
    figure.add_trace(trace)


def _log_ticks(low: float, high: float) -> dict[str, Any]:
    """Plain numbers at 1, 2, 5 times the powers of ten; at the powers alone of a long axis."""
    steps = (1, 2, 5) if high / low < 300.0 else (1,)
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = [step * 10.0**power for power in powers for step in steps]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def _line(solver: str, style: Style, **line: Any) -> dict[str, Any]:
    """What all lines of a solver have in common."""
    return {
        "name": plain(solver),
        "meta": {"solver": style.number},
        "line": {"color": style.colour, "dash": style.dash, "width": 2, **line},
    }


def _figure(x: str, y: str) -> "Figure":
    """Empty axes: x logarithmic, y a share."""
    from plotly.graph_objects import Figure

    figure = Figure()
    figure.update_layout(
        template="none",
        margin={"l": 64, "r": 12, "t": 8, "b": 48},
        legend={"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        hovermode="closest",
        showlegend=True,
        xaxis={"title": {"text": x}, "type": "log"},
        yaxis={"title": {"text": y}, "range": [0.0, 1.02], "tickformat": ".0%", "zeroline": False},
    )
    return figure
