"""NumPy's .npy as pyroomacoustics takes it: an array (3, N), metres, one column a microphone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.microphones import MicrophonePositions

NAME = "pyroomacoustics array"
SUFFIXES = (".npy",)


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`."""
    with open(path, "wb") as file:
        np.save(file, np.ascontiguousarray(placed.positions.T))
