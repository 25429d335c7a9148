"""SOFA (AES69): impulse responses of several receivers, or of one that was moved.

Data.IR is (M, R, N) or, with several emitters, (M, R, N, E) or (M, R, E, N), as its dimensions are named: M
measurements with R receivers each, N samples, which begin Data.Delay later. A measurement places the listener, a
receiver stands relative to it and is turned with it. Microphones are all pairs of measurement
and receiver that heard the same source; `--source` names one of several, in the order of the file.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import numpy as np

from ...model.microphones import MicrophonePositions
from ...model.validation import InputError, StorageError
from ..recording import ZERO_CELSIUS, Recording, sound_speed
from .sofa_fields import SAME, delays_of, number_of, opened, receivers_of, responses, source_of, values_of

NAME = "SOFA"
SUFFIXES = (".sofa",)
SEVERAL = True
# Conventions that can be read but not written any more, and what has replaced them.
REPLACED = {"SingleRoomDRIR": "SingleRoomSRIR_1.0", "MultiSpeakerBRIR": "SingleRoomMIMOSRIR_1.0"}


def read(path: Path, source: int | None = None) -> Recording:
    """Recording of a SOFA file, streamed. Raises InputError for a damaged file or a convention without responses."""
    with opened(path) as file:
        _, shape, axes = responses(file, path)
        rate = number_of(file, path, "Data.SamplingRate")
        where = receivers_of(file, path, shape["M"], shape["R"])
        group, emitter = source_of(file, path, shape["M"], shape["E"], source)
        late = delays_of(file, path, shape, emitter)
        told = _sound_speed(file, path)
    pairs = np.array([(m, r) for m in group for r in range(shape["R"])])
    late = late[pairs[:, 0], pairs[:, 1]]
    samples = shape["N"] + int(late.max())

    def block(start: int, stop: int, chosen: np.ndarray) -> np.ndarray:
        values = np.zeros((len(chosen), stop - start))
        with opened(path) as file:
            data = file.variables["Data.IR"]
            for row, (m, r), begin in zip(values, pairs[chosen], late[chosen].tolist(), strict=True):
                first, last = (min(max(sample - begin, 0), shape["N"]) for sample in (start, stop))
                index = {"M": int(m), "R": int(r), "N": slice(first, last), "E": emitter}
                part = data[tuple(index[axis] for axis in axes)]
                row[first + begin - start : last + begin - start] = np.ma.filled(part.astype(float), np.nan)
        return values

    places = where[pairs[:, 0], pairs[:, 1]]
    return Recording(str(path), "response", rate, len(pairs), samples, block, positions=places, sound_speed=told)


def _sound_speed(file, path: Path) -> float | None:
    """Of RoomTemperature, m/s; None without one: 0 K is the default of the format."""
    if "RoomTemperature" not in file.variables:
        return None
    warm = float(np.mean(values_of(file, path, "RoomTemperature")))
    if "cels" in str(getattr(file.variables["RoomTemperature"], "Units", "")).lower():
        warm += ZERO_CELSIUS
    return sound_speed(warm - ZERO_CELSIUS) if 100 < warm < 1000 else None


def write(path: Path, placed: MicrophonePositions, original: str | None = None) -> None:
    """The positions as receivers: of the `original` file if given, or of one with unit impulses for data.

    Receivers are in the order of the microphones; their names are not kept. Raises InputError where the original has
    another number of them, StorageError where it cannot be read.
    """
    from . import needs

    sofar = needs("sofar")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = _blank(sofar, len(placed.names)) if original is None else _copied(sofar, original)
        _place(sofa, placed, original)
        for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
            sofa.delete(name)  # optional, and with netCDF4 1.7.5 sofar cannot write a text for each
        try:
            sofar.write_sofa(str(path), sofa)
        except ValueError as error:
            raise InputError(f"{original or path} cannot be written as SOFA: {error}") from error


def _blank(sofar, count: int):
    """One measurement of `count` receivers, whose responses are unit impulses."""
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.Data_IR, sofa.Data_Delay = np.ones((1, count, 1)), np.zeros((1, count))
    sofa.GLOBAL_Title = "microphone positions found by fdcal; Data.IR is a placeholder"
    for name, direction in (("View", [1.0, 0, 0]), ("Up", [0, 0, 1.0])):  # those of the microphones are not known
        setattr(sofa, f"Receiver{name}", np.tile(direction, (count, 1))[:, :, None])
    return sofa


def _copied(sofar, original: str):
    """What the original file holds, to be written elsewhere."""
    if Path(original).suffix.lower() not in SUFFIXES:
        raise InputError(f"--original {original} is no SOFA file; give the .sofa that the result is from")
    try:
        with open(original, "rb"):
            pass
    except OSError as error:
        raise StorageError(f"cannot read {original}: {error.strerror}") from error
    try:
        sofa = sofar.read_sofa(original, verbose=False)
        np.shape(sofa.Data_IR)[1]  # one without responses is refused here, in one line with other damage
        if sofa.GLOBAL_SOFAConventions in REPLACED:
            with contextlib.redirect_stdout(io.StringIO()):  # it tells what it does
                sofa.upgrade_convention(REPLACED[sofa.GLOBAL_SOFAConventions])
    except Exception as error:
        raise InputError(f"--original {original} cannot be read: {error}") from error
    return sofa


def _place(sofa, placed: MicrophonePositions, original: str | None) -> None:
    """Positions into a file: of the receivers, or of the listener who carries one receiver from place to place."""
    measurements, receivers = np.shape(sofa.Data_IR)[:2]
    source = np.atleast_2d(np.asarray(sofa.SourcePosition, float))
    turn = np.zeros(measurements, int)  # of each measurement, how often its source was heard before
    if len(source) != measurements:
        turn = np.arange(measurements)
    else:
        which = np.unique(np.round(source.reshape(measurements, -1) / SAME), axis=0, return_inverse=True)[1].ravel()
        for one in range(which.max() + 1):
            turn[which == one] = np.arange(np.sum(which == one))
    number = turn[:, None] * receivers + np.arange(receivers)  # of the microphone (M, R)
    if not np.array_equal(np.unique(number), np.arange(len(placed.names))):
        raise InputError(
            f"{original} has {number.max() + 1} places of receivers, the result {len(placed.names)} microphones; leave"
            " out --original, or calibrate all of them"
        )
    _require_one_order(sofa, turn, original)
    where = _in_order(placed)[number]
    moved = turn.max() > 0
    carried = moved and receivers == 1
    receiver = np.zeros((1, 3, 1)) if carried else np.moveaxis(where if moved else where[:1], 0, 2)
    if receiver.shape[2] == 1 and np.ndim(sofa.ReceiverPosition) == 2:
        receiver = receiver[:, :, 0]
    changed = {
        "ListenerPosition": where[:, 0] if carried else np.zeros((1, 3)),
        "ReceiverPosition": receiver,
        "ListenerView": np.array([[1.0, 0, 0]]),
        "ListenerUp": np.array([[0, 0, 1.0]]),
    }
    for name, value in changed.items():
        if hasattr(sofa, name):  # some conventions have no directions
            setattr(sofa, name, value)
            for key, told in (("Type", "cartesian"), ("Units", "metre")):
                if hasattr(sofa, f"{name}_{key}"):
                    setattr(sofa, f"{name}_{key}", told)


def _require_one_order(sofa, turn: np.ndarray, original: str | None) -> None:
    """InputError where sources were heard at the same places in other orders, by what the original tells of them.

    turn : (M,) int, of each measurement, the how many-eth of its source
    """
    listener, receiver = (np.asarray(getattr(sofa, f"{n}Position"), float) for n in ("Listener", "Receiver"))
    M = len(turn)
    told = [np.broadcast_to(np.atleast_2d(listener), (M, 3))]
    if receiver.ndim == 3:
        told.append(np.broadcast_to(np.moveaxis(receiver, 2, 0), (M, *receiver.shape[:2])).reshape(M, -1))
    places = np.concatenate(told, axis=1)
    if any(np.ptp(places[turn == one], axis=0).max() > SAME for one in np.unique(turn)):
        raise InputError(
            f"{original} has sources whose places of receivers stand in different orders; leave out --original"
        )


def _in_order(placed: MicrophonePositions) -> np.ndarray:
    """Positions in the order of the channels (N, 3), metres, where the names are the channels' numbers."""
    numbers = {str(n): n for n in range(len(placed.names))}
    if set(placed.names) != set(numbers):
        return placed.positions
    return placed.positions[np.argsort([numbers[name] for name in placed.names])]
