"""What a plan is asked for: array, room, noise, given positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...acoustics.dictionary import array_f_max
from ...acoustics.room_modes import independent_frequencies
from ...assessment.bound import Prior
from ...model.validation import (
    InputError,
    require_choice,
    require_integer,
    require_not_negative,
    require_number,
    require_positive,
)
from .layout import Layout
from .request_checks import require_given, require_layout, require_modes, require_room, require_takes


@dataclass(frozen=True)
class PlanLimits:
    """What is assumed where nothing is given, and how much is computed."""

    low: float = 20.0  # lowest frequency by default
    # highest frequency by default, relative to what the array can interpolate (Eq. 9): there the functions are as many
    # as the microphones, and the pressures predict nothing
    high: float = 0.7
    most_frequencies: int = 150  # of the bounds; more are accounted for by scaling the information
    search_frequencies: int = 16  # of the maps and the advice, likewise
    clearance: float = 0.7  # least distance of a source from the microphones in a room, metres
    sources: int = 4  # source positions in a room that the bound is averaged over
    # centre of an array in a room where its own coordinates do not lie inside, relative to the room's lengths
    place: tuple[float, float, float] = (0.43, 0.46, 0.45)
    most_microphones: int = 300  # of a plan
    most_takes: int = 100  # likewise
    most_snr_db: float = 120.0  # dB
    wide: float = 5.0  # width of an array from which a refusal asks for its unit, metres


LIMITS = PlanLimits()


@dataclass(frozen=True)
class Assumptions:
    """Tape measures, channels and accuracies, as assumed unless a request says otherwise."""

    # metres, one sigma of a coordinate that is measured by tape. A tape of class II errs by 0.3 mm and 0.2 mm more for
    # each metre at most (Directive 2014/32/EU, annex X); finding the middle of a membrane in its housing and holding
    # the tape level take the rest.
    tape_sigma_m: float = 0.005
    # dB, spread of the channels' gains: what makers promise for the sensitivity of MEMS and of measurement microphones
    # without calibration, +-1 dB.
    gain_sigma_db: float = 1.0
    # relative one sigma of the size, or of a stretch, from which a plan mentions it: over an array of 1 m it is the
    # accuracy that is wanted by default, 10 mm.
    blurred: float = 0.01


ASSUMED = Assumptions()
LEAST_FREQUENCIES = 3  # of a calibration
SOLVERS = ("robust", "joint")  # that trials run


@dataclass(frozen=True)
class PlanRequest:
    """An array, and the circumstances of its calibration.

    Raises InputError: a value is out of range, or the band holds too few frequencies.
    """

    layout: Layout
    # (2,) or (3,) tuple of float, metres, lengths of a rectangular room; None for a diffuse field in space
    room: tuple[float, ...] | None = None
    reverberation_time: float = 0.5  # s
    snr_db: float = 30.0  # signal-to-noise ratio of each frequency
    # (2,) tuple of float, Hz; from 20 Hz to 0.7 times what the array can interpolate (Eq. 9) unless given. Of
    # frequencies above what it can interpolate none is used
    band: tuple[float, float] | None = None
    known: tuple[int, ...] = ()  # (A,) tuple of int, microphones whose positions are given
    known_sigma: float = 0.0  # metres, one sigma of each of their coordinates; 0 for exact ones
    gain_sigma_db: float = 0.0  # spread of the channels' gains; 0 for equal channels
    sound_speed: float = 343.0  # m/s
    accuracy: float = 0.01  # metres, that is wanted
    seed: int = 0  # of sources, noise and gains
    modes: int | None = None  # the lowest so many independent frequencies of the band; all of them unless given
    takes: int = 1  # places of the source, each recorded by itself at `snr_db`; every take has all frequencies
    # of the trials, one of SOLVERS; "robust" models all that a plan assumes of gains and given positions
    solver: str = "robust"

    def __post_init__(self):
        require_layout(self.layout, LIMITS.most_microphones)
        units = {"reverberation_time": "s", "sound_speed": "m/s", "accuracy": "m"}
        for key, unit in units.items():
            require_positive(key, getattr(self, key), unit)
        require_number("snr", self.snr_db)
        if not 0 < self.snr_db <= LIMITS.most_snr_db:
            remedy = f"use more than 0 and at most {LIMITS.most_snr_db:g}"
            raise InputError(f"snr = {self.snr_db:g} dB is out of range", remedy, key="snr", value=self.snr_db)
        require_room(self.room, self.layout.positions.shape[1])
        require_given(self.known, self.known_sigma, self.layout.positions)
        require_not_negative("gain_sigma_db", self.gain_sigma_db, "dB")
        require_integer("seed", self.seed)
        require_modes(self.modes, LEAST_FREQUENCIES)
        require_takes(self.takes, LIMITS.most_takes)
        require_choice("solver", self.solver, SOLVERS)
        if len(self.frequencies) < LEAST_FREQUENCIES:
            low, high = self.limits
            problem = f"{low:g} to {high:.0f} Hz with a reverberation time of {self.reverberation_time:g} s hold"
            remedy = "use a wider band (<frequencies>), or a smaller array, whose band reaches higher" + self._width
            raise InputError(f"{problem} {len(self.frequencies)} independent frequencies", remedy, key="frequencies")

    @property
    def dimension(self) -> int:
        """Of the sound field, 2 or 3."""
        return 3 if self.room is None else len(self.room)

    @property
    def is_plane_in_room(self) -> bool:
        """Whether the array is plane and the room has three dimensions."""
        return self.room is not None and len(self.room) == 3 and self.layout.positions.shape[1] == 2

    @property
    def f_max(self) -> float:
        """The highest frequency that the array can interpolate (Eq. 9), Hz."""
        return array_f_max(self.layout.positions, self.sound_speed, self.dimension)

    @property
    def limits(self) -> tuple[float, float]:
        """The band in use, Hz: of the one that was given, what the array can interpolate."""
        low, high = self.band or (min(LIMITS.low, self.f_max / 10), LIMITS.high * self.f_max)
        if not 0 < low < high:
            remedy = "give <frequencies> as LO:HI with LO below HI"
            raise InputError(f"{low:g} to {high:g} Hz is no band", remedy, key="frequencies")
        if low >= self.f_max:
            problem = f"the array interpolates up to {self.f_max:.0f} Hz, and the band begins at {low:g} Hz"
            remedy = "use a lower band (<frequencies>), a smaller array or more microphones" + self._width
            raise InputError(problem, remedy, key="frequencies", value=self.band)
        return low, min(high, self.f_max)

    @property
    def _width(self) -> str:
        """What a remedy adds for an array so wide that its positions may be in another unit than metres."""
        width = float(np.ptp(self.layout.positions, axis=0).max())
        wide = f"; the array is {width:.3g} m wide: give its positions in metres, not in centimetres or millimetres"
        return wide if width > LIMITS.wide else ""

    @property
    def frequencies(self) -> np.ndarray:
        """The independent frequencies in use : (M,) float64, Hz."""
        return self._all_frequencies[: self.modes]

    @property
    def most_modes(self) -> int:
        """Number of independent frequencies in the band."""
        return len(self._all_frequencies)

    @property
    def _all_frequencies(self) -> np.ndarray:
        return independent_frequencies(*self.limits, self.reverberation_time, self.sound_speed, self.room)

    @property
    def noise_share(self) -> float:
        """Power of the noise in that of the pressures."""
        noise = 10 ** (-self.snr_db / 10)
        return noise / (1 + noise)

    @property
    def prior(self) -> Prior:
        """What is given beside the pressures."""
        return Prior(np.array(self.known, int), self.known_sigma, self.gain_sigma_db * np.log(10) / 20)

    def spaced(self, most: int) -> np.ndarray:
        """Return at most so many of the frequencies, evenly taken : float64, Hz."""
        f = self.frequencies
        return f[np.unique(np.linspace(0, len(f) - 1, min(len(f), most)).round().astype(int))]
