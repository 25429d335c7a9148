"""Commands of `fdcal`, run as a user would: in a process of their own, or in this one, which saves time."""

import contextlib
import io
import subprocess
import sys
from pathlib import Path

import pytest

from fdcal.commands.cli import main

FDCAL = [sys.executable, "-m", "fdcal"]


def fdcal(*arguments, folder: Path) -> subprocess.CompletedProcess:
    """A command in a process of its own, as a user runs it."""
    return subprocess.run([*FDCAL, *map(str, arguments)], capture_output=True, text=True, timeout=120, cwd=folder)


def exit_code(*arguments) -> int:
    """The exit code of a command that runs in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code or 0


def done(*arguments, folder: Path) -> str:
    """Standard output of a command that must succeed; a calibration may end with a verdict that is not good.

    In this process: to start another and to load the libraries again takes longer than most commands.
    """
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = exit_code(*arguments)
    assert code in ((0, 4) if arguments[0:1] == ("calibrate",) else (0,)), errors.getvalue()
    return out.getvalue()
