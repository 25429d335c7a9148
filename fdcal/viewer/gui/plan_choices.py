"""The choices of the tab Plan: whether the plan is drawn, under which circumstances, and what was dragged."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class PlanChoices:
    """What the controls of the tab show.

    Attributes
    ----------
    shown : whether the scene shows the planned array in place of the estimates
    snr_db : signal-to-noise ratio of each frequency, dB
    frequencies : the lowest so many are in use; None for all that the array can interpolate
    known : numbers of the microphones whose positions are given
    gain_sigma_db : spread of the channels' gains, dB; 0 for equal channels
    moved : number, x and y, metres, of each microphone that was dragged
    takes : places of the source, recorded equally long from each
    """

    shown: bool = False
    snr_db: float = 30.0
    frequencies: int | None = None
    known: tuple[int, ...] = ()
    gain_sigma_db: float = 0.0
    moved: tuple[tuple[int, float, float], ...] = ()
    takes: int = 1

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
