"""What a solver sees of a measurement: pressures and known positions, never the true ones; and the power of a mode."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .gauge import GaugeFrame
from .settings import Search
from .validation import frozen_array


def mode_power(pressures) -> np.ndarray:
    """Return the mean of abs(pressures)**2 over the microphones, mode by mode.

    Parameters
    ----------
    pressures : (..., M, N) complex128
        Pressures of M modes at N microphones, in any unit.

    Returns
    -------
    (..., M) float64
        Mean power, in the squared unit of the pressures.
    """
    return np.mean(np.abs(pressures) ** 2, axis=-1)


@dataclass(frozen=True, eq=False)
class Problem:
    """All that a solver may see: no true positions. Compared by identity, so that tables of one can be cached.

    Attributes
    ----------
    pressures : (M, N) complex128
        Dimensionless with `weights = "unit"` (each mode of unit RMS).
    wavenumbers : (M,) complex128
        k, rad/m, time sign exp(+j w t).
    frequencies : (M,) float64
        Hz.
    known : (A,) int64
        Known microphones, ascending.
    known_positions : (A, D) float64
        Metres.
    search : Search or None
        Lattice of candidates and expansion radius.
    noise_power : (M,) float64 or None
        In the unit of abs(pressures)**2.
    sound_speed : float
        c, m/s.
    dimension, array_dimension : int
        Of the sound field and of the positions (D), 2 or 3.
    frame : GaugeFrame or None
        The minimal gauge; no microphone is `known` then.
    takes : (M,) int64
        The take of each row; one unless given. Rows of one take share the directions from which the sound comes.
    arrivals : (T, N) float64 or None
        Arrivals of the direct sound, seconds, row t of take t, its origin arbitrary; NaN where there is none.
    arrival_sigma : (T,) float64 or None
        One sigma of an arrival of each take, seconds; with `arrivals`.
    """

    pressures: np.ndarray
    wavenumbers: np.ndarray
    frequencies: np.ndarray
    known: np.ndarray
    known_positions: np.ndarray
    search: Search | None
    noise_power: np.ndarray | None
    sound_speed: float
    dimension: int
    array_dimension: int
    frame: GaugeFrame | None = None
    takes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    arrivals: np.ndarray | None = None
    arrival_sigma: np.ndarray | None = None

    def __post_init__(self):
        if len(self.takes) != len(self.frequencies):
            object.__setattr__(self, "takes", frozen_array(np.zeros(len(self.frequencies)), np.int64))

    @property
    def free(self) -> np.ndarray:
        """(N - A,) int64, the microphones to be found, ascending."""
        return np.setdiff1d(np.arange(self.pressures.shape[1]), self.known)
