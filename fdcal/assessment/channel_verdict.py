"""Whether the array that solver "robust" found can be trusted.

The codes are those of `fdcal.assessment.verdict`, their order is that of `fdcal.assessment.channel_findings`. A faulty
channel does not spoil the verdict of the others: it is named, and the verdict is that of the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..acoustics.single_wave import is_single_wave
from ..model.problem import Problem
from ..model.validation import frozen_array, word_arguments
from ..solvers.robust.convergence import remaining_step
from ..solvers.robust.state import State
from ..solvers.robust.unit_power import in_unit_power
from .calibration import DECIBELS_PER_NEPER, Channels, GivenPosition
from .channel_covariance import uncertainty
from .channel_findings import LIMITS, ChannelEvidence, first_finding, residual_to_noise
from .error_ellipses import one_sigma
from .given_check import check_given
from .odd_channels import OddChannel, channel_faults, exchange_back, healthy_channels, odd_channels
from .search_spread import search_spread


@dataclass(frozen=True)
class RobustVerdict:
    """The judgement on an array with the gains of its channels.

    Attributes
    ----------
    code : str
        good, too_noisy, undersampled, not_converged, known_position, model_mismatch, sound_speed, ambiguous or
        scale_undetermined.
    message : str
        What it means and what to do, one line; arguments stand in angle brackets.
    positions : (N, D) float64
        Metres, exchanges undone.
    covariance : (N, D, D) float64
        Metres^2.
    sigma : (N,) float64
        Metres, square root of the trace of the covariance.
    gains, gain_sigma : (N, 2) float64
        Log gain, nepers, and phase, radians.
    channel_noise : (N,) float64
        Over that of a healthy channel.
    odd : tuple of OddChannel
    stretch_sigma : float
        One sigma of the least certain stretching of the array, relative.
    noise_share : float
        Of the power.
    residual_to_noise : float
        Reduced chi-square of the pressures of the healthy channels.
    sound_speed, sound_speed_sigma : float
        m/s, as found, and its one sigma; 0 for one that is exact.
    known : (A,) int64
        Microphones whose positions were given.
    known_positions : (A, D) float64
        Metres, as given.
    """

    code: str
    message: str
    positions: np.ndarray
    covariance: np.ndarray
    sigma: np.ndarray
    gains: np.ndarray
    gain_sigma: np.ndarray
    channel_noise: np.ndarray
    odd: tuple[OddChannel, ...]
    stretch_sigma: float
    noise_share: float
    residual_to_noise: float
    sound_speed: float
    sound_speed_sigma: float
    known: np.ndarray
    known_positions: np.ndarray

    def channels(self, names: Sequence[str]) -> Channels:
        """Return gain and noise of every channel, and what is wrong with it, with the names of the microphones."""
        gain, phase = self.gains.T
        gain_sigma, phase_sigma = self.gain_sigma.T
        return Channels(
            DECIBELS_PER_NEPER * gain,
            DECIBELS_PER_NEPER * gain_sigma,
            np.degrees(np.angle(np.exp(1j * phase))),
            np.degrees(phase_sigma),
            10 * np.log10(self.channel_noise / np.median(self.channel_noise)),
            channel_faults(self.odd, names),
            self._given(names),
        )

    def _given(self, names: Sequence[str]) -> tuple[GivenPosition, ...]:
        wrong = {one.number for one in self.odd if one.kind in ("misplaced", "exchanged")}
        numbers: list[int] = self.known.tolist()
        return tuple(
            GivenPosition(names[n], tuple(place), tuple(self.positions[n].tolist()), float(self.sigma[n]), n in wrong)
            for n, place in zip(numbers, self.known_positions.tolist(), strict=True)
        )

    def worded(self, names: Mapping[str, str]) -> str:
        """Return the message with its arguments called as in `names`."""
        return word_arguments(self.message, names)


def judge(
    problem: Problem, state: State, names: Sequence[str] | None = None, stretch: float | None = None
) -> RobustVerdict:
    """Return the verdict on where the solver ended.

    Parameters
    ----------
    problem : Problem
    state : State
    names : sequence of N str, optional
        Of the microphones; their numbers unless given.
    stretch : float, optional
        The sound speed that follows from a given distance over that of the problem; the array becomes larger by it.
    """
    problem = in_unit_power(problem)
    names = [str(n) for n in range(len(state.positions))] if names is None else list(names)
    seen = replace(_evidence(problem, state), stretch=stretch)
    code, message = first_finding(problem, state, seen, names)
    m, found, size = state.model, seen.found, stretch or 1.0
    speed = problem.sound_speed * size * float(np.exp(m.log_speed))
    positions = exchange_back(problem, state, seen.odd)
    centre = positions.mean(axis=0)
    return RobustVerdict(
        code, message, frozen_array(centre + size * (positions - centre), float),
        frozen_array(size**2 * seen.covariance, float), frozen_array(size * seen.sigma, float), state.gains,
        found.gains, m.channel_noise, seen.odd, found.stretch_sigma, m.share,
        residual_to_noise(problem, state, found, seen.healthy), speed, speed * found.log_speed,
        problem.known, problem.known_positions,
    )  # fmt: skip


def _evidence(problem: Problem, state: State) -> ChannelEvidence:
    """Return what the verdict rests on; modes have unit power."""
    found = uncertainty(problem, state, LIMITS.weaker_field)
    single = is_single_wave(problem.pressures[state.modes])
    odd = () if single else odd_channels(problem, state, found)
    healthy = healthy_channels(len(state.positions), odd)
    step, sigma = remaining_step(problem, state)
    covariance = found.covariance + step[:, :, None] * step[:, None, :] + search_spread(problem, state, healthy)
    return ChannelEvidence(
        found,
        covariance,
        np.asarray(one_sigma(covariance)),
        odd,
        float(np.max(np.abs(step[healthy]) / sigma[healthy], initial=0.0)),
        check_given(problem, state, found, odd),
        single_wave=single,
    )
