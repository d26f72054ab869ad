"""Checkpoints: a run that is broken off and taken up again is the run, bit for bit; faults are named."""

import os
import subprocess
import sys
from dataclasses import fields, replace

import h5py
import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from fibercontact.cli import app
from fibercontact.simulation.checkpoint import CHECKPOINT, CheckpointError, load_checkpoint, save_checkpoint
from fibercontact.simulation.scene import Air
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import simulate, start, take_step

STEPS, BROKEN_AFTER = 12, 8


def scene_of(model, kind="twist"):
    return replace(build(Parameters(kind, 8, "mixed", 0.4, 0.3, 3, model)), steps=STEPS)


def run(scene, world=None, first=0):
    *_, last = simulate(scene, world, first)
    return last


def broken_off(scene, file):
    last = run(replace(scene, steps=BROKEN_AFTER))
    save_checkpoint(file, scene, last.index, last.world)
    return last


def numbers(value):
    """All arrays and numbers in a value, in order."""
    if isinstance(value, np.ndarray | float | int):
        return [np.asarray(value)]
    if hasattr(value, "_asdict"):
        value = list(value)
    elif hasattr(value, "__dataclass_fields__"):
        value = [getattr(value, field.name) for field in fields(value)]
    return [x for part in value for x in numbers(part)] if isinstance(value, list | tuple) else []


def assert_same_world(one, other):
    pairs = list(zip(numbers(one), numbers(other), strict=True))
    assert len(pairs) > 10
    for x, y in pairs:
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("kind", ["twist", "comb", "plane"])
@pytest.mark.parametrize("model", ["helix", "clothoid", "discrete"])
def test_a_run_that_goes_on_from_a_checkpoint_is_the_run(model, kind, tmp_path):
    scene, file = scene_of(model, kind), tmp_path / "checkpoint.h5"
    before = broken_off(scene, file)
    first, world = load_checkpoint(file, scene)
    assert first == BROKEN_AFTER
    assert_same_world(world, before.world)
    whole, taken_up = run(scene), run(scene, world, first)
    assert whole.index == taken_up.index == STEPS - 1
    assert_same_world(taken_up.world, whole.world)
    np.testing.assert_array_equal(taken_up.guess, whole.guess)


