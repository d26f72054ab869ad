"""Pictures: the geometry of what is seen, regimes and forces, pages, animations, the command."""

import io
import math
import os
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from PIL import Image
from scipy.sparse import eye_array
from slope import incline
from typer.testing import CliRunner

from fibercontact.cli import app
from fibercontact.contact.obstacles import Cylinder, Plane, Sphere
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.local.algebra import OPEN, SLIP, STICK
from fibercontact.local.registry import configure, registered
from fibercontact.problem.fclib import Solution, write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.simulation import scene_file
from fibercontact.simulation.penalty import penalty_for
from fibercontact.simulation.pictures import animation
from fibercontact.simulation.pictures.animation import AnimationError, images, write_gif, write_mp4
from fibercontact.simulation.pictures.camera import framed, view_axes
from fibercontact.simulation.pictures.page import write_page
from fibercontact.simulation.pictures.problem import answered, problem_figure, problem_page
from fibercontact.simulation.pictures.raster import Raster
from fibercontact.simulation.pictures.scene_page import scene_page, tubes
from fibercontact.simulation.pictures.shown import REGIMES, Shown, force_scale, held, regimes, show
from fibercontact.simulation.pictures.still import _round_number, caption, draw, draw_shown, pixels
from fibercontact.simulation.pictures.surfaces import seen_surface
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import simulate

RED, GREEN = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
ANGLES = st.tuples(st.floats(-180.0, 180.0), st.floats(-90.0, 90.0))
MEGABYTE = 1_000_000
CORE = Path(__file__).parents[1] / "problems" / "core306"


def window(axes, reach=0.05, size=200):
    """A square window of half a side `reach` m, round the origin."""
    return replace(framed(axes, [reach * np.vstack([axes, -axes])], size), middle=np.zeros(3))


def shown(fibres, radius=1e-3, index=0, **more):
    fibres = np.asarray(fibres, dtype=float)
    nothing = {
        "obstacles": [],
        "points": np.zeros((0, 3)),
        "regime": np.zeros(0, int),
        "force": np.zeros((0, 3)),
    }
    return Shown(index, 0.01 * index, fibres, np.full(len(fibres), radius), **nothing | more)


@pytest.fixture(scope="module")
def scene():
    return replace(build(Parameters("plane", 5, "straight", 0.5, 0.5, 3)), steps=40)


@pytest.fixture(scope="module")
def steps(scene):
    return list(simulate(scene))


# The view


@given(ANGLES, st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=2, max_size=2))
def test_a_view_is_a_rigid_turn_and_a_scale(angles, two):
    axes = view_axes(*angles)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[0, 2] == 0.0
    camera, points = window(axes), np.array(two)
    seen = np.column_stack([camera.project(points) / camera.scale, points @ axes[2]])
    assert math.dist(*seen) == pytest.approx(math.dist(*points), abs=1e-12)


@given(ANGLES, st.integers(50, 500))
def test_the_window_holds_the_points_and_its_sides_are_even(angles, size):
    points = np.random.default_rng(size).normal(size=(40, 3)) * [0.3, 0.1, 0.02]
    camera = framed(view_axes(*angles), [points[:20], points[20:]], size)
    place = camera.project(points)
    assert (place > 0.0).all()
    assert (place < [camera.width, camera.height]).all()
    assert max(camera.width, camera.height) == pytest.approx(size, abs=2)
    assert camera.width % 2 == camera.height % 2 == 0


BALL = Sphere(np.array([0.1, 0.2, 0.3]), 0.1)
ROLLER = Cylinder(np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3.0]), 0.1, 0.1)


@given(ANGLES, st.sampled_from([BALL, ROLLER]))
def test_the_window_holds_obstacles_that_end_somewhere(angles, obstacle):
    """By the outlines of balls, which are circles from everywhere."""
    camera = framed(view_axes(*angles), held(shown([[[0, 0, 0], [0, 0, 0.01]]], obstacles=[obstacle])), 300)
    ends = [0.0] if obstacle is BALL else [-0.05, 0.05]
    for end in ends:
        middle = obstacle.point if obstacle is BALL else obstacle.point + end * obstacle.axis
        place, reach = camera.project(middle[None])[0], 0.1 * camera.scale
        assert (place > reach).all()
        assert (place < np.array([camera.width, camera.height]) - reach).all()


