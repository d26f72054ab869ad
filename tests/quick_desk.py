"""A desk whose passes take a few milliseconds and give the same whenever they are made: for tests of the runner."""

import hashlib
import json
import os
import time
from functools import partial

FINGERPRINTS = "QUICK_DESK_FINGERPRINTS"
PASS_SECONDS = 0.003


class Desk:
    def __init__(self, plugins, solvers):
        self._prints = json.loads(os.environ[FINGERPRINTS])
        self._file = None

    def fingerprints(self):
        return self._prints

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


def measure(plan, folder):
    """Run a plan with these desks."""
    from fibercontact.bench import run as run_module
    from fibercontact.bench.rows import RowFile
    from fibercontact.bench.worker import Setting

    run_module.Setting = partial(Setting, desk=__name__)
    os.environ[FINGERPRINTS] = json.dumps(plan.fingerprints())
    run_module.run(plan, RowFile(folder), _Nobody())


class _Nobody:
    def now(self, problem, solver):
        pass

    def row(self, unit, row):
        pass

    def note(self, text):
        pass
