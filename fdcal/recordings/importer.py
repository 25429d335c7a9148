"""From a file of somebody's to a measurement: what `fdcal import` does, without a command line.

intake     path and wishes (`fdcal.recordings.import_options`) to a measurement and a report
(`fdcal.recordings.import_report`)
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..model.measurement import Measurement
from ..model.validation import InputError
from . import channel_selection, formats
from .channel_health import inspect, require_usable
from .cross_spectra import from_work
from .import_options import Wishes, axes_of, band_of, check, speed_of, usable_by
from .import_report import Report
from .impulse_response import Pressures, from_response
from .recording import Recording

COMPLETE_DB = 20.0  # by which a complete recording falls towards its end
AS_IT_IS = Wishes()


def intake(path: str | Path, wishes: Wishes = AS_IT_IS) -> tuple[Measurement, Report]:
    """The measurement in a file or folder. Raises InputError and StorageError."""
    check(wishes)
    recording = formats.read(path, wishes.source)
    recording, left_out = _chosen(recording, wishes)
    if recording.count < 2:
        raise InputError(f"{path} gives one channel; an array needs two microphones at least")
    recording = _flattened(recording, wishes)
    numbers, places = (
        (np.zeros(0, int), None) if wishes.known is None else channel_selection.known(recording, wishes.known)
    )
    speed, speed_from = speed_of(recording, wishes)
    usable, usable_from = usable_by(recording, wishes, places, speed)
    band = band_of(recording, wishes, usable, usable_from)
    recording, kind, noise = _complete(recording, wishes, band)
    pressures = _pressures(recording, kind, wishes, band, speed, noise)
    measurement = _measurement(recording, wishes, numbers, places, pressures, speed)
    return measurement, Report(recording, kind, left_out, pressures, speed, speed_from, usable, usable_from)


def _chosen(recording: Recording, wishes: Wishes) -> tuple[Recording, dict[str, str]]:
    """The channels that the user wants, each found sound, and why each of those left out is."""
    if wishes.plane is not None:
        recording = channel_selection.on_plane(recording, wishes.plane)
    if wishes.subset is not None:
        recording = channel_selection.subset(recording, wishes.subset, wishes.seed)
    listed = [name for name in (wishes.leave_out or "").split(",") if name.strip() not in ("", "bad")]
    left_out = dict.fromkeys((name.strip() for name in listed), "as asked")
    if listed:  # before they are looked at: they may hold what cannot be read
        recording = channel_selection.without(recording, ",".join(listed), np.zeros(0, int))
    health = inspect(recording)
    if "bad" in [part.strip() for part in (wishes.leave_out or "").split(",")]:
        left_out |= {recording.names[n]: health.fault(n, recording.names) for n in health.bad}
        recording = channel_selection.without(recording, "bad", health.bad)
    else:
        require_usable(recording, health)
    return recording, left_out


def _flattened(recording: Recording, wishes: Wishes) -> Recording:
    """Without heights where the field has none. Raises InputError where they differ."""
    positions = recording.positions
    if positions is None or positions.shape[1] <= wishes.dimension:
        return recording
    if np.ptp(positions[:, 2]) > channel_selection.LEVEL:
        raise InputError("--dimension 2 needs microphones of one height; choose them: --plane z=HEIGHT")
    return replace(recording, positions=positions[:, :2])


def _complete(recording: Recording, wishes: Wishes, band):
    """The recording, deconvolved where a reference is given, its kind, and the noise if that is known already."""
    if wishes.reference is not None:
        from .deconvolution import deconvolved

        responses, noise = deconvolved(recording, formats.read(wishes.reference), band)
        return responses, "response", noise
    kind = "work" if wishes.against is not None else wishes.kind if wishes.kind != "auto" else recording.kind
    return recording, kind or ("response" if _falls(recording, band) else "work"), None


def _falls(recording: Recording, band) -> bool:
    """Whether the sound is gone, or nearly, at the end: then the recording is complete."""
    from .impulse_response import LONGEST
    from .reverberation import piece_levels

    if recording.samples > LONGEST:
        return False
    level = piece_levels(recording, band)
    return bool(level[-2:].mean() <= level.max() * 10 ** (-COMPLETE_DB / 10))


def _pressures(recording: Recording, kind: str, wishes: Wishes, band, speed: float, noise) -> Pressures:
    if kind == "work":
        if wishes.window != "auto":
            raise InputError(f"--window {wishes.window} is for --kind response; a source at work needs none")
        if wishes.against is not None and wishes.against not in recording.names:
            raise InputError(f'--reference-microphone "{wishes.against}" is no channel; use a name or number of one')
        reference = None if wishes.against is None else recording.names.index(wishes.against)
        return from_work(recording, band, speed, wishes.most, reference)
    rate = {"auto": None, "none": 0.0}.get(wishes.window, wishes.window)
    try:
        rate = None if rate is None else float(rate)
    except ValueError:
        rate = -1.0
    if rate is not None and not 0 <= rate * recording.duration <= 50:
        raise InputError(
            f'--window "{wishes.window}" must be auto, none or a rate up to {50 / recording.duration:.3g} per second'
        )
    return from_response(recording, band, speed, rate, wishes.most, noise)


def _measurement(recording: Recording, wishes: Wishes, numbers, places, taken: Pressures, speed: float) -> Measurement:
    axes = axes_of(recording, wishes, places)
    if places is not None and places.shape[1] != axes:
        raise InputError(f"--known {wishes.known} gives {places.shape[1]} coordinates where the file has {axes}")
    return Measurement(
        frequencies=taken.frequencies,
        pressures=taken.pressures,
        sound_speed=speed,
        dimension=wishes.dimension,
        array_dimension=min(axes, wishes.dimension),
        wavenumbers=taken.wavenumbers,
        noise_power=taken.noise_power,
        names=recording.names,
        positions=recording.positions,
        known=numbers,
        known_positions=places,
    )
