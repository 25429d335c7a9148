"""Whether an estimated array can be trusted: a fixed code, and plain words with a remedy.

The figures are those of `fdcal.assessment.diagnostics`, the limits those of `fdcal.assessment.thresholds`, the
checks those of `fdcal.assessment.findings` and `fdcal.assessment.ambiguity`.

good                no check contradicts it
odd_channel         a microphone recorded what no microphone could record at that position
too_noisy           hardly anything but noise
known_position      the position given for a known microphone contradicts its recording, or its channel is swapped
undersampled        frequencies in use that the array cannot interpolate (Eq. 9)
not_converged       the solver stopped while microphones still moved
sound_speed         known microphones, or a given distance, agree with the array at another speed of sound only
model_mismatch      the pressures are not those of a sound field without sources at these microphones
ambiguous           another array fits the pressures nearly as well, or the positions are hardly determined
scale_undetermined  the shape is right, its size hardly determined
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.problem import Problem
from ..model.validation import frozen_array, word_arguments
from . import findings
from .ambiguity import ambiguous, mirrored_rivals
from .diagnostics import Diagnostics, diagnose
from .error_ellipses import one_sigma


@dataclass(frozen=True)
class Verdict:
    """The judgement on an estimated array.

    Attributes
    ----------
    code : one of those above, or of `fdcal.assessment.room_verdict`
    message : what it means and what to do, one line; arguments stand in angle brackets, as in the remedy of
        `fdcal.model.validation.InputError`
    uncertainty : (N,) float64, metres, one sigma: square root of the trace of the covariance; 0 for a known microphone
    covariance : (N, D, D) float64, metres^2
    residual_to_noise : float, reduced chi-square
    """

    code: str
    message: str
    uncertainty: np.ndarray
    covariance: np.ndarray
    residual_to_noise: float

    @property
    def text(self) -> str:
        """The message with the names of the arguments in Python."""
        return self.worded({})

    def worded(self, names: Mapping[str, str]) -> str:
        """Return the message with its arguments called as in `names`."""
        return word_arguments(self.message, names)


def judge(
    problem: Problem,
    positions,
    modes: slice,
    noise: np.ndarray | None = None,
    names: Sequence[str] | None = None,
    converged: bool = True,
    stretch: float | None = None,
) -> Verdict:
    """Return the verdict on estimated positions: the first finding in the order below.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes : slice, the modes in use
    noise : (M,) float64, assumed by the solver of all measured modes, in the unit of abs(problem.pressures)**2; None to
        estimate it
    names : (N,) names of the microphones; their numbers by default
    converged : whether the solver has converged
    stretch : the sound speed of `problem` over that of the measurement, where a given distance has set the size
    """
    positions = np.asarray(positions, float)
    names = [str(n) for n in range(len(positions))] if names is None else list(names)
    figures = diagnose(problem, positions, modes, noise)
    rivals = mirrored_rivals(problem, positions, modes, noise, figures)
    found = (
        ("odd_channel", findings.odd_channel(problem, figures, names)),
        ("too_noisy", findings.too_noisy(figures)),
        ("known_position", findings.known_position(problem, figures, names, clear_only=True)),
        ("undersampled", findings.undersampled(problem, positions, modes)),
        ("not_converged", "" if converged else findings.NOT_CONVERGED),
        ("sound_speed", findings.sound_speed(problem, figures)),
        ("sound_speed", _implied_speed(problem, figures, stretch)),
        ("known_position", findings.known_position(problem, figures, names)),
        ("model_mismatch", findings.model_mismatch(problem, figures, names, modes)),
        ("ambiguous", ambiguous(problem, positions, figures, rivals)),
        ("scale_undetermined", findings.scale_undetermined(problem, figures, stretch is not None)),
        ("good", findings.good(problem, figures)),
    )
    code, message = next(finding for finding in found if finding[1])
    uncertainty = frozen_array(one_sigma(figures.covariance), float)
    return Verdict(code, message, uncertainty, frozen_array(figures.covariance, float), figures.residual_to_noise)


def _implied_speed(problem: Problem, figures: Diagnostics, stretch: float | None) -> str:
    speed = problem.sound_speed / (stretch or 1.0)
    return findings.implied_speed(speed, stretch, figures.scale_sigma)
