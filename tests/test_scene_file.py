"""Scene files: what is written is what is built, any fault is named by its key, nothing overlaps at the start."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fibercontact.contact.obstacles import Cylinder, Plane, Sphere
from fibercontact.rods.basis import CLOTHOID
from fibercontact.rods.discrete_model import DiscreteRods
from fibercontact.rods.interface import rod_model
from fibercontact.simulation import scene_file
from fibercontact.simulation.scene import SceneError
from fibercontact.simulation.scene_faults import known_keys
from fibercontact.simulation.scene_file import open_scene
from fibercontact.simulation.scenes import build
from fibercontact.simulation.step import simulate
from fibercontact.simulation.strands import MODELS, cap, hexagonal

TEMPLATE = Path(scene_file.__file__).with_name("template.toml").read_text(encoding="utf-8")

DOCS = (Path(__file__).parents[1] / "docs" / "scenes.md").read_text(encoding="utf-8")

LEAST = """
dt = 1e-3
steps = 3
mu = 0.5
fibres = [{ count = 1, length = 0.1, radius = 1e-3, young = 1e7, density = 1000.0, place = PLACE }]
"""
BUNDLE = '{ pattern = "bundle", spacing = 3e-3 }'


def written(tmp_path, text, name="scene.toml"):
    file = tmp_path / name
    file.write_text(text, encoding="utf-8")
    return str(file)


def least(tmp_path, place=BUNDLE, count=1, rest="", keys=""):
    """The shortest scene file there can be, and what is put in its place."""
    text = LEAST.replace("PLACE", place).replace("count = 1", f"count = {count}") + rest
    return written(tmp_path, keys + text)


@pytest.mark.parametrize("model", ["", *MODELS])
def test_the_template_runs_with_any_rods(tmp_path, model):
    scene = open_scene(written(tmp_path, TEMPLATE, "my_wisp.toml") + (f"@{model}" if model else ""))
    assert scene.name == (f"my_wisp@{model}" if model else "my_wisp")
    assert len(scene.rods.length) == 37
    assert isinstance(scene.rods, DiscreteRods) == (model == "discrete")
    if model == "clothoid":
        assert scene.rods.basis == CLOTHOID
    for _, step in zip(range(2), simulate(scene), strict=False):
        assert np.isfinite(rod_model(scene.rods).centreline(step.world.state, 5)).all()


def test_only_what_follows_the_file_names_rods(tmp_path):
    """Folders and files may have an @ in their names."""
    folder = tmp_path / "me@home.py"
    folder.mkdir()
    for name in ("my_wisp.toml", "my@wisp.toml"):
        file = written(folder, TEMPLATE, name)
        assert not isinstance(open_scene(file).rods, DiscreteRods)
        assert isinstance(open_scene(f"{file}@discrete").rods, DiscreteRods)


def test_a_short_file_has_the_documented_defaults(tmp_path):
    scene = open_scene(least(tmp_path))
    assert (scene.name, scene.dt, scene.steps, scene.skip_root) == ("scene", 1e-3, 3, 0.0)
    assert scene.mu_fibres == scene.mu_obstacles == 0.5
    np.testing.assert_array_equal(scene.gravity(1.0), [0, 0, -9.81])
    assert not scene.rods.free
    assert scene.rods.q_rest.shape == (1, 5, 3)
    assert not scene.rods.q_rest.any()
    np.testing.assert_allclose(scene.rods.stiffness[0, 1], 1e7 * np.pi * 1e-12 / 4)
    ends = rod_model(scene.rods).centreline(scene.state, 1)[0]
    np.testing.assert_allclose(ends, [[0, 0, 0], [0, 0, -0.1]], atol=1e-15)


@pytest.mark.parametrize("model", MODELS)
def test_a_natural_start_is_the_natural_shape(tmp_path, model):
    """An arc of half a turn ends at `(2/pi, 0)` lengths across, along and up to the turn about the tangent."""
    bend = np.pi / 0.1
    file = least(tmp_path, keys=f'model = "{model}"\nelements = 4\nedges = 200\n')
    text = Path(file).read_text(encoding="utf-8")
    natural = text.replace("count = 1,", f'count = 1, curvature = [0.0, {bend}, 0.0], start = "natural",')
    scene = open_scene(written(tmp_path, natural))
    root, end = rod_model(scene.rods).centreline(scene.state, 1)[0][[0, -1]]
    tolerance = 2e-3 if model == "discrete" else 1e-12
    np.testing.assert_allclose(np.hypot(*(end - root)[:2]), 0.2 / np.pi, rtol=tolerance)
    np.testing.assert_allclose((end - root)[2], 0, atol=0.1 * tolerance)


def test_patterns_put_the_roots_where_they_say(tmp_path):
    def roots_and_tangents(place, count):
        state = open_scene(least(tmp_path, place, count)).state
        return state.root_position, state.root_frame[:, :, 0]

    slanted = '{ pattern = "bundle", at = [1.0, 2.0, 3.0], direction = [1.0, 1.0, 0.0], spacing = 3e-3 }'
    roots, tangents = roots_and_tangents(slanted, 19)
    along = np.array([1, 1, 0]) / np.sqrt(2)
    np.testing.assert_allclose(tangents, np.tile(along, (19, 1)), atol=1e-12)
    np.testing.assert_allclose((roots - [1, 2, 3]) @ along, 0, atol=1e-12)
    apart = np.linalg.norm(roots[:, None] - roots, axis=2)[~np.eye(19, dtype=bool)]
    np.testing.assert_allclose(apart.min(), 3e-3)

    roots, tangents = roots_and_tangents('{ pattern = "sphere", at = [0.0, 0.0, 1.0], radius = 0.2 }', 12)
    np.testing.assert_allclose(roots - [0, 0, 1], 0.2 * tangents, atol=1e-12)

    roots, tangents = roots_and_tangents('{ pattern = "layers", spread = 0.01, spacing = 3e-3 }', 5)
    np.testing.assert_allclose(roots[:, 2], 3e-3 * np.arange(5), atol=1e-15)
    np.testing.assert_allclose(tangents[:, 2], 0, atol=1e-15)
    assert abs(roots + 0.05 * tangents)[:, :2].max() <= 0.01

    two = '{ pattern = "points", at = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]], direction = [[0.0, 3.0, 0.0]] }'
    roots, tangents = roots_and_tangents(two, 2)
    np.testing.assert_array_equal(roots, [[0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(tangents, [[0, 1, 0]] * 2, atol=1e-15)


@given(st.integers(2, 60), st.floats(0.1, 2.0))
def test_a_cap_covers_its_heights_evenly(count, share):
    normals = cap(count, share)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    np.testing.assert_allclose(normals[:, 2].mean(), 1 - share / 2, atol=1e-12)  # Archimedes
    assert (np.diff(normals[:, 2]) < 0).all()


@given(st.integers(1, 80), st.floats(1e-4, 1.0))
def test_a_hexagonal_lattice_keeps_its_spacing(count, spacing):
    points = hexagonal(count, spacing)
    assert points.shape == (count, 2)
    apart = np.linalg.norm(points[:, None] - points, axis=2)[~np.eye(count, dtype=bool)]
    if count > 1:
        np.testing.assert_allclose(apart.min(), spacing)


BODIES = """
[[bodies]]
name = "hand"
pivot = [0.0, 0.0, 1.0]
motion = [
  { until = 0.5, velocity = [1.0, 0.0, 0.0] },
  { until = 1.0, angular_velocity = [0.0, 2.0, 0.0], frequency = 1.0 },
]
obstacles = [
  { shape = "plane", point = [0.0, 0.0, -1.0], normal = [0.0, 0.0, 2.0] },
  { shape = "sphere", point = [1.0, 0.0, 0.0], radius = 0.1 },
  { shape = "cylinder", point = [2.0, 0.0, 0.0], axis = [0.0, 1.0, 0.0], radius = 0.1, length = 0.3 },
]
"""


def test_bodies_move_stage_by_stage_and_carry_what_they_hold(tmp_path):
    text = LEAST.replace("PLACE", BUNDLE).replace("count = 1", 'count = 1, body = "hand"')
    scene = open_scene(written(tmp_path, text + BODIES))
    world, hand = scene.bodies
    assert scene.carrier.tolist() == [1]
    for time, velocity, omega in (
        (0.3, 1.0, 0.0), (0.5, 1.0, 0.0), (0.75, 0.0, 2 * np.cos(1.5 * np.pi)), (1.0, 0.0, 2.0), (1.1, 0.0, 0.0),
    ):  # fmt: skip
        motion = hand.motion(time)
        np.testing.assert_allclose(motion.velocity, [velocity, 0, 0], atol=1e-12)
        np.testing.assert_allclose(motion.angular_velocity, [0, omega, 0], atol=1e-12)
    assert not np.any(world.motion(0.3))
    assert [type(obstacle) for obstacle in hand.obstacles] == [Plane, Sphere, Cylinder]
    np.testing.assert_array_equal(hand.obstacles[0].normal, [0, 0, 1])
    assert hand.obstacles[2].length == 0.3
    moved = next(simulate(scene)).world.state.root_position
    np.testing.assert_allclose(moved[0], [1e-3, 0, 0], atol=1e-12)


def test_air_is_drag_and_a_steady_wind(tmp_path):
    air = open_scene(
        least(tmp_path, keys="air = { normal = 1e-3, tangential = 5e-4, wind = [1.0, 0.0, 0.0] }\n")
    ).air
    assert (air.normal, air.tangential) == (1e-3, 5e-4)
    np.testing.assert_array_equal(air.wind(3.0), [1, 0, 0])


def test_the_same_file_gives_the_same_scene_and_another_seed_another(tmp_path):
    one, again = (open_scene(written(tmp_path, TEMPLATE)) for _ in range(2))
    other = open_scene(written(tmp_path, TEMPLATE.replace("seed = 1", "seed = 2")))
    np.testing.assert_array_equal(one.rods.q_rest, again.rods.q_rest)
    np.testing.assert_array_equal(one.state.root_frame, again.state.root_frame)
    assert not np.array_equal(one.rods.length, other.rods.length)


FAULTS = [
    ("count = 37", "count = 0", r"fibres\[0\].count: should be greater than or equal to 1 \(it is 0\)"),
    ("length = [0.11", "lenght = [0.11", r"length: is missing.*lenght: no such key \(did you mean length\?\)"),
    ("[0.11, 0.13]", "[0.13, 0.11]", r"fibres\[0\].length: the lower end of a range comes first"),
    ("[0.11, 0.13]", "-0.1", r"fibres\[0\].length\[0\]: should be greater than 0"),
    ('"wavy"', '"wavey"', r"fibres\[0\].curl: should be 'straight', 'wavy', 'curly' or 'mixed' \(it is 'wavey'"),
    ('"wavy"', '"wavy"\ncurvature = [0.0, 1.0, 0.0]', r"fibres\[0\].curvature: give either"),
    ('"wavy"', '"wavy"\nbody = "foot"', r"fibres\[0\].body: no body 'foot' \(known: world, hand\)"),
    ('pattern = "bundle"', 'pattern = "bndle"', r"fibres\[0\].place.pattern: must be one of 'bundle', 'sphere'"),
    ('pattern = "bundle", ', "", r"fibres\[0\].place: needs the key pattern"),
    ("young = 3e7\n", "", r"fibres\[0\].young: is missing"),
    ("axis = [0.0, 1.0, 0.0]", "axis = [0, 0, 0]", r"bodies\[0\].obstacles\[0\].axis: must not be zero"),
    ("velocity = [0.15, 0.0, 0.0]", "velocity = [0.15, 0.0, nan]", r"motion\[0\].velocity\[2\]: should be a finite"),
    ("velocity = [0.15, 0.0, 0.0]", "velocity = [0.15]", r"bodies\[0\].motion\[0\].velocity: list should have"),
    ("until = 0.4", "until = -1", r"bodies\[0\].motion\[0\].until: should be greater than 0"),
    ('name = "hand"', 'name = "world"', r"bodies\[0\].name: there are two bodies 'world'"),
    ("dt = 4e-3", "dt = '4e-3'", r"dt: should be a valid number \(it is '4e-3'\)"),
    ("dt = 4e-3", "dt =", r"not TOML: .*line 5"),
    ("mu = 0.4", "mu = -1", r"mu: should be greater than or equal to 0"),
    ("seed = 1", "air = { normal = -1.0, tangential = 1.0 }", r"air.normal: should be greater than or equal to 0"),
    ("seed = 1", "seed = true", r"seed: should be a valid integer"),
    ('model = "helix"', 'model = "spline"', r"model: should be 'helix', 'clothoid' or 'discrete'"),
    ('description =', 'name = "../up"\ndescription =', r"name: string should match"),
    ("[[fibres]]", "[fibres]", r"fibres: is a list of tables: write \[\[fibres\]\]"),
    ("spacing = 1.5e-3", "spacing = 0.5e-3", r"fibre 0 and fibre \d+ overlap by 0.5 mm at the start"),
    ("point = [-0.02", "point = [0.0", r"fibre 0 and obstacle 0 overlap by 3.5 mm at the start"),
]  # fmt: skip


@pytest.mark.parametrize(("good", "bad", "message"), FAULTS, ids=[bad[:20] for _, bad, _ in FAULTS])
def test_a_fault_is_named_with_its_file_and_key(tmp_path, good, bad, message):
    assert good in TEMPLATE
    file = written(tmp_path, TEMPLATE.replace(good, bad, 1))
    with pytest.raises(SceneError, match=message) as fault:
        open_scene(file)
    assert str(fault.value).startswith(f"{file}: ")


def test_files_that_are_not_scenes(tmp_path):
    with pytest.raises(SceneError, match=r"nowhere.toml: no such file"):
        open_scene(str(tmp_path / "nowhere.toml"))
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SceneError, match=r"binary.toml: not TOML"):
        open_scene(str(tmp_path / "binary.toml"))
    with pytest.raises(SceneError, match=r"unknown scene 'wisp'"):
        open_scene("wisp")


PYTHON = """
from dataclasses import replace
from fibercontact.simulation.scenes import Parameters, build

