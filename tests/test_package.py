"""The package: one version, the sample set, the ways to start it, the checks that are defined once."""

import csv
import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import h5py
import numpy as np
import pytest

import fibercontact
from fibercontact.bench.problem_set import find_set, load_set
from fibercontact.reference.store import Store, references_file

ROOT = Path(__file__).parents[1]
PROBLEMS = ROOT / "problems"


def lines(folder):
    with (PROBLEMS / folder / "manifest.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def started(*arguments, **environment):
    """What a command prints."""
    return subprocess.run(
        [sys.executable, "-m", "fibercontact", *arguments],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip


def test_the_version_is_the_same_everywhere():
    citation = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text("utf-8"), flags=re.MULTILINE)
    newest = re.search(r"^## \[(.+?)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), flags=re.MULTILINE)
    assert re.fullmatch(r"\d+\.\d+\.\d+", fibercontact.__version__)
    assert citation[1] == newest[1] == fibercontact.__version__
    assert version("fibercontact") == fibercontact.__version__
    assert started("--version") == f"fibercontact {fibercontact.__version__}\n"


def test_the_sample_follows_its_rule():
    """Of each kind of scene, the two scenes with the fewest fibres; of each, the step with the fewest contacts."""
    scenes = dict.fromkeys(line["scene"] for line in lines("core306"))
    by_kind = {}
    for scene in sorted(scenes, key=lambda scene: int(scene.split("-")[2])):
        by_kind.setdefault(scene.split("-")[0], []).append(scene)
    smallest = {scene for of_kind in by_kind.values() for scene in of_kind[:2]}
    expected = {
        min(of_scene, key=lambda line: int(line["contacts"]))["file"]
        for scene in smallest
        for of_scene in [[line for line in lines("core306") if line["scene"] == scene]]
    }
    listed = lines("sample")
    assert len(by_kind) == 6
    assert len(listed) >= 12
    assert {line["file"] for line in listed} == {f"../core306/{name}" for name in expected}
    assert sum(int(line["bytes"]) for line in listed) < 2e6


def test_the_sample_is_a_set_with_the_references_of_core306():
    folder = find_set("sample")
    entries = load_set(folder)
    assert [entry.scene for entry in entries] == [line["scene"] for line in lines("sample")]
    with (
        h5py.File(references_file(folder)) as found,
        h5py.File(references_file(PROBLEMS / "core306")) as expected,
    ):
        assert set(found) == {entry.hash for entry in entries}
        for key in found:
            np.testing.assert_array_equal(found[key]["solution/r"], expected[key]["solution/r"])
    assert Store(references_file(folder)).claimed_unsolvable() == set()


@pytest.mark.parametrize(("shell", "instruction"), [("bash", "complete_bash"), ("zsh", "complete_zsh")])
def test_the_shell_completes_commands(shell, instruction):
    name = "fibercontact"
    words = {"COMP_WORDS": f"{name} ta", "COMP_CWORD": "1", "_TYPER_COMPLETE_ARGS": f"{name} ta"}
    shown = subprocess.run(
        [sys.executable, "-c", "from fibercontact.cli import app; app(prog_name='fibercontact')"],
        env=os.environ | {"PYTHONPATH": str(ROOT), "_FIBERCONTACT_COMPLETE": instruction} | words,
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "table" in shown
    assert "solve" not in shown


def test_completion_can_be_installed():
    shown = started("--help")
    assert "--install-completion" in shown
    assert "--show-completion" in shown


def test_the_hook_before_a_commit_runs_what_integration_runs():
    """Both by `make lint`, and by nothing else."""
    hooks = (ROOT / ".pre-commit-config.yaml").read_text("utf-8")
    integration = (ROOT / ".ci" / "run").read_text("utf-8").splitlines()
    assert re.findall(r"entry: (.+)", hooks) == ["make lint"]
    assert "make lint" in integration
    assert not [line for line in integration if "ruff" in line or "mypy" in line]
