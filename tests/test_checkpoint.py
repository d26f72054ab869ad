"""Checkpoints: a run that is broken off and taken up again is the run, bit for bit; faults are named."""

import subprocess
import sys
from dataclasses import fields, replace

import h5py
import numpy as np
import pytest

from fibercontact.simulation.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import simulate, start

STEPS, BROKEN_AFTER = 12, 6


def scene_of(model, kind="twist"):
    return replace(build(Parameters(kind, 16, "mixed", 0.4, 0.3, 3, model)), steps=STEPS)


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
        (edit("world/state/q", np.zeros(3)), r"world/state/q holds float64 \(3,\), not float64 \(16, 5, 3\)"),
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
        (build("wisp-straight-19-mu0.3"), "a checkpoint of the scene 'twist-mixed-16-mu0.4', not of 'wisp-"),
        (replace(scene_of("helix"), mu_obstacles=0.9), "is not what it was"),
        (replace(scene_of("helix"), gravity=lambda time: np.zeros(3)), "is not what it was"),
    ],
)
def test_a_checkpoint_of_another_scene_is_refused(other, message, tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(file, other)


def test_more_steps_are_the_same_scene(tmp_path):
    scene, file = scene_of("helix"), tmp_path / "checkpoint.h5"
    broken_off(scene, file)
    assert load_checkpoint(file, replace(scene, steps=1000))[0] == BROKEN_AFTER
