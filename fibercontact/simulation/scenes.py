"""The scenes: seven kinds, each a function of the number of fibres, their curl, the friction and a seed.

Every fibre starts straight, so that none overlaps another, and curls up as the scene runs. The fibres are
strands of 0.5 mm radius as heavy for their stiffness as long hair is: the dimensionless weight
`rho S g L³ / EI` of a 15 cm strand is 18.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fibercontact.contact.obstacles import Cylinder, Plane, Sphere
from fibercontact.rods.model import Rods, circular_rods
from fibercontact.simulation.scene import Body, Motion, Scene, SceneError, earth
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

__all__ = ["COMPARED", "HEADS", "KINDS", "NAMED", "SCENES", "Parameters", "build"]

Array = NDArray[np.float64]

RADIUS = 0.5e-3  # m
YOUNG = 3e7  # Pa
DENSITY = 1000.0  # kg/m³
DAMPING = 0.02  # s
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class Parameters:
    """A scene of the corpus: its kind, and what makes it differ from others of the kind."""

    kind: str
    fibres: int
    curl: str  # straight, wavy, curly or mixed
    mu: float  # between fibres
    mu_obstacles: float
    seed: int
    model: str = "helix"  # of the rods, one of `strands.MODELS`

    @property
    def name(self) -> str:
        """Its name, without the seed."""
        suffix = "" if self.model == "helix" else f"@{self.model}"
        return f"{self.kind}-{self.curl}-{self.fibres}-mu{self.mu:g}{suffix}"


def _rods(p: Parameters, length: float, rng: np.random.Generator, free: bool = False) -> Rods:
    """Strands of the scene; free ones have fewer elements, and curl less or they would fling themselves away."""
    elements, share = (4, 0.2) if free else (5, 1.0)
    return circular_rods(
        length=length * rng.uniform(0.9, 1.1, p.fibres),
        radius=RADIUS,
        young=YOUNG,
        poisson=0.5,
        density=DENSITY,
        elements=elements,
        curvature=share * curled(p.curl, p.fibres, coefficients(p.model, elements), rng),
        damping=DAMPING,
        free=free,
        basis=basis_of(p.model),
    )


def _hanging(count: int, spacing: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Roots (count, 3) of a bundle packed round the origin, and frames that point down."""
    roots = np.column_stack([hexagonal(count, spacing), np.zeros(count)])
    return roots, turned_frames(np.tile(DOWN, (count, 1)), rng)


def wisp(p: Parameters, rng: np.random.Generator) -> Scene:
    """A wisp pulled aside by a tilted gravity, then released to swing and settle."""
    roots, frames = _hanging(p.fibres, 1.3e-3, rng)
    rods = _rods(p, 0.15, rng)

    def gravity(time: float) -> Array:
        tilt = math.radians(70.0) if time < 0.3 else 0.0
        return 9.81 * np.array([math.sin(tilt), 0.0, -math.cos(tilt)])

    return _scene(p, rods, roots, frames, [Body(np.zeros(3))], dt=4e-3, steps=200, gravity=gravity)


def head(p: Parameters, rng: np.random.Generator) -> Scene:
    """Hair on the upper part of a sphere that is shaken sideways and nods."""
    return _hair(p, rng, 0.05)


def scalp(p: Parameters, rng: np.random.Generator) -> Scene:
    """Hair on a head of full size, for up to thousands of fibres, that is shaken sideways and nods."""
    return _hair(p, rng, 0.1)


def _hair(p: Parameters, rng: np.random.Generator, radius: float) -> Scene:
    normals = cap(p.fibres)
    rods = _rods(p, 0.18, rng)

    def shake(time: float) -> Motion:
        rate = 2 * math.pi * 2.0
        sideways = 0.03 * rate * math.cos(rate * time) * min(1.0, time / 0.1)
        return Motion(np.array([sideways, 0.0, 0.0]), np.array([0.0, 2.0 * math.sin(0.7 * rate * time), 0.0]))

    body = Body(np.zeros(3), shake, [Sphere(np.zeros(3), radius)])
    frames = turned_frames(normals + 0.1 * rng.standard_normal(normals.shape), rng)
    return _scene(p, rods, radius * normals, frames, [body], dt=4e-3, steps=200, skip_root=4e-3)


