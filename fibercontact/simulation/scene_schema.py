"""What may stand in a scene file in TOML: keys, units and bounds. `docs/scenes.md` explains them."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

__all__ = [
    "WORLD", "AirTable", "Body", "Bundle", "CylinderObstacle", "Fibres", "Layers", "Obstacle", "Place",
    "PlaneObstacle", "Points", "SceneFile", "Sphere", "SphereObstacle", "Stage",
]  # fmt: skip

WORLD = "world"
"""The body that never moves."""


def _not_zero(vector: list[float]) -> list[float]:
    if not any(vector):
        raise ValueError("must not be zero")
    return vector


def _as_range(value: Any) -> Any:
    return value if isinstance(value, list) else [value, value]


def _ascending(ends: list[float]) -> list[float]:
    if ends[0] > ends[1]:
        raise ValueError("the lower end of a range comes first")
    return ends


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Direction = Annotated[Vector, AfterValidator(_not_zero)]
Range = Annotated[
    list[Positive], Field(min_length=2, max_length=2), BeforeValidator(_as_range), AfterValidator(_ascending)
]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class Bundle(_Table):
    """Roots on a hexagonal lattice across `direction`, round `at`."""

    pattern: Literal["bundle"]
    at: Vector = [0.0, 0.0, 0.0]
    direction: Direction = [0.0, 0.0, -1.0]
    spacing: Positive


class Sphere(_Table):
    """Roots on a sphere, from its top down by `share` radii (1: its upper half), fibres along its normals."""

    pattern: Literal["sphere"]
    at: Vector = [0.0, 0.0, 0.0]
    radius: Positive
    share: Annotated[float, Field(gt=0, le=2)] = 0.7


class Layers(_Table):
    """Level fibres in random directions one above the other, their middles within `spread` of `at`."""

    pattern: Literal["layers"]
    at: Vector = [0.0, 0.0, 0.0]
    spread: NotNegative = 0.0
    spacing: Positive


class Points(_Table):
    """Roots where they are listed; one direction for each of them, or one for all."""

    pattern: Literal["points"]
    at: Annotated[list[Vector], Field(min_length=1)]
    direction: Annotated[list[Direction], Field(min_length=1)]


Place = Annotated[Bundle | Sphere | Layers | Points, Field(discriminator="pattern")]


class Fibres(_Table):
    """A group of fibres alike."""

    count: Annotated[int, Field(ge=1)]
    length: Range  # m
    radius: Range  # m
    young: Positive  # Pa
    density: Positive  # kg/m³
    poisson: Annotated[float, Field(gt=-1, le=0.5)] = 0.5
    damping: NotNegative = 0.0  # s
    curl: Literal["straight", "wavy", "curly", "mixed"] = "straight"
    curvature: Vector | None = None  # (tau, kappa_1, kappa_2), 1/m
    start: Literal["straight", "natural"] = "straight"
    body: str = WORLD
    place: Place


class Stage(_Table):
    """Motion of a body until a time, m/s and rad/s, times `cos(2 pi frequency t)`."""

    until: Annotated[float, Field(gt=0, allow_inf_nan=True)] = float("inf")  # s
    velocity: Vector = [0.0, 0.0, 0.0]
    angular_velocity: Vector = [0.0, 0.0, 0.0]
    frequency: NotNegative = 0.0  # Hz


class AirTable(_Table):
    """Drag coefficients across and along a fibre, kg/(m s), and a steady wind."""

    normal: NotNegative
    tangential: NotNegative
    wind: Vector = [0.0, 0.0, 0.0]  # m/s


class PlaneObstacle(_Table):
    """A half-space."""

    shape: Literal["plane"]
    point: Vector
    normal: Direction


class SphereObstacle(_Table):
    """A ball."""

    shape: Literal["sphere"]
    point: Vector
    radius: Positive


class CylinderObstacle(_Table):
    """A cylinder, endless or with round ends."""

    shape: Literal["cylinder"]
    point: Vector
    axis: Direction
    radius: Positive
    length: Annotated[float, Field(gt=0, allow_inf_nan=True)] = float("inf")


Obstacle = Annotated[PlaneObstacle | SphereObstacle | CylinderObstacle, Field(discriminator="shape")]


class Body(_Table):
    """A rigid body: what it carries turns about `pivot`."""

    name: str
    pivot: Vector = [0.0, 0.0, 0.0]
    motion: list[Stage] = []
    obstacles: list[Obstacle] = []


class SceneFile(_Table):
    """A whole file."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][\w.+-]*$")] | None = None
    description: str = ""
    model: Literal["helix", "clothoid", "discrete"] = "helix"
    elements: Annotated[int, Field(ge=1)] = 5
    edges: Annotated[int, Field(ge=2)] = 20
    free: bool = False
    dt: Positive  # s
    steps: Annotated[int, Field(ge=1)]
    mu: NotNegative
    mu_obstacles: NotNegative | None = None
    gravity: Vector = [0.0, 0.0, -9.81]  # m/s²
    skip_root: NotNegative = 0.0  # m
    seed: Annotated[int, Field(ge=0)] = 0
    air: AirTable | None = None
    fibres: Annotated[list[Fibres], Field(min_length=1)]
    bodies: list[Body] = []
