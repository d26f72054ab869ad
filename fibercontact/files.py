"""Files are written whole or not at all: whatever happens meanwhile leaves the old file or the new one."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["naming", "replace_file", "replacing"]


def replace_file(path: Path, content: bytes) -> None:
    """Put `content` into the file in one step; raises `OSError` naming it."""
    with replacing(path) as draft:
        draft.write_bytes(content)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Another file to write, which takes the place of `path` at the end, or goes; raises `OSError` naming `path`."""
    draft = None
    try:
        handle, name = tempfile.mkstemp(path.suffix, f".{path.stem[:32]}.", path.parent)
        os.close(handle)
        draft = Path(name)
        yield draft
        draft.chmod(0o644)  # mkstemp makes it private
        draft.replace(path)
    except BaseException as fault:
        if draft is not None:
            draft.unlink(missing_ok=True)
        if isinstance(fault, OSError):
            raise _of_file(fault, path) from None
        raise


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an `OSError` that names no file, of a full disk for instance, name this one."""
    try:
        yield
    except OSError as fault:
        raise fault if fault.filename else _of_file(fault, path) from None


def _of_file(fault: OSError, path: Path) -> OSError:
    if fault.errno is None:
        return OSError(f"{path}: {fault}")
    return OSError(fault.errno, fault.strerror, str(path))