def scene():
    return replace(build(Parameters("wisp", 7, "wavy", 0.3, 0.3, 1)), name="mine", steps=2)
"""


def test_a_python_file_gives_its_scene(tmp_path):
    scene = open_scene(written(tmp_path, PYTHON, "mine.py"))
    assert (scene.name, len(list(simulate(scene)))) == ("mine", 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\ny = x / 0\n", r"mine.py: ZeroDivisionError: division by zero \(line 2\)"),
        ("x = = 1", r"mine.py: SyntaxError: invalid syntax.*\(line 1\)"),
        ("def scene():\n    return 7\n", r"needs a function scene\(\) that returns"),
        (PYTHON.replace("steps=2", "steps=0"), r"mine.py: steps: must be at least 1, not 0"),
        (PYTHON.replace("steps=2", "dt=float('nan')"), r"mine.py: dt: must be positive and finite, not nan"),
        (PYTHON.replace("steps=2", "mu_fibres=-1.0"), r"mu_fibres: must be finite and not negative, not -1"),
        (
            PYTHON.replace("steps=2", "tolerance=float('inf')"),
            r"tolerance: must be finite and not negative, not inf",
        ),
        (PYTHON.replace("steps=2", "segments=0"), r"segments: must be at least 1, not 0"),
        (PYTHON.replace("steps=2", "bodies=[]"), r"bodies: there is none"),
        (PYTHON.replace("steps=2", "carrier=[0, 1]"), r"carrier: needs the index of one of the 1 bodies"),
    ],
)
def test_faults_of_python_files(tmp_path, text, message):
    with pytest.raises(SceneError, match=message):
        open_scene(written(tmp_path, text, "mine.py"))


def test_a_python_scene_chooses_its_own_rods(tmp_path):
    with pytest.raises(SceneError, match="chooses its own rods: leave out @discrete"):
        open_scene(written(tmp_path, PYTHON, "mine.py") + "@discrete")


def test_scenes_by_name_are_those_of_the_project():
    one, other = open_scene("twist-straight-24-mu0@clothoid"), build("twist-straight-24-mu0@clothoid")
    assert one.name == other.name
    np.testing.assert_array_equal(one.state.root_position, other.state.root_position)


def test_the_documentation_shows_the_template_and_a_scene_in_python_that_runs(tmp_path):
    (table,) = re.findall(r"```toml\n(.*?)```", DOCS, flags=re.DOTALL)
    assert table == TEMPLATE
    (code,) = re.findall(r"```python\n(.*?)```", DOCS, flags=re.DOTALL)
    scene = open_scene(written(tmp_path, code, "round.py"))
    assert scene.name == "round"
    np.testing.assert_allclose(np.linalg.norm(scene.gravity(0.7)), 9.81)


def test_the_documentation_has_every_key():
    assert known_keys() <= set(re.findall(r"\w+", DOCS.replace(TEMPLATE, "")))
