"""A calibration by the likelihood loads no compiler, and `fdcal warm` says how far it is."""

import subprocess
import sys

import pytest
from running import exit_code

from fdcal.acoustics.measure import cached_measurement
from fdcal.commands import cli
from fdcal.commands.cli import all_pieces
from fdcal.model.measurement import save_measurement
from fdcal.model.scene import load_scene

COMMAND = """
import atexit, sys
import fdcal
from fdcal.commands.cli import main
unneeded = {"numba", "llvmlite", "scipy.signal", "viser", "pyvista", "trimesh", "matplotlib", "PIL"}
unneeded |= {"soundfile", "h5py"}
atexit.register(lambda: print(sorted(unneeded & set(sys.modules))))
main(["calibrate", sys.argv[1], "--modes", "12"])
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


def test_warm_compiles_everything_and_tells_how_far_it_is(capsys, monkeypatch):
    """On standard error. `benchmarks/checks/test_compiled.py` asks that the pieces leave nothing to compile."""
    names, compiled = [name for name, _ in all_pieces()], []
    monkeypatch.setattr(cli, "all_pieces", lambda: [(name, lambda name=name: compiled.append(name)) for name in names])
    ended = exit_code("warm")
    out, errors = capsys.readouterr()
    assert not ended and out == "" and compiled == names
    for number, name in enumerate(names, 1):
        assert f"{number} of {len(names)}: {name} ..." in errors
