"""A calibration by the likelihood compiles nothing, and what else is compiled is compiled beforehand."""

import os
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
SEARCH = """
import sys
from pathlib import Path
from numba.core.registry import CPUDispatcher
from fdcal.acoustics import fdtd_kernels
from fdcal.acoustics.measure import cached_measurement
from fdcal.cost import basins, lattice
from fdcal.model.scene import load_scene
from fdcal.solvers import load
from fdcal.commands.cli import all_pieces

values = [value for module in (lattice, basins, fdtd_kernels) for value in vars(module).values()]
kernels = {value.py_func: value for value in values if isinstance(value, CPUDispatcher)}

def signatures():
    return {function: list(kernel.signatures) for function, kernel in kernels.items()}

for _, compile_piece in all_pieces():
    compile_piece()
before, scene = signatures(), load_scene("tiny")
problem, descent = cached_measurement(scene).problem(), load("descent")
state = descent.init(problem, scene.solver, 0)
for _ in range(20):
    state = descent.step(problem, state)
basins.local_minima(descent.landscape(problem, state, 1, slice(0, 3)).sum(axis=0))
after = signatures()
called = {kernel.__name__ for kernel in before if before[kernel]}
stored = [any(Path(kernels[one].stats.cache_path).glob(f"*.{one.__name__}-*.nbi")) for one in before if before[one]]
new = [(kernel.__name__, one) for kernel in after for one in after[kernel] if one not in before[kernel]]
print({"pruned_search", "_basins", "sweep"} <= called, all(stored), new)
"""


def run(*args: str) -> str:
    """In a process of its own: in this one other tests have loaded the compiler and compiled what there is."""
    done = subprocess.run([sys.executable, "-c", *args], capture_output=True, text=True, env=os.environ)
    return done.stdout.strip() or done.stderr


@pytest.fixture(scope="module")
def tiny_file(tmp_path_factory):
    """The measurement of `tiny`."""
    path = tmp_path_factory.mktemp("warmup") / "tiny.npz"
    with open(path, "wb") as file:
        save_measurement(cached_measurement(load_scene("tiny")), file)
    return path


def test_the_command_loads_only_what_a_calibration_needs(tiny_file):
    """No compiler, whichever solver; libraries for pictures, the page and recordings take seconds to load."""
    *_, summary, loaded = run(COMMAND, str(tiny_file)).splitlines()
    assert "verdict good" in summary and loaded == "[]"


def test_nothing_is_compiled_after_its_warmup():
    assert run(SEARCH) == "True True []"


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
    """On standard error. That the pieces leave nothing to compile, and that it lies on the disk, is shown above."""
    names, compiled = [name for name, _ in all_pieces()], []
    monkeypatch.setattr(cli, "all_pieces", lambda: [(name, lambda name=name: compiled.append(name)) for name in names])
    ended = exit_code("warm")
    out, errors = capsys.readouterr()
    assert not ended and out == "" and compiled == names
    for number, name in enumerate(names, 1):
        assert f"{number} of {len(names)}: {name} ..." in errors
