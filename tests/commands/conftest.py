"""Fixtures of the tests of the command line: files made from scene `tiny`."""

from pathlib import Path

import numpy as np
import pytest
from running import done


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """Folder with the measurement and the result of `tiny`, made by the commands."""
    folder = tmp_path_factory.mktemp("made")
    done("simulate", "tiny", "-o", "tiny.npz", folder=folder)
    done("calibrate", "tiny.npz", "--modes", 12, "--seed", 1, "-o", "result.json", folder=folder)
    return folder


@pytest.fixture
def altered(made, tmp_path):
    """Function that writes tiny's measurement with some keys changed; None removes a key."""

    def write(**changes) -> Path:
        with np.load(made / "tiny.npz") as archive:
            table = {**archive, **changes}
        path = tmp_path / "altered.npz"
        np.savez(path, **{key: value for key, value in table.items() if value is not None})
        return path

    return write
