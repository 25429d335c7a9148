"""What stands at the door of the command line: every exception becomes one line and an exit code."""

from __future__ import annotations

import contextlib
import os
import sys
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import click

from ..model.validation import InputError
from .options import OPTIONS

INTERRUPTED = "interrupted; nothing is left half-written"
NO_MEMORY = "there is not enough memory for this; use fewer microphones, frequencies or candidate positions"
REPORT = "this is a fault of fdcal; please report it with the command, its input and what the same command prints with"
LONGEST = 600  # characters of the one line


@dataclass
class End:
    """How a command has ended: its exit code."""

    code: int = 0


def without_debug(args: Sequence[str]) -> tuple[list[str], bool]:
    """Return the arguments without `--debug`, wherever it stands before `--`, and whether it was among them."""
    args = list(args)
    stop = args.index("--") if "--" in args else len(args)
    head = [argument for argument in args[:stop] if argument != "--debug"]
    return head + args[stop:], len(head) < stop


@contextlib.contextmanager
def guarded(debug: bool = False) -> Iterator[End]:
    """Turn an exception into one line on standard error and the exit code that `fdcal.commands.cli` lists.

    Parameters
    ----------
    debug : bool
        Whether the traceback is shown before that line.
    """
    end = End()
    try:
        yield end
    except (KeyboardInterrupt, Exception) as error:
        if debug:
            with contextlib.suppress(OSError):
                traceback.print_exc()
        message, end.code = _described(error)
        _print_error(message)


def _described(error: BaseException) -> tuple[str, int]:
    """Return the message for an exception, and the exit code."""
    if isinstance(error, (click.exceptions.Abort, KeyboardInterrupt)):
        return INTERRUPTED, 130
    if isinstance(error, click.NoSuchOption):
        return error.format_message().rstrip(".") + _owners(error), 2
    if isinstance(error, click.ClickException):
        return error.format_message(), 2
    if isinstance(error, InputError):
        return error.worded(OPTIONS), 2
    if isinstance(error, MemoryError):
        return NO_MEMORY, 1
    if isinstance(error, OSError):
        return str(error), 3
    return f"{REPORT} --debug ({type(error).__name__}: {error})", 1


def _owners(error: click.NoSuchOption) -> str:
    """Return which other commands have an option, in words; "" if none has."""
    group = error.ctx.parent.command if error.ctx and error.ctx.parent else None
    if not isinstance(group, click.Group):
        return ""
    owners = [
        f"fdcal {name}"
        for name, command in group.commands.items()
        if any(error.option_name in option.opts for option in command.params)
    ]
    return f"; it is an option of {', '.join(owners)}" if owners else ""


def _print_error(message: str) -> None:
    """Print one line to standard error, if anyone reads it."""
    line = " ".join(message.split())
    line = line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."
    with contextlib.suppress(OSError, ValueError):
        print("error:", line, file=sys.stderr, flush=True)


def flush_output() -> None:
    """Write what is left of standard output; OSError where nobody reads it, and nothing is left for Python to write."""
    try:
        sys.stdout.flush()
    except OSError:
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise
