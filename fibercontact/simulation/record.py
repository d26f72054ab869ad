"""What a run of a scene leaves behind: one row a step, a picture, a summary."""

from pathlib import Path

import numpy as np
import pandas as pd

from fibercontact.files import replace_file
from fibercontact.rods.interface import rod_model
from fibercontact.simulation.pictures.still import draw
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import Step

__all__ = ["Recorder"]

STEPS = "steps.csv"


def _rows_before(first: int, file: Path) -> list[dict[str, float]]:
    """The rows of the steps before `first`, of an earlier run; what was run beyond it is run again."""
    if not file.is_file():
        return []
    table = pd.read_csv(file, float_precision="round_trip")
    return [
        {str(key): value for key, value in row.items()}
        for row in table[table.step < first].to_dict("records")
    ]


class Recorder:
    """Collects rows of the steps of a scene and keeps the last step.

    A run that is taken up at the step `first` goes on with the rows of the steps before it in `folder`.
    """

    def __init__(self, scene: Scene, folder: Path | None = None, first: int = 0) -> None:
        self.scene = scene
        self.rows: list[dict[str, float]] = _rows_before(first, folder / STEPS) if folder and first else []
        self.last: Step | None = None

    def add(self, step: Step) -> None:
        """Add the row of a step: times in s, energies in J, the deepest overlap in m."""
        e = rod_model(self.scene.rods).energy(step.world.state, self.scene.gravity(step.world.time))
        run = step.run
        self.rows.append(
            {
                "step": step.index,
                "time": step.world.time,
                "contacts": len(step.contacts.gap),
                "overlap": float(max(0.0, -step.contacts.gap.min(initial=0.0))),
                "sweeps": run.sweeps if run else 0,
                "residual": run.residual if run else 0.0,
                "solved": run.claimed if run else True,
                "kinetic": float(e.kinetic.sum()),
                "elastic": float(e.elastic.sum()),
                "gravitational": float(e.gravitational.sum()),
                "seconds": step.seconds,
                **{f"{part}_seconds": seconds for part, seconds in step.parts.items()},
            }
        )
        self.last = step

    def write(self, folder: Path) -> None:
        """Write `steps.csv` and `last.png`."""
        self.write_rows(folder)
        if self.last is not None:
            draw(self.scene, self.last, folder / "last.png")

    def write_rows(self, folder: Path) -> None:
        """Write `steps.csv`, whole or not at all."""
        text = pd.DataFrame(self.rows).to_csv(index=False, lineterminator="\n")
        folder.mkdir(parents=True, exist_ok=True)
        replace_file(folder / STEPS, text.encode())

    def summary(self) -> str:
        """The run in one line."""
        if not self.rows:
            return f"{self.scene.name}: no step was run"
        table = pd.DataFrame(self.rows)
        contacts = table.contacts.to_numpy()
        return (
            f"{self.scene.name}: {len(table)} steps, {table.time.iloc[-1]:.3g} s of motion; "
            f"contacts median {np.median(contacts):.0f}, most {contacts.max()}; "
            f"sweeps median {table.sweeps.median():.0f}; unsolved steps {int((~table.solved).sum())}; "
            f"{1e3 * table.seconds.median():.3g} ms a step"
        )
