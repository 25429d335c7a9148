"""Where the microphones are, with their names: what is handed on to other programs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .validation import InputError, frozen_array, require_array


@dataclass(frozen=True)
class MicrophonePositions:
    """Named microphones in space.

    Attributes
    ----------
    names : (N,) tuple of str, each different
    positions : (N, 3) float64, metres; (N, 2) is taken as the plane z = 0
    uncertainty : (N,) float64, metres, one standard deviation of the position, or None
    frame : str, what the axes are
    """

    names: tuple[str, ...]
    positions: np.ndarray
    uncertainty: np.ndarray | None = None
    frame: str = "as found"

    def __post_init__(self):
        positions = require_array("positions", self.positions, "real", (len(self.names), None), "m")
        if positions.shape[1] not in (2, 3):
            raise InputError(f"positions of shape {positions.shape} must be (N, 2) or (N, 3), metres")
        space = np.zeros((len(positions), 3))
        space[:, : positions.shape[1]] = positions
        object.__setattr__(self, "positions", frozen_array(space, float))
        if self.uncertainty is not None:
            spread = require_array("uncertainty_m", self.uncertainty, "real", (len(self.names),), "m")
            object.__setattr__(self, "uncertainty", spread)
        if len(set(self.names)) < len(self.names):
            raise InputError("microphones must have different names; rename those that have the same")
