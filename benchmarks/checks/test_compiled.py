"""`fdcal warm` compiles all that the search of descent and the maps need, and stores it on the disk."""

import subprocess
import sys

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
basins.basins_of(descent.landscape(problem, state, 1, slice(0, 3)).sum(axis=0))
after = signatures()
called = {kernel.__name__ for kernel in before if before[kernel]}
stored = [any(Path(kernels[one].stats.cache_path).glob(f"*.{one.__name__}-*.nbi")) for one in before if before[one]]
new = [(kernel.__name__, one) for kernel in after for one in after[kernel] if one not in before[kernel]]
print({"pruned_search", "_basins", "sweep"} <= called, all(stored), new)
"""


def test_nothing_is_compiled_after_its_warmup():
    """It runs in a process of its own, which has compiled nothing yet."""
    done = subprocess.run([sys.executable, "-c", SEARCH], capture_output=True, text=True)
    assert done.stdout.strip() == "True True []", done.stderr
