"""Impulse responses from a recording and the signal that the source emitted.

X / S, regularised where S is weak, is the transform of the response, apart from a factor at each frequency that is the
same for all channels and does no harm. The response starts `lead` seconds late, so that the ringing of the band-limited
spectrum, which comes before the sound as well as after it, lies inside.

1 / S spreads the noise of the recording over as long a time as was recorded, at each frequency another time where S is
a sweep. So the noise inside the response is estimated from what lies outside of it, and not from its end alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..acoustics.spectrum import fast_length, irfft, rfft
from ..model.validation import InputError
from .impulse_response import smoothed
from .recording import Recording, channel_groups, read_samples, recording_of


@dataclass(frozen=True)
class DeconvolutionSettings:
    """How a recording is divided by the signal of its source."""

    # lead, length: of a response: before the sound, and in all, seconds
    lead: float = 0.25
    length: float = 2.25
    max_samples: int = 16_000_000  # of one channel; what is longer is cut: 5 min at 48 kHz
    regularisation: float = 1e-3  # relative to the greatest power of the reference
    # widening, max_widening: factor by which the band is widened, but by no more than so many Hz at its upper end,
    # where a sweep may end
    widening: float = 1.5
    max_widening: float = 50.0
    min_outside: float = 0.25  # share of the recording that must lie outside of the response to estimate the noise
    smoothing: int = 31  # neighbouring frequencies over which the noise is averaged


SETTINGS = DeconvolutionSettings()


def deconvolve(
    recording: Recording, reference: Recording, band: tuple[float, float]
) -> tuple[Recording, Callable[[np.ndarray], np.ndarray] | None]:
    """Return the impulse responses of all channels, kept in memory, and the noise in them.

    `reference`: one channel with the signal that the source emitted; `band`: Hz. Returns the noise power of one sample
    of the transform; None where the recording is too short to estimate it. Raises InputError: the sampling rates
    differ, or the reference has several channels or is silent in the band.
    """
    if reference.sample_rate != recording.sample_rate:
        raise InputError(
            f"{reference.path} has {reference.sample_rate:g} Hz and {recording.path} {recording.sample_rate:g} Hz",
            "convert one of them to the sampling rate of the other",
            key="reference",
        )
    if reference.count != 1:
        raise InputError(
            f"{reference.path} has {reference.count} channels",
            "give a reference signal of one channel",
            key="reference",
        )
    fs, samples = recording.sample_rate, min(recording.samples, SETTINGS.max_samples)
    emitted = min(reference.samples, samples)
    padded = fast_length(samples + emitted)
    inverse = _inverse(
        rfft(read_samples(reference, 0, emitted)[0], padded), np.arange(padded // 2 + 1) * fs / padded, band
    )
    if inverse is None:
        raise InputError(
            f"{reference.path} is silent between {band[0]:g} and {band[1]:g} Hz",
            "choose another band: <frequencies>",
            key="frequencies",
        )
    lead = int(SETTINGS.lead * fs)
    length = min(int(SETTINGS.length * fs), padded)
    responses, outside = np.empty((recording.count, length)), np.zeros(padded // 2 + 1)
    for channels, values in channel_groups(recording):
        for n, row in zip(channels, values, strict=True):
            whole = np.roll(irfft(rfft(row[:samples], padded) * inverse, padded), lead)
            responses[n] = whole[:length]
            outside += np.abs(rfft(whole[length:], padded)) ** 2
    made = recording_of(recording.path, "impulse", fs, responses, names=recording.names)
    made = replace(made, positions=recording.positions, sound_speed=recording.sound_speed)
    if samples - length < SETTINGS.min_outside * samples:
        return made, None
    density = outside / recording.count / (samples - length)
    return made, smoothed(np.arange(len(outside)) * fs / padded, density, SETTINGS.smoothing)


def _inverse(S: np.ndarray, f: np.ndarray, band: tuple[float, float]) -> np.ndarray | None:
    """Return conj(S) / |S|^2 within the band, falling smoothly to zero outside; None if S is silent in the band."""
    low, high = band[0] / SETTINGS.widening, min(band[1] * SETTINGS.widening, band[1] + SETTINGS.max_widening)
    rise, fall = np.clip((f - low) / (band[0] - low), 0, 1), np.clip((high - f) / (high - band[1]), 0, 1)
    taper = np.sin(np.pi / 2 * np.minimum(rise, fall)) ** 2
    power = np.abs(S) ** 2
    inside = taper > 0
    if not np.any(inside) or not power[inside].max() > 1e-20 * max(power.max(), 1e-300):
        return None
    inverse = np.zeros_like(S)
    inverse[inside] = taper[inside] * S[inside].conj() / (power[inside] + SETTINGS.regularisation * power[inside].max())
    return inverse
