"""What a command does with the errors of its user: one line on stderr, exit code 2; 130 when it is interrupted."""

import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer

__all__ = ["check_known", "user_errors"]


@contextmanager
def user_errors() -> Iterator[None]:
    """Turn what the user can mend into one line and exit code 2, and warnings into one line each."""
    from fibercontact.errors import UserError

    with warnings.catch_warnings():
        warnings.showwarning = _one_line  # type: ignore[assignment]
        try:
            yield
        except BrokenPipeError:  # the reader of our output has gone: no error of the user's
            raise
        except (UserError, OSError) as fault:
            typer.echo(f"error: {_sentence(fault)}", err=True)
            raise typer.Exit(2) from None
        except KeyboardInterrupt:
            typer.echo("interrupted", err=True)
            raise typer.Exit(130) from None
        except MemoryError as fault:
            typer.echo(f"error: out of memory ({_sentence(fault)})", err=True)
            raise typer.Exit(2) from None


def check_known(what: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Raise `BenchError` listing what is known when one of `given` is not."""
    from fibercontact.bench.protocol import BenchError

    for name in given:
        if name not in known:
            raise BenchError(f"unknown {what} {name!r} (known: {', '.join(known)})")


def _sentence(fault: BaseException) -> str:
    """What is wrong, on one line; of the system's errors, with the file first."""
    if isinstance(fault, OSError) and fault.filename is not None and fault.strerror:
        return " ".join(f"{fault.filename}: {fault.strerror}".split())
    return " ".join(str(fault).split())


def _one_line(message: Warning | str, *_: Any) -> None:
    print(f"warning: {message}", file=sys.stderr)
