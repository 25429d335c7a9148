"""How far to trust the end of a run: sound speed, verdict and leave-one-out errors, of every kind of solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ..assessment.calibration import Channels, Evidence, KnownRoom
from ..model.channels import microphone_index
from ..model.gauge import move_to_frame
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import InputError
from ..solvers import load
from ..solvers.interface import AssessmentMethod
from .sources import CalibrationInput

ARGUMENTS: Mapping[str, str] = MappingProxyType({})  # arguments are called as in Python


@dataclass(frozen=True, eq=False)
class Assessment:
    """The positions at the end of a run and what is known about their quality.

    Attributes
    ----------
    positions : (N, D) float64
        Metres; of the corrected sound speed where it was estimated.
    problem : Problem
        With the corrected sound speed likewise.
    verdict, verdict_text : str
    uncertainty : (N,) float64
        One sigma, metres.
    covariance : (N, D, D) float64
        Metres^2.
    evidence : Evidence
    room : KnownRoom or None
        Of solver "room".
    channels : Channels or None
        Of solver "robust".
    sound_speed_sigma : float or None
        One sigma of an uncertain sound speed, m/s; of solver "robust".
    """

    positions: np.ndarray
    problem: Problem
    verdict: str
    verdict_text: str
    uncertainty: np.ndarray
    covariance: np.ndarray
    evidence: Evidence
    room: KnownRoom | None = None
    channels: Channels | None = None
    sound_speed_sigma: float | None = None


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
    methods = {
        AssessmentMethod.LIKELIHOOD: _assess_array,
        AssessmentMethod.CHANNELS: _assess_channels,
        AssessmentMethod.KNOWN_ROOM: _assess_in_room,
    }
    return methods[load(inputs.settings.name).TRAITS.assessment](inputs, problem, state, wording)


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


def _assess_array(inputs: CalibrationInput, problem: Problem, state, wording: Mapping[str, str]) -> Assessment:
    from ..assessment.field import cross_validate  # these load the compiler, which other commands do not need
    from ..assessment.verdict import judge

    # Where hardly any noise is left, the real-valued kernel of the verdict has its own limit, which it finds itself.
    noise = state.assessment_noise
    positions, speed = state.positions, problem.sound_speed
    if inputs.estimate_sound_speed:
        positions, problem = _at_estimated_sound_speed(inputs, problem, state, noise)
    stretch = None if inputs.distance is None else problem.sound_speed / speed
    verdict = judge(problem, positions, state.modes, noise, inputs.measurement.names, state.converged, stretch)
    evidence = _evidence(verdict, cross_validate(problem, positions, state.modes, noise))
    return Assessment(
        positions, problem, verdict.code, verdict.worded(wording), verdict.uncertainty, verdict.covariance, evidence
    )


def _assess_channels(inputs: CalibrationInput, problem: Problem, state, wording: Mapping[str, str]) -> Assessment:
    from ..assessment.channel_verdict import judge  # these load the compiler
    from ..assessment.field import cross_validate
    from ..assessment.odd_channels import healthy_channels
    from ..assessment.sound_speed import at_sound_speed, from_distance
    from ..solvers.robust import assumptions

    names, stretch = inputs.measurement.names, None
    if inputs.distance is not None:
        found = from_distance(problem, state.positions, distance_pair(inputs), inputs.distance[2])
        stretch = found.sound_speed / problem.sound_speed
    verdict = judge(problem, state, names, stretch)
    pressures, recorded = assumptions.corrected(problem, state, slice(None)), problem
    problem = at_sound_speed(problem, verdict.sound_speed)
    corrected = replace(problem, pressures=pressures)
    healthy = healthy_channels(len(names), verdict.odd)
    prediction = cross_validate(corrected, verdict.positions, state.modes, healthy=healthy)
    return Assessment(
        verdict.positions, problem, verdict.code, verdict.worded(wording), verdict.sigma, verdict.covariance,
        replace(_evidence(verdict, prediction), noise_to_given=_noise_to_given(recorded, verdict.noise_share)),
        channels=verdict.channels(names),
        sound_speed_sigma=verdict.sound_speed_sigma or None,
    )  # fmt: skip


def _noise_to_given(problem: Problem, share: float) -> float | None:
    """Return a noise, as a share of the power, over the noise given; None where none is given."""
    from ..solvers.robust.unit_power import in_unit_power

    given = in_unit_power(problem).noise_power
    median = 0.0 if given is None else float(np.median(given))
    return share / median if median > 0 else None


def _at_estimated_sound_speed(inputs: CalibrationInput, problem: Problem, state, noise) -> tuple[np.ndarray, Problem]:
    """Return the positions and the problem at the sound speed that the array itself speaks for."""
    from ..assessment import sound_speed

    if inputs.distance is None:
        found = sound_speed.from_known(problem, state.positions, state.modes, noise)
    else:
        found = sound_speed.from_distance(problem, state.positions, distance_pair(inputs), inputs.distance[2])
    positions = found.positions if problem.frame is None else move_to_frame(found.positions, problem.frame)
    return positions, found.problem


def _assess_in_room(inputs: CalibrationInput, problem: Problem, state, wording: Mapping[str, str]) -> Assessment:
    from ..assessment.field import summarise  # these load the compiler, which other commands do not need
    from ..assessment.room_verdict import judge

    found = judge(problem, state, inputs.measurement.names)
    pressures = problem.pressures[state.modes]
    prediction = summarise(pressures / np.sqrt(mode_power(pressures))[:, None], found.leave_one_out_errors)
    verdict, positions = found.verdict, np.asarray(state.positions)
    size = tuple(map(float, inputs.settings.room or ()))
    symmetries = tuple((str(image), image.apply(positions)) for image in found.images)
    return Assessment(
        positions, problem, verdict.code, verdict.worded(wording), verdict.uncertainty, verdict.covariance,
        _evidence(verdict, prediction), KnownRoom(size, found.source, found.admittance, symmetries),
    )  # fmt: skip


def _evidence(verdict, prediction) -> Evidence:
    return Evidence(verdict.residual_to_noise, prediction.overall, prediction.microphones, prediction.modes)


def sound(sought: np.ndarray, names: Sequence[str], found: Assessment | None) -> np.ndarray:
    """Return the microphones whose errors are averaged: those sought, without the odd channels of an assessment.

    Parameters
    ----------
    sought : (K,) int64
    names : sequence of str
        Of all microphones.
    found : Assessment or None
    """
    faulty = set() if found is None or found.channels is None else found.channels.faulty
    kept = np.array([n for n in sought if names[n] not in faulty], np.int64)
    return kept if len(kept) else sought