def test_upwards_is_up_and_the_nearer_is_nearer_to_the_eye():
    axes = view_axes(0.0, 0.0)
    camera = window(axes)
    above, right, behind = camera.project(0.01 * np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])) - 0.5 * 200
    np.testing.assert_allclose(above, [0.0, -0.01 * camera.scale], atol=1e-9)
    np.testing.assert_allclose(right, [0.01 * camera.scale, 0.0], atol=1e-9)
    np.testing.assert_allclose(behind, 0.0, atol=1e-9)
    assert axes[2] @ [0.0, 1.0, 0.0] < 0.0


# What is seen: judged by the signed distances that contact detection has


@pytest.mark.parametrize(
    "obstacle",
    [
        Sphere(np.array([0.01, -0.02, 0.005]), 0.02),
        Cylinder(np.array([0.0, 0.01, 0.0]), np.array([1.0, 2.0, 0.5]), 0.01, 0.05),
        Cylinder(np.array([0.0, 0.01, 0.0]), np.array([1.0, -1.0, 2.0]), 0.015),
        Cylinder(np.zeros(3), view_axes(40.0, 30.0)[2], 0.01, 0.04),
        Plane(np.array([0.0, 0.0, -0.01]), np.array([0.1, 0.2, 1.0])),
    ],
    ids=["sphere", "capsule", "cylinder", "capsule from its end", "plane"],
)
def test_what_is_seen_of_an_obstacle_is_its_nearest_surface(obstacle):
    axes = view_axes(40.0, 30.0)
    camera = window(axes)
    x, y = np.random.default_rng(0).uniform(-0.05, 0.05, (2, 3000))
    depth, normal = seen_surface(obstacle, x, y, camera)
    hit = np.isfinite(depth)
    assert 20 < hit.sum() <= 3000
    points = np.column_stack([x[hit], y[hit], depth[hit]]) @ axes
    distance, gradient = obstacle.signed_distance(points)
    np.testing.assert_allclose(distance, 0.0, atol=1e-12)
    np.testing.assert_allclose(normal[hit] @ axes, gradient, atol=1e-7)
    for before in np.linspace(1e-6, 0.2, 40):  # towards the eye, and all along the rays that miss
        assert (obstacle.signed_distance(points + before * axes[2])[0] > 0.0).all()
    if not isinstance(obstacle, Plane):  # of which a disc is drawn
        for z in np.linspace(-0.2, 0.2, 401):
            along = np.column_stack([x[~hit], y[~hit], np.full((~hit).sum(), z)]) @ axes
            assert (obstacle.signed_distance(along)[0] > -1e-9).all()


def test_nothing_is_seen_of_a_plane_from_below():
    camera = window(view_axes(0.0, -30.0))
    plane = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert not np.isfinite(seen_surface(plane, np.zeros(5), np.linspace(-0.1, 0.1, 5), camera).depth).any()


@pytest.mark.parametrize("radius", [1e-3, 2e-3, 5e-3])
@pytest.mark.parametrize("lean", [0.0, 0.5, 1.2])
def test_tubes_are_true_to_scale(radius, lean):
    """The shadow of a cylinder: its diameter times the length that is seen."""
    across = math.cos(lean) * np.array([math.cos(0.3), math.sin(0.3)])  # off the rows of pixels
    along = np.array([across[0], math.sin(lean), across[1]])  # the eye is at -y
    raster = Raster(window(view_axes(0.0, 0.0), size=400))
    raster.tubes(np.linspace(-0.04, 0.04, 9)[None, :, None] * along, np.array([radius]), RED[None])
    scale, length = raster.camera.scale, 0.08 * math.cos(lean)
    width = np.isfinite(raster.depth).sum() / scale**2 / length
    ends = math.pi * radius**2 * math.sin(lean) / length  # half an ellipse; the near end is open
    assert width == pytest.approx(2.0 * radius, rel=0.01, abs=ends + 0.3 / scale)
    facing = raster.normal[np.isfinite(raster.depth)]
    np.testing.assert_allclose(np.linalg.norm(facing, axis=1), 1.0, rtol=1e-9)
    assert (facing[:, 2] >= 0.0).all()
    assert np.abs(facing @ np.array([along[0], along[2], -along[1]])).max() < 1e-9


