"""Microphone positions as the receivers of a SOFA file, new or a copy of an original."""

from __future__ import annotations

import contextlib
import io
import warnings
from pathlib import Path

import numpy as np

from ...model.given_positions import MicrophonePositions
from ...model.validation import InputError, StorageError
from .sofa_fields import TOLERANCES

# Conventions that can be read but no longer written, and what has replaced them.
REPLACED = {"SingleRoomDRIR": "SingleRoomSRIR_1.0", "MultiSpeakerBRIR": "SingleRoomMIMOSRIR_1.0"}


def write_positions(path: Path, placed: MicrophonePositions, original: str | None) -> None:
    """Write the positions into a copy of `original` if given, else into a file with unit impulses for data.

    Raises InputError: the original has another number of receivers, or cannot be written as SOFA; StorageError: the
    original cannot be read.
    """
    from . import needs

    sofar = needs("sofar")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sofa = _blank(sofar, len(placed.names)) if original is None else _copied(sofar, original)
        _fill_in(sofa, placed, original)
        for name in [name for name in vars(sofa) if name.endswith("Descriptions")]:
            sofa.delete(name)  # optional, and with netCDF4 1.7.5 sofar cannot write a text for each receiver
        try:
            sofar.write_sofa(str(path), sofa)
        except ValueError as error:
            raise InputError(f"{original or path} cannot be written as SOFA: {error}") from error


def _blank(sofar, count: int):
    """Return a file of one measurement with `count` receivers, whose responses are unit impulses."""
    sofa = sofar.Sofa("SingleRoomSRIR")
    sofa.Data_IR, sofa.Data_Delay = np.ones((1, count, 1)), np.zeros((1, count))
    sofa.GLOBAL_Title = "microphone positions found by fdcal; Data.IR is a placeholder"
    for name, direction in (("View", [1.0, 0, 0]), ("Up", [0, 0, 1.0])):  # the orientation of microphones is unknown
        setattr(sofa, f"Receiver{name}", np.tile(direction, (count, 1))[:, :, None])
    return sofa


def _copied(sofar, original: str):
    """Return the content of the original file, to be written elsewhere."""
    if Path(original).suffix.lower() not in (".sofa",):
        raise InputError(
            f"original = {original} is no SOFA file",
            "give the .sofa file that the result was calibrated from as <original>",
            key="original",
            value=original,
        )
    try:
        with open(original, "rb"):
            pass
    except OSError as error:
        raise StorageError(f"cannot read {original}: {error.strerror}") from error
    try:
        sofa = sofar.read_sofa(original, verbose=False)
        np.shape(sofa.Data_IR)[1]  # raises for a file without responses
        if sofa.GLOBAL_SOFAConventions in REPLACED:
            with contextlib.redirect_stdout(io.StringIO()):  # sofar prints what it does
                sofa.upgrade_convention(REPLACED[sofa.GLOBAL_SOFAConventions])
    except Exception as error:  # a damaged file raises anything
        raise InputError(f"original = {original} cannot be read: {error}", key="original", value=original) from error
    return sofa


def _fill_in(sofa, placed: MicrophonePositions, original: str | None) -> None:
    """Set the positions of the receivers, or those of the listener who carries one receiver from place to place."""
    receivers = np.shape(sofa.Data_IR)[1]
    repetition = _repetitions(sofa)
    microphone = repetition[:, None] * receivers + np.arange(receivers)  # of each measurement and receiver (M, R)
    if not np.array_equal(np.unique(microphone), np.arange(len(placed.names))):
        raise InputError(
            f"{original} has {microphone.max() + 1} receiver positions, the result {len(placed.names)} microphones",
            "leave out <original>, or calibrate all of them",
            key="original",
            value=original,
        )
    _require_one_order(sofa, repetition, original)
    positions = _in_channel_order(placed)[microphone]
    moved = repetition.max() > 0
    carried = moved and receivers == 1
    receiver = np.zeros((1, 3, 1)) if carried else np.moveaxis(positions if moved else positions[:1], 0, 2)
    if receiver.shape[2] == 1 and np.ndim(sofa.ReceiverPosition) == 2:
        receiver = receiver[:, :, 0]
    _set_cartesian(sofa, "ListenerPosition", positions[:, 0] if carried else np.zeros((1, 3)))
    _set_cartesian(sofa, "ReceiverPosition", receiver)
    _set_cartesian(sofa, "ListenerView", np.array([[1.0, 0, 0]]))
    _set_cartesian(sofa, "ListenerUp", np.array([[0, 0, 1.0]]))


def _repetitions(sofa) -> np.ndarray:
    """Return how often the source of each measurement was recorded before it : (M,) int64."""
    measurements = np.shape(sofa.Data_IR)[0]
    source = np.atleast_2d(np.asarray(sofa.SourcePosition, float))
    if len(source) != measurements:
        return np.arange(measurements)
    cells = np.round(source.reshape(measurements, -1) / TOLERANCES.same_position)
    which = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    repetition = np.zeros(measurements, int)
    for one in range(which.max() + 1):
        repetition[which == one] = np.arange(np.sum(which == one))
    return repetition


def _set_cartesian(sofa, name: str, value: np.ndarray) -> None:
    """Set a position or direction in metres, if the convention has it."""
    if hasattr(sofa, name):
        setattr(sofa, name, value)
        for key, text in (("Type", "cartesian"), ("Units", "metre")):
            if hasattr(sofa, f"{name}_{key}"):
                setattr(sofa, f"{name}_{key}", text)


def _require_one_order(sofa, repetition: np.ndarray, original: str | None) -> None:
    """Raise InputError where sources were recorded at the same positions in different orders."""
    listener, receiver = (np.asarray(getattr(sofa, f"{n}Position"), float) for n in ("Listener", "Receiver"))
    M = len(repetition)
    columns = [np.broadcast_to(np.atleast_2d(listener), (M, 3))]
    if receiver.ndim == 3:
        columns.append(np.broadcast_to(np.moveaxis(receiver, 2, 0), (M, *receiver.shape[:2])).reshape(M, -1))
    positions = np.concatenate(columns, axis=1)
    spreads = [np.ptp(positions[repetition == one], axis=0).max() for one in np.unique(repetition)]
    if max(spreads) > TOLERANCES.same_position:
        raise InputError(
            f"{original} has sources whose receiver positions are in different orders",
            "leave out <original>",
            key="original",
            value=original,
        )


def _in_channel_order(placed: MicrophonePositions) -> np.ndarray:
    """Return positions in the order of the channels (N, 3), metres, where the names are the numbers of channels."""
    numbers = {str(n): n for n in range(len(placed.names))}
    if set(placed.names) != set(numbers):
        return placed.positions
    return placed.positions[np.argsort([numbers[name] for name in placed.names])]
