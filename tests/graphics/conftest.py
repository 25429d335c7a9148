"""A process that draws off-screen, shared by the tests of a worker: it loads pyvista once."""

import pickle
import subprocess
import sys

import pytest

DRAW = """
import os, pickle, sys
out = os.fdopen(os.dup(1), "wb")
os.dup2(2, 1)  # what a library prints is no image
from fdcal.graphics.snapshot import draw
while True:
    try:
        arguments = pickle.load(sys.stdin.buffer)
    except EOFError:
        break
    pickle.dump(draw(*arguments), out)
    out.flush()
"""


@pytest.fixture(scope="session")
def painted(require_gl):
    """Function (picture, size, view) -> image (H, W, 3) int, as `render_png` draws it."""
    process = subprocess.Popen([sys.executable, "-c", DRAW], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin and process.stdout

    def paint(picture, size, view):
        pickle.dump((picture, tuple(size), view), process.stdin)
        process.stdin.flush()
        return pickle.load(process.stdout).astype(int)

    yield paint
    process.stdin.close()
    process.wait(timeout=60)
