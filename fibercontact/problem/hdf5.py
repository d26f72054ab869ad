"""HDF5 files, of strangers too: a fault is a `ProblemError` that names the member, nothing outside is touched."""

import math
import stat
from pathlib import Path
from typing import Any

import h5py
from numpy.typing import NDArray

from fibercontact.problem.incremental import ProblemError

__all__ = ["DEFLATE_LIMIT", "full_name", "has", "load", "member", "open_file", "write_array"]

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


def open_file(path: Path) -> h5py.File:
    """Open a file for reading; the fault alone is named, not the path."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise ProblemError("no such file") from None
    except OSError as fault:
        raise ProblemError(f"cannot be opened ({fault.strerror})") from None
    if stat.S_ISDIR(mode):
        raise ProblemError("is a directory, not a file")
    if not stat.S_ISREG(mode):  # a pipe would be waited for, a device has no end
        raise ProblemError("is not a file on a disk")
    try:
        return h5py.File(path, "r")
    except Exception as fault:
        raise ProblemError(f"not a readable HDF5 file ({_sentence(fault)})") from None


def full_name(group: h5py.Group, name: str) -> str:
    """Path of a member inside its file."""
    return f"{group.name}/{name}".lstrip("/")


def has(group: h5py.Group, name: str) -> bool:
    """Whether a group has a member of that name; a soft or external link, which may lead anywhere, is a fault."""
    head, _, rest = name.partition("/")
    try:
        links, key = group.id.links, head.encode()
        found = links.exists(key)
        hard = found and links.get_info(key).type == h5py.h5l.TYPE_HARD
    except Exception as fault:
        raise _unreadable(full_name(group, name), fault) from None
    if found and not hard:
        raise ProblemError(f"{full_name(group, head)} is a link: only what is in the file itself is read")
    return found and (not rest or has(member(group, head, h5py.Group), rest))


def member(group: h5py.Group, name: str, kind: type) -> Any:
    """A group or a dataset by name."""
    label = full_name(group, name)
    if not has(group, name):
        raise ProblemError(f"{label} is missing")
    try:
        found = group[name]
    except Exception as fault:
        raise _unreadable(label, fault) from None
    if not isinstance(found, kind):
        raise ProblemError(f"{label} is not a {kind.__name__.lower()}")
    return found


def load(group: h5py.Group, name: str, kinds: str, wanted: str) -> Any:
    """Value of a dataset whose type is one of numpy's `kinds`, `wanted` in words; of kind `O`, a single one."""
    dataset, label = member(group, name, h5py.Dataset), full_name(group, name)
    try:
        _check_storage(dataset, label, kinds, wanted)
        return dataset[()]
    except ProblemError:
        raise
    except Exception as fault:
        raise _unreadable(label, fault) from None


def _check_storage(dataset: h5py.Dataset, label: str, kinds: str, wanted: str) -> None:
    """Look at how a dataset is stored before anything is allocated for it."""
    if dataset.dtype.kind not in kinds:
        raise ProblemError(f"{label} holds {dataset.dtype}, not {wanted}")
    if dataset.external or dataset.is_virtual:
        raise ProblemError(f"{label} is stored in another file: only what is in the file itself is read")
    if dataset.size is None:
        raise ProblemError(f"{label} has no values")
    unpacked = max(dataset.size, math.prod(dataset.chunks or (0,))) * dataset.dtype.itemsize
    if unpacked > DEFLATE_LIMIT * dataset.file.id.get_filesize():
        raise ProblemError(f"{label} has an impossible size")
    if dataset.dtype.kind == "O" and dataset.size != 1:  # each might be as long as the file
        raise ProblemError(f"{label} is not one {wanted}: its shape is {dataset.shape}")


def _unreadable(label: str, fault: Exception) -> ProblemError:
    return ProblemError(f"{label} cannot be read ({_sentence(fault)})")


def _sentence(fault: Exception) -> str:
    """What damaged bytes made h5py say, on one line."""
    return " ".join(str(fault).split())
