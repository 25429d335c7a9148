"""A calibration by the likelihood loads no compiler, and a page tells how far its warm-up is."""

import subprocess
import sys
import threading
import time

import pytest
from running import exit_code

from fdcal.acoustics.measure import cached_measurement
from fdcal.commands import cli
from fdcal.commands.cli import all_pieces
from fdcal.model.measurement import save_measurement
from fdcal.model.scene import load_scene
from fdcal.viewer import prepare as warmup
from fdcal.viewer.prepare import Warmup

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


def test_a_warmup_reports_its_progress_and_ends(monkeypatch):
    gate = threading.Event()
    monkeypatch.setattr(warmup, "warmup_calls", lambda _: [("", lambda: None), ("", gate.wait), ("", lambda: 1 / 0)])
    monkeypatch.setattr(warmup, "COMPILE_TIME", 0.0)
    made = Warmup(load_scene("tiny"))
    deadline = time.monotonic() + 60
    while not made.text.endswith("2 of 3") and time.monotonic() < deadline:
        time.sleep(0.01)
    assert made.busy and made.text.endswith("2 of 3")
    gate.set()
    assert made.close(60.0) and made.text == "", "a piece that fails ends it"


def test_warm_compiles_everything_and_tells_how_far_it_is(capsys, monkeypatch):
    """On standard error. `benchmarks/checks/test_compiled.py` asks that the pieces leave nothing to compile."""
    names, compiled = [name for name, _ in all_pieces()], []
    monkeypatch.setattr(cli, "all_pieces", lambda: [(name, lambda name=name: compiled.append(name)) for name in names])
    ended = exit_code("warm")
    out, errors = capsys.readouterr()
    assert not ended and out == "" and compiled == names
    for number, name in enumerate(names, 1):
        assert f"{number} of {len(names)}: {name} ..." in errors
