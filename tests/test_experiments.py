"""Every script in experiments/ has a small run."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "experiments"
SMALL = {
    "assemblies.py": ["--contacts", "60"],
    "sweep_cost.py": ["--contacts", "60", "--repetitions", "1", "--solvers", "secular,pyramid"],
    "reference_methods.py": ["--problems", "6", "--max-contacts", "60", "--seconds", "0.5"],
    "one_contact_failures.py": [
        "--set",
        ROOT / "problems" / "one_contact.h5",
        "--sample",
        "5",
        "--out",
        "evidence.csv",
    ],
    "alart_curnier_steps.py": ["--problems", "20", "--out", "figure"],
    "scaling.py": ["--fibres", "40,60,90", "--models", "helix", "--steps", "24", "--out", "figure"],
    "rod_convergence.py": ["--most", "8", "--out", "figure"],
    "outer_loops.py": ["--limit", "2", "--out", "figure"],
    "speed.py": ["--most", "200", "--repetitions", "1", "--out", "figure"],
    "global_methods.py": ["--limit", "1", "--methods", "apgd,newton-ac,interior-point", "--out", "figure"],
    "isolation.py": ["--limit", "1", "--repetitions", "1"],
    "penalty.py": ["--time", "0.01", "--stiffness", "300", "--fibres", "2", "--out", "figure"],
    "rod_validation.py": ["--elements", "6,8", "--bends", "8", "--curve", "1", "--out", "figure"],
    "rod_stick_slip.py": ["--elements", "4", "--mus", "0.3", "--dt", "0.1", "--out", "figure"],
    "rod_capstan.py": ["--meshes", "4", "--cases", "0.3:1", "--out", "figure"],
    "rod_incline.py": ["--mus", "0.5", "--resolution", "0.1", "--out", "figure"],
    "rod_energy.py": ["--steps", "60", "--out", "figure"],
    "rod_table.py": ["--tables", ROOT / "results" / "rods", "--out", "table"],
}


def test_every_script_has_a_small_run():
    assert {file.name for file in FOLDER.glob("*.py")} == set(SMALL)


@pytest.mark.parametrize("script", SMALL)
def test_small_run(script, tmp_path):
    done = subprocess.run(
        [sys.executable, FOLDER / script, *SMALL[script]],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
