"""What is compiled beforehand is what a run calls: nothing is left to be compiled when somebody waits for it."""

import os
import subprocess
import sys

import pytest

from fdcal.rehearsal import pieces
from fdcal.viewer.rehearsing import Rehearsal

CALIBRATION = """
import sys
from numba.core.registry import CPUDispatcher
from fdcal import dense, expansion, learned, likelihood, rehearsal, series, solvers
from fdcal.scene import load_scene
from fdcal.store import cached_measurement

def signatures():
    kernels = {value for module in (dense, expansion, learned, series) for value in vars(module).values()}
    return {kernel.py_func.__name__: list(kernel.signatures) for kernel in kernels if isinstance(kernel, CPUDispatcher)}

for piece in sum(rehearsal.pieces(2, "joint"), []):
    piece()
before, scene = signatures(), load_scene("tiny")
problem = cached_measurement(scene).problem(scene.solver.weights)
for state in solvers.run(problem, scene.solver, scene.seed):
    pass
assert state.finished and state.near, "the stage that takes the other kernels was not reached"
after = signatures()
print([(name, new) for name in after for new in after[name] if new not in before[name]])
"""


def test_a_run_compiles_nothing_after_its_rehearsal():
    """In a process of its own: in this one other tests have compiled what there is."""
    run = subprocess.run([sys.executable, "-c", CALIBRATION], capture_output=True, text=True, env=os.environ)
    assert run.stdout.strip() == "[]", run.stdout + run.stderr


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_piece_can_be_done(dimension):
    first, last = pieces(dimension, "descent+joint")
    assert first and last
    for piece in (*first, *last):
        piece()


def test_descent_has_nothing_to_rehearse():
    assert pieces(2, "descent") == ([], [])


def test_a_rehearsal_tells_how_far_it_is_and_ends(scene, monkeypatch):
    import threading

    from fdcal.viewer import rehearsing

    gate = threading.Event()
    monkeypatch.setattr(rehearsing, "pieces", lambda *_: ([lambda: None], [gate.wait, lambda: 1 / 0]))
    monkeypatch.setattr(rehearsing, "LONG", 0.0)
    made = Rehearsal(scene)
    made.wait_for_first(lambda: None)
    assert made.busy and made.text.endswith("2 of 3")
    gate.set()
    assert made.close(60.0) and made.text == "", "a piece that fails ends it"
