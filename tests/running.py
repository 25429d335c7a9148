"""Commands of `fdcal`, run in this process, which saves the start of another one and the loading of libraries."""

import contextlib
import io
from pathlib import Path

import pytest

from fdcal.commands.cli import main
from fdcal.model.validation import InputError, StorageError


def exit_code(*arguments) -> int:
    """The exit code of a command that runs in this process."""
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code or 0


def run(*arguments, code: int = 0) -> None:
    """Run a command that must end with `code`."""
    assert exit_code(*arguments) == code


def done(*arguments, folder: Path) -> str:
    """Standard output of a command that must succeed; a calibration may end with a verdict that is not good."""
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = exit_code(*arguments)
    assert code in ((0, 4) if arguments[0:1] == ("calibrate",) else (0,)), errors.getvalue()
    return out.getvalue()


def refuses(words: str, call, *arguments, **options) -> InputError | StorageError:
    """The error that a call must raise, in one line that matches `words`, if they are given."""
    with pytest.raises((InputError, StorageError), match=words or None) as caught:
        call(*arguments, **options)
    assert "\n" not in str(caught.value)
    return caught.value
