"""HDF5 files, of strangers too: a fault is a `ProblemError` that names the member, a write is whole or not at all."""

import os
import tempfile
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from fibercontact.problem.incremental import ProblemError

__all__ = ["full_name", "has", "load", "member", "open_file", "replace_file", "write_array"]

DEFLATE_LIMIT = 1100  # gzip shrinks at most this much: a larger array in a file is a damaged one

# Damaged bytes make h5py raise nearly any kind of exception: nothing else in the package touches it for reading.


def write_array(group: h5py.Group, name: str, values: NDArray[Any]) -> None:
    """Write a compressed dataset with a checksum, the same bytes for the same array."""
    if values.size == 0:
        group.create_dataset(name, data=values)
        return
    group.create_dataset(
        name,
        data=values,
        chunks=values.shape,
        shuffle=True,
        compression="gzip",
        compression_opts=9,
        fletcher32=True,
    )


def replace_file(path: Path, content: bytes) -> None:
    """Put `content` into the file in one step: an interruption leaves the old file or the new one."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        temporary.chmod(0o644)  # mkstemp makes it private
        temporary.replace(path)
    except BaseException:
        temporary.unlink()
        raise


def open_file(path: Path) -> h5py.File:
    """Open a file for reading; the fault alone is named, not the path."""
    try:
        return h5py.File(path, "r")
    except FileNotFoundError:
        raise ProblemError("no such file") from None
    except IsADirectoryError:
        raise ProblemError("is a directory, not a file") from None
    except Exception as fault:  # damaged bytes make h5py raise nearly any kind
        raise ProblemError(f"not a readable HDF5 file ({fault})") from None


def full_name(group: h5py.Group, name: str) -> str:
    """Path of a member inside its file."""
    return f"{group.name}/{name}".lstrip("/")


def has(group: h5py.Group, name: str) -> bool:
    """Whether a group has a member of that name."""
    try:
        return name in group
    except Exception as fault:
        raise ProblemError(f"{full_name(group, name)} cannot be read ({fault})") from None


def member(group: h5py.Group, name: str, kind: type) -> Any:
    """A group or a dataset by name."""
    try:
        found = group.get(name)
    except Exception as fault:
        raise ProblemError(f"{full_name(group, name)} cannot be read ({fault})") from None
    if found is None:
        raise ProblemError(f"{full_name(group, name)} is missing")
    if not isinstance(found, kind):
        raise ProblemError(f"{full_name(group, name)} is not a {kind.__name__.lower()}")
    return found


def load(group: h5py.Group, name: str, kinds: str, wanted: str) -> Any:
    """Value of a dataset whose type is one of numpy's `kinds`, `wanted` in words."""
    dataset, label = member(group, name, h5py.Dataset), full_name(group, name)
    try:
        dtype, count = dataset.dtype, dataset.size
        if dtype.kind not in kinds:
            raise ProblemError(f"{label} holds {dtype}, not {wanted}")
        if count is None or count * dtype.itemsize > DEFLATE_LIMIT * group.file.id.get_filesize():
            raise ProblemError(f"{label} has an impossible size")
        return dataset[()]
    except ProblemError:
        raise
    except Exception as fault:
        raise ProblemError(f"{label} cannot be read ({fault})") from None
