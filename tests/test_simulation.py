"""The step of a scene, judged by physics; the scenes and the corpus, by their rules."""

import csv
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree
from slope import UP, incline

from fibercontact.bench.problem_set import load_set
from fibercontact.problem.fclib import read
from fibercontact.problem.measure import measure
from fibercontact.rods.dynamics import energy
from fibercontact.simulation import corpus
from fibercontact.simulation.scene import Motion, SceneError
from fibercontact.simulation.scenes import HEADS, KINDS, SCENES, Parameters, build
from fibercontact.simulation.step import SimulationError, simulate

GRAVITY = 9.81


def final_speed(scene):
    *_, last = simulate(scene)
    return float(np.linalg.norm(last.world.state.v[0, :3])), last.world.time


@pytest.mark.parametrize("mu", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("share", [0.7, 0.99])
def test_a_rod_on_an_incline_sticks_below_the_friction_angle(mu, share):
    speed, time = final_speed(incline(math.atan(share * mu), mu))
    assert speed < 1e-5 * GRAVITY * time


@pytest.mark.parametrize("mu", [0.0, 0.1, 0.5, 1.0])
@pytest.mark.parametrize("excess", [0.01, 0.3])
def test_above_the_friction_angle_it_slides_as_coulomb_says(mu, excess):
    theta = math.atan(mu + excess)
    speed, time = final_speed(incline(theta, mu))
    acceleration = GRAVITY * (math.sin(theta) - mu * math.cos(theta))
    assert speed == pytest.approx(acceleration * time, rel=2e-3)


def test_the_incline_carries_the_weight():
    theta, mu = 0.3, 0.5
    scene = incline(theta, mu)
    *_, last = simulate(scene)
    weight = scene.rods.line_density[0] * scene.rods.length[0] * GRAVITY
    total = last.world.impulses.sum(axis=0) / scene.dt
    np.testing.assert_allclose(total, weight * UP, atol=1e-4 * weight)


def test_friction_and_contact_do_not_create_energy():
    """Free fibres fall on a plane: their energy decreases, but for the first-order error of the step."""
    scene = replace(build(Parameters("plane", 6, "straight", 0.5, 0.5, 3)), steps=120, dt=1e-3)
    energies = []
    for step in simulate(scene):
        e = energy(scene.rods, step.world.state, scene.gravity(0.0))
        energies.append(float((e.kinetic + e.elastic + e.gravitational).sum()))
    drop = energies[0] - energies[-1]
    assert drop > 0
    assert np.diff(energies).max() < 0.02 * drop


def test_roots_follow_the_body_that_carries_them():
    scene = build("head-curly-96-mu0.6")
    scene = replace(scene, steps=20)
    *_, last = simulate(scene)
    motion_centre = last.world.bodies[0].pivot
    arms = np.linalg.norm(last.world.state.root_position - motion_centre, axis=1)
    np.testing.assert_allclose(arms, 0.05, rtol=2e-3)
    np.testing.assert_allclose(last.world.bodies[0].obstacles[0].point, motion_centre, atol=1e-12)
    assert np.linalg.norm(motion_centre) > 1e-3


def test_a_moving_plane_carries_a_sticking_rod():
    scene = incline(0.0, 1.0)
    belt = np.array([0.2, 0.0, 0.0])
    body = replace(scene.bodies[0], motion=lambda time: Motion(belt, np.zeros(3)))
    *_, last = simulate(replace(scene, bodies=[body]))
    np.testing.assert_allclose(last.world.state.v[0, :3], belt, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("curl", ["straight", "mixed"])
def test_every_kind_of_scene_runs_and_poses_problems(kind, curl):
    scene = replace(build(Parameters(kind, 12, curl, 0.3, 0.3, 1)), steps=12)
    steps = list(simulate(scene))
    assert len(steps) == 12
    assert np.isfinite(steps[-1].world.state.v).all()
    for step in steps:
        if step.problem is None:
            assert len(step.contacts.gap) == 0
            continue
        assert step.problem.n == len(step.contacts.gap)
        assert step.problem.d == step.world.state.v.size
        assert measure(step.problem.condense(), step.run.r).residual == pytest.approx(
            step.run.residual, rel=1e-6
        )


def test_the_same_scene_gives_the_same_steps():
    scene = replace(build(Parameters("twist", 12, "wavy", 0.3, 0.3, 1)), steps=15)
    for one, other in zip(simulate(scene), simulate(scene), strict=True):
        np.testing.assert_array_equal(one.world.state.q, other.world.state.q)
        np.testing.assert_array_equal(one.guess, other.guess)


def test_the_guess_is_close_when_little_changes():
    """A rod at rest on a plane: the last step's impulse solves the next step."""
    scene = incline(0.1, 0.5, steps=40)
    *_, last = simulate(scene)
    problem = last.problem.condense()
    assert measure(problem, last.guess).residual < 1e-3
    assert measure(problem, np.zeros_like(last.guess)).residual > 0.1


def test_a_motion_that_blows_up_is_an_error():
    scene = incline(0.0, 0.5)
    state = scene.state._replace(v=np.full_like(scene.state.v, np.inf))
    with (
        pytest.raises(SimulationError, match=r"incline: the motion blew up at 0 s"),
        np.errstate(all="ignore"),
    ):
        next(simulate(replace(scene, state=state)))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ("nowhere", r"unknown scene 'nowhere' \(known: wisp"),
        (Parameters("sponge", 9, "wavy", 0.3, 0.3, 1), r"unknown kind of scene 'sponge' \(known: wisp"),
        (Parameters("wisp", 9, "frizzy", 0.3, 0.3, 1), r"unknown curl 'frizzy' \(known: straight"),
        (Parameters("wisp", 1, "wavy", 0.3, 0.3, 1), "at least 2 fibres"),
    ],
)
def test_scenes_that_are_not(parameters, message):
    with pytest.raises(SceneError, match=message):
        build(parameters)


