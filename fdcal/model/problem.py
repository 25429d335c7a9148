"""The part of a measurement that a solver gets, without true positions, and the channel correction that it finds."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .gauge import GaugeFrame
from .quantities import Seconds
from .settings import Search
from .validation import InputError, Numbers, Reals, convert, frozen_array, require_array


def mode_power(pressures: Numbers) -> np.ndarray:
    """Return the mean of abs(pressures)**2 over the microphones : (..., M, N), any unit -> (..., M), its square."""
    return np.mean(np.abs(pressures) ** 2, axis=-1)


# Largest number of microphones of an array with short windows, by the number of its coordinates. In space, 64
# microphones take a minute of processor time, and the heights of a flat array are not found reliably, which also
# increases the errors within its plane.
MAX_COUNT = {2: 64, 3: 32}


@dataclass(frozen=True, eq=False)
class ShortWindows:
    """Spectra of many short Hann windows of recordings, in groups, each of one take and one frequency.

    Raises InputError if shapes disagree or a value is impossible.
    """

    frequencies: np.ndarray  # (G,) float64, Hz
    takes: np.ndarray  # (G,) int64, the take of each group, counted from 0
    pressures: np.ndarray  # (G, W, N) complex64, any unit; an unused window is 0 in all channels
    length: float  # seconds, length of a window

    def __post_init__(self):
        put = functools.partial(object.__setattr__, self)
        put("frequencies", require_array("short_frequencies", self.frequencies, "real", (None,), "Hz"))
        G = len(self.frequencies)
        put("takes", require_array("short_takes", self.takes, "index", (G,), "counted from 0"))
        what = "groups, windows, microphones"
        pressures = require_array("short_pressures", self.pressures, "complex", (G, None, None), what)
        put("pressures", frozen_array(pressures, np.complex64))
        put("length", convert(self.length, Seconds, "short_length"))
        if np.any(self.frequencies <= 0) or np.any(self.takes < 0):
            raise InputError("short_frequencies <= 0 or short_takes < 0", "correct them", key="short_frequencies")

    def of_microphones(self, chosen: np.ndarray) -> "ShortWindows":
        """Return the windows of some microphones, indices (n,) or a mask (N,)."""
        return replace(self, pressures=self.pressures[..., chosen])

    def of_take(self, take: int) -> "ShortWindows | None":
        """Return the windows of one take, None if it has none."""
        rows = self.takes == take
        if not rows.any():
            return None
        return ShortWindows(self.frequencies[rows], self.takes[rows], self.pressures[rows], self.length)


def joined_windows(parts: Sequence[ShortWindows | None], firsts: Sequence[int]) -> ShortWindows | None:
    """Return the windows of several measurements together; None if there are none.

    `firsts` are the numbers that the first takes of the measurements get.
    """
    some = [(one, int(first)) for one, first in zip(parts, firsts, strict=True) if one is not None]
    if not some:
        return None
    count = max(one.pressures.shape[1] for one, _ in some)
    padded = [np.pad(one.pressures, ((0, 0), (0, count - one.pressures.shape[1]), (0, 0))) for one, _ in some]
    return ShortWindows(
        np.concatenate([one.frequencies for one, _ in some]),
        np.concatenate([one.takes + first for one, first in some]),
        np.concatenate(padded),
        min(one.length for one, _ in some),
    )


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a solver gets. Problems are compared by identity, so that tables of a problem can be cached."""

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
    frame: GaugeFrame | None = None  # the minimal gauge; if there is one, `known` is empty
    # (M,) int64, the take of each row; one take unless given. In all rows of a take the sound comes from the same
    # directions.
    takes: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    # (T, N) float64 or None, times at which the direct sound arrives, seconds; NaN where none is known. Row t belongs
    # to take t and has an arbitrary origin.
    arrivals: np.ndarray | None = None
    # (T,) float64 or None, one sigma of an arrival of each take, seconds; None without `arrivals`
    arrival_sigma: np.ndarray | None = None
    windows: ShortWindows | None = None  # short windows of the recordings, beside the long rows

    def __post_init__(self):
        if len(self.takes) != len(self.frequencies):
            object.__setattr__(self, "takes", frozen_array(np.zeros(len(self.frequencies)), np.int64))

    @property
    def free(self) -> np.ndarray:
        """(N - A,) int64, the microphones to be found, ascending."""
        return np.setdiff1d(np.arange(int(self.pressures.shape[1])), self.known)


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
    noise: Reals  # (N,) float64, noise power of the corrected pressures, divided by that of a healthy channel

    def corrected(self, pressures: ArrayLike) -> np.ndarray:
        """Return pressures (..., N) divided by the gains."""
        return np.asarray(pressures) / self.gains

    @property
    def scale(self) -> np.ndarray:
        """Factors for rows of W and corrected pressures that make the noise of all channels equal : (N,) float64."""
        return 1 / np.sqrt(self.noise)


def equalised(pressures: ArrayLike, channels: ChannelCorrection | None) -> tuple[np.ndarray, np.ndarray]:
    """Return pressures (M, N), corrected and scaled so that all channels have equal noise, and the `scale` (N,)."""
    pressures = np.asarray(pressures)
    if channels is None:
        return pressures, np.ones(int(pressures.shape[-1]))
    return channels.corrected(pressures) * channels.scale, channels.scale


class SolverState(Protocol):
    """The attributes of a solver's state that costs and maps use."""

    @property
    def positions(self) -> np.ndarray: ...
    @property
    def channels(self) -> ChannelCorrection | None: ...
