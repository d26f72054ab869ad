"""`python -m fibercontact` is the same as `fibercontact`."""

import atexit
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

__all__ = ["main"]

INTERRUPTED = 130


def main() -> None:
    """Entry point, which may be interrupted from its first import on."""
    try:
        from fibercontact.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        _leave("interrupted\n")
    except SystemExit as end:
        cause = getattr(end.__context__, "__cause__", None)  # typer ends interrupted commands without a word
        if isinstance(cause, KeyboardInterrupt):
            _leave("interrupted\n")
        if end.code == INTERRUPTED:
            _leave("")
        raise
    finally:
        _ignore_signals()


def _ignore_signals() -> None:
    """All is done and said: while Python ends, which takes 0.1 s, a signal would kill it without a word."""
    for code in (signal.SIGINT, signal.SIGTERM):
        signal.signal(code, signal.SIG_IGN)


def _leave(words: str) -> NoReturn:
    """End at once, but for what was registered to be done then.

    Code that was being compiled is left as it is: LLVM can crash when Python takes apart what is half done.
    """
    _ignore_signals()
    sys.stderr.write(words)
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(INTERRUPTED)


if __name__ == "__main__":
    main()