def test_the_corpus_has_306_problems_by_its_rule():
    assert len(corpus.CORE.scenes) * corpus.CORE.per_scene == 306
    assert {p.kind for p in SCENES.values()} == set(KINDS) - {"scalp"}
    frictions = sorted({p.mu for p in SCENES.values()})
    assert frictions[0] == 0.0
    assert frictions[-1] == 1.0


def test_the_large_set_is_24_problems_of_helices_and_clothoids():
    large = corpus.SETS["large"]
    assert len(large.scenes) * large.per_scene == 24
    assert (large.fewest, large.most) == (3000, 30_000)
    assert {p.model for p in large.scenes} == {"helix", "clothoid"}
    assert max(p.fibres for p in large.scenes) == 4000
    assert len({p.seed for p in large.scenes}) > 4


@pytest.mark.parametrize("name", HEADS)
def test_a_head_has_its_roots_on_the_scalp_and_none_overlap(name):
    scene = build(name)
    roots = scene.state.root_position
    np.testing.assert_allclose(np.linalg.norm(roots, axis=1), 0.1)
    distance, _ = KDTree(roots).query(roots, k=2)
    assert distance[:, 1].min() > 2 * scene.rods.radius[0]


@pytest.mark.parametrize("count", [1, 2, 5, 17])
@pytest.mark.parametrize("eligible", [17, 18, 100])
def test_evenly_spaced_steps(count, eligible):
    steps = list(range(7, 7 + eligible))
    chosen = corpus.evenly_spaced(steps, count)
    assert len(set(chosen)) == count
    assert chosen == sorted(chosen)
    assert chosen[0] == steps[0]
    if count > 1:
        assert chosen[-1] == steps[-1]
        gaps = np.diff(chosen)
        assert gaps.max() - gaps.min() <= 1


@pytest.mark.parametrize("problems", corpus.SETS.values(), ids=corpus.SETS)
def test_the_scenes_of_every_set_have_names_that_build_them(problems, monkeypatch):
    for kind in KINDS:
        monkeypatch.setitem(KINDS, kind, lambda p, rng: p)
    assert [build(p.name) for p in problems.scenes] == list(problems.scenes)


