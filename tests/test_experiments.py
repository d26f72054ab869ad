"""Every script in experiments/ has a small run."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from fibercontact.local.one_contact import read, write

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "experiments"
CONTACTS = ROOT / "problems" / "one_contact.h5"
SMALL = {
    "assemblies.py": ["--contacts", "60"],
    "sweep_cost.py": ["--contacts", "60", "--repetitions", "1", "--solvers", "secular,pyramid"],
    "reference_methods.py": ["--problems", "6", "--max-contacts", "60", "--seconds", "0.2"],
    "one_contact_failures.py": ["--set", CONTACTS, "--sample", "5", "--out", "evidence.csv"],
    "alart_curnier_steps.py": ["--problems", "20", "--out", "figure"],
    "scaling.py": ["--fibres", "40,60,90", "--models", "helix", "--steps", "24", "--out", "figure"],
    "rod_convergence.py": ["--most", "8", "--out", "figure"],
    "outer_loops.py": ["--limit", "2", "--out", "figure"],
    "speed.py": ["--most", "200", "--repetitions", "1", "--out", "figure"],
    "global_methods.py": ["--limit", "1", "--methods", "apgd,newton-ac,interior-point", "--out", "figure"],
    "isolation.py": ["--limit", "1", "--repetitions", "1"],
    "penalty.py": [
        "--time",
        "0.01",
        "--stiffness",
        "300",
        "--trial",
        "30",
        "--fibres",
        "2",
        "--out",
        "figure",
    ],
    "rod_validation.py": ["--elements", "6", "--bends", "8", "--curve", "1", "--out", "figure"],
    "rod_stick_slip.py": ["--elements", "4", "--mus", "0.3", "--dt", "0.1", "--out", "figure"],
    "rod_capstan.py": ["--meshes", "4", "--cases", "0.3:1", "--out", "figure"],
    "rod_incline.py": ["--mus", "0.5", "--resolution", "0.6", "--out", "figure"],
    "rod_energy.py": ["--steps", "60", "--out", "figure"],
    "rod_table.py": ["--tables", ROOT / "results" / "rods", "--out", "table"],
}


def test_every_script_has_a_small_run():
    assert {file.name for file in FOLDER.glob("*.py")} == set(SMALL)


@pytest.fixture(scope="module")
def few_contacts(tmp_path_factory):
    """The one-contact problems, thinned out."""
    contacts, file = read(CONTACTS), tmp_path_factory.mktemp("few") / "contacts.h5"
    write(file, contacts.select(range(0, contacts.m, 20)))
    return file


@pytest.fixture
def interpreted(monkeypatch):
    """Programs that a script starts do not compile: a cold start would take a minute."""
    run = subprocess.run

    def without_jit(*arguments, env=os.environ, **more):
        return run(*arguments, env=dict(env) | {"NUMBA_DISABLE_JIT": "1"}, **more)

    monkeypatch.setattr(subprocess, "run", without_jit)


@pytest.mark.parametrize("script", SMALL)
@pytest.mark.usefixtures("interpreted")
def test_small_run(script, few_contacts, tmp_path, monkeypatch, capsys):
    """In this process, as `python SCRIPT` would: most of a small run's time would be that of its imports."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(FOLDER)
    arguments = [few_contacts if argument is CONTACTS else argument for argument in SMALL[script]]
    monkeypatch.setattr(sys, "argv", [script, *map(str, arguments)])
    runpy.run_path(str(FOLDER / script), run_name="__main__")
    assert capsys.readouterr().out.strip()
