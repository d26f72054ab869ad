"""Scenes of a user's: a short TOML file, or a Python file with a function `scene()`."""

import math
import re
import runpy
import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from fibercontact.contact.detect import detect
from fibercontact.contact.obstacles import Cylinder, Obstacle, Plane, Sphere
from fibercontact.rods.interface import rod_model
from fibercontact.rods.model import Rods, circular_rods
from fibercontact.simulation import scene_schema as schema
from fibercontact.simulation.scene import STILL, Air, Body, Motion, Scene, SceneError
from fibercontact.simulation.scene_faults import in_words
from fibercontact.simulation.scenes import build
from fibercontact.simulation.strands import (
    basis_of,
    begin,
    cap,
    coefficients,
    curled,
    hexagonal,
    level,
    turned_frames,
)

__all__ = ["open_scene"]

Array = NDArray[np.float64]


def open_scene(name: str) -> Scene:
    """A scene by its name, or from a TOML or Python file; with `@MODEL` behind either, with other rods.

    A Python file has a function `scene()` that returns a `Scene`, and chooses its own rods. Raises `SceneError`
    naming the file and the key that is wrong, or saying which bodies overlap at the start.
    """
    if not (found := re.fullmatch(r"(.+\.(?:toml|py))(?:@([^@/]*))?", name)):
        return build(name)
    file, model = Path(found[1]), found[2] or ""
    if not file.is_file():
        raise SceneError(f"{file}: no such file")
    scene = _from_toml(file, model) if file.suffix == ".toml" else _from_python(file, model)
    _check_apart(scene, file)
    return scene


def _from_python(file: Path, model: str) -> Scene:
    if model:
        raise SceneError(f"{file}: a scene in Python chooses its own rods: leave out @{model}")
    try:
        scene = runpy.run_path(str(file)).get("scene")
        scene = scene() if callable(scene) else scene
    except SceneError as fault:
        raise SceneError(f"{file}: {fault}") from None
    except Exception as fault:  # whatever a stranger's code raises
        raise SceneError(f"{file}: {type(fault).__name__}: {fault}{_line_of(fault, file)}") from fault
    if not isinstance(scene, Scene):
        raise SceneError(f"{file}: needs a function scene() that returns a fibercontact Scene")
    return scene


def _line_of(fault: BaseException, file: Path) -> str:
    """Where in the file a fault arose."""
    line, trace = getattr(fault, "lineno", None), fault.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(file):
            line = trace.tb_lineno
        trace = trace.tb_next
    return "" if line is None else f" (line {line})"


def _from_toml(file: Path, model: str) -> Scene:
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as fault:
        raise SceneError(f"{file}: not TOML: {fault}") from None
    if model:
        table["model"] = model
    try:
        given = schema.SceneFile.model_validate(table)
        scene = _scene(given, file)
    except ValidationError as fault:
        faults = "; ".join(in_words(error, table) for error in fault.errors())
        raise SceneError(f"{file}: {faults}") from None
    except SceneError as fault:
        raise SceneError(f"{file}: {fault}") from None
    return replace(scene, name=f"{scene.name}@{model}") if model else scene


def _scene(given: schema.SceneFile, file: Path) -> Scene:
    rng = np.random.default_rng(given.seed)
    names = _body_names(given)
    groups = [_group(given, index, rng) for index in range(len(given.fibres))]
    rods = _joined([group[0] for group in groups])
    roots, frames = (np.concatenate([group[k] for group in groups]) for k in (1, 2))
    natural = np.concatenate([np.full(group.count, group.start == "natural") for group in given.fibres])
    modelled, state = begin(given.model, rods, roots, frames, natural=natural, edges=given.edges)
    gravity = np.array(given.gravity)
    return Scene(
        name=given.name or _name_of(file),
        description=given.description,
        rods=modelled,
        state=state,
        bodies=[Body(np.zeros(3)), *(_body(body, f"bodies[{k}]") for k, body in enumerate(given.bodies))],
        carrier=np.concatenate([np.full(group.count, names.index(group.body)) for group in given.fibres]),
        dt=given.dt,
        steps=given.steps,
        mu_fibres=given.mu,
        mu_obstacles=given.mu if given.mu_obstacles is None else given.mu_obstacles,
        gravity=lambda time: gravity,
        skip_root=given.skip_root,
        air=_air(given.air),
    )


def _air(given: schema.AirTable | None) -> Air | None:
    if given is None:
        return None
    wind = np.array(given.wind)
    return Air(given.normal, given.tangential, lambda time: wind)


def _name_of(file: Path) -> str:
    return "".join(c if c.isalnum() or c in "._+-" else "-" for c in file.stem)


def _body_names(given: schema.SceneFile) -> list[str]:
    """Names of the bodies, the still world first; raises `SceneError` for what names none or two."""
    names = [schema.WORLD, *(body.name for body in given.bodies)]
    for index, body in enumerate(given.bodies):
        if names.count(body.name) > 1:
            raise SceneError(f"bodies[{index}].name: there are two bodies {body.name!r}")
    for index, group in enumerate(given.fibres):
        if group.body not in names:
            raise SceneError(f"fibres[{index}].body: no body {group.body!r} (known: {', '.join(names)})")
    return names


