"""What an import has read and taken, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.measurement import Measurement
from ..model.problem import mode_power
from ..model.validation import word_arguments
from ..solvers.requirements import min_microphones
from .frequencies import Pressures
from .recording import Recording

LOWEST = 3  # frequencies of the lowest signal-to-noise ratio that are named
MANY = 32  # microphones with which errors in a room are of the order of their uncertainty
CLEAN_DB = 100.0  # above it the estimate of the noise is at its floor
ARGUMENTS: Mapping[str, str] = {}  # by their own names
KIND_WORDS = {"impulse": "impulse response: from silence to the end of the sound", "stationary": "stationary source"}


@dataclass(frozen=True)
class ImportReport:
    """What an import has read and taken."""

    recording: Recording  # the channels that were used
    kind: str  # one of `fdcal.recordings.recording.KINDS`
    left_out: dict[str, str]  # name of each channel left out, and why
    pressures: Pressures
    speed: float  # sound speed, m/s
    speed_from: str  # where it is from, in words
    highest_frequency: float | None  # that the array can interpolate, Hz
    highest_frequency_from: str  # which radius it follows from, in words
    height: float | None = None  # of all given positions, metres, where the array is sought in this plane
    # one each of several takes, the first of which the other fields describe; none of a single take
    takes: tuple[ImportReport, ...] = ()
    skipped: tuple[str, ...] = ()  # parts of a recording in which no sound rises above the noise


def import_summary(measurement: Measurement, report: ImportReport, wording: Mapping[str, str] = ARGUMENTS) -> str:
    """Return what was imported in words, one fact per line; `wording`: how it calls the arguments that it mentions."""
    recording, taken = report.recording, report.pressures
    limit = word_arguments(report.highest_frequency_from, wording)
    if report.highest_frequency is not None:
        limit = f"{report.highest_frequency:.0f} Hz, {limit}"
    left_out = ", ".join(f"{name} ({reason})" for name, reason in report.left_out.items()) or "none"
    left_out = f"left out     {left_out}; none of the others is silent, clipped or a copy"
    if report.takes:
        lines = _take_lines(report.takes, measurement, left_out)
    else:
        lines = [
            f"channels     {recording.count}, {_duration(recording)} ({KIND_WORDS[report.kind]})",
            left_out,
            f"taken by     {taken.how}",
            f"frequencies  {_band(taken)}",
        ]
    lines += [f"skipped      {', '.join(report.skipped)}: no sound above the noise"] if report.skipped else []
    lines += [
        f"sound speed  {report.speed:.1f} m/s {report.speed_from}",
        f"known        {len(measurement.known)} of {measurement.count} microphones",
    ]
    height = report.takes[0].height if report.takes else report.height
    if height is not None:
        space = word_arguments("<array_dimension> 3", wording)
        lines += [f"array        in the plane z = {height:g} m, the height of all given positions; in space: {space}"]
    given = measurement.known_positions
    if height is None and given is not None and len(given) and given.shape[1] == 3 and not np.ptp(given[:, 2]):
        plane = word_arguments("<array_dimension> 2", wording)
        lines += [
            f"array        in space; if all microphones stand at z = {given[0, 2]:g} m as the known ones: {plane}"
        ]
    if measurement.arrivals is not None and measurement.arrival_sigma is not None:
        found, sigma = np.isfinite(measurement.arrivals), np.median(measurement.arrival_sigma)
        scatter = f"{1e3 * measurement.sound_speed * sigma:.1f} mm"
        lines += [f"arrivals     direct sound at {np.sum(found)} of {found.size} microphones, to about {scatter}"]
    if not report.takes:
        lines += [f"modelled     {recording.modelled}"] if recording.modelled else _snr_lines(taken)
    lines.append(f"highest usable frequency  {limit}")
    count, needed = measurement.count, min_microphones(measurement.dimension)
    if count < needed:
        lines.append(f"warning: {count} microphones are too few to be found: use {needed} or more, {MANY} in a room")
    return "\n".join(lines)


def _take_lines(takes: Sequence[ImportReport], measurement: Measurement, left_out: str) -> list[str]:
    """Return a line for each take: its rows, where they are from, and their signal-to-noise ratio."""
    counts = [len(one.pressures.frequencies) for one in takes]
    even = f"{counts[0]}" if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
    f = measurement.frequencies
    lines = [
        f"takes        {len(takes)} of {measurement.count} channels",
        f"rows         {even} per take, {len(f)} in all, {f[0]:.1f} to {f[-1]:.1f} Hz",
        left_out,
    ]
    for number, one in enumerate(takes):
        snr = _snr(one.pressures)
        level = "modelled" if one.recording.modelled else "SNR unknown" if snr is None else f"SNR {_median(snr)}"
        kind = KIND_WORDS[one.kind].partition(":")[0]
        lines.append(f"{f'take {number}':<12} {one.recording.path}: {_duration(one.recording)} ({kind})")
        lines.append(f"             {one.pressures.how}; {_band(one.pressures)}; {level}")
    return lines


def _duration(recording: Recording) -> str:
    return f"{recording.duration:.3g} s at {recording.sample_rate:g} Hz"


def _band(taken: Pressures) -> str:
    """Return the frequencies, how far apart they are, and how many have several rows."""
    f = taken.frequencies
    different = np.unique(f, return_counts=True)[1]
    text = f"{len(different)}, {f[0]:.1f} to {f[-1]:.1f} Hz, at least {taken.spacing.step:.2g} Hz apart"
    if taken.spacing.decorrelation > 1.5 * taken.spacing.step:
        text += f" (independent: {taken.spacing.decorrelation:.2g} Hz)"
    several = int(np.sum(different > 1))
    if several:
        text += f"; {len(f)} rows, since {several} have up to {different.max()} eigenvalues above noise and leakage"
    return text


def _snr(taken: Pressures) -> np.ndarray | None:
    """Return the signal-to-noise ratio of each row, decibels; None where the noise is unknown."""
    if taken.noise_power is None:
        return None
    power = mode_power(taken.pressures)
    return 10 * np.log10(np.maximum(power / np.maximum(taken.noise_power, 1e-12 * power) - 1, 1e-3))


def _median(snr: np.ndarray) -> str:
    return f"above {CLEAN_DB:g} dB" if snr.min() > CLEAN_DB else f"median {np.median(snr):.0f} dB"


def _snr_lines(taken: Pressures) -> list[str]:
    """Return the signal-to-noise ratio of the frequencies, decibels, and where it is lowest."""
    snr = _snr(taken)
    if snr is None:
        return ["SNR          unknown: the room still rings at the end; a longer recording would show the noise"]
    if snr.min() > CLEAN_DB:
        return [f"SNR          above {CLEAN_DB:g} dB at all frequencies: no noise was found"]
    low = np.sort(np.argsort(snr, kind="stable")[:LOWEST])
    cells = ", ".join(f"{snr[n]:.0f} dB at {taken.frequencies[n]:.1f} Hz" for n in low)
    return [f"SNR          {_median(snr)}, {snr.min():.0f} to {snr.max():.0f} dB; lowest {cells}"]
