"""What a run does not show, said from what it is."""

from collections.abc import Iterator

from fibercontact.bench.html_report.runs import RunRead
from fibercontact.bench.protocol import ACCURACIES, GLOBAL
from fibercontact.bench.report import IDLE_LOAD, number
from fibercontact.bench.rows import TIMED

__all__ = ["limitations"]


def limitations(run: RunRead) -> list[str]:
    """Sentences that a reader of the tables must know."""
    return [*_problems(run), *_accuracy(run), *_times(run), *_laws(run), *_comparison(run)]


def _problems(run: RunRead) -> Iterator[str]:
    problems = run.rows.drop_duplicates("problem_hash")
    low, high = int(problems["contacts"].min()), int(problems["contacts"].max())
    yield (
        f"{len(problems)} problems of {low} to {high} contacts, from {problems['scene'].nunique()} scene(s). Steps "
        "of one scene resemble each other: they are fewer independent trials than their number says. The project's "
        "sets are from its own simulations of fibres; rigid bodies, granular matter and other people's fibres may "
        "rank the solvers otherwise."
    )
    yield (
        "Every solve began from zero impulses; a simulation begins from the step before, and needs fewer sweeps."
        if problems["start"].iloc[0] == "cold"
        else "Every solve began from the guess in the problem's file, as good as the simulation that wrote it."
    )


def _accuracy(run: RunRead) -> Iterator[str]:
    levels = ", ".join(f"{view.accuracy} ({ACCURACIES[view.accuracy]:.0e})" for view in run.views)
    row = run.rows.iloc[0]
    yield (
        f"Accuracies: {levels}, natural-map residual relative to b. Which solver fails, and the ranking, depend on "
        f"it, and on the limits of {row['max_sweeps']:.0f} sweeps and {number(row['max_seconds'])} s a problem."
    )
    yield (
        "Solved is what the recomputed residual says, whatever a solver claims. A small residual is not a small "
        "error: friction problems may be ill-conditioned, and may have several solutions."
    )


def _times(run: RunRead) -> Iterator[str]:
    timed = run.rows[run.rows["mode"] == TIMED]
    if timed.empty:
        yield "Nothing was timed: the order of the solvers by sweeps is not their order by time."
        return
    threads = ", ".join(f"{count:.0f}" for count in sorted(timed["threads"].dropna().unique())) or "unknown"
    load = timed["load"].mean()
    noise = (
        f" {load:.1f} other processes were at work on average: times are too long."
        if load > IDLE_LOAD
        else ""
    )
    yield (
        f"Times are medians of {timed['repetitions'].min():.0f} passes on one machine ({timed['cpu'].iloc[0]}; "
        f"threads: {threads}).{noise} Differences of a few per cent mean nothing, and another processor may rank "
        "close solvers otherwise."
    )
    yield (
        "Means of sweeps and times are over the problems that all compared solvers solve, the easier ones: the "
        "performance profile charges failures, the means do not."
    )


def _laws(run: RunRead) -> Iterator[str]:
    pyramids = run.rows[run.rows["law_facets"] > 0]["solver"].unique()
    if len(pyramids):
        yield (
            f"Judged by a linearised law of its own: {', '.join(pyramids)}. Its failure rate does not say how far it "
            "is from Coulomb's law; the Coulomb residual does."
        )
    methods = run.rows[run.rows["outer"] == GLOBAL]["solver"].unique()
    if len(methods):
        yield f"Iterations, not sweeps, each of a cost of its own: {', '.join(methods)}."


def _comparison(run: RunRead) -> Iterator[str]:
    if any(isinstance(name, str) for view in run.views for name in view.table["published"]):
        yield (
            "The talk's 306 problems, its machine and its tolerance are not published: orders and ratios can be "
            "compared with its figures, milliseconds and percentages cannot."
        )
