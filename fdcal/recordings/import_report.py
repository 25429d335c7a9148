"""What `fdcal import` has read and taken, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.measurement import Measurement
from ..model.power import mode_power
from .impulse_response import Pressures
from .recording import Recording


@dataclass(frozen=True)
class ImportReport:
    """What was read and taken: `recording`, `kind`, `left_out` names and why, `pressures`, `speed` m/s and its origin,
    `usable` Hz or None and the radius it is from, in words."""

    recording: Recording
    kind: str
    left_out: dict[str, str]
    pressures: Pressures
    speed: float
    speed_from: str
    usable: float | None
    usable_from: str


def import_summary(measurement: Measurement, told: ImportReport) -> str:
    """What was imported, in words, one fact a line."""
    recording, taken = told.recording, told.pressures
    f = taken.frequencies
    kind = {"response": "complete: from silence to the end of the sound", "work": "a source at work"}[told.kind]
    usable = told.usable_from if told.usable is None else f"{told.usable:.0f} Hz, {told.usable_from}"
    lines = [
        f"channels     {recording.count}, {recording.duration:.3g} s at {recording.sample_rate:g} Hz ({kind})",
        f"left out     {_left_out(told.left_out)}; none of the others is silent, clipped or a copy",
        f"taken by     {taken.how}",
        f"frequencies  {len(f)}, {f[0]:.1f} to {f[-1]:.1f} Hz",
        f"highest usable frequency  {usable}",
        f"sound speed  {told.speed:.1f} m/s {told.speed_from}",
        f"known        {len(measurement.known)} of {measurement.count} microphones",
    ]
    return "\n".join(lines + _snr_lines(taken))


def _left_out(why: dict[str, str]) -> str:
    """Every channel left out, and why."""
    return ", ".join(f"{name} ({reason})" for name, reason in why.items()) or "none"


def _snr_lines(taken: Pressures) -> list[str]:
    """Signal-to-noise ratio of every frequency, dB, eight to a line."""
    if taken.noise_power is None:
        return ["SNR          not told: the room still rings at the end; record longer to know it"]
    power = mode_power(taken.pressures)
    snr = 10 * np.log10(np.maximum(power / np.maximum(taken.noise_power, 1e-12 * power) - 1, 1e-3))
    cells = [f"{f:7.1f} Hz {s:3.0f} dB" for f, s in zip(taken.frequencies, snr, strict=True)]
    rows = ["  ".join(cells[start : start + 6]) for start in range(0, len(cells), 6)]
    return [f"SNR          {np.median(snr):.0f} dB in the middle, {snr.min():.0f} to {snr.max():.0f} dB", *rows]