def test_dumped_problems_are_those_of_the_steps(tmp_path):
    scene = replace(build(Parameters("wisp", 8, "curly", 0.3, 0.3, 1)), steps=40)
    rows = corpus.dump_scene(scene, tmp_path, count=3, fewest=5, most=500)
    corpus.write_manifest(tmp_path, rows)
    with (tmp_path / "manifest.csv").open() as stream:
        listed = list(csv.DictReader(stream))
    assert [row["file"] for row in listed] == sorted(row["file"] for row in listed)
    by_index = {step.index: step for step in simulate(scene)}
    for row in listed:
        found = read(tmp_path / row["file"])
        step = by_index[int(row["step"])]
        assert found.problem.condense().content_hash() == step.problem.condense().content_hash()
        np.testing.assert_array_equal(found.guesses[0].r, step.guess)
        assert int(row["contacts"]) == found.problem.n == step.problem.n


def test_too_few_eligible_steps_is_an_error(tmp_path):
    scene = replace(build("wisp-straight-19-mu0.3"), steps=3)
    with pytest.raises(SceneError, match=r"wisp-straight-19-mu0.3: only \d eligible steps, 17 are needed"):
        corpus.dump_scene(scene, tmp_path)


SMALL = corpus.ProblemSet(
    "small", [Parameters("wisp", 7, "curly", mu, mu, 1) for mu in (0.1, 0.7)], per_scene=2, fewest=1, most=500
)


@pytest.fixture
def short(monkeypatch):
    """Scenes end before most of their steps."""
    monkeypatch.setattr(corpus, "build", lambda p: replace(build(p), steps=30))


def test_a_set_is_written_scene_by_scene_with_one_manifest(tmp_path, short):
    written = dict(corpus.dump_set(SMALL, tmp_path))
    assert list(written) == [p.name for p in SMALL.scenes]
    with (tmp_path / "manifest.csv").open() as stream:
        files = [row["file"] for row in csv.DictReader(stream)]
    assert files == [row["file"] for rows in written.values() for row in rows]
    assert len(files) == len(set(files)) == 4


def test_a_set_that_was_interrupted_goes_on_with_the_next_scene(tmp_path, short):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    dict(corpus.dump_set(SMALL, whole))
    next(corpus.dump_set(SMALL, parts))
    assert not (parts / "manifest.csv").exists()
    assert [name for name, _ in corpus.dump_set(SMALL, parts)] == [SMALL.scenes[1].name]
    assert {f.name: f.read_bytes() for f in parts.iterdir()} == {
        f.name: f.read_bytes() for f in whole.iterdir()
    }


def test_a_run_taken_up_in_the_middle_is_the_run():
    scene = replace(build(Parameters("twist", 12, "wavy", 0.3, 0.3, 1)), steps=9)
    steps = list(simulate(scene))
    for one, other in zip(steps[5:], simulate(scene, steps[4].world, 5), strict=True):
        assert one.index == other.index
        np.testing.assert_array_equal(one.world.state.q, other.world.state.q)
        np.testing.assert_array_equal(one.world.impulses, other.world.impulses)


@pytest.mark.parametrize("problems", corpus.SETS.values(), ids=corpus.SETS)
def test_committed_sets_keep_their_rule(problems):
    """As many problems of each scene as the rule says, their contacts and files as the manifest has them."""
    folder = Path(__file__).parents[1] / "problems" / problems.name
    if not folder.is_dir():
        pytest.skip("a set that is made, not kept")
    entries = load_set(folder)  # compares every hash
    scenes = Counter(entry.scene for entry in entries)
    assert scenes == dict.fromkeys((p.name for p in problems.scenes), problems.per_scene)
    with (folder / "manifest.csv").open() as stream:
        contacts = [int(row["contacts"]) for row in csv.DictReader(stream)]
    assert problems.fewest <= min(contacts) <= max(contacts) <= problems.most


def test_rods102_has_34_problems_of_each_model_and_is_small():
    folder = Path(__file__).parents[1] / "problems" / "rods102"
    models = Counter(entry.scene.partition("@")[2] for entry in load_set(folder))
    assert models == {"": 34, "clothoid": 34, "discrete": 34}
    assert sum(file.stat().st_size for file in folder.iterdir()) <= 32e6
    last = read(folder / "twist-mixed-40-mu0.5@discrete-249.hdf5").problem
    bandwidth = abs(np.subtract(*last.M.nonzero())).max()
    assert bandwidth <= 11  # of discrete rods: what is dumped is what the bands hold
