"""The measurement in files of recordings, and a report on it: `fdcal import` without its command line.

A take is a recording of all microphones with the source at one position. Each file holds a take, several takes or some
channels of a take.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..acoustics.compiled import parallel_map
from ..model.measurement import Measurement
from ..model.problem import mode_power
from ..model.validation import InputError, word_arguments
from ..solvers.requirements import min_microphones
from . import channels as select
from . import formats, frequencies
from .arrivals import first_arrivals
from .cross_spectra import min_duration, stationary_pressures
from .frequencies import NothingAboveNoise, Pressures, coordinate_count, frequency_band, frequency_limit
from .impulse_response import MAX_SAMPLES, deconvolve, impulse_response_pressures, require_quiet_end, segment_levels
from .recording import IMPORT_LIMITS, Band, ImportOptions, Noise, Recording, in_memory, number_in, read_samples
from .short_windows import found_flat, short_windows

SHORTER = 0.05  # fraction by which the channels of one take may be shorter than the longest, whose end is then cut off
SAME_POSITION = 1e-3  # metres, distance up to which two positions of one microphone count as the same
CLASSIFIED_CHANNELS = 6  # number of channels whose level shows whether a recording is an impulse response
DECAYED_DB = 20.0  # least decay of the level of an impulse response at its end
ARRIVAL_BAND = 0.4  # highest frequency from which arrivals are determined, divided by the sampling rate
DEFAULTS = ImportOptions()  # options of an import unless given
LOWEST = 3  # number of frequencies with the lowest signal-to-noise ratio that are listed
MANY = 32  # number of microphones with which errors in a room are about as large as their estimated uncertainty
CLEAN_DB = 100.0  # signal-to-noise ratio above which the estimate of the noise is not meaningful
ARGUMENTS: Mapping[str, str] = {}  # messages call the arguments by their own names
KIND_WORDS = {"impulse": "impulse response: from silence to the end of the sound", "stationary": "stationary source"}


@dataclass(frozen=True)
class ImportReport:
    """How an import made the measurement."""

    recording: Recording  # with the channels that were used
    kind: str  # one of `fdcal.recordings.recording.KINDS`
    left_out: dict[str, str]  # name of each channel left out, and the reason
    pressures: Pressures
    speed: float  # sound speed, m/s
    speed_from: str  # where the sound speed comes from, in words
    highest_frequency: float | None  # highest frequency that the array can interpolate, Hz
    radius: str  # radius of the array, which determines that frequency, and where it comes from, in words
    height: float | None = None  # common height of all given positions, metres; then the array is sought in this plane
    # one report for each of several takes, () for a single take; the fields above describe the first take
    takes: tuple[ImportReport, ...] = ()
    flat: bool = False  # whether the short windows show that the array is flat, so that it is sought in a plane
    skipped: tuple[str, ...] = ()  # parts of a recording without sound above the noise


def import_recording(
    path: str | Path | Sequence[str | Path],
    options: ImportOptions = DEFAULTS,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Measurement, ImportReport]:
    """Return the measurement in a file or folder, or in several (see `ImportOptions.files`), and a report on it.

    `progress`: called with the fraction done, 0 to 1, and a note, first with 0 and then after each take.
    """
    paths = [path] if isinstance(path, (str, Path)) else list(path)
    return measurement_of_takes(read_takes(paths, options), options, progress)


def read_takes(paths: Sequence[str | Path], options: ImportOptions) -> list[Recording]:
    """Return the takes in files or folders, all with the same channels, before they are split."""
    if not paths:
        raise InputError("no file is given", "give one or several", key="source")
    paths = [one for path in paths for one in formats.sound_files(path) or [path]]
    if twice := [path for path, times in Counter(os.path.realpath(one) for one in paths).items() if times > 1]:
        raise InputError(f"{twice[0]} is given twice", "give each file once", key="source")
    read = list[Recording]()
    for path in paths:
        numbers = range(formats.source_count(path)) if isinstance(options.source, str) else [options.source]
        found = [formats.read(path, number, options.rate) for number in numbers]
        read += [replace(one, path=f"{path}, source {n}") for n, one in enumerate(found)] if len(found) > 1 else found
    if len(read) == 1:
        return read
    if options.files == "channels" or (options.files == "auto" and {one.count for one in read} == {1}):
        return [join_channels(read)]
    first, few = read[0], min_microphones(options.dimension)
    if options.files == "auto" and 1 < first.count < few and {one.count for one in read} == {first.count}:
        problem = f"as takes, these files of {first.count} channels have too few microphones to be found"
        raise InputError(problem, "give <channels> if several recorders recorded one take together", key="files")
    placed = [(one.path, one.positions) for one in read if one.positions is not None]
    for one in read:  # all takes must be of the same array
        if one.count != first.count:
            problem = f"{first.path} and {one.path} have {first.count} and {one.count} channels"
            raise InputError(problem, "give takes of one array, or <channels> for one take", key="files")
        if one.sample_rate != first.sample_rate:
            problem = f"{first.path} has {first.sample_rate:g} Hz and {one.path} {one.sample_rate:g} Hz"
            raise InputError(problem, "convert one of them to the sampling rate of the other", key="sample_rate")
        if one.names != first.names:
            problem = f"{first.path} and {one.path} have channels of other names or in another order"
            raise InputError(problem, "give takes of one array", key="names")
    for path, positions in placed[1:]:
        if placed[0][1].shape != positions.shape or np.abs(placed[0][1] - positions).max() > SAME_POSITION:
            problem = f"{placed[0][0]} and {path} have different positions of the microphones"
            raise InputError(problem, "give takes of one array that does not move", key="positions")
    return read


def join_channels(files: Sequence[Recording]) -> Recording:
    """Return the channels of files that recorded at the same time as one recording, named after the files."""
    shortest, longest = (pick(files, key=lambda one: one.samples) for pick in (min, max))
    if other := next((one for one in files if one.sample_rate != files[0].sample_rate), None):
        problem = f"{files[0].path} has {files[0].sample_rate:g} Hz and {other.path} {other.sample_rate:g} Hz"
        raise InputError(problem, "convert one of them: all channels of a take need the same rate", key="sample_rate")
    if shortest.samples < (1 - SHORTER) * longest.samples:
        problem = f"{shortest.path} lasts {shortest.duration:.3g} s and {longest.path} {longest.duration:.3g} s"
        raise InputError(problem, "give channels of one take, which were recorded at the same time", key="files")
    owner = np.repeat(np.arange(len(files)), [one.count for one in files])
    local = np.concatenate([np.arange(one.count) for one in files])

    def block(start: int, stop: int, channels: np.ndarray) -> np.ndarray:
        values = np.empty((len(channels), stop - start))
        for number in np.unique(owner[channels]):
            rows = np.flatnonzero(owner[channels] == number)
            values[rows] = files[number].block(start, stop, local[channels[rows]])
        return values

    def common(key: str):
        values = [getattr(one, key) for one in files]
        return values[0] if all(value == values[0] for value in values) else None

    # Each channel is named after its file, with its folder or its whole path where files have the same name.
    ways = (lambda path: path.stem, lambda path: f"{path.parent.name}/{path.stem}", str)
    tried = ([way(Path(one.path)) for one in files] for way in ways)
    stems = next(stems for stems in tried if len(set(stems)) == len(stems))
    pairs = zip(files, stems, strict=True)
    names = tuple(stem if one.count == 1 else f"{stem}.{name}" for one, stem in pairs for name in one.names)
    placed = [one.positions for one in files if one.positions is not None]
    rest = f" and {len(files) - 1} other {'file' if len(files) == 2 else 'files'}"
    return Recording(
        f"{files[0].path}{rest if len(files) > 1 else ''}",
        common("kind"),
        files[0].sample_rate,
        len(owner),
        shortest.samples,
        block,
        names=names,
        positions=np.concatenate(placed) if len(placed) == len(files) else None,
        sound_speed=common("sound_speed"),
        full_scale=common("full_scale"),
        lowest=max(one.lowest for one in files),
    )


def split(recording: Recording, seconds: float, min_seconds: float) -> list[Recording]:
    """Cut a recording into parts of `seconds`, at least `min_seconds`; a short remainder is joined to the last part."""
    if seconds < min_seconds:
        problem = f"split = {seconds:.3g} s is too short for a mean over segments of {recording.path}"
        raise InputError(problem, f"use {np.ceil(100 * min_seconds) / 100:g} s or more", key="split")
    length = int(seconds * recording.sample_rate)
    starts = list(range(0, recording.samples, length))
    if len(starts) > 1 and recording.samples - starts[-1] < max(length / 2, min_seconds * recording.sample_rate):
        starts.pop()
    if len(starts) < 2:
        problem = f"split = {seconds:.3g} s is too long for {recording.path}, which lasts {recording.duration:.3g} s"
        longest = np.floor(99 * min(recording.duration / 1.5, recording.duration - min_seconds)) / 100
        remedy = f"use {longest:g} s or less" if longest >= min_seconds else "leave out <split>"
        raise InputError(problem, remedy, key="split")
    return [
        replace(
            recording,
            path=f"{recording.path}, {first / recording.sample_rate:.4g} to {last / recording.sample_rate:.4g} s",
            kind="stationary",
            samples=last - first,
            block=lambda start, stop, channels, at=first: recording.block(at + start, at + stop, channels),
        )
        for first, last in zip(starts, [*starts[1:], recording.samples], strict=True)
    ]


def measurement_of_takes(
    recordings: Sequence[Recording],
    options: ImportOptions = DEFAULTS,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Measurement, ImportReport]:
    """Return the measurement of recordings of the same channels, each of which is a take, and a report on it."""
    count = len(recordings)
    recordings = list(parallel_map(lambda one: in_memory(one, count), recordings, count > 1, "takes"))
    recordings, left_out = _selected(recordings, options)
    if recordings[0].count < 2:
        problem = f"{recordings[0].path} has one channel, and an array needs two microphones at least"
        raise InputError(problem, "give the files of all channels")
    takes = list(recordings)
    if options.split is not None:
        low = number_in(options.frequencies.partition(":")[0])  # NaN for "auto"; `frequency_band` reports a mistake
        if impulses := [one.path for one in takes if one.kind == "impulse"]:
            problem = f"split is for a stationary recording, but {impulses[0]} has impulse responses"
            raise InputError(problem, "leave out <split>", key="split")
        shortest = min_duration(low if low > 0 else IMPORT_LIMITS.low)
        takes = [part for one in takes for part in split(one, options.split, shortest)]
    default = frequencies.default_max_rows(takes[0].count, len(takes))
    each = options.max_rows // len(takes) if options.max_rows else default
    done, skipped = [], []

    def of_take(number: int) -> tuple[Measurement, ImportReport] | NothingAboveNoise:
        try:
            return _measurement_of_take(takes[number], options, max(1, each), left_out, number, len(takes))
        except NothingAboveNoise as error:
            return error

    progress = progress or (lambda done, note: None)
    progress(0.0, f"takes: {len(takes)}")
    for number, found in enumerate(parallel_map(of_take, range(len(takes)), len(takes) > 1, "takes")):
        progress((number + 1) / len(takes), f"takes: {number + 1} of {len(takes)}")
        if not isinstance(found, NothingAboveNoise):
            done.append(found)
            continue
        skipped.append(takes[number].path)
        if options.split is None or len(skipped) == len(takes):  # a split recording may have pauses
            raise found
    measurement, report = done[0]
    if len(done) > 1:
        report = replace(report, takes=tuple(one for _, one in done))
        measurement = Measurement.from_takes([one for one, _ in done])
    flat = options.array_dimension is None and found_flat(measurement)
    if flat:
        measurement = replace(measurement, array_dimension=2, known_positions=None)
    return measurement, replace(report, skipped=tuple(skipped), flat=flat)


def _measurement_of_take(
    recording: Recording, options: ImportOptions, max_rows: int, left_out: dict[str, str], number: int, takes: int
) -> tuple[Measurement, ImportReport]:
    """Return the measurement of take `number` of `takes`, of at most `max_rows` rows, and a report on it."""
    recording, known, known_positions = in_memory(recording), np.zeros(0, int), None
    if options.known is not None:
        known, known_positions = select.known_microphones(recording, options.known)
    taken, known_positions, height = _in_plane(recording, options, known_positions)
    speed, speed_from = options.speed(taken.sound_speed)
    found = frequency_limit(taken, options, known_positions, speed)
    band = frequency_band(taken, options, found, speed)
    recording, kind, noise = _classified(taken, options, band)
    if kind == "impulse":
        pressures = impulse_response_pressures(recording, band, speed, max_rows, noise)
    else:
        pressures = stationary_pressures(recording, band, speed, max_rows)
    axes = coordinate_count(recording, options, known_positions)
    if known_positions is not None and known_positions.shape[1] != axes:
        problem = f"known = {options.known} gives {known_positions.shape[1]} coordinates, but the file has {axes}"
        raise InputError(problem, f"give {axes} coordinates", key="known")
    places: Any = known_positions  # None if no microphone is known
    measurement = Measurement(
        frequencies=pressures.frequencies,
        pressures=pressures.pressures,
        sound_speed=speed,
        dimension=options.dimension,
        array_dimension=min(axes, options.dimension),
        wavenumbers=pressures.wavenumbers,
        noise_power=pressures.noise_power,
        names=recording.names,
        positions=recording.positions,
        known=known,
        known_positions=places,
        takes=np.zeros(len(pressures.frequencies), np.int64),  # several rows may have one frequency
    )
    responses = recording
    if kind == "impulse":
        if options.reference is not None:  # deconvolved in the whole band, since a wide band makes the onset sharp
            whole = IMPORT_LIMITS.low, ARRIVAL_BAND * recording.sample_rate
            responses, _ = deconvolve(taken, formats.read(options.reference, rate=options.rate), whole)
        if arrived := first_arrivals(read_samples(responses, 0, responses.samples), responses.sample_rate):
            times, sigma = arrived
            measurement = replace(measurement, arrivals=times[None], arrival_sigma=sigma)
    measurement = replace(measurement, windows=short_windows(responses, kind, options, takes, number, axes))
    how = (recording, kind, left_out, pressures, speed, speed_from, found.limit, found.words, height)
    return measurement, ImportReport(*how)


def _selected(recordings: Sequence[Recording], options: ImportOptions) -> tuple[list[Recording], dict[str, str]]:
    """Return the takes with the channels that are chosen and usable in every take, and why the others are left out."""
    parts = [part.strip() for part in (options.leave_out or "").split(",")]
    listed = [name for name in parts if name not in ("", "bad")]
    left_out = dict.fromkeys(listed, "as requested")
    chosen = list(recordings)
    if options.subset is not None:
        chosen = [select.select_subset(one, options.subset) for one in chosen]
    if listed:  # before the samples are checked, since those of these channels may not be numbers
        chosen = [select.exclude_channels(one, listed) for one in chosen]
    health = list(parallel_map(select.inspect_channels, chosen, len(chosen) > 1, "takes"))
    if "bad" not in parts:
        for one, state in zip(chosen, health, strict=True):
            select.require_usable_channels(one, state)
    if len(chosen) > 1 and chosen[0].count > 2:
        select.require_different_takes(chosen, health)
    if "bad" not in parts:
        return chosen, left_out
    for one, state in zip(chosen, health, strict=True):
        left_out |= {one.names[n]: state.fault(n, one.names) for n in state.bad}
    bad = np.unique(np.concatenate([state.bad for state in health]))
    return [select.exclude_channels(one, (), bad) for one in chosen], left_out


def _in_plane(
    recording: Recording, options: ImportOptions, known_positions: np.ndarray | None
) -> tuple[Recording, np.ndarray | None, float | None]:
    """Return the recording and the known positions without their heights, and the height, if all heights are equal."""
    given = [one for one in (recording.positions, known_positions) if one is not None]
    wanted = 2 if options.dimension == 2 else options.array_dimension
    if wanted == 3 and given and given[0].shape[1] == 2:
        raise InputError("array_dimension = 3 needs heights", "give z, or leave out the option", key="array_dimension")
    if wanted == 3 or not given or any(one.shape[1] == 2 for one in given):
        return recording, known_positions, None
    heights = np.concatenate([one[:, 2:] for one in given])
    level, every = np.ptp(heights) <= select.PLANE_TOLERANCE, max(map(len, given)) == recording.count
    if wanted is None and not (level and every):  # some heights differ or are unknown
        return recording, known_positions, None
    if not level:
        key = "dimension" if options.dimension == 2 else "array_dimension"
        problem = f"{key} = 2 needs microphones of one height, but theirs differ by {np.ptp(heights):.3g} m"
        raise InputError(problem, "choose them with <subset> I,J,...", key=key)
    if recording.positions is not None:
        recording = replace(recording, positions=recording.positions[:, :2])
    height = None if options.dimension == 2 else float(heights.mean())
    return recording, None if known_positions is None else known_positions[:, :2], height


def _classified(recording: Recording, options: ImportOptions, band: Band) -> tuple[Recording, str, Noise | None]:
    """Return the recording, deconvolved if a reference is given, its kind, and its noise power if it is known."""
    if options.reference is not None:
        responses, noise = deconvolve(recording, formats.read(options.reference, rate=options.rate), band)
        return responses, "impulse", noise
    kind = recording.kind if options.kind == "auto" or options.split is not None else options.kind
    short = recording.samples <= MAX_SAMPLES
    if kind is None:  # an impulse response has nearly decayed at its end
        level = segment_levels(recording, band, CLASSIFIED_CHANNELS) if short else np.ones(2)
        decayed = level[-2:].mean() <= level.max() * 10 ** (-DECAYED_DB / 10)
        kind = "impulse" if decayed else "stationary"
    if kind == "impulse" and short:
        require_quiet_end(recording, band)
    return recording, kind, None


def import_summary(measurement: Measurement, report: ImportReport, wording: Mapping[str, str] = ARGUMENTS) -> str:
    """Return the report on an import in words, one fact per line; `wording`: names of the arguments in the text."""
    left_out = ", ".join(f"{name} ({reason})" for name, reason in report.left_out.items())
    rest = f"{left_out}; none of the others" if left_out else "none; no channel"
    left_out = f"left out     {rest} is silent, clipped or a copy"
    takes, count = report.takes or (report,), measurement.count
    lasts = [f"{one.recording.duration:.3g} s at {one.recording.sample_rate:g} Hz" for one in takes]
    if report.takes:
        counts = [len(one.pressures.frequencies) for one in takes]
        even = f"{counts[0]}" if len(set(counts)) == 1 else f"{min(counts)} to {max(counts)}"
        f = measurement.frequencies
        lines = [
            f"takes        {len(takes)}, each of {count} channels",
            f"frequencies  {even} per take, {len(f)} in all, {f[0]:.1f} to {f[-1]:.1f} Hz",
            left_out,
        ]
        for number, (one, last) in enumerate(zip(takes, lasts, strict=True)):
            taken, kind = one.pressures, KIND_WORDS[one.kind].partition(":")[0]
            lines.append(f"{f'take {number}':<12} {one.recording.path}: {last} ({kind})")
            lines.append(f"             {taken.how}; frequencies: {_band_words(taken)}; SNR {_snr_words(taken)[0]}")
    else:
        lines = [
            f"channels     {count}, {lasts[0]} ({KIND_WORDS[report.kind]})",
            left_out,
            f"method       {report.pressures.how}",
            f"frequencies  {_band_words(report.pressures)}",
        ]
    names = takes[0].recording.names
    if len(names) > 2 and names != tuple(map(str, range(len(names)))):
        lines.insert(1, f"order        {', '.join(names[:3])} ... {names[-1]}")
    lines += [f"skipped      {', '.join(report.skipped)}: no sound above the noise"] if report.skipped else []
    lines += [
        f"sound speed  {report.speed:.1f} m/s {report.speed_from}",
        f"known        {len(measurement.known)} of {count} microphones",
    ]
    height, given = takes[0].height, measurement.known_positions
    space = word_arguments("<array_dimension> 3", wording)
    if height is not None:
        lines += [f"array        in the plane z = {height:g} m, like all given positions; {space} estimates heights"]
    elif report.flat:
        lines += [f"array        flat according to its short windows, sought in a plane; {space} estimates heights"]
    elif len(given) and given.shape[1] == 3 and not np.ptp(given[:, 2]):
        plane = f"z = {given[0, 2]:g} m like the known ones, give {word_arguments('<array_dimension> 2', wording)}"
        lines += [f"array        in space; if all microphones stand at {plane}"]
    if measurement.arrivals is not None and measurement.arrival_sigma is not None:
        found, sigma = np.isfinite(measurement.arrivals), np.median(measurement.arrival_sigma)
        of = f"{np.sum(found)} of {found.size} channels of all takes"
        lines += [f"arrivals     direct sound in {of}, exact to about {1e3 * measurement.sound_speed * sigma:.1f} mm"]
    if (windows := measurement.windows) is not None:
        groups, largest, _ = windows.pressures.shape
        of = f"up to {largest} of {1e3 * windows.length:g} ms at each of {groups} frequencies"
        lines += [f"windows      {of}, {windows.frequencies.min():.0f} to {windows.frequencies.max():.0f} Hz"]
    if not report.takes:
        lines += [f"SNR          {''.join(_snr_words(report.pressures))}"]
    highest = "unknown" if report.highest_frequency is None else f"{report.highest_frequency:.0f} Hz"
    lines.append(f"highest usable frequency  {highest}; radius of the array: {word_arguments(report.radius, wording)}")
    if count < (needed := min_microphones(measurement.dimension)):
        lines.append(f"warning: {count} microphones are too few: use {needed} or more, and {MANY} or more in a room")
    return "\n".join(lines)


def _band_words(taken: Pressures) -> str:
    """Return the band and the spacing of the frequencies, and how many have several rows, in words."""
    f = taken.frequencies
    different = np.unique(f, return_counts=True)[1]
    text = f"{len(different)}, {f[0]:.1f} to {f[-1]:.1f} Hz, about {taken.spacing.step:.2g} Hz apart or more"
    if taken.spacing.decorrelation > 1.5 * taken.spacing.step:
        text += f" (independent if {taken.spacing.decorrelation:.2g} Hz apart)"
    several = int(np.sum(different > 1))
    if several:
        text += f"; {several} of them count up to {different.max()} times, once for each eigenvalue above the noise"
    return text


def _snr_words(taken: Pressures) -> tuple[str, str]:
    """Return the signal-to-noise ratio of the rows in words, and details of it for a longer text."""
    if taken.noise_power is None:
        return "unknown", ": the room still rings at the end; a longer recording would show the noise"
    power = mode_power(taken.pressures)
    snr = 10 * np.log10(np.maximum(power / np.maximum(taken.noise_power, 1e-12 * power) - 1, 1e-3))
    if snr.min() > CLEAN_DB:
        return f"above {CLEAN_DB:g} dB", " at all frequencies: no noise was found"
    low = np.sort(np.argsort(snr, kind="stable")[:LOWEST])
    cells = ", ".join(f"{snr[n]:.0f} dB at {taken.frequencies[n]:.1f} Hz" for n in low)
    return f"median {np.median(snr):.0f} dB", f", {snr.min():.0f} to {snr.max():.0f} dB; lowest {cells}"
