"""From a file of somebody's to a measurement: what `fdcal import` does, without a command line.

import_recording     path and options (`fdcal.recordings.import_options`) to a measurement and a report
(`fdcal.recordings.import_report`)
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.measurement import Measurement
from ..model.validation import InputError
from . import channel_selection, formats
from .channel_health import inspect_channels, require_usable_channels
from .cross_spectra import stationary_pressures
from .import_options import ImportOptions, check, coordinate_count, frequency_band, sound_speed_of, usable_limit
from .import_report import ImportReport
from .impulse_response import Pressures, impulse_response_pressures
from .recording import Recording

COMPLETE_DB = 20.0  # by which a complete recording falls towards its end
DEFAULTS = ImportOptions()


def import_recording(path: str | Path, options: ImportOptions = DEFAULTS) -> tuple[Measurement, ImportReport]:
    """The measurement in a file or folder. Raises InputError and StorageError."""
    check(options)
    recording = formats.read(path, options.source)
    recording, left_out = _chosen(recording, options)
    if recording.count < 2:
        raise InputError(f"{path} gives one channel; an array needs two microphones at least")
    recording = _flattened(recording, options)
    numbers, places = (
        (np.zeros(0, int), None)
        if options.known is None
        else channel_selection.known_microphones(recording, options.known)
    )
    speed, speed_from = sound_speed_of(recording, options)
    usable, usable_from = usable_limit(recording, options, places, speed)
    band = frequency_band(recording, options, usable, usable_from)
    recording, kind, noise = _complete(recording, options, band)
    pressures = _pressures(recording, kind, options, band, speed, noise)
    measurement = _measurement(recording, options, numbers, places, pressures, speed)
    return measurement, ImportReport(recording, kind, left_out, pressures, speed, speed_from, usable, usable_from)


def _chosen(recording: Recording, options: ImportOptions) -> tuple[Recording, dict[str, str]]:
    """The channels that the user wants, each found sound, and why each of those left out is."""
    if options.plane is not None:
        recording = channel_selection.select_plane(recording, options.plane)
    if options.subset is not None:
        recording = channel_selection.select_subset(recording, options.subset, options.seed)
    listed = [name for name in (options.leave_out or "").split(",") if name.strip() not in ("", "bad")]
    left_out = dict.fromkeys((name.strip() for name in listed), "as asked")
    if listed:  # before they are looked at: they may hold what cannot be read
        recording = channel_selection.exclude_channels(recording, ",".join(listed), np.zeros(0, int))
    health = inspect_channels(recording)
    if "bad" in [part.strip() for part in (options.leave_out or "").split(",")]:
        left_out |= {recording.names[n]: health.fault(n, recording.names) for n in health.bad}
        recording = channel_selection.exclude_channels(recording, "bad", health.bad)
    else:
        require_usable_channels(recording, health)
    return recording, left_out


def _flattened(recording: Recording, options: ImportOptions) -> Recording:
    """Without heights where the field has none. Raises InputError where they differ."""
    positions = recording.positions
    if positions is None or positions.shape[1] <= options.dimension:
        return recording
    if np.ptp(positions[:, 2]) > channel_selection.LEVEL:
        raise InputError("--dimension 2 needs microphones of one height; choose them: --plane z=HEIGHT")
    return replace(recording, positions=positions[:, :2])


def _complete(recording: Recording, options: ImportOptions, band):
    """The recording, deconvolve where a reference is given, its kind, and the noise if that is known already."""
    if options.reference is not None:
        from .deconvolution import deconvolve

        responses, noise = deconvolve(recording, formats.read(options.reference), band)
        return responses, "response", noise
    kind = "work" if options.against is not None else options.kind if options.kind != "auto" else recording.kind
    return recording, kind or ("response" if _falls(recording, band) else "work"), None


def _falls(recording: Recording, band) -> bool:
    """Whether the sound is gone, or nearly, at the end: then the recording is complete."""
    from .impulse_response import LONGEST
    from .reverberation import segment_levels

    if recording.samples > LONGEST:
        return False
    level = segment_levels(recording, band)
    return bool(level[-2:].mean() <= level.max() * 10 ** (-COMPLETE_DB / 10))


def _pressures(recording: Recording, kind: str, options: ImportOptions, band, speed: float, noise) -> Pressures:
    if kind == "work":
        if options.window != "auto":
            raise InputError(f"--window {options.window} is for --kind response; a source at work needs none")
        if options.against is not None and options.against not in recording.names:
            raise InputError(f'--reference-microphone "{options.against}" is no channel; use a name or number of one')
        reference = None if options.against is None else recording.names.index(options.against)
        return stationary_pressures(recording, band, speed, options.most, reference)
    rate = {"auto": None, "none": 0.0}.get(options.window, options.window)
    try:
        rate = None if rate is None else float(rate)
    except ValueError:
        rate = -1.0
    if rate is not None and not 0 <= rate * recording.duration <= 50:
        raise InputError(
            f'--window "{options.window}" must be auto, none or a rate up to {50 / recording.duration:.3g} per second'
        )
    return impulse_response_pressures(recording, band, speed, rate, options.most, noise)


def _measurement(
    recording: Recording, options: ImportOptions, numbers, places, taken: Pressures, speed: float
) -> Measurement:
    axes = coordinate_count(recording, options, places)
    if places is not None and places.shape[1] != axes:
        raise InputError(f"--known {options.known} gives {places.shape[1]} coordinates where the file has {axes}")
    return Measurement(
        frequencies=taken.frequencies,
        pressures=taken.pressures,
        sound_speed=speed,
        dimension=options.dimension,
        array_dimension=min(axes, options.dimension),
        wavenumbers=taken.wavenumbers,
        noise_power=taken.noise_power,
        names=recording.names,
        positions=recording.positions,
        known=numbers,
        known_positions=places,
    )
