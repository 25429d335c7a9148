"""A picture as PNG bytes, drawn by a child process (`python -m fdcal.graphics.snapshot`).

The child process keeps a crash of the GL library away from the caller, and VTK out of its memory.
"""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ..model.validation import InputError, StorageError, require_choice
from .camera import VIEWS
from .primitives import Picture

MIN_EDGE, MAX_EDGE = 64, 8192  # pixels
REMEDY = "pictures need a GL library; install one with: apt-get install -y libegl1 libgl1-mesa-dri"
VERSIONS = "install the versions of pyvista, vtk and pillow that fdcal needs: pip install -U fdcal"
MISFIT = re.compile(r"^(ImportError|ModuleNotFoundError|AttributeError|TypeError)\b")  # of libraries that do not fit
TIMEOUT = 120.0  # s


def render_png(picture: Picture, size: Sequence[int] = (1280, 800), view: str = "top") -> bytes:
    """Return the bytes of the PNG, drawn by a child process.

    `size` (width, height), pixels; `view`: "top", "3d" or "close". Raises InputError: the size or the view is unusable;
    StorageError: the child process failed: there is no GL library, or one of another version than fdcal needs.
    """
    require_size(size)
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
        messages = child.stderr.decode(errors="replace").strip().splitlines()
        reason = messages[-1].strip() if messages else ""
        remedy = VERSIONS if MISFIT.match(reason) and "shared object" not in reason else REMEDY
        raise StorageError(f"the picture could not be drawn{reason and f' ({reason})'}; {remedy}")
    return child.stdout


def require_size(size: Sequence[int]) -> None:
    """Raise InputError unless `size` is (width, height) of a usable image, pixels."""
    if len(size) != 2 or not all(MIN_EDGE <= length <= MAX_EDGE for length in size):
        text = "x".join(str(length) for length in size)
        raise InputError(
            f"size = {text} pixels is not usable",
            f"give <size> as two lengths from {MIN_EDGE} to {MAX_EDGE}, as in 1280x800",
            key="size",
            value=size,
        )
