"""SOFA (AES69): impulse responses of several receivers, or of one that was moved.

Data.IR is (M, R, N) or, with several emitters, (M, R, N, E) or (M, R, E, N), as its dimensions are named: M
measurements with R receivers each, N samples, which begin Data.Delay later. A measurement gives the position of the
listener; a receiver has a position relative to it and turns with it. Microphones are all pairs of measurement and
receiver that recorded the same source; sources are counted in the order of the file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...model.given_positions import MicrophonePositions
from ..recording import ZERO_CELSIUS, Recording, sound_speed
from .sofa_fields import (
    delays_of,
    impulse_responses,
    measurements_of,
    number_of,
    open_sofa,
    receiver_positions,
    sources_of,
    values_of,
)

SUFFIXES = (".sofa",)


def read(path: Path, source: int | None = None) -> Recording:
    """Return the recording of a SOFA file, read in pieces.

    Raises InputError: the file is damaged, or of a convention without impulse responses.
    """
    with open_sofa(path) as file:
        _, shape, axes = impulse_responses(file, path)
        rate = number_of(file, path, "Data.SamplingRate")
        positions = receiver_positions(file, path, shape["M"], shape["R"])
        group, emitter = measurements_of(file, path, shape["M"], shape["E"], source)
        delays = delays_of(file, path, shape, emitter)
        speed = _sound_speed(file, path)
    pairs = np.array([(m, r) for m in group for r in range(shape["R"])])
    delays = delays[pairs[:, 0], pairs[:, 1]]
    samples = shape["N"] + int(delays.max())

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.zeros((len(chosen), stop - start))
        with open_sofa(path) as file:
            data = file.variables["Data.IR"]
            for row, (m, r), begin in zip(values, pairs[chosen], delays[chosen].tolist(), strict=True):
                first, last = (min(max(sample - begin, 0), shape["N"]) for sample in (start, stop))
                index = {"M": int(m), "R": int(r), "N": slice(first, last), "E": emitter}
                part = data[tuple(index[axis] for axis in axes)]
                row[first + begin - start : last + begin - start] = np.ma.filled(part.astype(float), np.nan)
        return values

    positions = positions[pairs[:, 0], pairs[:, 1]]
    return Recording(str(path), "impulse", rate, len(pairs), samples, block, positions=positions, sound_speed=speed)


def source_count(path: Path) -> int:
    """Return the number of sources: places of the source, times its emitters."""
    with open_sofa(path) as file:
        _, shape, _ = impulse_responses(file, path)
        return len(np.unique(sources_of(file, path, shape["M"]))) * shape["E"]


def _sound_speed(file, path: Path) -> float | None:
    """Return the sound speed at RoomTemperature, m/s; None without one or at 0 K, the default of the format."""
    if "RoomTemperature" not in file.variables:
        return None
    kelvin = float(np.mean(values_of(file, path, "RoomTemperature")))
    if "cels" in str(getattr(file.variables["RoomTemperature"], "Units", "")).lower():
        kelvin += ZERO_CELSIUS
    return sound_speed(kelvin - ZERO_CELSIUS) if 100 < kelvin < 1000 else None


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """Write the positions as receivers: of the `original` file if given, or of one with unit impulses for data.

    Receivers are in the order of the microphones; their names are not kept.

    Raises InputError: the original has another number of receivers, or cannot be written as SOFA; StorageError: the
    original cannot be read.
    """
    from .sofa_writer import write_positions

    write_positions(path, placed, original)