def _dropped(p: Parameters, rng: np.random.Generator, spread: float, low: float) -> tuple[Rods, Array, Array]:
    """Free level rods, one a layer, from the height `low` upwards."""
    rods = _rods(p, 0.1, rng, free=True)
    roots, tangents = level(rods.length, spread, low, 1.5e-3, rng)
    return rods, roots, turned_frames(tangents, rng)


def plane(p: Parameters, rng: np.random.Generator) -> Scene:
    """Free fibres falling on a plane, where they pile up."""
    rods, roots, frames = _dropped(p, rng, 0.02, 5e-3)
    body = Body(np.zeros(3), obstacles=[Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))])
    return _scene(p, rods, roots, frames, [body], dt=1e-3, steps=480)


def cylinder(p: Parameters, rng: np.random.Generator) -> Scene:
    """Free fibres falling across a level cylinder that turns slowly: they drape over it and slide off."""
    rods, roots, frames = _dropped(p, rng, 0.012, 0.027)
    body = Body(
        np.zeros(3),
        lambda time: Motion(np.zeros(3), np.array([0.0, 2.0, 0.0])),
        [Cylinder(np.zeros(3), np.array([0.0, 1.0, 0.0]), 0.025)],
    )
    return _scene(p, rods, roots, frames, [body], dt=1e-3, steps=480)


def twist(p: Parameters, rng: np.random.Generator) -> Scene:
    """Two bundles that lean towards each other and whose roots circle round a common axis: they wind up."""
    half = p.fibres // 2
    sides = []
    for count, side in ((half, -1.0), (p.fibres - half, 1.0)):
        lean = Rotation.from_rotvec([0.0, math.radians(20.0) * side, 0.0])
        roots, frames = _hanging(count, 1.2e-3, rng)
        sides.append((lean.apply(roots) + np.array([0.012 * side, 0.0, 0.0]), lean.as_matrix() @ frames))
    roots, frames = (np.concatenate(x) for x in zip(*sides, strict=True))
    body = Body(
        np.zeros(3), lambda time: Motion(np.zeros(3), np.array([0.0, 0.0, 6.0 * min(1.0, time / 0.1)]))
    )
    return _scene(p, _rods(p, 0.14, rng), roots, frames, [body], dt=4e-3, steps=250)


def comb(p: Parameters, rng: np.random.Generator) -> Scene:
    """A comb of round-tipped level teeth, pushed into a hanging bundle and drawn down through it."""
    roots, frames = _hanging(p.fibres, 1.6e-3, rng)
    width, depth = np.ptp(roots[:, :2], axis=0)
    teeth = np.arange(-0.5 * width, 0.5 * width + 4e-3, 4.5e-3)
    length = depth + 0.02
    behind = -0.5 * (depth + length) - 3e-3
    cylinders = [
        Cylinder(np.array([x, behind, -0.03]), np.array([0.0, 1.0, 0.0]), 1e-3, length) for x in teeth
    ]
    inserted = (depth + 0.01) / 0.15

    def draw(time: float) -> Motion:
        return Motion(np.array([0.0, 0.15, 0.0] if time < inserted else [0.0, 0.0, -0.15]), np.zeros(3))

    bodies = [Body(np.zeros(3)), Body(np.zeros(3), draw, cylinders)]
    return _scene(p, _rods(p, 0.15, rng), roots, frames, bodies, dt=4e-3, steps=250)


def _scene(
    p: Parameters,
    rods: Rods,
    roots: Array,
    frames: Array,
    bodies: list[Body],
    dt: float,
    steps: int,
    gravity: Callable[[float], Array] = earth,
    skip_root: float = 2e-3,
) -> Scene:
    modelled, state = begin(p.model, rods, roots, frames)
    return Scene(
        name=p.name,
        description=(KINDS[p.kind].__doc__ or "").strip(),
        rods=modelled,
        state=state,
        bodies=bodies,
        carrier=np.zeros(p.fibres, dtype=np.int64),
        dt=dt,
        steps=steps,
        mu_fibres=p.mu,
        mu_obstacles=p.mu_obstacles,
        gravity=gravity,
        skip_root=0.0 if rods.free else skip_root,
    )