@pytest.mark.parametrize(("turn", "nearer"), [(0.0, RED), (180.0, GREEN)])
def test_the_nearer_tube_hides_the_other(turn, nearer):
    camera = window(view_axes(turn, 0.0))
    ends = np.array([[-0.03], [0.03]])
    red = ends * [1.0, 0.0, 0.0] + [0.0, -0.01, 0.0]  # before green for an eye at -y
    green = ends * [0.0, 0.0, 1.0] + [0.0, 0.01, 0.0]
    for order in ([0, 1], [1, 0]):
        raster = Raster(camera)
        raster.tubes(np.array([red, green])[order], np.full(2, 2e-3), np.array([RED, GREEN])[order])
        middle = (raster.camera.height // 2) * raster.camera.width + raster.camera.width // 2
        np.testing.assert_array_equal(raster.colour[middle], nearer)


def test_an_obstacle_hides_what_is_behind_it_and_nothing_else():
    fibres = np.array([[-0.04], [0.04]]) * [1.0, 0.0, 0.0] + np.array(
        [[[0.0, -0.03, 0.0]], [[0.0, 0.03, 0.01]]]
    )
    raster = Raster(window(view_axes(0.0, 0.0)))
    raster.tubes(fibres, np.full(2, 1e-3), np.array([RED, GREEN]))
    before = (raster.colour == GREEN).all(axis=1)
    red = (raster.colour == RED).all(axis=1).sum()
    raster.obstacle(Sphere(np.zeros(3), 0.02))
    after = (raster.colour == GREEN).all(axis=1)
    assert (raster.colour == RED).all(axis=1).sum() == red
    width, scale = raster.camera.width, raster.camera.scale
    column = (np.arange(len(before)) % width + 0.5 - 0.5 * width) / scale
    half = math.sqrt(0.02**2 - 0.01**2)  # of the chord of the sphere at the height of the green one
    hidden = np.abs(column[before & ~after])
    assert hidden.max() == pytest.approx(half, abs=1e-3)
    assert np.abs(column[after]).min() == pytest.approx(half, abs=1e-3)


def test_nothing_at_all_is_a_white_picture():
    np.testing.assert_array_equal(Raster(window(view_axes())).image(), 1.0)


# Regimes, contacts, forces


def test_regimes_of_known_answers():
    """Unit masses on a plane: pushed, pushed and drawn, lifted, and pushed where there is no friction."""
    b = np.array([-1.0, 0.2, 0.1, -1.0, 3.0, -1.0, 1.0, 0.0, 0.0, -1.0, 0.1, 0.0])
    problem = IncrementalProblem.from_sparse(eye_array(12), b, np.array([0.5, 0.5, 0.5, 0.0]))
    run = GaussSeidel(configure("secular", registered()), tolerance=1e-10).solve(problem)
    np.testing.assert_array_equal(regimes(run.r, problem.mu), [STICK, SLIP, OPEN, SLIP])
    assert answered("", problem, run.r, "").words.startswith("4 contacts (1 stick, 2 slip, 1 take-off);")


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_a_rod_on_a_slope_is_shown_to_stick_or_slip_as_its_forces_say(share):
    """Forces are split by the slope's own normal; above the friction angle every contact slips."""
    scene = incline(math.atan(share * 0.5), 0.5, steps=20)
    *_, last = simulate(scene)
    drawn, normal = show(scene, last), scene.bodies[0].obstacles[0].normal
    f_N = drawn.force @ normal
    f_T = np.linalg.norm(drawn.force - f_N[:, None] * normal, axis=1)
    expected = np.where(f_N <= 0.0, OPEN, np.where(f_T < (1.0 - 1e-7) * 0.5 * f_N, STICK, SLIP))
    np.testing.assert_array_equal(drawn.regime, expected)
    assert len(drawn.points) == len(drawn.regime) >= 2
    assert (drawn.count(STICK) > 0) == (share < 1.0)
    weight = scene.rods.line_density[0] * scene.rods.length[0] * 9.81
    if share < 1.0:
        np.testing.assert_allclose(drawn.force.sum(axis=0), [0.0, 0.0, weight], atol=1e-3 * weight)
    np.testing.assert_allclose(drawn.points @ normal, 0.0, atol=1e-5)


def test_contacts_lie_where_their_fibres_touch(scene, steps):
    """By interpolation fibre by fibre: half of the gap, of its change and of the sagitta away from each surface."""
    step = steps[-1]
    drawn, contacts = show(scene, step), step.contacts
    assert len(contacts.gap) > 10
    arc = np.linspace(0.0, 1.0, drawn.fibres.shape[1])
    moved = scene.dt * np.abs(step.world.state.v[:, :3]).max() * 3
    for k, point in enumerate(drawn.points):
        sides = [(contacts.fibre_a[k], contacts.s_a[k]), (contacts.fibre_b[k], contacts.s_b[k])]
        for rod, s in sides[: 1 if contacts.obstacle[k] >= 0 else 2]:
            at = [np.interp(s / scene.rods.length[rod], arc, x) for x in drawn.fibres[rod].T]
            off = np.linalg.norm(point - at) - drawn.radius[rod]
            assert abs(off) <= 0.5 * abs(contacts.gap[k]) + moved + 1e-5


def test_nearly_all_forces_are_short():
    force = np.zeros((100, 3))
    force[:, 2] = np.arange(100) / 7.0
    frame = shown(np.zeros((1, 2, 3)), force=force, regime=np.full(100, STICK), points=np.zeros((100, 3)))
    lengths = force_scale([frame], 2.0) * force[:, 2]
    assert 1 <= (lengths > 0.08 * 2.0).sum() <= 3
    assert force_scale([shown(np.zeros((1, 2, 3)))], 2.0) == 0.0


# Stills


def share_of(colour, picture):
    """Number of pixels of nearly a colour."""
    return int((np.abs(picture - 255.0 * np.array(to_rgb(colour))) < 20).all(axis=2).sum())


def test_a_still_shows_every_regime_that_there_is(scene, steps, tmp_path):
    step = next(s for s in reversed(steps) if {STICK, SLIP} <= set(show(scene, s).regime.tolist()))
    draw(scene, step, tmp_path / "a.png", size=500)
    picture = np.asarray(Image.open(tmp_path / "a.png").convert("RGB"), dtype=float)
    assert max(picture.shape) >= 500
    legend = picture.shape[0] - 70
    for kind in (STICK, SLIP):
        assert share_of(REGIMES[kind].colour, picture[:legend]) > 5
    frictionless = replace(show(scene, step), regime=np.full(len(step.contacts.gap), SLIP))
    camera = framed(view_axes(), [frictionless.fibres.reshape(-1, 3)], 500)
    other = pixels(draw_shown(frictionless, camera, 0.0, caption(scene, frictionless))).astype(float)
    assert share_of(REGIMES[STICK].colour, other[:-70]) == 0
    assert share_of(REGIMES[SLIP].colour, other[:-70]) > 5


@given(st.integers(-12, 12), st.integers(-2, 2), st.floats(1.0, 10.0))
def test_a_scale_bar_is_a_round_number_as_long_as_fits(power, ulps, share):
    for most in (share * 10.0**power, 10.0**power * (1.0 + ulps * 2.0**-52)):
        length = _round_number(most)
        assert length <= most < 2.51 * length
        assert f"{length:e}"[0] in "125"
        assert length == pytest.approx(float(f"{length:.0e}"), rel=1e-12)


def test_penalty_contacts_are_shown_to_slide_or_not_to_touch(tmp_path):
    """Where nothing pushes there is take-off; its friction has no stick."""
    scene = incline(0.2, 0.5, steps=30, dt=2e-4)
    *_, last = simulate(scene, penalty=penalty_for(scene))
    drawn, pushed = show(scene, last), last.world.impulses.any(axis=1)
    assert pushed.any()
    np.testing.assert_array_equal(drawn.regime, np.where(pushed, SLIP, OPEN))
    np.testing.assert_allclose(drawn.force, last.world.impulses / scene.dt)
    draw(scene, last, tmp_path / "a.png", size=120)


def test_names_are_no_formulae(scene, steps):
    """A dollar sign in the name of a scene begins no mathematics."""
    frame = show(scene, steps[-1])
    camera = framed(view_axes(), [frame.fibres.reshape(-1, 3)], 120)
    pixels(draw_shown(frame, camera, 0.0, ("$\\frac{1$", "words")))


# Pages


class Reader(HTMLParser):
    """Collects what a page refers to, its title and heading, and its scripts."""

    def __init__(self):
        super().__init__()
        self.references, self.texts, self.scripts, self.open = [], {}, 0, None

    def handle_starttag(self, tag, attributes):
        self.references += [value for name, value in attributes if name in ("src", "href", "srcset", "data")]
        self.scripts += tag == "script"
        self.open = tag

    def handle_endtag(self, tag):
        self.open = None

    def handle_data(self, data):
        if self.open in ("title", "h1", "p"):
            self.texts[self.open] = self.texts.get(self.open, "") + data


def read_page(file):
    reader = Reader()
    reader.feed(file.read_text(encoding="utf-8"))
    return reader


def test_a_page_needs_nothing_else_and_names_are_text(scene, steps, tmp_path):
    file, name = tmp_path / "a.html", '</title><script>alert("1")</script>&amp;<img src=x>'
    write_page(scene_page(show(scene, steps[-1]), steps[-1]), name, name, file)
    page = read_page(file)
    assert page.references == []
    assert page.scripts == 3
    assert page.texts == {"title": name, "h1": name, "p": name}
    text = file.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert len(text.encode()) < 8 * MEGABYTE
    assert "Plotly.newPlot" in text


def test_the_traces_of_a_page_are_those_of_the_step(scene, steps):
    step = steps[-1]
    drawn = show(scene, step)
    figure = scene_page(drawn, step)
    by_name = {trace.name: trace for trace in figure.data}
    for kind, regime in REGIMES.items():
        trace = by_name[f"{drawn.count(kind)} {regime.name}"]
        points = np.column_stack([trace.x, trace.y, trace.z])
        np.testing.assert_allclose(points, drawn.points[drawn.regime == kind], atol=1e-6)
        assert len(trace.customdata) == drawn.count(kind)
    u = step.problem.condense().W @ step.run.r + step.problem.condense().b
    said = np.array([row[1:] for row in by_name[f"{drawn.count(SLIP)} slip"].customdata], dtype=float)
    np.testing.assert_allclose(said[:, 4:], u.reshape(-1, 3)[drawn.regime == SLIP], rtol=6e-3)
    (forces,) = (trace for name, trace in by_name.items() if name.startswith("forces"))
    pushing = drawn.regime != OPEN
    assert len(forces.x) == 3 * pushing.sum()
    assert len(by_name["fibres"].x) == len(by_name["fibres"].intensity) == 5 * 31 * 6
    assert "obstacle" in by_name
    assert figure.layout.scene.aspectmode == "data"


def test_a_page_of_2000_fibres_stays_below_8_megabytes(scene, steps, tmp_path):
    rng = np.random.default_rng(0)
    crowd = shown(rng.normal(size=(2000, 61, 3)))
    write_page(scene_page(crowd, replace(steps[-1], run=None)), "crowd", "", tmp_path / "a.html")
    assert (tmp_path / "a.html").stat().st_size < 8 * MEGABYTE


@given(st.integers(2, 12), st.integers(3, 8), st.integers(0, 100))
def test_tubes_of_a_page_keep_their_radius(points, sides, seed):
    rng = np.random.default_rng(seed)
    lines = np.cumsum(rng.normal(size=(3, points, 3)) + np.array([2.0, 0.0, 0.0]), axis=1)
    radius = rng.uniform(0.01, 0.1, 3)
    corner, triangle = tubes(lines, radius, sides)
    arm = corner.reshape(3, points, sides, 3) - lines[:, :, None]
    np.testing.assert_allclose(
        np.linalg.norm(arm, axis=3), np.broadcast_to(radius[:, None, None], arm.shape[:3])
    )
    along = np.gradient(lines, axis=1)
    np.testing.assert_allclose(np.einsum("rpsi,rpi->rps", arm, along), 0.0, atol=1e-9)
    assert triangle.shape == (3 * (points - 1) * 2 * sides, 3)
    edges = np.sort(triangle[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, used = np.unique(edges, axis=0, return_counts=True)
    assert (used == 1).sum() == 3 * 2 * sides  # the open ends; every other edge is between two triangles
    assert used.max() == 2


# Animations


def moving(count=4):
    """A fibre that moves between two that stand still."""
    line, aside = np.linspace(0.0, 0.05, 5)[:, None] * [0.0, 0.0, 1.0], np.array([1.0, 0.0, 0.0])
    return [
        shown([line - 0.05 * aside, line + 0.05 * aside, line + 0.01 * k * aside], index=k)
        for k in range(count)
    ]


def test_all_frames_are_seen_through_one_window():
    pictures = list(images(incline(0.0, 0.5), moving(), 20.0, 160, turn=0.0))
    assert len({picture.shape for picture in pictures}) == 1
    inner = np.array([picture[60:-60] for picture in pictures], dtype=float)
    change = [np.flatnonzero((np.abs(p - inner[0]) > 8).any(axis=(0, 2))) for p in inner[1:]]
    middle = 0.5 * pictures[0].shape[1]
    for k, columns in enumerate(change, start=1):
        assert abs(columns.min() - middle) < 12
        assert columns.max() < middle + 0.3 * middle * k
    assert len({columns.max() for columns in change}) == 3


def test_a_gif_holds_every_frame(tmp_path):
    pictures = list(images(incline(0.0, 0.5), moving(), 20.0, 160))
    assert write_gif(tmp_path / "a.gif", pictures, 20.0) == 4
    with Image.open(tmp_path / "a.gif") as found:
        assert (found.n_frames, found.info["duration"], found.info["loop"]) == (4, 50, 0)
        assert (found.height, found.width) == pictures[0].shape[:2]
        for k, picture in enumerate(pictures):
            found.seek(k)
            assert np.abs(np.asarray(found.convert("RGB")).astype(float) - picture).mean() < 4.0


def test_colours_of_regimes_survive_in_a_gif(tmp_path):
    picture = np.full((64, 64, 3), 255, dtype=np.uint8)
    picture[:, :40] = np.random.default_rng(0).integers(0, 255, (64, 40, 3))
    wanted = [tuple(int(255 * x + 0.5) for x in to_rgb(regime.colour)) for regime in REGIMES.values()]
    picture[0, 60 : 60 + len(wanted)] = wanted
    write_gif(tmp_path / "a.gif", [picture], 10.0)
    with Image.open(tmp_path / "a.gif") as found:
        assert [found.convert("RGB").getpixel((60 + k, 0)) for k in range(len(wanted))] == wanted


def interrupted(pictures, after):
    yield from pictures[:after]
    raise KeyboardInterrupt


PICTURES = [np.full((40, 60, 3), level, dtype=np.uint8) for level in (0, 80, 160, 240)]


def test_ctrl_c_keeps_the_frames_that_are_drawn(tmp_path):
    assert write_gif(tmp_path / "a.gif", interrupted(PICTURES, 3), 20.0) == 3
    with Image.open(tmp_path / "a.gif") as found:
        assert found.n_frames == 3
    with pytest.raises(KeyboardInterrupt):
        write_gif(tmp_path / "b.gif", interrupted(PICTURES, 0), 20.0)
    assert not (tmp_path / "b.gif").exists()


@pytest.fixture
def encoder(tmp_path, monkeypatch):
    """A stand-in for ffmpeg that keeps what it is given."""
    program = tmp_path / "bin" / "ffmpeg"
    program.parent.mkdir()
    program.write_text('#!/bin/sh\nfor last; do :; done\nexec cat > "${last#file:}"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    return program


@pytest.mark.parametrize(("after", "count"), [(4, 4), (2, 2)])
def test_an_mp4_is_made_of_the_pictures(tmp_path, encoder, after, count):
    assert write_mp4(tmp_path / "-a.mp4", interrupted(PICTURES, after), 20.0) == count
    assert (tmp_path / "-a.mp4").read_bytes() == b"".join(p.tobytes() for p in PICTURES[:count])


def test_a_failure_of_the_encoder_is_told(tmp_path, encoder):
    encoder.write_text("#!/bin/sh\ncat > /dev/null\necho no such codec >&2\nexit 1\n")
    with pytest.raises(AnimationError, match=r"a\.mp4: ffmpeg failed: no such codec"):
        write_mp4(tmp_path / "a.mp4", PICTURES, 20.0)


def broken(pictures):
    yield from pictures
    raise OSError("no picture")


def test_a_film_that_is_not_finished_leaves_the_old_one(tmp_path, encoder):
    film = tmp_path / "a.mp4"
    film.write_bytes(b"old")
    with pytest.raises(OSError, match="no picture"):
        write_mp4(film, broken(PICTURES), 20.0)
    encoder.write_text(encoder.read_text().replace("exec cat", "cat") + "exit 1\n")
    with pytest.raises(AnimationError, match=r"a\.mp4: ffmpeg failed: no reason given"):
        write_mp4(film, PICTURES, 20.0)
    assert film.read_bytes() == b"old"
    assert sorted(tmp_path.iterdir()) == [film, encoder.parent]


def test_without_ffmpeg_one_is_told_how_to_get_it(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(animation.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(AnimationError, match=r"pip install 'fibercontact\[film\]'"):
        animation.ffmpeg()


# Problems


def unit_problem():
    b = np.array([-1.0, 0.2, 0.1, -1.0, 3.0, -1.0, 1.0, 0.0, 0.0])
    return IncrementalProblem.from_sparse(eye_array(9), b, np.full(3, 0.5))


R = np.array([1.0, -0.2, -0.1, 1.0, -0.5 * 3 / math.sqrt(10), 0.5 / math.sqrt(10), 0.0, 0.0, 0.0])


def test_the_figure_of_a_problem_shows_its_law():
    figure = problem_figure(answered("$a problem$", unit_problem(), R, "known"))
    figure.savefig(io.BytesIO())
    coupling, strengths, disc, law = figure.axes[:4]
    np.testing.assert_array_equal(coupling.images[0].get_array().filled(0.0), np.eye(3))
    _, stick, slip = (line.get_xydata() for line in disc.lines)
    np.testing.assert_allclose(stick, [[-0.4, -0.2]])
    np.testing.assert_allclose(np.linalg.norm(slip, axis=1), 1.0)
    _, stick, slip = (line.get_xydata() for line in law.lines)
    np.testing.assert_allclose(stick, [[0.0, math.hypot(0.4, 0.2)]], atol=1e-12)
    np.testing.assert_allclose(slip, [[math.sqrt(10.0) - 0.5, 1.0]])
    assert sum(bar.get_height() for bars in strengths.containers[:1] for bar in bars) == 1


@pytest.mark.parametrize("mu", [0.5, 0.0])
def test_the_page_of_a_problem_has_every_contact_in_its_cone(mu):
    problem = IncrementalProblem.from_sparse(eye_array(9), unit_problem().b, np.full(3, mu))
    r = R if mu else R * np.tile([1.0, 0.0, 0.0], 3)
    figure = problem_page(answered("p", problem, r, "known"))
    dots = [trace for trace in figure.data if trace.type == "scatter3d"]
    assert [trace.name for trace in dots] == (
        ["1 stick", "1 slip", "1 take-off"] if mu else ["0 stick", "2 slip", "1 take-off"]
    )
    for trace in dots:
        assert (np.hypot(trace.x, trace.y) <= trace.z + 1e-6).all()
    problem_figure(answered("p", problem, r, "known")).savefig(io.BytesIO())


def test_a_problem_in_which_all_takes_off_has_a_figure_and_a_page():
    problem = IncrementalProblem.from_sparse(eye_array(3), np.array([1.0, 0.0, 0.0]), np.array([0.5]))
    answer = answered("p", problem, np.zeros(3), "known")
    problem_figure(answer).savefig(io.BytesIO())
    assert len(problem_page(answer).data) == 4


# The command


def call(*arguments):
    return CliRunner().invoke(app, ["render", *map(str, arguments)])


def fails(*arguments):
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


TEMPLATE = Path(scene_file.__file__).with_name("template.toml").read_text(encoding="utf-8")
WISP = "wisp-straight-19-mu0.3"


def test_a_scene_is_drawn_in_every_form(tmp_path):
    files = [tmp_path / f"a{suffix}" for suffix in (".png", ".html", ".gif")]
    result = call(WISP, "--step", 8, "--every", 3, "--size", 120, *(x for f in files for x in ("--out", f)))
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines()[-1] == f"wrote {files[2]}: 3 of 3 pictures"
    assert read_page(files[1]).texts["p"].startswith("step 8, 0.04 s: 19 fibres, ")
    with Image.open(files[2]) as film, Image.open(files[0]) as still:
        assert film.n_frames == 3
        assert max(still.size) >= 120


def test_by_default_there_is_a_picture_and_a_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert call(WISP, "--time", "0.0079", "--size", 120).exit_code == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == [f"{WISP}.html", f"{WISP}.png"]
    assert read_page(tmp_path / f"{WISP}.html").texts["p"].startswith("step 1, 0.01 s")


def test_pictures_of_a_scene_file_have_the_name_of_its_scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(TEMPLATE)
    assert call("my.toml@clothoid", "--step", 0, "--size", 120).exit_code == 0
    assert sorted(tmp_path.glob("my@*")) == [tmp_path / "my@clothoid.html", tmp_path / "my@clothoid.png"]


def test_ctrl_c_draws_what_was_run(tmp_path, monkeypatch):
    import fibercontact.simulation.step as module

    def stopped(scene):
        for step in simulate(scene):
            yield step
            if step.index == 2:
                raise KeyboardInterrupt

    monkeypatch.setattr(module, "simulate", stopped)
    result = call(
        WISP, "--step", 20, "--size", 120, "--out", tmp_path / "a.html", "--out", tmp_path / "a.gif"
    )
    assert result.exit_code == 130
    assert "stopped after step 2" in result.stderr
    assert read_page(tmp_path / "a.html").texts["p"].startswith("step 2,")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 3


@pytest.mark.parametrize(
    ("given", "solution", "source"),
    [
        ("its own", R, "the file's solution, residual"),
        ("a wrong one", np.zeros(9), "solved by secular, residual"),
        ("none", None, "solved by secular, residual"),
    ],
)
def test_a_problem_is_drawn_with_an_answer_that_is_one(tmp_path, given, solution, source):
    file = tmp_path / "p.hdf5"
    r = (
        Solution(r=solution, u=unit_problem().W @ solution + unit_problem().b)
        if solution is not None
        else None
    )
    write(file, unit_problem(), title="three", solution=r)
    result = call(file, "--out", tmp_path / "p.html", "--out", tmp_path / "p.png")
    assert result.exit_code == 0, result.output
    words = read_page(tmp_path / "p.html").texts["p"]
    assert words.startswith("3 contacts (1 stick, 1 slip, 1 take-off); ")
    assert source in words
    with Image.open(tmp_path / "p.png") as picture:
        assert picture.size[0] > 500


def test_a_problem_of_a_set_is_drawn_with_its_rods(tmp_path):
    result = call(f"{WISP}-007", "--rods", "--size", 120, "--out", tmp_path / "a.html")
    assert result.exit_code == 0, result.output
    assert read_page(tmp_path / "a.html").texts["h1"] == WISP
    assert read_page(tmp_path / "a.html").texts["p"].startswith("step 7, ")


def test_a_scene_that_poses_another_problem_is_told(tmp_path):
    write(tmp_path / "p.hdf5", unit_problem(), title="three")
    (tmp_path / "manifest.csv").write_text(f"file,scene,step\np.hdf5,{WISP},7\n")
    result = call(tmp_path / "p.hdf5", "--rods", "--size", 120, "--out", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    assert re.search(r"does not pose this very problem: \d+ contacts where the file has 3", result.stderr)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([WISP, "--out", "a.jpg"], "a.jpg: pictures end in .png, .html, .gif, .mp4"),
        ([WISP, "--out", "a"], "a: pictures end in"),
        ([WISP, "--out", "nowhere/a.png"], "nowhere/a.png: no such folder as nowhere"),
        ([WISP, "--out", "folder.png"], "folder.png: cannot be written"),
        ([WISP, "--step", "200"], f"{WISP}: step 200 is beyond its end: its last step, 199, ends at 0.8 s"),
        ([WISP, "--time", "0.9"], f"{WISP}: 0.9 s is beyond its end"),
        ([WISP, "--time", "0.1", "--step", "3"], "--step or --time, not both"),
        ([WISP, "--rods"], "--rods is for problems"),
        (["wisp-straight"], "unknown scene 'wisp-straight' (known: "),
        (["wisp-straight"], "no problem 'wisp-straight': no file, nor in "),
        (["nowhere.hdf5"], "no problem 'nowhere.hdf5'"),
        (["p.hdf5", "--out", "a.gif"], "a.gif: a problem does not move; with --rods its scene does"),
        (["p.hdf5", "--step", "3"], "--step and --time are for scenes"),
        (["p.hdf5", "--rods"], "p.hdf5: no manifest.csv beside it tells the scene and the step it is from"),
    ],
)
def test_faults_are_told_in_one_line(tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    write(tmp_path / "p.hdf5", unit_problem(), title="three")
    assert message in fails(*arguments)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["folder.png", "p.hdf5"]
