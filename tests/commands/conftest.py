"""What the tests of the command line share: a command that must fail, and files made from scene `tiny`."""

import re
from pathlib import Path

import numpy as np
import pytest
from running import done

from fdcal.commands.cli import main


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Function that runs a command that must fail, and gives its one error line; in this process, which saves time."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, code: int = 2) -> str:
        before = sorted(tmp_path.iterdir())
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        out, errors = capsys.readouterr()
        assert ended.value.code == code, errors
        assert out == ""
        (line,) = [line for line in errors.splitlines() if line.startswith("error: ")]
        assert errors.endswith(line + "\n") and not re.search("<[a-z_]+>", line), "each argument has its option's name"
        assert sorted(tmp_path.iterdir()) == before, "no output, no temporary file"
        return line

    return run


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Folder with the measurement and the result of `tiny`, made by the commands."""
    folder = tmp_path_factory.mktemp("made")
    done("simulate", "tiny", "-o", "tiny.npz", folder=folder)
    done("calibrate", "tiny.npz", "--modes", 12, "--seed", 1, "-o", "result.json", folder=folder)
    return folder


@pytest.fixture
def altered(made, tmp_path):
    """Function that writes tiny's measurement with some keys changed, None taking one out."""

    def write(**changes) -> Path:
        with np.load(made / "tiny.npz") as archive:
            table = {**archive, **changes}
        path = tmp_path / "altered.npz"
        np.savez(path, **{key: value for key, value in table.items() if value is not None})
        return path

    return write
