"""Impulse responses from a recording and the signal that the source was given.

X / S, with what S hardly holds held down, is the response's transform, but for a factor at each frequency that is the
same for all channels and does no harm. Its start is set `LEAD` seconds late, so that the ringing of the cut-off band,
which comes before the sound as well as after it, lies inside.

Noise of the recording is spread by 1 / S over as long a time as was recorded, at each frequency another time where S is
a sweep. So what lies outside of the response tells how much of it lies inside; its end alone would not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from ..model.validation import InputError
from .impulse_response import smoothed
from .recording import Recording, channel_groups, read_samples, recording_of

LEAD, LENGTH = 0.25, 2.25  # s: before the sound, and in all
MOST_SAMPLES = 16_000_000  # of one channel: what is longer is cut, 5 min at 48 kHz
WEAK = 1e-3  # of the reference's greatest power: what is weaker is held down
EDGE = 1.5  # the band in use and a little more: the factor by which it is widened,
FALL = 50.0  # but no more than so many Hz at its upper end, where a sweep may be over
OUTSIDE = 0.25  # of the recording, that must lie outside of the response to tell the noise
SMOOTH = 31  # neighbouring frequencies of which the noise is the mean


def deconvolve(
    recording: Recording, reference: Recording, band: tuple[float, float]
) -> tuple[Recording, Callable[[np.ndarray], np.ndarray] | None]:
    """The responses of all channels to the one channel of `reference`, kept in memory, and the noise in them.

    The noise is a function of frequencies (B,), Hz: the power of one sample of the transform (B,); None where the
    recording is too short to tell it.

    Raises InputError where the sampling rates differ, the reference has several channels or is silent in the band.
    """
    if reference.sample_rate != recording.sample_rate:
        raise InputError(
            f"{reference.path} has {reference.sample_rate:g} Hz and {recording.path} {recording.sample_rate:g} Hz;"
            " convert one of them to the other's sampling rate"
        )
    if reference.count != 1:
        raise InputError(f"{reference.path} has {reference.count} channels; the reference signal must be one")
    fs, samples = recording.sample_rate, min(recording.samples, MOST_SAMPLES)
    heard = min(reference.samples, samples)
    padded = next_fast_len(samples + heard, real=True)
    inverse = _inverse(
        rfft(read_samples(reference, 0, heard)[0], padded), np.arange(padded // 2 + 1) * fs / padded, band
    )
    if inverse is None:
        raise InputError(f"{reference.path} is silent between {band[0]:g} and {band[1]:g} Hz; name another band")
    lead = int(LEAD * fs)
    length = min(int(LENGTH * fs), padded)
    responses, outside = np.empty((recording.count, length)), np.zeros(padded // 2 + 1)
    for channels, values in channel_groups(recording):
        for n, row in zip(channels, values, strict=True):
            whole = np.roll(irfft(rfft(row[:samples], padded) * inverse, padded), lead)
            responses[n] = whole[:length]
            outside += np.abs(rfft(whole[length:], padded)) ** 2
    made = recording_of(recording.path, "response", fs, responses, names=recording.names)
    made = replace(made, positions=recording.positions, sound_speed=recording.sound_speed)
    if samples - length < OUTSIDE * samples:
        return made, None
    density = outside / recording.count / (samples - length)
    return made, smoothed(np.arange(len(outside)) * fs / padded, density, SMOOTH)


def _inverse(S: np.ndarray, f: np.ndarray, band: tuple[float, float]) -> np.ndarray | None:
    """conj(S) / |S|^2 within the band, falling smoothly to zero outside; None without sound in the band."""
    low, high = band[0] / EDGE, min(band[1] * EDGE, band[1] + FALL)
    rise, fall = np.clip((f - low) / (band[0] - low), 0, 1), np.clip((high - f) / (high - band[1]), 0, 1)
    taper = np.sin(np.pi / 2 * np.minimum(rise, fall)) ** 2
    power = np.abs(S) ** 2
    inside = taper > 0
    if not np.any(inside) or not power[inside].max() > 1e-20 * max(power.max(), 1e-300):
        return None
    inverse = np.zeros_like(S)
    inverse[inside] = taper[inside] * S[inside].conj() / (power[inside] + WEAK * power[inside].max())
    return inverse