KINDS: Mapping[str, Callable[[Parameters, np.random.Generator], Scene]] = {
    kind.__name__: kind for kind in (wisp, head, plane, cylinder, twist, comb, scalp)
}

_RUNS = (
    Parameters("wisp", 19, "straight", 0.3, 0.3, 1),
    Parameters("wisp", 61, "curly", 0.5, 0.5, 2),
    Parameters("wisp", 217, "wavy", 0.1, 0.1, 3),
    Parameters("head", 96, "straight", 0.2, 0.4, 4),
    Parameters("head", 96, "curly", 0.6, 0.6, 5),
    Parameters("head", 160, "mixed", 0.3, 0.1, 6),
    Parameters("plane", 24, "straight", 1.0, 1.0, 7),
    Parameters("plane", 48, "curly", 0.4, 0.2, 8),
    Parameters("plane", 96, "mixed", 0.0, 0.0, 9),
    Parameters("cylinder", 40, "straight", 0.1, 0.5, 10),
    Parameters("cylinder", 48, "wavy", 0.8, 0.8, 11),
    Parameters("cylinder", 80, "mixed", 0.5, 0.3, 12),
    Parameters("twist", 24, "straight", 0.0, 0.0, 13),
    Parameters("twist", 48, "wavy", 0.4, 0.4, 14),
    Parameters("twist", 128, "straight", 0.7, 0.7, 15),
    Parameters("comb", 37, "straight", 0.2, 0.2, 16),
    Parameters("comb", 61, "wavy", 0.5, 0.3, 17),
    Parameters("comb", 91, "curly", 1.0, 0.5, 18),
)

SCENES: Mapping[str, Parameters] = {p.name: p for p in _RUNS}
"""The scenes by name: three of each kind."""

_COMPARED = (
    Parameters("twist", 40, "mixed", 0.5, 0.5, 21),
    Parameters("cylinder", 36, "curly", 0.3, 0.3, 22),
)

COMPARED: Mapping[str, Parameters] = {p.name: p for p in _COMPARED}
"""One scene of clamped and one of free fibres, by name, to be run with each of the three rod models."""

_HEADS = (
    Parameters("scalp", 2000, "mixed", 0.3, 0.3, 31),
    Parameters("scalp", 4000, "curly", 0.1, 0.1, 32),
    Parameters("scalp", 2000, "straight", 0.2, 0.4, 33),
    Parameters("scalp", 2000, "mixed", 0.3, 0.3, 31, "clothoid"),
    Parameters("scalp", 2000, "wavy", 1.0, 0.5, 35, "clothoid"),
    Parameters("scalp", 1000, "straight", 0.8, 0.8, 36, "clothoid"),
)

HEADS: Mapping[str, Parameters] = {p.name: p for p in _HEADS}
"""Heads of hair of full size by name, with 3000 contacts and more."""

NAMED: Mapping[str, Parameters] = {**SCENES, **COMPARED, **HEADS}
"""All that have a name."""


def build(scene: str | Parameters) -> Scene:
    """Build a scene from parameters or by its name; `NAME@MODEL` is the same scene with other rods.

    Raises `SceneError` listing what is known.
    """
    if isinstance(scene, str):
        name, _, model = scene.partition("@")
        known = {key.partition("@")[0]: p for key, p in NAMED.items()}
        if name not in known:
            raise SceneError(f"unknown scene {name!r} (known: {', '.join(NAMED)})")
        scene = replace(known[name], model=model or "helix")
    if scene.kind not in KINDS:
        raise SceneError(f"unknown kind of scene {scene.kind!r} (known: {', '.join(KINDS)})")
    if scene.fibres < 2:
        raise SceneError(f"a scene needs at least 2 fibres, not {scene.fibres}")
    return KINDS[scene.kind](scene, np.random.default_rng(scene.seed))
