"""What a solver sees of a measurement: pressures and known positions, never the true ones; and the power of a mode."""

from dataclasses import dataclass, field

import numpy as np

from .gauge import GaugeFrame
from .settings import Search
from .types import Numbers
from .validation import frozen_array


def mode_power(pressures: Numbers) -> np.ndarray:
    """Return the mean of abs(pressures)**2 over the microphones : (..., M, N), any unit -> (..., M), its square."""
    return np.mean(np.abs(pressures) ** 2, axis=-1)


@dataclass(frozen=True, eq=False)
class Problem:
    """All that a solver may see: no true positions. Compared by identity, so that tables of one can be cached."""

    pressures: np.ndarray  # (M, N) complex128, dimensionless with `weights = "unit"` (each mode of unit RMS)
    wavenumbers: np.ndarray  # (M,) complex128 k, rad/m, time sign exp(+j w t).
    frequencies: np.ndarray  # (M,) float64, Hz
    known: np.ndarray  # (A,) int64, known microphones, ascending
    known_positions: np.ndarray  # (A, D) float64, metres
    search: Search | None  # lattice of candidates and expansion radius
    noise_power: np.ndarray | None  # (M,) float64 or None, in the unit of abs(pressures)**2
    sound_speed: float  # c, m/s
    # dimension, array_dimension: of the sound field and of the positions (D), 2 or 3
    dimension: int
    array_dimension: int
    frame: GaugeFrame | None = None  # the minimal gauge; no microphone is `known` then
    # (M,) int64, the take of each row; one unless given. Rows of one take share the directions from which the sound
    # comes
    takes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    # (T, N) float64 or None, arrivals of the direct sound, seconds, row t of take t, its origin arbitrary; NaN where
    # there is none
    arrivals: np.ndarray | None = None
    # (T,) float64 or None, one sigma of an arrival of each take, seconds; with `arrivals`
    arrival_sigma: np.ndarray | None = None

    def __post_init__(self):
        if len(self.takes) != len(self.frequencies):
            object.__setattr__(self, "takes", frozen_array(np.zeros(len(self.frequencies)), np.int64))

    @property
    def free(self) -> np.ndarray:
        """(N - A,) int64, the microphones to be found, ascending."""
        return np.setdiff1d(np.arange(int(self.pressures.shape[1])), self.known)
