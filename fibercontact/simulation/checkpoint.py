"""Checkpoints: the world between two steps in a file, from which a run goes on bit for bit.

What a step reads is its scene and the world before it. A checkpoint holds every number of the world, one dataset
with a checksum for each array; functions (the motions of the bodies) are the scene's. A fingerprint tells the
scene from any other, also from one of the same name.
"""

import hashlib
import io
from collections.abc import Iterator
from copy import copy
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.detect import Contacts
from fibercontact.errors import UserError
from fibercontact.files import replace_file
from fibercontact.problem.hdf5 import has, load, open_file, write_array
from fibercontact.problem.incremental import ProblemError
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import World, start

__all__ = ["CHECKPOINT", "CheckpointError", "load_checkpoint", "save_checkpoint"]

CHECKPOINT = "checkpoint.h5"
FORMAT = "fibercontact checkpoint 1"


class CheckpointError(UserError):
    """A checkpoint that cannot be used; the message names the file and the fault."""


def save_checkpoint(file: Path, scene: Scene, index: int, world: World) -> None:
    """Write the `world` at the end of step `index` of a scene, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    image = io.BytesIO()
    with h5py.File(image, "w") as content:
        for name, text in {"format": FORMAT, "scene": scene.name, "fingerprint": _fingerprint(scene)}.items():
            content[name] = text
        content["index"] = index
        for name, values in _leaves(world, "world"):
            write_array(content, name, np.atleast_1d(values))
    replace_file(file, image.getvalue())


def load_checkpoint(file: Path, scene: Scene) -> tuple[int, World]:
    """The number of the next step of a scene, and the world before it: `simulate(scene, world, next)` goes on.

    Raises `CheckpointError("FILE: fault")` for a file that is missing or damaged, of another format, or of
    another scene.
    """
    try:
        with open_file(file) as content:
            _check_origin(content, scene)
            index = int(load(content, "index", "iu", "an integer"))
            world = _rebuilt(_pattern(content, scene), "world", content)
    except ProblemError as fault:
        raise CheckpointError(f"{file}: {fault}") from None
    return index + 1, world


def _check_origin(content: h5py.File, scene: Scene) -> None:
    found = _text(content, "format") if has(content, "format") else "none"
    if found != FORMAT:
        raise ProblemError(
            f"not a checkpoint that this version reads: its format is {found!r}, not {FORMAT!r}"
        )
    if (name := _text(content, "scene")) != scene.name:
        raise ProblemError(f"a checkpoint of the scene {name!r}, not of {scene.name!r}")
    if _text(content, "fingerprint") != _fingerprint(scene):
        raise ProblemError(f"the scene {name!r} is not what it was when the checkpoint was written")


def _text(content: h5py.File, name: str) -> str:
    text = load(content, name, "SO", "text")
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def _fingerprint(scene: Scene) -> str:
    """Hash of all that makes a scene, but for the number of its steps; of functions, values at some times."""
    times = scene.dt * 2.0 ** np.arange(11)
    driven = [
        [scene.gravity(t), *(body.motion(t) for body in scene.bodies), scene.air and scene.air.wind(t)]
        for t in times
    ]
    digest = hashlib.sha256()
    for name, values in _leaves([replace(scene, steps=1), driven]):
        digest.update(f"{name} {values.dtype} {values.shape}\n".encode() + values.tobytes())
    return digest.hexdigest()


def _parts(value: Any) -> dict[str, Any] | None:
    """The parts of a value by name; None if it has none."""
    if hasattr(value, "_asdict"):
        return dict(value._asdict())
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, list | tuple):
        return {str(number): part for number, part in enumerate(value)}
    return None


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays, numbers and texts in a value, each with its path; functions and None have none."""
    parts = _parts(value)
    if parts is not None:
        for key, part in parts.items():
            yield from _leaves(part, f"{name}/{key}")
    elif value is not None and not callable(value):
        yield name, np.asarray(value)


def _pattern(content: h5py.File, scene: Scene) -> World:
    """A world with the arrays that a checkpoint must hold, whatever their values."""
    world = start(scene)
    if not has(content, "world/contacts"):
        return world
    n = len(load(content, "world/contacts/gap", "f", "floating-point numbers"))
    index, number, vector = np.empty(n, dtype=np.int64), np.empty(n), np.empty((n, 3))
    contacts = Contacts(index, number, index, number, index, vector, vector, number)
    return replace(world, contacts=contacts, impulses=vector)


def _rebuilt(like: Any, name: str, content: h5py.File) -> Any:
    """A value like `like`, with the arrays and numbers of a checkpoint."""
    parts = _parts(like)
    if parts is None:
        return like if like is None or callable(like) else _array(like, name, content)
    found = {key: _rebuilt(part, f"{name}/{key}", content) for key, part in parts.items()}
    if hasattr(like, "_replace"):
        return like._replace(**found)
    if not is_dataclass(like):
        return type(like)(found.values())
    twin = copy(like)  # not `replace`: a unit vector made unit once more changes in its last digit
    for key, part in found.items():
        object.__setattr__(twin, key, part)
    return twin


def _array(like: Any, name: str, content: h5py.File) -> Any:
    wanted = np.asarray(like)
    found = np.asarray(load(content, name, wanted.dtype.kind, f"{wanted.dtype} values"))
    if found.dtype != wanted.dtype or found.shape != np.atleast_1d(wanted).shape:
        raise ProblemError(f"{name} holds {found.dtype} {found.shape}, not {wanted.dtype} {wanted.shape}")
    return found if isinstance(like, np.ndarray) else found.item()
