"""Checks of what is to be calibrated, before any solver starts: lengths, a search domain, the size of a room."""

from __future__ import annotations

import numpy as np

from ..model.measurement import Measurement
from ..model.problem import Problem
from ..model.settings import SolverSettings
from ..model.validation import InputError, require_positive
from ..solvers import load
from .assess import distance_pair
from .sources import CalibrationInput


def require_length(inputs: CalibrationInput, problem: Problem) -> None:
    """Raise InputError where the sound speed is asked for without a known length, or with two."""
    needs_room = load(inputs.settings.name).TRAITS.needs_room
    if needs_room and (inputs.estimate_sound_speed or inputs.settings.known == "minimal"):
        raise InputError(
            "a known room fixes size and place", "leave out <estimate_sound_speed> and <known> minimal", key="room"
        )
    if inputs.distance is not None:
        if not inputs.estimate_sound_speed:
            raise InputError(
                "distance fixes the size of the array, so that the sound speed follows from it",
                "give <estimate_sound_speed> with <distance>",
                key="distance",
            )
        if len(problem.known):
            raise InputError(
                "distance is for arrays without known microphones, which fix the size already",
                "leave out <distance>",
                key="distance",
            )
        require_positive("distance", inputs.distance[2], "m")
        distance_pair(inputs)
    elif inputs.estimate_sound_speed and len(problem.known) < 2:
        raise InputError(
            "the sound speed follows from a known length, and fewer than two microphones are known",
            "name two known microphones at least, or give <distance>",
            key="estimate_sound_speed",
        )


def require_inside_search(inputs: CalibrationInput) -> None:
    """Raise InputError if the solver searches a lattice and a true position lies outside the search domain."""
    measurement, traits = inputs.measurement, load(inputs.settings.name).TRAITS
    if measurement.positions is None or measurement.search is None or not traits.needs_search:
        return
    search, free = measurement.search, np.setdiff1d(np.arange(measurement.count), measurement.known)
    low, high = np.array(search.origin) - search.step, np.add(search.origin, search.size) + search.step
    truth = measurement.positions[free]
    outside = free[np.any((truth < low) | (truth > high), axis=1)]
    if len(outside):
        raise InputError(
            f"microphone {outside[0]} stands at {measurement.positions[outside[0]].tolist()} m, outside the search"
            f" domain of origin {list(search.origin)} m and size {list(search.size)} m",
            "enlarge or move it with <search>",
            key="search",
        )


def require_room_for_array(measurement: Measurement, settings: SolverSettings) -> None:
    """Raise InputError where the true positions do not fit into the known room."""
    truth, size = measurement.positions, settings.room
    if truth is None or size is None or len(size) != measurement.array_dimension:
        return
    extent, diagonal = float(np.linalg.norm(truth[:, None] - truth, axis=-1).max()), float(np.linalg.norm(size))
    if extent > diagonal:
        text = "x".join(f"{length:g}" for length in size)
        raise InputError(
            f"room = {text} m is smaller than the array, whose microphones are up to {extent:.3g} m apart",
            "give <room> in metres",
            key="room",
            value=size,
        )
