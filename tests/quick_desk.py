"""A desk whose passes take a few milliseconds and give the same whenever they are made: for tests of the runner."""

import hashlib
import time

from listeners import Silent

from fibercontact.bench import run as run_module
from fibercontact.bench.rows import RowFile
from fibercontact.bench.worker import Worker

PASS_SECONDS = 0.003


class Desk:
    def load(self, path, start):
        self._file = path
        sizes = {"contacts": 4, "dofs": 15, "mu_min": 0.3, "mu_max": 0.3, "blocks": 10}
        return sizes | {"setup_seconds": time.perf_counter(), "warning": ""}

    def solve(self, task):
        time.sleep(PASS_SECONDS)
        text = f"{self._file.name} {task.solver} {task.accuracy}"
        sweeps = int(hashlib.sha256(text.encode()).hexdigest()[:4], 16)
        verdict = {"claimed": True, "solved": True, "false_success": False, "reason": "", "detail": ""}
        numbers = {"outcome": "converged", "residual": 0.0, "coulomb": 0.0, "sweeps": sweeps}
        return {"seconds": PASS_SECONDS} | verdict | numbers


class Here(Worker):
    """Its desk is in this process: starting one takes longer than all the passes."""

    def __init__(self, setting):
        super().__init__(setting)
        self._desk = Desk()

    def ask(self, name, arguments, limit):
        return getattr(self._desk, name)(*arguments)


def measure(plan, folder):
    """Run a plan with such a desk."""
    run_module.Worker = Here
    run_module.run(plan, RowFile(folder), Silent())
