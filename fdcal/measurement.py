"""What was measured, and what of it a solver may see.

`Measurement` may hold the true positions, for scoring alone; `Problem` cannot.
The .npz file of a measurement is a public contract (README, "The measurement file").
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .checks import InputError, StorageError, frozen_array, require_choice, require_finite, require_positive
from .scene import Search


@dataclass(frozen=True)
class Problem:
    """All that a solver may see: no truth.

    Attributes
    ----------
    pressures : (M, N) complex128, dimensionless with `weights = "unit"` (each mode of unit RMS)
    wavenumbers : (M,) complex128, rad/m, time sign exp(+j w t)
    frequencies : (M,) float64, Hz
    known : (A,) int64, known microphones, ascending
    known_positions : (A, D) float64, metres
    search : Search or None, lattice of candidates and expansion radius
    noise_power : (M,) float64 or None, in the unit of abs(pressures)**2
    sound_speed : float, m/s
    dimension, array_dimension : 2 or 3, of the sound field and of the positions (D)
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

    @property
    def free(self) -> np.ndarray:
        """(N - A,) int64, the microphones to be found, ascending."""
        return np.setdiff1d(np.arange(self.pressures.shape[1]), self.known)


@dataclass(frozen=True)
class Measurement:
    """Pressures of M modes at N microphones and what is known about them.

    Attributes
    ----------
    frequencies : (M,) float64, Hz, ascending
    pressures : (M, N) complex128, any one unit for all (recordings are not calibrated)
    sound_speed : float, m/s
    dimension : 2 or 3, of the sound field
    array_dimension : 2 or 3, the D of all positions; `dimension` unless given
    wavenumbers : (M,) complex128, rad/m, time sign exp(+j w t); 2 pi f / c unless given
    noise_power : (M,) float64 or None, unit of abs(pressures)**2
    names : (N,) tuple of str; "0", "1", ... unless given
    positions : (N, D) float64 or None, metres, the truth, for scoring alone
    known : (A,) int64, indices of known microphones, ascending
    known_positions : (A, D) float64, metres
    search : Search or None

    Raises InputError for a wrong shape, NaN, a dead microphone or frequency, real pressures.
    """

    frequencies: np.ndarray
    pressures: np.ndarray
    sound_speed: float
    dimension: int = 2
    array_dimension: int | None = None
    wavenumbers: np.ndarray | None = None
    noise_power: np.ndarray | None = None
    names: tuple[str, ...] | None = None
    positions: np.ndarray | None = None
    known: np.ndarray = ()
    known_positions: np.ndarray | None = None
    search: Search | None = None

    def __post_init__(self):
        _fill_defaults(self)
        _check_pressures(self)
        _check_positions(self)

    @property
    def count(self) -> int:
        """Number of microphones N."""
        return self.pressures.shape[1]

    def problem(self, weights: str = "unit") -> Problem:
        """What a solver sees: modes of unit RMS (`weights = "unit"`), or as measured ("raw", the paper's)."""
        require_choice("weights", weights, ("unit", "raw"))
        power = np.mean(np.abs(self.pressures) ** 2, axis=1) if weights == "unit" else np.ones(len(self.frequencies))
        noise = None if self.noise_power is None else frozen_array(self.noise_power / power, float)
        return Problem(
            pressures=frozen_array(self.pressures / np.sqrt(power)[:, None], complex),
            noise_power=noise,
            **{
                name: getattr(self, name)
                for name in (
                    "wavenumbers",
                    "frequencies",
                    "known",
                    "known_positions",
                    "search",
                    "sound_speed",
                    "dimension",
                    "array_dimension",
                )
            },
        )
