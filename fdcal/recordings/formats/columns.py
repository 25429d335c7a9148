"""NumPy's .npy as pyroomacoustics reads it: an array (3, N), metres, one column per microphone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.given_positions import MicrophonePositions

SUFFIXES = (".npy",)


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write `placed`; there is no original to fill in."""
    with open(path, "wb") as file:
        np.save(file, np.ascontiguousarray(placed.positions.T))
