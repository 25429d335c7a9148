"""A calibration by the likelihood loads no compiler."""

import subprocess
import sys

import pytest

from fdcal.acoustics.measure import cached_measurement
from fdcal.model.measurement import save_measurement
from fdcal.model.scene import load_scene

COMMAND = """
import atexit, sys
import fdcal
from fdcal.commands.cli import main
unneeded = {"numba", "llvmlite", "scipy.signal", "viser", "pyvista", "trimesh", "matplotlib", "PIL"}
unneeded |= {"soundfile", "h5py"}
atexit.register(lambda: print(sorted(unneeded & set(sys.modules))))
main(["calibrate", sys.argv[1]])
"""


@pytest.fixture(scope="module")
def tiny_file(tmp_path_factory):
    """The measurement of `tiny`."""
    path = tmp_path_factory.mktemp("warmup") / "tiny.npz"
    with open(path, "wb") as file:
        save_measurement(cached_measurement(load_scene("tiny")), file)
    return path


def test_the_command_loads_only_what_a_calibration_needs(tiny_file):
    """No compiler, whichever solver; libraries for pictures, the page and recordings take seconds to load."""
    done = subprocess.run([sys.executable, "-c", COMMAND, str(tiny_file)], capture_output=True, text=True)
    *_, summary, loaded = done.stdout.splitlines()
    assert "verdict good" in summary and loaded == "[]"
