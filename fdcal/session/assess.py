"""How far to trust the end of a run, with the sound speed and the given distance that the inputs ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..assessment.assess import ARGUMENTS, Assessment
from ..model.channels import microphone_index
from ..model.gauge import move_to_frame, turn_to_frame
from ..model.problem import Problem
from ..model.validation import InputError, frozen_array
from ..solvers import load
from .sources import CalibrationInput


def assess(inputs: CalibrationInput, problem: Problem, state, wording: Mapping[str, str] = ARGUMENTS) -> Assessment:
    """Judge the last state of a run, with the sound speed estimated where `inputs` ask for it.

    Parameters
    ----------
    inputs : CalibrationInput
    problem : Problem
    state : RunState
    wording : mapping of str to str
        How the text of the verdict calls the arguments that it mentions; by their names in Python unless given.
    """
    from ..assessment.assess import assess as assessed  # loads the compiler, which other commands do not need

    estimate = load(inputs.settings.name).result(problem, state)
    stretch = None if inputs.distance is None else stretch_of(state.positions, inputs)
    found = replace(assessed(estimate, inputs.measurement.names, stretch), wording=wording)
    if problem.frame is None:
        return found
    turn = turn_to_frame(found.positions, problem.frame)  # a run that was stopped ended in a frame of its own
    positions = frozen_array(move_to_frame(found.positions, problem.frame), float)
    return replace(found, positions=positions, covariance=frozen_array(turn.T @ found.covariance @ turn, float))


def distance_pair(inputs: CalibrationInput) -> tuple[int, int]:
    """Return the numbers of the two microphones whose distance is given.

    Raises
    ------
    InputError
        A name is unknown, or both are the same microphone.
    """
    if inputs.distance is None:
        raise InputError("no distance is given", "give <distance>", key="distance")
    names = inputs.measurement.names
    first, second = (microphone_index(text, names, "distance") for text in inputs.distance[:2])
    if first == second:
        raise InputError(f"distance names microphone {names[first]} twice", "name two", key="distance")
    return first, second


def stretch_of(positions, inputs: CalibrationInput) -> float:
    """Return the given distance over that of the positions found (N, D): the factor of size and sound speed."""
    pair = distance_pair(inputs)
    apart = float(np.linalg.norm(np.subtract(*np.asarray(positions)[list(pair)])))
    if inputs.distance is None or not apart > 0:
        raise InputError(
            f"microphones {pair[0]} and {pair[1]} were estimated at the same position",
            "name another pair in <distance>",
            key="distance",
        )
    return inputs.distance[2] / apart


def sound(sought: np.ndarray, names: Sequence[str], found: Assessment | None) -> np.ndarray:
    """Return the microphones whose errors are averaged: those sought, without the faulty channels of an assessment.

    Parameters
    ----------
    sought : (K,) int64
    names : sequence of str
        Of all microphones.
    found : Assessment or None
    """
    faults = () if found is None or found.channels is None else found.channels.faults
    faulty = {fault.name for fault in faults if fault.kind != "misplaced"}
    kept = np.array([n for n in sought if names[n] not in faulty], np.int64)
    return kept if len(kept) else sought
