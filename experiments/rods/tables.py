"""Tables of what was measured against what is known, and the colours of the models in figures."""

import numpy as np
import pandas as pd

from fibercontact.bench.figures import COLOURS

COLUMNS = ["quantity", "model", "elements", "value", "reference"]
PALETTE = (COLOURS[4], COLOURS[1], COLOURS[3])


def with_errors(rows: list[tuple]) -> pd.DataFrame:
    """Rows of `COLUMNS` with relative errors, and orders between one mesh and the next finer one."""
    table = pd.DataFrame(rows, columns=COLUMNS)
    table["error"] = abs(table.value / table.reference - 1)
    table = table.sort_values(["quantity", "model", "elements"], kind="stable")
    of_a_kind = table.groupby(["quantity", "model"])
    errors, sizes = of_a_kind.error, of_a_kind.elements
    table["order"] = np.log(errors.shift() / table.error) / np.log(table.elements / sizes.shift())
    return table