def _group(given: schema.SceneFile, index: int, rng: np.random.Generator) -> tuple[Rods, Array, Array]:
    """Rods of a group, their roots (R, 3) and frames (R, 3, 3)."""
    group = given.fibres[index]
    count = coefficients(given.model, given.elements)
    if group.curvature is not None and group.curl != "straight":
        raise SceneError(f"fibres[{index}].curvature: give either curl or curvature")
    curvature = np.array(group.curvature) if group.curvature else curled(group.curl, group.count, count, rng)
    length = rng.uniform(group.length[0], group.length[1], group.count)
    rods = circular_rods(
        length=length,
        radius=rng.uniform(group.radius[0], group.radius[1], group.count),
        young=group.young,
        poisson=group.poisson,
        density=group.density,
        elements=given.elements,
        curvature=curvature,
        damping=group.damping,
        free=given.free,
        basis=basis_of(given.model),
    )
    roots, tangents = _placed(group, index, length, rng)
    return rods, roots, turned_frames(tangents, rng)


def _placed(group: schema.Fibres, index: int, length: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Roots and tangents (R, 3) of a group."""
    place, count = group.place, group.count
    match place:
        case schema.Bundle():
            direction = np.array(place.direction) / np.linalg.norm(place.direction)
            lattice = np.column_stack([hexagonal(count, place.spacing), np.zeros(count)])
            turn, _ = Rotation.align_vectors([direction], [[0.0, 0.0, -1.0]])
            return np.array(place.at) + turn.apply(lattice), np.tile(direction, (count, 1))
        case schema.Sphere():
            normals = cap(count, place.share)
            return np.array(place.at) + place.radius * normals, normals
        case schema.Layers():
            roots, tangents = level(length, place.spread, 0.0, place.spacing, rng)
            return np.array(place.at) + roots, tangents
        case schema.Points():
            if len(place.at) != count or len(place.direction) not in (1, count):
                raise SceneError(
                    f"fibres[{index}].place: {count} fibres need {count} points and one or {count} directions, "
                    f"not {len(place.at)} and {len(place.direction)}"
                )
            return np.array(place.at), np.broadcast_to(np.array(place.direction), (count, 3))


def _joined(groups: list[Rods]) -> Rods:
    """The rods of all groups as one batch."""
    length, line_density, radius, stiffness, q_rest, damping = (
        np.concatenate([group[field] for group in groups]) for field in range(6)
    )
    first = groups[0]
    return Rods(length, line_density, radius, stiffness, q_rest, damping, first.free, first.basis)


def _body(given: schema.Body, where: str) -> Body:
    stages = given.motion
    for index, (stage, later) in enumerate(pairwise(stages), start=1):
        if later.until <= stage.until:
            raise SceneError(f"{where}.motion[{index}].until: must be later than the stage before")

    def motion(time: float) -> Motion:
        for stage in stages:
            if time <= stage.until:
                swing = math.cos(2 * math.pi * stage.frequency * time)
                return Motion(swing * np.array(stage.velocity), swing * np.array(stage.angular_velocity))
        return STILL

    return Body(np.array(given.pivot), motion, [_obstacle(obstacle) for obstacle in given.obstacles])


def _obstacle(given: schema.Obstacle) -> Obstacle:
    point = np.array(given.point)
    match given:
        case schema.PlaneObstacle():
            return Plane(point, np.array(given.normal))
        case schema.SphereObstacle():
            return Sphere(point, given.radius)
        case schema.CylinderObstacle():
            return Cylinder(point, np.array(given.axis), given.radius, given.length)


def _check_apart(scene: Scene, file: Path) -> None:
    """Raise `SceneError` when bodies overlap at the start by more than a tenth of a radius."""
    rods = rod_model(scene.rods)
    contacts = detect(
        rods.centreline(scene.state, scene.segments), scene.rods.length, scene.rods.radius,
        skip_root=max(scene.skip_root, rods.held_length),
        obstacles=[obstacle for body in scene.bodies for obstacle in body.obstacles],
    )  # fmt: skip
    deepest = int(np.argmin(contacts.gap)) if len(contacts.gap) else -1
    if deepest < 0 or -contacts.gap[deepest] <= 0.1 * scene.rods.radius.min():
        return
    a, b, obstacle = (int(x[deepest]) for x in (contacts.fibre_a, contacts.fibre_b, contacts.obstacle))
    other = f"fibre {b}" if obstacle < 0 else f"obstacle {obstacle}"
    raise SceneError(
        f"{file}: fibre {a} and {other} overlap by {-1e3 * contacts.gap[deepest]:.3g} mm at the start, "
        f"{1e3 * contacts.s_a[deepest]:.3g} mm from the root: place them further apart"
    )
