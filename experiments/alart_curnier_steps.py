"""How the steps rho and the friction disc of the Alart–Curnier function change the failures of PAC and DAC.

One-contact problems are drawn at random: W with a condition number up to 1e6, mu log-uniform from 0.01 to 10, b
Gaussian with b_N < 0. Each is solved once from zero; a failure is a status other than converged, or a converged
answer whose natural-map residual exceeds 1e-6 |b|. Writes a figure and a table.

    python experiments/alart_curnier_steps.py [--problems 20000] [--out results/alart_curnier_steps]
"""

from pathlib import Path

import numpy as np
import pandas as pd
from common.script import options, write_table
from matplotlib.figure import Figure

from fibercontact.bench.figures import save
from fibercontact.local.algebra import law_residual
from fibercontact.local.contract import Status
from fibercontact.local.registry import configure, registered

RHO = np.logspace(-2, 2, 13)
ZERO = (0.0, 0.0, 0.0)


def contacts(count: int, seed: int) -> list[tuple]:
    """Random one-contact problems `(W, b, mu)` as tuples."""
    rng = np.random.default_rng(seed)
    problems = []
    for _ in range(count):
        Q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        W = (Q * 10.0 ** -rng.uniform(0, 6, 3)) @ Q.T
        W, b = 0.5 * (W + W.T), rng.standard_normal(3)
        b[0] = -abs(b[0])
        problems.append((tuple(map(tuple, W)), tuple(b), 10.0 ** rng.uniform(-2, 1)))
    return problems


def failure_percent(specification: str, problems: list[tuple]) -> float:
    """Share of the problems that a configured solver fails on, in %."""
    local = configure(specification, registered())
    kernel, failures = local.kernel(), 0
    for W, b, mu in problems:
        status, r, _ = kernel(W, b, mu, ZERO, local.options)
        good = status == Status.CONVERGED and law_residual(W, b, mu, r) <= 1e-6 * np.linalg.norm(b)
        failures += not good
    return 100.0 * failures / len(problems)


def measure(problems: list[tuple]) -> pd.DataFrame:
    rows = [
        {"solver": solver, "disc": disc, "rho": rho, "failure_percent": failure_percent(
            f"{solver}:rho={rho:.6g},disc={disc}", problems)}
        for solver in ("pac", "dac") for disc in (0, 1) for rho in RHO
    ]  # fmt: skip
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(5.5, 3.6), layout="constrained")
    axes = figure.add_subplot(xlabel="rho, relative to 1/W_NN and 1/lambda_max(W_TT)", ylabel="failures (%)")
    for (solver, disc), curve in table.groupby(["solver", "disc"]):
        radius = "mu r_N" if disc else "mu (r_N - rho u_N)"
        style = {"color": "#0072B2" if solver == "pac" else "#D55E00", "linestyle": "--" if disc else "-"}
        axes.semilogx(curve.rho, curve.failure_percent, label=f"{solver}, disc {radius}", marker=".", **style)
    axes.axvline(1.0, color="0.7", linewidth=0.8)
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8, loc="upper center")
    return figure


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--problems", type=int, default=20_000)
    parser.add_argument("--out", type=Path, default=Path("results/alart_curnier_steps"))
    given = parser.parse_args()
    table = measure(contacts(given.problems, 1))
    write_table(table, given.out.with_suffix(".csv"), 6)
    save(draw(table), given.out.parent, given.out.name)


if __name__ == "__main__":
    main()
