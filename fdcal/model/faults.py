"""Faults of a scene's channels: what a measurement suffers from beside noise."""

from __future__ import annotations

import typing
from dataclasses import dataclass

import numpy as np

from .validation import InputError

DEAD_SHARE = 1e-6  # power of a dead channel, which is noise of its own, over that of the others


@dataclass(frozen=True)
class Faults:
    """Channels that are faulty, and how far the others scatter."""

    inverted: tuple[int, ...] = ()  # microphones of inverted polarity
    dead: tuple[int, ...] = ()  # microphones without signal, which give noise of their own, 60 dB below the others
    # gain_db, phase_deg: standard deviation of the gains, decibels, and phases, degrees, of all channels, drawn by the
    # scene's seed
    gain_db: float = 0.0
    phase_deg: float = 0.0

    OPTIONAL: typing.ClassVar = ("inverted", "dead", "gain_db", "phase_deg")

    def __post_init__(self):
        for key, most in (("gain_db", 40.0), ("phase_deg", 180.0)):
            value = getattr(self, key)
            if not 0 <= value <= most:
                problem = f"faults.{key} = {value:g} is out of range"
                raise InputError(problem, f"use 0 to {most:g}", key=f"faults.{key}", value=value)
        both = sorted(set(self.inverted) & set(self.dead))
        if both:
            problem = f"faults.inverted and faults.dead both name microphone {both[0]}"
            raise InputError(problem, "name it once", key="faults.dead", value=both[0])

    def require_channels(self, count: int) -> None:
        """Raise InputError for a microphone that an array of `count` lacks."""
        for key in ("inverted", "dead"):
            for n in getattr(self, key):
                if not 0 <= n < count:
                    problem = f"faults.{key} names microphone {n}"
                    raise InputError(problem, f"the array has 0 to {count - 1}", key=f"faults.{key}", value=n)

    def gains(self, count: int, seed: int) -> np.ndarray:
        """Return the gain of every channel, 0 of a dead one : (N,) complex128.

        Raises InputError for a microphone that the array lacks.
        """
        self.require_channels(count)
        draws = np.random.default_rng([seed, 2]).normal(size=(2, count))
        gains = 10 ** (self.gain_db * draws[0] / 20) * np.exp(1j * np.radians(self.phase_deg * draws[1]))
        gains[list(self.inverted)] *= -1
        gains[list(self.dead)] = 0
        return gains
