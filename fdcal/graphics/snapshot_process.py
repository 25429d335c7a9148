"""A picture as PNG bytes, drawn by a child process (`python -m fdcal.graphics.snapshot`).

The child keeps a fault of the GL library away from whoever asked, and VTK out of their memory.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

from ..model.validation import InputError, StorageError, require_choice
from .camera import VIEWS
from .primitives import Picture

SMALLEST, LARGEST = 64, 8192  # pixels an edge
REMEDY = "pictures need a GL library; install one with: apt-get install -y libegl1 libgl1-mesa-dri"
TIMEOUT = 120.0  # s


def render_png(picture: Picture, size=(1280, 800), view: str = "top") -> bytes:
    """The bytes of the PNG, drawn by a child process. Raises InputError and StorageError."""
    check_size(size)
    require_choice("view", view, VIEWS)
    package = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path}
    try:
        child = subprocess.run(
            [sys.executable, "-m", "fdcal.graphics.snapshot"],
            input=pickle.dumps((picture, tuple(size), view)),
            capture_output=True,
            timeout=TIMEOUT,
            env=environment,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise StorageError(f"the picture could not be drawn: {error}") from error
    if child.returncode != 0 or not child.stdout.startswith(b"\x89PNG"):
        words = child.stderr.decode(errors="replace").strip().splitlines()
        reason = f" ({words[-1].strip()})" if words else ""
        raise StorageError(f"the picture could not be drawn{reason}; {REMEDY}")
    return child.stdout


def check_size(size) -> None:
    """Raise InputError unless `size` is (width, height) of a usable image."""
    if len(size) != 2 or not all(SMALLEST <= length <= LARGEST for length in size):
        text = "x".join(str(length) for length in size)
        raise InputError(f"size = {text} pixels must be two lengths from {SMALLEST} to {LARGEST}, as in 1280x800")