FRESH = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_checkpoint import load_checkpoint, run, save_checkpoint, scene_of
scene, file = scene_of("helix"), Path(sys.argv[2])
first, world = load_checkpoint(file, scene)
last = run(scene, world, first)
save_checkpoint(file, scene, last.index, last.world)
"""


def test_a_fresh_process_goes_on_with_the_same_numbers(tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    subprocess.run([sys.executable, "-c", FRESH, str(__file__).rpartition("/")[0], str(file)], check=True)
    _, world = load_checkpoint(file, scene)
    assert_same_world(world, run(scene).world)


def test_a_world_without_contacts_keeps_none(tmp_path):
    scene, file = scene_of("helix", "plane"), tmp_path / "checkpoint.h5"
    save_checkpoint(file, scene, 0, start(scene))
    _, world = load_checkpoint(file, scene)
    assert world.contacts is None
    assert world.impulses is None


def test_directions_are_kept_to_the_last_digit(tmp_path):
    """Obstacles make their directions unit vectors, which changes one that is a unit vector already."""
    scene, file = scene_of("helix", "comb"), tmp_path / "checkpoint.h5"
    world, odd = start(scene), np.array([0.0, 0.0, 1.0 + 2**-52])
    object.__setattr__(world.bodies[1].obstacles[0], "axis", odd)
    save_checkpoint(file, scene, 0, world)
    np.testing.assert_array_equal(load_checkpoint(file, scene)[1].bodies[1].obstacles[0].axis, odd)


def test_a_failed_write_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    save_checkpoint(file, scene, 0, start(scene))
    old = file.read_bytes()
    monkeypatch.setattr("pathlib.Path.replace", lambda *_: (_ for _ in ()).throw(OSError("no space")))
    with pytest.raises(OSError, match="no space"):
        save_checkpoint(file, scene, 1, start(scene))
    assert file.read_bytes() == old
    assert list(tmp_path.iterdir()) == [file]


def truncate(file):
    file.write_bytes(file.read_bytes()[:-1000])


def damage(file):
    with h5py.File(file) as content:
        at = content["world/state/q"].id.get_chunk_info(0).byte_offset
    bytes_ = bytearray(file.read_bytes())
    bytes_[at + 40] ^= 1
    file.write_bytes(bytes_)


def edit(name, value):
    def change(file):
        with h5py.File(file, "a") as content:
            del content[name]
            if value is not None:
                content[name] = value

    return change


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda file: file.unlink(), "no such file"),
        (truncate, "not a readable HDF5 file"),
        (damage, "world/state/q cannot be read"),
        (edit("format", None), "its format is 'none', not 'fibercontact checkpoint 1'"),
        (edit("format", "fibercontact checkpoint 0"), "its format is 'fibercontact checkpoint 0'"),
        (edit("world/state/q", None), "world/state/q is missing"),
        (edit("world/state/q", np.zeros(3)), r"world/state/q holds float64 \(3,\), not float64 \(8, 5, 3\)"),
        (edit("world/impulses", np.zeros((1, 3))), r"world/impulses holds float64 \(1, 3\)"),
        (edit("world/state/v", "fast"), "world/state/v holds object, not float64 values"),
    ],
)
def test_a_checkpoint_that_cannot_be_used_is_named_with_its_fault(fault, message, tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    fault(file)
    with pytest.raises(CheckpointError, match=rf"checkpoint\.h5: .*{message}"):
        load_checkpoint(file, scene)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (build("wisp-straight-19-mu0.3"), "a checkpoint of the scene 'twist-mixed-8-mu0.4', not of 'wisp-"),
        (replace(scene_of("helix"), mu_obstacles=0.9), "is not what it was"),
        (replace(scene_of("helix"), gravity=lambda time: np.zeros(3)), "is not what it was"),
        (replace(scene_of("helix"), air=Air(1e-3, 5e-4)), "is not what it was"),
    ],
)
def test_a_checkpoint_of_another_scene_is_refused(other, message, tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(file, other)


def test_another_wind_is_another_scene(tmp_path):
    file, calm = tmp_path / "checkpoint.h5", replace(scene_of("helix"), air=Air(1e-3, 5e-4))
    windy = replace(calm, air=replace(calm.air, wind=lambda time: np.array([1.0, 0.0, 0.0])))
    save_checkpoint(file, calm, 0, start(calm))
    assert load_checkpoint(file, calm)[0] == 1
    with pytest.raises(CheckpointError, match="is not what it was"):
        load_checkpoint(file, windy)


def test_more_steps_are_the_same_scene(tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    assert load_checkpoint(file, replace(scene, steps=1000))[0] == BROKEN_AFTER


# The command line

SCENE = "wisp-straight-19-mu0.3"


def command(*arguments):
    return CliRunner().invoke(app, ["simulate", SCENE, *(str(a) for a in arguments)])


def rows_of(folder):
    """The rows of a run without what its clock said."""
    table = pd.read_csv(folder / "steps.csv")
    return table[[name for name in table.columns if "seconds" not in name]]


def world_of(folder):
    return load_checkpoint(folder / CHECKPOINT, build(SCENE))


@pytest.fixture(scope="module", autouse=True)
def _no_pictures():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("fibercontact.simulation.record.draw", lambda *_: None)
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    result = command("--steps", 12, "--out", folder, "--checkpoint-every", 100, "--dump", "every=3")
    assert result.exit_code == 0, result.output
    return folder


def assert_same_run(folder, whole):
    pd.testing.assert_frame_equal(rows_of(folder), rows_of(whole), check_exact=True)
    (index, world), (whole_index, whole_world) = world_of(folder), world_of(whole)
    assert index == whole_index == 12
    assert_same_world(world, whole_world)


def test_a_restart_goes_on_with_rows_and_problems(whole, tmp_path):
    asked = ("--out", tmp_path, "--dump", "every=3")
    assert command("--steps", 5, *asked, "--checkpoint-every", 2).exit_code == 0
    result = command("--steps", 12, *asked, "--restart")
    assert result.exit_code == 0, result.output
    assert_same_run(tmp_path, whole)
    for file in sorted(whole.glob("problems/*")):
        assert (tmp_path / "problems" / file.name).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("options", [("--checkpoint-every", 4), ("--checkpoint-every", 100)])
def test_a_run_that_is_interrupted_can_go_on(options, whole, tmp_path, monkeypatch):
    def interrupted(scene, solver, world, index):
        if index == 7:
            raise KeyboardInterrupt
        return take_step(scene, solver, world, index)

    with monkeypatch.context() as patch:
        patch.setattr("fibercontact.simulation.step.take_step", interrupted)
        result = command("--steps", 12, "--out", tmp_path, *options)
    assert result.exit_code == 130
    assert world_of(tmp_path)[0] == 7
    assert command("--steps", 12, "--out", tmp_path, "--restart").exit_code == 0
    assert_same_run(tmp_path, whole)


def test_a_killed_run_goes_on_from_the_last_checkpoint(whole, tmp_path, monkeypatch):
    def killed(scene, solver, world, index):
        if index == 7:
            os._exit(9)
        return take_step(scene, solver, world, index)

    monkeypatch.setattr("fibercontact.simulation.step.take_step", killed)
    if (child := os.fork()) == 0:
        command("--steps", 12, "--out", tmp_path, "--checkpoint-every", 3)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
    monkeypatch.undo()
    assert world_of(tmp_path)[0] == 6
    assert len(rows_of(tmp_path)) == 6
    assert command("--steps", 12, "--out", tmp_path, "--restart").exit_code == 0
    assert_same_run(tmp_path, whole)


def test_a_restart_without_a_checkpoint_says_so(tmp_path):
    result = command("--out", tmp_path, "--restart")
    assert result.exit_code == 2
    assert f"{tmp_path / CHECKPOINT}: no such file" in " ".join(result.output.split())
