"""One table of all that the rods were measured by: the errors of every model, and the orders where a mesh is refined.

Joins the tables that `rod_convergence`, `rod_validation`, `rod_stick_slip`, `rod_capstan`, `rod_incline` and
`rod_energy` have written: `table.csv` with a row for each quantity, model and mesh, and `table.md` with the finest
mesh of each.

    python experiments/rod_table.py [--tables results/rods] [--out results/rods]
"""

from pathlib import Path

import pandas as pd
from common.script import options
from rods.contact_scenes import MODELS
from rods.tables import COLUMNS

FILES = ("convergence", "validation", "stick_slip", "capstan", "incline", "sliding")
NAMES = {"test": "quantity", "steps_a_second": "elements"}


def joined(folder: Path) -> pd.DataFrame:
    """All rows, in the order of the files."""
    tables = [pd.read_csv(folder / f"{name}.csv").rename(columns=NAMES) for name in FILES]
    return pd.concat(tables, ignore_index=True).reindex(columns=[*COLUMNS, "error", "order"])


def markdown(table: pd.DataFrame) -> str:
    """A row for each quantity: relative errors of the models on the finest mesh, orders in brackets."""
    lines = [f"| quantity | mesh | reference | {' | '.join(MODELS)} |", "|---|---|---|---|---|---|"]
    for quantity, rows in table.groupby("quantity", sort=False):
        finest = rows[rows.elements == rows.elements.max()].set_index("model")
        first = finest.loc[MODELS[0]]
        exact = "" if pd.isna(first.reference) else f"{first.reference:.5g}"
        cells = [_cell(finest.loc[model]) for model in MODELS]
        lines.append(f"| {quantity} | {first.elements} | {exact} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(row: pd.Series) -> str:
    return f"{row.error:.1e}" if pd.isna(row.order) else f"{row.error:.1e} ({row.order:.2f})"


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--tables", type=Path, default=Path("results/rods"), help="where the tables are")
    parser.add_argument("--out", type=Path, default=Path("results/rods"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    table = joined(given.tables)
    table.to_csv(given.out / "table.csv", index=False, float_format="%.6g")
    (given.out / "table.md").write_text(markdown(table))
    print(markdown(table))


if __name__ == "__main__":
    main()
