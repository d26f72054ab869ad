"""The facts of a run in one figure: residual, regimes, where it fails, what moves."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from fibercontact.bench.explain import NEGLIGIBLE, Facts
from fibercontact.bench.explain_words import title
from fibercontact.bench.figures import COLOURS

__all__ = ["draw"]

BLACK, ORANGE, SKY, GREEN, BLUE, RED, PINK, BROWN = COLOURS
REGIMES = (("open", "0.85"), ("stick", SKY), ("slip", ORANGE))
LONG = 200
"""Sweeps above which the axis of the sweeps is logarithmic, and curves are pixels in the SVG: it stays short."""
WIDE = 30.0
"""Ratio of largest and smallest value above which an axis of a property is logarithmic."""

Array = NDArray[Any]


def draw(facts: Facts) -> Figure:
    """The four panels."""
    figure = Figure(figsize=(11.0, 8.0), dpi=100, layout="constrained")
    figure.suptitle(title(facts), fontsize=11)
    panels = figure.subplots(2, 2)
    _residual(panels[0, 0], facts)
    _regimes(panels[0, 1], facts)
    _where(panels[1, 0], facts)
    _moving(panels[1, 1], facts)
    for axes in panels.flat:
        axes.set_axisbelow(True)
        axes.title.set_fontsize(10)
    return figure


def _sweep_axis(axes: Axes, facts: Facts) -> None:
    last = max(1, int(facts.record.sweeps[-1]))
    axes.set_xlabel("sweep")
    if last > LONG:
        axes.set_xscale("log")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(1 if last > LONG else 0, last)


def _residual(axes: Axes, facts: Facts) -> None:
    record, about = facts.record, facts.record.about
    curves = [
        _curve(axes, np.arange(len(a.history)), a.history, f"{a.solver}, {a.outer}", colour, 1.0, dashes)
        for a, colour, dashes in zip(facts.attempts, (SKY, GREEN, PINK), ("-", "-", "--"), strict=False)
    ]
    mine = f"{about['solver']}, {about['outer']}"
    curves.append(_curve(axes, record.sweeps, record.residual, mine, BLACK, 1.8))
    axes.axhline(about["tolerance"], color=RED, linestyle="--", linewidth=1.2, label="tolerance")
    if cured := about["proximal_from"]:
        axes.axvline(cured, color=BLUE, linestyle=":", linewidth=1.5, label=f"proximal term from {cured}")
    values = np.concatenate([*curves, [about["tolerance"]]])
    axes.set_ylim(0.5 * values.min(), 2.0 * values.max())
    axes.set_yscale("log")
    _sweep_axis(axes, facts)
    axes.grid(color="0.9")
    axes.set_ylabel("residual relative to b")
    axes.set_title("residual")
    axes.legend(fontsize=8)


def _curve(axes: Axes, x: Array, y: Array, label: str, colour: str, width: float, dashes: str = "-") -> Array:
    """Draw what a logarithmic axis can show of a residual, and return it."""
    shown = np.isfinite(y) & (y > 0)
    axes.plot(
        x[shown], y[shown], dashes, color=colour, linewidth=width, label=label, rasterized=len(x) > LONG
    )
    return y[shown]


def _regimes(axes: Axes, facts: Facts) -> None:
    record = facts.record
    visits = record.counts[1:, :3].sum(axis=1)
    shares = 100.0 * record.counts[1:, :3].T / np.maximum(visits, 1)
    axes.stackplot(record.sweeps[1:], *shares, labels=[name for name, _ in REGIMES],
                   colors=[colour for _, colour in REGIMES], rasterized=True)  # fmt: skip
    _sweep_axis(axes, facts)
    axes.set_ylim(0.0, 100.0)
    axes.set_ylabel("share of the visits (%)")
    axes.set_title(
        "regimes and failed local solves" if facts.failures.total else "regimes (no local solve failed)"
    )
    handles, labels = axes.get_legend_handles_labels()
    if facts.failures.total:
        failing = 100.0 * record.counts[1:, 3] / np.maximum(visits, 1)
        right = axes.twinx()
        right.plot(
            record.sweeps[1:], failing, color=BLACK, linewidth=1.2, label="failed (right)", rasterized=True
        )
        right.set_ylim(0.0, 1.3 * max(float(failing.max()), 1e-9))
        right.set_ylabel("failed local solves (% of the visits)")
        more = right.get_legend_handles_labels()
        handles, labels = handles + more[0], labels + more[1]
        axes = right
    axes.legend(handles, labels, fontsize=8, loc="upper right", framealpha=0.9)


def _where(axes: Axes, facts: Facts) -> None:
    """Where the failed local solves sit; without any, where the residual sits."""
    failures = facts.failures
    if not failures.total:
        _where_residual(axes, facts)
        return
    axes.set_title("where local solves fail")
    values = 100.0 * failures.by_contact / np.maximum(facts.record.statuses.sum(axis=1), 1)
    _by_contact(axes, facts, values, failures.holders, "failed local solves (% of the contact's visits)")


def _where_residual(axes: Axes, facts: Facts) -> None:
    axes.set_title("where the residual of the answer sits")
    _by_contact(axes, facts, 100.0 * facts.residual, facts.holders, "share of the squared residual (%)")


def _by_contact(axes: Axes, facts: Facts, values: Array, group: NDArray[np.int64], what: str) -> None:
    """Values over the property that tells the group from the others, over the contact's number without one."""
    name, _, _ = facts.telling(group)
    axes.set_xlabel(name or "contact")
    axes.set_ylabel(what)
    _scatter(axes, facts.properties.get(name, np.arange(facts.record.n, dtype=float)), values, group)


