"""`python -m fibercontact` is the same as `fibercontact`."""

import signal
import sys
from typing import NoReturn

__all__ = ["main"]


def main() -> None:
    """Entry point, which may be interrupted from its first import on."""
    try:
        from fibercontact.cli import main as command_line

        command_line()
    except KeyboardInterrupt:
        _say_interrupted()
    except SystemExit as end:
        cause = getattr(end.__context__, "__cause__", None)  # typer ends interrupted commands without a word
        if isinstance(cause, KeyboardInterrupt):
            _say_interrupted()
        raise
    finally:  # all is done and said: while Python ends, which takes 0.1 s, a signal would kill it without a word
        for code in (signal.SIGINT, signal.SIGTERM):
            signal.signal(code, signal.SIG_IGN)


def _say_interrupted() -> NoReturn:
    print("interrupted", file=sys.stderr)
    sys.exit(130)


if __name__ == "__main__":
    main()
