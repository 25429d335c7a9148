"""What is compiled beforehand is what a run calls: nothing is left to be compiled when somebody waits for it."""

import os
import subprocess
import sys
import threading

import pytest

from fdcal.model.scene_file import load_scene
from fdcal.solvers.warmup import warmup_calls
from fdcal.viewer.background import warmup
from fdcal.viewer.background.warmup import Warmup

CALIBRATION = """
import sys
from numba.core.registry import CPUDispatcher
from fdcal import solvers
from fdcal.cost import angular_prior, bessel_kernels, dense_covariance, low_rank_covariance
from fdcal.cost import newton_kernels, spherical_covariance
from fdcal.solvers import warmup
from fdcal.model.scene_file import load_scene
from fdcal.acoustics.measurement_cache import cached_measurement

def signatures():
    modules = dense_covariance, low_rank_covariance, newton_kernels, bessel_kernels, angular_prior, spherical_covariance
    values = [value for module in modules for value in vars(module).values()]
    return {value.py_func: list(value.signatures) for value in values if isinstance(value, CPUDispatcher)}

for piece in sum(warmup.warmup_calls(2, "joint"), []):
    piece()
before, scene = signatures(), load_scene("tiny")
problem = cached_measurement(scene).problem(scene.solver.weights)
for state in solvers.run(problem, scene.solver, scene.seed):
    pass
assert state.finished and state.field.near_field, "the stage that takes the other kernels was not reached"
after = signatures()
print([(kernel.__name__, new) for kernel in after for new in after[kernel] if new not in before[kernel]])
"""


def test_a_run_compiles_nothing_after_its_warmup():
    """In a process of its own: in this one other tests have compiled what there is."""
    run = subprocess.run([sys.executable, "-c", CALIBRATION], capture_output=True, text=True, env=os.environ)
    assert run.stdout.strip() == "[]", run.stdout + run.stderr


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_piece_can_be_done(dimension):
    first, last = warmup_calls(dimension, "descent+joint")
    assert first and last
    for piece in (*first, *last):
        piece()


def test_descent_has_nothing_to_rehearse():
    assert warmup_calls(2, "descent") == ([], [])


def test_a_warmup_reports_its_progress_and_ends(monkeypatch):
    gate = threading.Event()
    monkeypatch.setattr(warmup, "warmup_calls", lambda *_: ([lambda: None], [gate.wait, lambda: 1 / 0]))
    monkeypatch.setattr(warmup, "COMPILE_TIME", 0.0)
    made = Warmup(load_scene("tiny"))
    made.wait_for_first(lambda: None)
    assert made.busy and made.text.endswith("2 of 3")
    gate.set()
    assert made.close(60.0) and made.text == "", "a piece that fails ends it"