def _scatter(axes: Axes, x: Array, y: Array, group: NDArray[np.int64]) -> None:
    """Contacts by property and value; those without a value are ticks at the bottom."""
    shown = y > 1e-6 * max(float(y.max(initial=0.0)), 1e-300)
    inside = np.isin(np.arange(len(x)), group)
    if not shown.any():
        axes.text(0.5, 0.5, "nowhere", transform=axes.transAxes, ha="center", color="0.5")
        return
    low = 10.0 ** (np.floor(np.log10(y[shown].min())) - 0.5)
    axes.plot(x[~shown], np.full((~shown).sum(), low), "|", color="0.6", markersize=9, label="none")
    axes.plot(x[shown & ~inside], y[shown & ~inside], "o", color=BLUE, markersize=4, alpha=0.7, label="some")
    axes.plot(x[inside], y[inside], "o", color=RED, markersize=6, label="the fewest with 90 % of all")
    axes.set_yscale("log")
    if x.min() > 0 and x.max() > WIDE * x.min() and np.isfinite(x.max()):
        axes.set_xscale("log")
    axes.grid(color="0.9")
    axes.legend(fontsize=8)


def _moving(axes: Axes, facts: Facts) -> None:
    """How far each contact's impulse moved over the last sweeps, and how; when none did, where the residual sits."""
    motion, record = facts.motion, facts.record
    if motion.kind == "still" and facts.failures.total and not record.about["solved"]:
        _where_residual(axes, facts)
        axes.set_title(f"no impulse moved over the last {motion.sweeps} sweeps: where the residual sits")
        return
    tolerance = float(record.about["tolerance"])
    text = {"cycle": f": a cycle of period {motion.period}", "drift": ": a drift", "wander": ": no period",
            "still": ": none", "short": ""}[motion.kind]  # fmt: skip
    axes.set_title(f"change of the impulses over the last {motion.sweeps} sweeps{text}")
    axes.set_xlabel("contact")
    axes.set_ylabel("largest change of sigma_i r_i, relative to b")
    _periods(axes, facts)
    if motion.change is not None:
        contact, regime, sweeps = motion.change
        what = f"contact {contact}: {'opens' if regime == 'open' else 'slips'} in {sweeps:.2g} sweeps, going on so"
        axes.plot(
            [contact],
            record.amplitude[[contact]],
            "o",
            color=RED,
            markersize=10,
            fillstyle="none",
            label=what,
        )
    axes.axhline(tolerance, color=RED, linestyle="--", linewidth=1.2, label="tolerance")
    axes.axhline(NEGLIGIBLE * tolerance, color="0.4", linestyle=":", label="still below")
    axes.set_yscale("log")
    axes.set_xlim(-0.02 * record.n, 1.02 * max(1, record.n))
    axes.grid(color="0.9")
    axes.legend(fontsize=8, loc="best")


def _periods(axes: Axes, facts: Facts) -> None:
    """The contacts that moved, by their periods."""
    contacts, periods = facts.motion.contacts, facts.motion.periods
    amplitude = facts.record.amplitude[contacts]
    if (periods == 0).any():
        alone = periods == 0
        axes.plot(contacts[alone], amplitude[alone], "o", color="0.6", markersize=4, label="no period")
    for k, period in enumerate(_commonest(periods[periods > 0])):
        mine = periods == period
        axes.plot(contacts[mine], amplitude[mine], "osD^v"[k], color=(RED, BLUE, GREEN, PINK, BROWN)[k],
                  markersize=5, label=f"period {period} ({mine.sum()})")  # fmt: skip


def _commonest(periods: NDArray[np.int64]) -> list[int]:
    """The five commonest periods, in order."""
    found, counts = np.unique(periods, return_counts=True)
    return sorted(found[np.argsort(-counts, kind="stable")[:5]].tolist())
