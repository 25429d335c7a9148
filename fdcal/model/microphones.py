"""Positions of named microphones, as files of positions for other programs hold them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .validation import InputError, frozen_array, require_array


@dataclass(frozen=True)
class MicrophonePositions:
    """Positions of named microphones in space."""

    names: tuple[str, ...]  # (N,) tuple of str, each different
    positions: np.ndarray  # (N, 3) float64, metres; (N, 2) is taken as the plane z = 0
    uncertainty: np.ndarray | None = None  # (N,) float64 or None, one standard deviation of the position, metres
    frame: str = "as found"  # name of the coordinate system

    def __post_init__(self):
        positions = require_array("positions", self.positions, "real", (len(self.names), None), "m")
        if positions.shape[1] not in (2, 3):
            problem = f"positions have shape {positions.shape}"
            raise InputError(problem, "give shape (N, 2) or (N, 3), metres", key="positions")
        space = np.zeros((len(positions), 3))
        space[:, : positions.shape[1]] = positions
        object.__setattr__(self, "positions", frozen_array(space, float))
        if self.uncertainty is not None:
            spread = require_array("uncertainty_m", self.uncertainty, "real", (len(self.names),), "m")
            object.__setattr__(self, "uncertainty", spread)
        if len(set(self.names)) < len(self.names):
            raise InputError("two microphones have the same name", "rename one of them", key="names")
