"""Faults of a case. Each function gets the recording, a size and a generator, and returns the changed recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .constants import SOUND_SPEED


@dataclass(frozen=True)
class Recording:
    """Input of the solver in a case, before noise.

    Attributes
    ----------
    frequencies : (M,) float64, Hz
    pressures : (M, N) complex128
    power : (M,) float64, mean power without faults
    known : (A,) int64
    given : (A, D) float64, metres, the positions given for them
    wavenumbers : (M,) complex128, rad/m, as reported
    sound_speed : m/s, as reported
    reports_wavenumbers : whether they are in the file where they are complex
    noise_factor : factor of the reported noise power; None reports it as the spec says
    named : microphones that the fault concerns
    """

    frequencies: np.ndarray
    pressures: np.ndarray
    power: np.ndarray
    known: np.ndarray
    given: np.ndarray
    wavenumbers: np.ndarray
    sound_speed: float = SOUND_SPEED
    reports_wavenumbers: bool = True
    noise_factor: float | None = None
    named: tuple[int, ...] = ()

    @property
    def free(self) -> np.ndarray:
        """Return the microphones whose positions are not given."""
        return np.setdiff1d(np.arange(self.pressures.shape[1]), self.known)

    def with_channel(self, n: int, factor) -> Recording:
        """The recording with channel `n` multiplied by `factor`, a number or (M,)."""
        pressures = self.pressures.copy()
        pressures[:, n] *= factor
        return replace(self, pressures=pressures, named=(n,))


def known_error(recording: Recording, size: float, rng) -> Recording:
    """One given position is wrong by `size` metres."""
    given, i = recording.given.copy(), int(rng.integers(len(recording.known)))
    direction = rng.standard_normal(given.shape[1])
    given[i] += size * direction / np.linalg.norm(direction)
    return replace(recording, given=given, named=(int(recording.known[i]),))


def known_error_all(recording: Recording, size: float, rng) -> Recording:
    """Every given position is wrong by `size` metres."""
    direction = rng.standard_normal(recording.given.shape)
    given = recording.given + size * direction / np.linalg.norm(direction, axis=1)[:, None]
    return replace(recording, given=given, named=tuple(recording.known.tolist()))


def known_swap(recording: Recording, size: float, rng) -> Recording:
    """Two given positions are swapped."""
    i, j = rng.permutation(len(recording.known))[:2]
    given = recording.given.copy()
    given[[i, j]] = given[[j, i]]
    return replace(recording, given=given, named=(int(recording.known[i]), int(recording.known[j])))


def channel_swap(recording: Recording, size: float, rng) -> Recording:
    """The channel of a given microphone is swapped with another."""
    i, j = int(rng.choice(recording.known)), int(rng.choice(recording.free))
    pressures = recording.pressures.copy()
    pressures[:, [i, j]] = pressures[:, [j, i]]
    return replace(recording, pressures=pressures, named=(i, j))


def polarity(recording: Recording, size: float, rng) -> Recording:
    """One channel is inverted: that of a microphone that is sought or, if `size` is not 0, of a given one."""
    return recording.with_channel(int(rng.choice(recording.free if size == 0 else recording.known)), -1.0)


def gain(recording: Recording, size: float, rng) -> Recording:
    """Gains scatter with a standard deviation of `size` dB."""
    factor = 10 ** (size * rng.standard_normal(recording.pressures.shape[1]) / 20)
    return replace(recording, pressures=recording.pressures * factor)


def gain_one(recording: Recording, size: float, rng) -> Recording:
    """One channel is louder by `size` dB."""
    return recording.with_channel(int(rng.choice(recording.free)), 10 ** (size / 20))


def phase(recording: Recording, size: float, rng) -> Recording:
    """Phases scatter with a standard deviation of `size` degrees."""
    factor = np.exp(1j * np.deg2rad(size) * rng.standard_normal(recording.pressures.shape[1]))
    return replace(recording, pressures=recording.pressures * factor)


def delay(recording: Recording, size: float, rng) -> Recording:
    """One channel is late by `size` seconds."""
    n = int(rng.choice(recording.free))
    return recording.with_channel(n, np.exp(-2j * np.pi * recording.frequencies * size))


def dead(recording: Recording, size: float, rng) -> Recording:
    """One channel is noise, of `size` times the amplitude of the others."""
    n, count = int(rng.choice(recording.free)), len(recording.frequencies)
    noise = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    pressures = recording.pressures.copy()
    pressures[:, n] = size * np.sqrt(recording.power / 2) * noise
    return replace(recording, pressures=pressures, named=(n,))


def hum(recording: Recording, size: float, rng) -> Recording:
    """All channels share a disturbance of `size` dB."""
    turn = np.exp(2j * np.pi * rng.random(len(recording.frequencies)))
    common = np.sqrt(recording.power) * 10 ** (size / 20) * turn
    return replace(recording, pressures=recording.pressures + common[:, None])


def sound_speed(recording: Recording, size: float, rng) -> Recording:
    """The reported sound speed is wrong by the fraction `size`."""
    factor = 1 + size
    return replace(
        recording,
        sound_speed=SOUND_SPEED * factor,
        wavenumbers=recording.wavenumbers * SOUND_SPEED / (SOUND_SPEED * factor),
    )


def drift(recording: Recording, size: float, rng) -> Recording:
    """The sound speed changes by the fraction `size` in the middle of the frequencies."""
    wavenumbers = recording.wavenumbers.copy()
    wavenumbers[len(wavenumbers) // 2 :] *= 1 + size
    return replace(recording, wavenumbers=wavenumbers)


def without_wavenumbers(recording: Recording, size: float, rng) -> Recording:
    """The decay is not reported."""
    return replace(recording, reports_wavenumbers=False)


def wrong_noise(recording: Recording, size: float, rng) -> Recording:
    """The reported noise is wrong by `size` dB."""
    return replace(recording, noise_factor=10 ** (size / 10))


FAULTS: dict[str, Callable[[Recording, float, np.random.Generator], Recording]] = {
    "known_error": known_error,
    "known_error_all": known_error_all,
    "known_swap": known_swap,
    "channel_swap": channel_swap,
    "polarity": polarity,
    "gain": gain,
    "gain_one": gain_one,
    "phase": phase,
    "delay": delay,
    "dead": dead,
    "hum": hum,
    "sound_speed": sound_speed,
    "drift": drift,
    "no_wavenumbers": without_wavenumbers,
    "wrong_noise": wrong_noise,
}
