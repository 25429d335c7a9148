"""The choices of the tab Plan: whether the plan is drawn, under which circumstances, and what was dragged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class PlanChoices:
    """What the controls of the tab show."""

    shown: bool = False  # whether the scene shows the planned array in place of the estimates
    snr_db: float = 30.0  # signal-to-noise ratio of each frequency, dB
    frequencies: int | None = None  # the lowest so many are in use; None for all that the array can interpolate
    known: tuple[int, ...] = ()  # numbers of the microphones whose positions are given
    gain_sigma_db: float = 0.0  # spread of the channels' gains, dB; 0 for equal channels
    moved: tuple[tuple[int, float, float], ...] = ()  # number, x and y, metres, of each microphone that was dragged
    takes: int = 1  # places of the source, recorded equally long from each

    def with_moved(self, microphone: int, place) -> PlanChoices:
        """Return the choices with a microphone at another place, (2,), metres."""
        others = tuple(move for move in self.moved if move[0] != microphone)
        return replace(self, moved=(*others, (int(microphone), float(place[0]), float(place[1]))))

    def placed(self, positions) -> np.ndarray:
        """Return positions (N, D), metres, with the microphones that were dragged where they are now."""
        placed = np.array(positions, float)
        for microphone, x, y in self.moved:
            placed[microphone, :2] = x, y
        return placed
