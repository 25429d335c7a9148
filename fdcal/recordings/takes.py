"""From files to takes: a take is one recording of all microphones with the source at one place.

read_takes       the takes in one or several files, which hold takes or the channels of one take
join_channels    files that recorded at the same time, as one recording
split            a long recording of a source that moves, or of several that take turns, in parts
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..model.validation import InputError
from . import formats
from .import_options import ImportOptions, sound_speed_of
from .recording import Recording


@dataclass(frozen=True)
class TakeTolerances:
    """By how much files that belong together may differ."""

    # share of the longest recording by which the channels of one take may be shorter; the rest is left out
    length: float = 0.05
    position: float = 1e-3  # distance of two positions of one microphone that are the same, metres


TOLERANCES = TakeTolerances()


def read_takes(paths: Sequence[str | Path], options: ImportOptions) -> list[Recording]:
    """Return the takes in files or folders, all of the same channels, not yet split.

    Raises InputError, StorageError: a file cannot be read, or the files do not belong together.
    """
    if not paths:
        raise InputError("no file is given", "give one or several", key="source")
    twice = {str(path) for path in paths if sum(Path(path).resolve() == Path(one).resolve() for one in paths) > 1}
    if twice:
        raise InputError(f"{sorted(twice)[0]} is given twice", "give each file once", key="source")
    read = [recording for path in paths for recording in _recordings(path, options)]
    counts = [recording.count for recording in read]
    if len(read) == 1:
        return read
    if options.files == "channels" or (options.files == "auto" and set(counts) == {1}):
        return [join_channels(read)]
    other = next((one for one in read if one.count != counts[0]), None)
    if other is not None:
        raise InputError(
            f"{read[0].path} has {_channels(counts[0])} and {other.path} {_channels(other.count)}: files are takes if"
            " all have the same channels, or channels of one take",
            "give takes of one array, or <channels> for one take",
            key="files",
        )
    _require_one_array(read)
    return read


def _channels(count: int) -> str:
    return "1 channel" if count == 1 else f"{count} channels"


def _recordings(path: str | Path, options: ImportOptions) -> list[Recording]:
    """Return the recordings in one file: one of each source that is asked for, or those rendered in its field."""
    if options.array is not None:
        from .formats.table import read_positions

        names, positions = read_positions(options.array)
        if positions.shape[1] != 3:
            raise InputError(f"array = {options.array} has two coordinates", "give name,x,y,z", key="array")
        return [formats.render(path, tuple(names), positions, sound_speed_of(None, options)[0])]
    if not isinstance(options.source, str):  # all of them otherwise, as `check_options` has seen
        return [formats.read(path, options.source)]
    found = [formats.read(path, number) for number in range(formats.source_count(path))]
    return [replace(one, path=f"{path}, source {n}") for n, one in enumerate(found)] if len(found) > 1 else found


def _require_one_array(takes: Sequence[Recording]) -> None:
    """Raise InputError where takes differ in sampling rate, or in names or positions of their channels."""
    first = takes[0]
    for one in takes[1:]:
        if one.sample_rate != first.sample_rate:
            raise InputError(
                f"{first.path} has {first.sample_rate:g} Hz and {one.path} {one.sample_rate:g} Hz",
                "convert one of them to the sampling rate of the other",
                key="sample_rate",
            )
        if one.names != first.names:
            problem = f"{first.path} and {one.path} have channels of other names or in another order"
            raise InputError(problem, "give takes of one array", key="names")
        if first.positions is None or one.positions is None:
            continue
        same = first.positions.shape == one.positions.shape
        if not same or np.abs(first.positions - one.positions).max() > TOLERANCES.position:
            problem = f"{first.path} and {one.path} have other positions of the microphones"
            raise InputError(problem, "give takes of one array that does not move", key="positions")


def join_channels(files: Sequence[Recording]) -> Recording:
    """Return the channels of files that recorded at the same time as one recording, named after the files.

    Raises InputError: the files differ in sampling rate or, by more than `TakeTolerances.length`, in length.
    """
    shortest, longest = (pick(files, key=lambda one: one.samples) for pick in (min, max))
    other = next((one for one in files if one.sample_rate != files[0].sample_rate), None)
    if other is not None:
        raise InputError(
            f"{files[0].path} has {files[0].sample_rate:g} Hz and {other.path} {other.sample_rate:g} Hz, and the"
            " channels of one take need one sampling rate",
            "convert one of them, from a recording that was made at the same time",
            key="sample_rate",
        )
    if shortest.samples < (1 - TOLERANCES.length) * longest.samples:
        raise InputError(
            f"{shortest.path} lasts {shortest.duration:.3g} s and {longest.path} {longest.duration:.3g} s: they are not"
            " channels of one take",
            "give files that were recorded at the same time, of one length",
            key="files",
        )
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

    placed = [one.positions for one in files if one.positions is not None]
    rest = f" and {len(files) - 1} other {'file' if len(files) == 2 else 'files'}"
    return Recording(
        f"{files[0].path}{rest if len(files) > 1 else ''}",
        common("kind"),
        files[0].sample_rate,
        len(owner),
        shortest.samples,
        block,
        names=_names(files),
        positions=np.concatenate(placed) if len(placed) == len(files) else None,
        sound_speed=common("sound_speed"),
        full_scale=common("full_scale"),
        highest=min((one.highest for one in files if one.highest is not None), default=None),
    )


def _names(files: Sequence[Recording]) -> tuple[str, ...]:
    """Return a name for every channel: that of its file, with its folder where files have the same name."""
    stems = [Path(one.path).stem for one in files]
    if len(set(stems)) < len(stems):
        stems = [f"{Path(one.path).parent.name}/{stem}" for one, stem in zip(files, stems, strict=True)]
    pairs = zip(files, stems, strict=True)
    return tuple(stem if one.count == 1 else f"{stem}.{name}" for one, stem in pairs for name in one.names)


def split(recording: Recording, seconds: float, least: float) -> list[Recording]:
    """Return parts of a recording; a remainder shorter than half a part is joined to the last one.

    `seconds`: length of a part; `least`: seconds that a part must last. Raises InputError: the parts are too short, or
    there is only one.
    """
    if seconds < least:
        problem = f"split = {seconds:.3g} s is too short for a mean over segments of {recording.path}"
        raise InputError(problem, f"use {least:.3g} s or more", key="split", value=seconds)
    length = int(seconds * recording.sample_rate)
    starts = list(range(0, recording.samples, length))
    if len(starts) > 1 and recording.samples - starts[-1] < max(length / 2, least * recording.sample_rate):
        starts.pop()
    if len(starts) < 2:
        problem = f"split = {seconds:.3g} s leaves {recording.path}, {recording.duration:.3g} s, in one part"
        longest = recording.duration / 1.5
        remedy = f"use {longest:.3g} s or less" if longest >= least else "leave out <split>"
        raise InputError(problem, remedy, key="split", value=seconds)
    return [_part(recording, a, b) for a, b in zip(starts, [*starts[1:], recording.samples], strict=True)]


def _part(recording: Recording, first: int, last: int) -> Recording:
    def block(start: int, stop: int, channels: np.ndarray) -> np.ndarray:
        return recording.block(first + start, first + stop, channels)

    fs = recording.sample_rate
    where = f"{recording.path}, {first / fs:.4g} to {last / fs:.4g} s"
    return replace(recording, path=where, kind="stationary", samples=last - first, block=block)
