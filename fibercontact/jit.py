"""The one place that says how kernels are compiled and where the compiled code is kept.

Numba's disk cache looks at the file of the compiled function only, never at the files of the functions it
calls. So the cache lives in a folder named after the content of every source file that a kernel can depend on:
an edit there opens a new folder, and nothing stale is ever read.
"""

import hashlib
import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.codegen import CPUCodeLibrary

from fibercontact.errors import NO_CACHE

__all__ = ["KERNEL_ROOMS", "cache_folder", "content_key", "jit", "jit_inline", "jit_lean", "jit_sum"]

KERNEL_ROOMS = ("rods", "contact", "problem", "local", "gauss_seidel", "global_methods")
"""Rooms with kernels. A module imports only from rooms before its own, so no kernel depends on the others."""

_PACKAGE = Path(__file__).parent
_KEPT = 8  # cache folders of older sources that stay on disk


def content_key(files: Iterable[Path]) -> str:
    """Hash of the names and contents of source files, 16 hexadecimal digits."""
    digest = hashlib.sha256(f"{numba.__version__} {sys.version}".encode())
    for file in sorted(files):
        digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path | None:
    """Folder of the compiled kernels of this version of the sources.

    `FIBERCONTACT_CACHE` names its root, or `NUMBA_CACHE_DIR`; else it is in the user's folder of caches.

    None, with a warning, where it cannot be made or written to: then every process compiles anew.
    """
    try:
        named = os.environ.get("FIBERCONTACT_CACHE") or os.environ.get("NUMBA_CACHE_DIR")
        root = named or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "fibercontact")
        sources = [file for room in KERNEL_ROOMS for file in (_PACKAGE / room).rglob("*.py")]
        folder = Path(root).absolute() / content_key([*_PACKAGE.glob("*.py"), *sources])
        _forget_older(folder)
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError) as fault:  # RuntimeError: there is no home
        _warn_of_no_cache(str(fault))
        return None


@cache
def _warn_of_no_cache(why: str) -> None:
    warnings.warn(
        f"{NO_CACHE} ({why}): every process compiles anew, for a minute; FIBERCONTACT_CACHE names another folder",
        stacklevel=2,
    )


def _forget_older(current: Path) -> None:
    """Remove the compiled code of all but the latest versions of the sources; the root may hold other things too."""
    if current.exists() or not current.parent.is_dir():
        return
    with suppress(OSError):  # other processes do the same
        folders = [folder for folder in current.parent.iterdir() if re.fullmatch("[0-9a-f]{16}", folder.name)]
        for folder in sorted(folders, key=lambda f: f.stat().st_mtime)[: -(_KEPT - 1)]:
            shutil.rmtree(folder, ignore_errors=True)


class _KernelCache(FunctionCache):
    """Numba's cache on disk; a kernel that cannot be put there, the disk being full, is used all the same."""

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel."""
        try:
            super().save_overload(sig, data)
        except OSError as fault:
            _warn_of_no_cache(f"{config.CACHE_DIR}: {fault.strerror}")


def _compiled(function: Callable[..., Any], **options: Any) -> Any:
    kernel = numba.njit(error_model="numpy", nogil=True, **options)(function)
    if config.DISABLE_JIT or not config.CACHE_DIR:
        return kernel
    kept = _KernelCache(function)
    if kept.cache_path.startswith(config.CACHE_DIR):  # other places are not named after all the sources
        kernel._cache = kept
    return kernel


def jit(function: Callable[..., Any]) -> Any:
    """Compile `function` lazily, read it from the disk cache in later processes.

    Division by zero gives inf or NaN as in numpy (`error_model="numpy"`), so kernels return a status instead
    of raising, and no fast-math is used: NaN must be seen. Kernels run without the interpreter's lock.
    """
    return _compiled(function)


def jit_lean(function: Callable[..., Any]) -> Any:
    """Compile a function that makes no array: it does not count the references to those that it is given or cuts.

    Each count is an atomic operation, which takes longer than a cross product, and much longer where two threads
    count the same. What such a function calls must be lean too, or cut no arrays.
    """
    return _compiled(function, _nrt=False)


def jit_inline(function: Callable[..., Any]) -> Any:
    """Compile `function` into each caller: for a loop whose ingredient is a jitted function passed as argument.

    A dispatcher passed by value would make its caller uncacheable; inlined, it is a direct call.
    """
    return _compiled(function, inline="always")


def jit_sum(function: Callable[..., Any]) -> Any:
    """Compile a function whose sums may be added up in any order, several at a time; NaN is still seen."""
    return _compiled(function, fastmath={"reassoc", "contract"})


@contextmanager
def _signals_later() -> Iterator[None]:
    """Hold back what interruptions do until the end of the block."""
    came: list[Any] = []
    handlers: dict[signal.Signals, Callable[..., Any]] = {}
    if threading.current_thread() is threading.main_thread():  # elsewhere Python runs no handlers
        for code in (signal.SIGINT, signal.SIGTERM):
            if callable(handler := signal.getsignal(code)):
                handlers[code] = handler
    for code in handlers:
        signal.signal(code, lambda *arguments: came.append(arguments))
    try:
        yield
    finally:
        for code, handler in handlers.items():
            signal.signal(code, handler)
        for arguments in came:
            handlers[arguments[0]](*arguments)


def _finalize(library: Any, finalize: Callable[[Any], None] = CPUCodeLibrary.finalize) -> None:
    """Make machine code, as numba does it, uninterrupted.

    LLVM hands it over by calling back. An exception there is lost, and numba fails for want of what it was not given.
    """
    with _signals_later():
        finalize(library)


CPUCodeLibrary.finalize = _finalize
config.CACHE_DIR = str(cache_folder() or "")
