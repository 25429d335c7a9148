"""How pressures are derived from recordings. Frequencies are hertz."""

from __future__ import annotations

import math
import typing
from dataclasses import dataclass

from .validation import LIMITS, InputError, require_choice, require_positive


@dataclass(frozen=True)
class Sensing:
    """How pressures are derived from recordings."""

    # signal-to-noise ratio of each mode, dB; inf for no noise. The noise is added to the complex pressures
    snr_db: float = math.inf
    # lowest, highest: band in which modes are picked, Hz
    lowest: float = 20.0
    highest: float = 400.0
    # height of a spectral peak above its surroundings, dB; 0 takes every frequency of the band, `resolution` apart
    prominence_db: float = 1.0
    resolution: float = 1.0  # smallest distance of two modes, Hz
    wavenumber: str = "discrete"  # "discrete", of a wave on the grid of the simulation, or "continuous"
    sound_speed_error: float = 0.0  # relative error of the sound speed given to the solvers, positive if it is too high

    OPTIONAL: typing.ClassVar = ("sound_speed_error",)

    def __post_init__(self):
        if not (abs(self.snr_db) <= LIMITS.decibels or self.snr_db == math.inf):
            raise InputError(
                f"measurement.snr_db = {self.snr_db:g} is out of range",
                f"give a number of decibels from -{LIMITS.decibels:g} to {LIMITS.decibels:g}, or inf for no noise",
                key="measurement.snr_db",
                value=self.snr_db,
            )
        for key in ("lowest", "highest", "resolution"):
            require_positive(f"measurement.{key}", getattr(self, key), "Hz")
        if self.prominence_db != 0:
            require_positive("measurement.prominence_db", self.prominence_db, "dB")
        if not self.lowest < self.highest:
            raise InputError(
                f"measurement.lowest = {self.lowest:g} Hz must lie below measurement.highest = {self.highest:g} Hz",
                "lower the one or raise the other",
                key="measurement.lowest",
                value=self.lowest,
            )
        most = LIMITS.sound_speed_error
        if not abs(self.sound_speed_error) <= most:
            raise InputError(
                f"measurement.sound_speed_error = {self.sound_speed_error:g} is a fraction out of range",
                f"use -{most:g} to {most:g}, for example 0.01 for 1 %",
                key="measurement.sound_speed_error",
                value=self.sound_speed_error,
            )
        require_choice("measurement.wavenumber", self.wavenumber, ("discrete", "continuous"))
