"""What a solver found about the recording channels, as costs and maps take it: gains and noise."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ..model.types import Reals


@dataclass(frozen=True)
class ChannelCorrection:
    """Gain and noise of every channel. Corrected pressures are the recorded ones divided by the gain.

    Examples
    --------
    >>> correction = ChannelCorrection(np.array([1.0, -2.0]), np.array([1.0, 4.0]))
    >>> correction.corrected([3.0, 6.0])
    array([ 3., -3.])
    >>> correction.scale
    array([1. , 0.5])
    """

    gains: np.ndarray  # (N,) complex128, dimensionless
    noise: Reals  # (N,) float64, noise power of the corrected pressures over that of a healthy channel

    def corrected(self, pressures: ArrayLike) -> np.ndarray:
        """Return pressures (..., N) divided by the gains."""
        return np.asarray(pressures) / self.gains

    @property
    def scale(self) -> np.ndarray:
        """What rows and corrected pressures are multiplied by, so that all channels have equal noise : (N,) float64."""
        return 1 / np.sqrt(self.noise)


def equalised(pressures: ArrayLike, channels: ChannelCorrection | None) -> tuple[np.ndarray, np.ndarray]:
    """Return pressures (M, N) corrected and scaled to equal noise of all channels, and the scale (N,) of rows of W."""
    pressures = np.asarray(pressures)
    if channels is None:
        return pressures, np.ones(int(pressures.shape[-1]))
    return channels.corrected(pressures) * channels.scale, channels.scale


class SolverState(Protocol):
    """What costs and maps read of a state of any solver."""

    @property
    def positions(self) -> np.ndarray: ...
    @property
    def channels(self) -> ChannelCorrection | None: ...
