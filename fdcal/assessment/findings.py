"""The findings of an assessment: an ordered table, FINDINGS. The first that applies is the verdict.

good                no check contradicts the result
too_noisy           a large part of the power is noise or unexplained
undersampled        the solver interpolates the field (Eq. 7); the array is too sparse for this at the frequencies in
                    use (Eq. 9)
not_converged       the solver stopped while microphones still moved
known_position      a given position contradicts the recordings, or its channel is swapped
sound_speed         the given positions or the given distance imply a sound speed that is hardly possible
model_mismatch      no sound field without sources explains the pressures at these microphones
ambiguous           another array fits the pressures nearly as well, or the positions are hardly determined
scale_undetermined  the shape is right, but the size is hardly determined

A remedy names arguments in angle brackets, as in `fdcal.model.validation.InputError`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..acoustics.coherence import SINGLE_WAVE, SINGLE_WAVE_REMEDY
from ..model.validation import length_text
from ..solvers.interface import CONTRADICTION, Estimate
from .calibration import OF_LIST, ChannelFault
from .uncertainty import one_sigma, root_mean_square
from .words import faults_text, listed

CAUSES = (
    "sound from few directions (record another take with the source elsewhere), a source or an obstacle inside the"
    " array, faulty channels, or positions not found yet"
)
MORE_MODES = "use more frequencies (<modes>), or "  # placeholder; `first_finding` replaces or removes it


AnswerState = Literal["fine", "differs", "fault", "unknown"]


@dataclass(frozen=True)
class Answer:
    """The answer to one question about a recording or a data set, as `fdcal.session.doctor` gives it."""

    question: str  # one of those in the docstring of `fdcal.session.doctor`
    state: AnswerState
    text: str
    value: float | None = None
    unit: str = ""
    # pairs: a fault or difference, which is a key of `FAULTS`, and the microphone's name, "" for the whole recording
    found: tuple[tuple[str, str], ...] = ()

    @property
    def line(self) -> str:
        """The answer in one line."""
        return f"{self.question:<12} {self.state:<8} {self.text}"


@dataclass(frozen=True)
class Judged:
    """The evidence for the verdict on an array."""

    estimate: Estimate
    names: Sequence[str]  # names of the microphones
    covariance: np.ndarray  # (N, D, D) float64, metres^2
    faulty: Mapping[int, ChannelFault]  # by the number of the microphone
    # probability that given positions would by chance disagree at least as much as they do: with the pressures, or with
    # the array found if the solver did not get these positions; 1 if it cannot be computed
    agreement: float
    # metres, largest sigma of a known microphone as found from all other data; 0 if none is known or all given
    # positions are exact, infinite if too few of them are right to place the array
    loosest: float
    search: np.ndarray  # (N,) float64, metres, spread of the search
    scale_sigma: float  # one sigma of the least certain stretching of the array, relative
    scale: float | None  # sound speed from a given distance, divided by that of the problem; None without a distance
    single_wave: bool  # whether the field has hardly any reflections, so that channels cannot be checked

    # The following fields are computed from those above.
    healthy: np.ndarray  # (N,) bool, which channels have no fault
    by_rows: bool  # whether the positions follow from the pressures of the modes alone, without short windows
    # Faulty channels and wrong given positions that the model does not explain. Gain, polarity, delay and high-pass are
    # parameters of the model, so that such a channel has a normal residual.
    unexplained: Sequence[ChannelFault]
    wrong_given: Sequence[ChannelFault]  # the given positions that the pressures contradict
    sigma: float  # metres, root mean square of one sigma over the healthy microphones
    uncertain: float  # metres, root sum of squares of `sigma` and the spread of the search
    radius: float  # metres, root mean square distance of the healthy microphones from their centre
    f_max: float  # Hz, highest frequency that the healthy microphones can interpolate (Eq. 9)
    highest: float  # Hz, highest frequency in use
    noise_fraction: float  # noise power found, divided by the mean power of the pressures
    # median of the given noise of the modes in use, as a fraction of the power; None if no noise is given
    given_noise: float | None
    step_left: float  # largest remaining Newton step of a healthy microphone, in sigmas of the coordinate
    residual_to_noise: float  # reduced chi-square of the pressures of the healthy channels
    noisiest: int  # unknown microphone with the largest noise among the healthy ones; -1 if there is none
    # sound speed that follows from given lengths, divided by that of the measurement, and one sigma of this ratio
    speed: tuple[float, float]
    # (N,) float64, metres, distance of each microphone from its position in another array that is as likely; 0 if there
    # is no such array
    rival: np.ndarray

    @property
    def uneven(self) -> np.ndarray:
        """Which of the healthy or noisy channels have far more residual than the median one : bool.

        Channels of the same type have equal noise either before or after their gain stages, but a source inside the
        array leaves unequal residuals. Up to UNEVEN_FRACTION of the power may be leakage of the spectrum. Channels with
        the fault "noisy" count as well, because a source can cause their noise. If no other channel is uneven, however,
        these are faults of single channels, and no channel counts as uneven.
        """
        channels, counted = self.estimate.channels, self.healthy | self.noisy
        before = channels.noise[counted]
        after = before * np.exp(2 * channels.gains[counted, 0])
        high = np.all([tau > UNEVEN * np.median(tau) for tau in (before, after)], axis=0)
        high &= before * self.noise_fraction > UNEVEN_FRACTION
        return high & np.any(high & self.healthy[counted])

    @property
    def channel_faults(self) -> list[ChannelFault]:
        """The faults of channels, without those of given positions."""
        return [one for one in self.faulty.values() if one.kind not in OF_LIST]

    @property
    def noisy(self) -> np.ndarray:
        """Which channels have the fault "noisy" : (N,) bool."""
        return np.isin(np.arange(len(self.names)), [n for n, one in self.faulty.items() if one.kind == "noisy"])


# Ratio of a channel's noise to that of the median channel above which the channel is uneven. In living rooms one or two
# of 16 or 32 channels are uneven; with a source inside the array, a tenth of all channels or more are.
UNEVEN = 3.0
UNEVEN_FRACTION = 1e-4  # smallest noise of an uneven channel, as a fraction of the power
# Fraction of the power that a healthy measurement may leave unexplained in addition to its noise. In measured arrays
# the error of predicting a microphone from the others at the true positions is -27 to -32 dB; in simulated living rooms
# the unexplained fraction is 1e-5 to 1e-3.
ROOM_RESIDUAL = 1e-3
# If the field leaves more than this fraction of the channels unexplained, these have a common cause.
MAX_UNEXPLAINED = 0.12
UNEXPLAINED = 1e-4  # largest unexplained fraction of the power of a measurement without noise
ROOM_FRACTION = 2e-4  # fraction of noise below which the residuals of healthy channels may differ by a large factor


def _many_faulty(seen: Judged) -> str:
    faults, count = seen.channel_faults, len(seen.names)
    sigma = f"; {precision(_sought_sigma(seen))}" if seen.estimate.ended else ""
    few = f"the other {count - len(faults)} are too few to check these positions{sigma}"
    return f"{len(faults)} of {count} channels are faulty: {faults_text(faults)}; {few}"


def _sought_sigma(seen: Judged) -> np.ndarray:
    """Return one sigma (K,), metres, of the healthy microphones sought, or of all healthy ones if all are given."""
    sought = np.setdiff1d(np.flatnonzero(seen.healthy), seen.estimate.problem.known)
    return one_sigma(seen.covariance)[sought if len(sought) else seen.healthy]


def _many_unexplained(seen: Judged, limit: float) -> bool:
    return len(seen.unexplained) > max(2, limit * len(seen.names))


def _few_right(seen: Judged, limit: float) -> bool:
    """Return whether too many given positions (at least two) are misplaced, or too few are right to fix a frame."""
    problem, wrong = seen.estimate.problem, seen.wrong_given
    few = bool(wrong) and len(problem.known) - len(wrong) < problem.array_dimension + 1
    return few or sum(one.kind == "misplaced" for one in wrong) > max(1, limit * len(problem.known))


def _disagreement(seen: Judged) -> str:
    found = "pressures" if len(seen.estimate.problem.known) else "array found without them"
    chance = f"1 of {1 / seen.agreement:.0f}" if seen.agreement > 1e-6 else "less than 1 of 1000000"
    return (
        f"the positions given and the {found} do not agree; chance causes such a disagreement in {chance} cases: a"
        " given position or the sound speed is wrong, or the array was not found"
    )


def _impossible_speed(seen: Judged) -> str:
    given, c = "position of a microphone" if seen.scale is None else "distance", seen.estimate.problem.sound_speed
    return (
        f"from the given {given} the sound speed would be {c * seen.speed[0]:.0f} m/s, not {c:.0f} m/s; the {given} or"
        " the sound speed is wrong, or the array was not found"
    )


def _good(seen: Judged) -> str:
    """Return the message for an array that no check contradicts, with the faults of its channels."""
    given, words = seen.estimate.given, precision(_sought_sigma(seen))
    if len(seen.estimate.problem.known) and given.sigma > INACCURATE * given.expected_sigma:
        words += f"; the given positions are inaccurate, one sigma {length_text(given.sigma, 2)}"
    if seen.estimate.window_ratio > CONTRADICTION:
        apart = np.sqrt(seen.estimate.window_ratio)
        words += f"; short windows and long spectra are {apart:.1f} sigma apart, so that one sigma is enlarged"
    if seen.estimate.flat:
        words += "; the array is flat, so that all heights were held near a plane"
    if not seen.faulty:
        return f"no check contradicts the positions found; {words}"
    faults = faults_text(seen.faulty.values())
    return f"no check contradicts the positions found for the other microphones; {words}; faulty: {faults}"


INACCURATE = 2.0  # ratio of the sigma of the given positions to the expected one above which the message mentions it


def precision(sigma: np.ndarray) -> str:
    """Return the root mean square of one sigma (N,), metres, over the microphones, in words."""
    return f"one sigma {length_text(root_mean_square(sigma), 2)}"


MORE_KNOWN = 4  # number of further microphones whose positions a remedy asks for: enough to fix a frame in space


def _positions_of(seen: Judged, doubt: np.ndarray) -> str:
    """Return words that name the positions of the healthy, unknown microphones with the largest `doubt` (N,)."""
    doubt = np.where(seen.healthy, doubt, 0.0)
    doubt[seen.estimate.problem.known] = 0.0
    chosen = [int(n) for n in np.argsort(-doubt, kind="stable")[:MORE_KNOWN] if doubt[n] > 0]
    of = "position of microphone" if len(chosen) == 1 else "positions of microphones"
    return f"the {of} {listed(seen.names[n] for n in sorted(chosen))} (<known>)"


def _least_certain(seen: Judged) -> str:
    return _positions_of(seen, one_sigma(seen.covariance))


def _in_doubt(seen: Judged) -> str:
    """Return the words for the positions that decide between the array and its rival."""
    away = np.where(np.isin(np.arange(len(seen.rival)), seen.estimate.problem.known), 0.0, seen.rival)
    return _positions_of(seen, np.where(away >= away.max() / 2, away, 0.0))


def _other_minimum(seen: Judged, limit: float) -> bool:
    """Return whether a microphone has a larger residual than the field of a room explains, and may stand elsewhere.

    In living rooms and halls the position of such a microphone is usually right nevertheless. The limit is higher with
    few frequencies, because the estimate of a channel's noise from M frequencies has an error of about 1 / sqrt(M).
    """
    least = max(limit, 1 + 9 / np.sqrt(len(seen.estimate.field.power)))
    judged = seen.noisiest >= 0 and seen.by_rows and seen.noise_fraction > ROOM_FRACTION
    return judged and bool(seen.estimate.channels.noise[seen.noisiest] > least)


@dataclass(frozen=True)
class Finding:
    """One row of a table."""

    code: str  # code of the verdict
    applies: Callable[[Judged, float], bool]  # maps evidence and limit to whether the finding applies
    words: Callable[[Judged], str]  # maps the evidence to a text that says what was found
    # what the user can do: a text, or a function that maps the evidence to one; "" if `words` already says it
    remedy: str | Callable[[Judged], str] = ""
    limit: float = 0.0  # the threshold
    # what is compared with the limit, and why it has this value; without a limit, the meaning of the condition
    reason: str = ""


# fmt: off
FINDINGS: tuple[Finding, ...] = (
    # code, condition, words, remedy, limit, its reason
    Finding("too_noisy", lambda seen, limit: seen.noise_fraction > limit,
            lambda seen: f"about {100 * seen.noise_fraction:.0f} % of the power is noise or unexplained",
            "measure ten times longer, or 10 dB louder",
            0.3, "ratio of the noise to the power; above the limit the search seldom finds the array"),
    Finding("model_mismatch", lambda seen, _: seen.single_wave, lambda _: SINGLE_WAVE, SINGLE_WAVE_REMEDY,
            reason="a single wave passes the array because there are hardly any reflections"),
    Finding("model_mismatch",  # if half of the faulty channels are noisy, the next row decides: the field may be wrong
            lambda seen, limit: len(seen.channel_faults) > max(2, limit * len(seen.names))
            and not (2 * seen.noisy.sum() >= len(seen.channel_faults) and _many_unexplained(seen, MAX_UNEXPLAINED)),
            _many_faulty, "check their cables and gains",
            0.3, "fraction of channels with a fault of their own; above the limit too few healthy ones remain"),
    Finding("model_mismatch", _many_unexplained,
            lambda seen: "no sound field without sources explains microphone"
                         f" {listed(one.name for one in seen.unexplained)}: {CAUSES}",
            "", MAX_UNEXPLAINED, "fraction of channels not explained by the field; so many have a common cause"),
    Finding("model_mismatch", lambda seen, limit: seen.by_rows
            and np.sum(seen.uneven) >= max(3, limit * len(seen.uneven)),
            lambda seen: f"the residual of {np.sum(seen.uneven)} of {len(seen.uneven)} microphones is {UNEVEN:g} times"
                         f" that of the median one, or more: {CAUSES}",
            "", 0.1, "fraction of uneven channels; below the limit they are faults of single channels"),
    Finding("undersampled", lambda seen, _: seen.estimate.interpolates and seen.highest > seen.f_max,
            lambda seen: f"{np.sum(seen.healthy)} microphones so far apart interpolate up to {seen.f_max:.0f} Hz"
                         f" (Eq. 9), but frequencies up to {seen.highest:.0f} Hz are in use",
            "use more microphones closer together", reason="frequencies above f_max (Eq. 9) are in use"),
    Finding("not_converged", lambda seen, limit: not seen.estimate.ended or seen.step_left >= limit,
            lambda seen: f"the solver ended while microphones still moved, by up to {seen.step_left:.2g} sigma", "",
            3.0, "ratio of the remaining Newton step to one sigma"),
    Finding("known_position", _few_right,
            lambda seen: f"known microphone {listed(one.name for one in seen.wrong_given)}: the position given"
                         " contradicts the recordings; it or the sound speed is wrong, or the channel is swapped"
                         " with another",
            "check the positions and the cables of the known microphones",
            0.2, "fraction of misplaced given positions; above the limit the frame of the array is unreliable"),
    Finding("known_position", lambda seen, limit: seen.agreement <= limit,
            _disagreement,
            "",
            0.01, "probability of the disagreement by chance: one healthy array in a hundred is suspected"),
    Finding("model_mismatch",
            lambda seen, limit: seen.by_rows and (given := seen.given_noise or 0.0) > 0
            and seen.noise_fraction > limit * given + ROOM_RESIDUAL,
            lambda seen: f"the residual is {seen.noise_fraction / (seen.given_noise or 1.0):.2g} times what the noise"
                         f" explains: {CAUSES}",
            "", 2.0, "ratio of the noise found, less 0.001 of the power as in healthy rooms, to the noise given"),
    Finding("model_mismatch", lambda seen, limit: seen.by_rows and seen.given_noise == 0
            and seen.noise_fraction > limit,
            lambda seen: f"{100 * seen.noise_fraction:.1g} % of the power is left unexplained, though the"
                         f" measurement is said to be free of noise: {CAUSES}",
            "", UNEXPLAINED, "unexplained fraction of the power of a measurement said to be free of noise"),
    Finding("sound_speed",  # whatever the sigma, a difference of 15 % is an error
            lambda seen, limit: (seen.scale is not None or seen.estimate.log_speed != 0)
            and abs(seen.speed[0] - 1) > min(limit + 4 * seen.speed[1], 0.15),
            _impossible_speed,
            "", 0.05, "relative difference of the sound speed implied: 5 % are 30 K in air"),
    Finding("scale_undetermined",  # carry_scale: a plane array in space without short windows
            lambda seen, limit: not len(seen.estimate.problem.known) and seen.scale is None
            and (seen.scale_sigma > limit or seen.estimate.given.carry_scale),
            lambda _: "no check contradicts the shape found, but the size of the array is hardly determined",
            lambda seen: f"give {_least_certain(seen)}, or one <distance>",
            0.1, "relative sigma of the least certain stretching or shearing of an array without known microphones"),
    Finding("ambiguous", lambda seen, limit: seen.estimate.given.mirror_advantage < limit,
            lambda seen: f"the mirror image of the array fits the given positions as well: these lie nearly"
                         f" {'on a line' if seen.estimate.positions.shape[1] == 2 else 'in a plane'}",
            lambda seen: f"{MORE_MODES}give {_least_certain(seen)}",
            3.0, "nats by which the array is likelier than its mirror image; 3 nats give the latter 5 % probability"),
    Finding("ambiguous", lambda seen, _: bool(seen.rival.any()),
            lambda seen: "another array explains the pressures as well; in it microphone"
                         f" {seen.names[int(seen.rival.argmax())]} is {100 * seen.rival.max():.2g} cm away",
            lambda seen: f"{MORE_MODES}give {_in_doubt(seen)}, or record another take with the source elsewhere",
            reason="another array explains the pressures as well"),
    Finding("ambiguous", _other_minimum,
            lambda seen: f"microphone {seen.names[seen.noisiest]} has"
                         f" {seen.estimate.channels.noise[seen.noisiest]:.2g} times the noise of the others: it may"
                         " stand elsewhere, or the room causes this at its right position",
            lambda seen: f"{MORE_MODES}give {_least_certain(seen)}",
            2.3, "ratio of a channel's noise to that of the median channel"),
    Finding("ambiguous", lambda seen, limit: seen.uncertain > limit * seen.radius,
            lambda seen: f"the positions are uncertain by {100 * seen.uncertain:.2g} cm",
            lambda seen: f"{MORE_MODES}give {_least_certain(seen)}, or record with less noise",
            0.1, "ratio of one sigma of the positions to the root mean square radius of the array"),
    Finding("ambiguous",
            lambda seen, limit: bool(len(seen.estimate.problem.known))
            and seen.loosest >= max(limit, 3 * seen.uncertain),
            lambda seen: "an error of a given position would not be noticed: without this position the sigma of its"
                         f" microphone is {length_text(seen.loosest, 2)}",
            lambda seen: f"{MORE_MODES}give {_least_certain(seen)}",
            0.04, "metres, sigma of a known microphone without its given position; at least 3 sigmas of the array"),
    Finding("good", lambda seen, _: True, _good, reason="no check has found anything"),
)
# fmt: on


def first_finding(seen: Judged, findings: Sequence[Finding] = FINDINGS) -> tuple[str, str]:
    """Return the code of the first finding that applies, and its message: words and remedy in one line."""
    found = next(one for one in findings if one.applies(seen, one.limit))
    words, measured = found.words(seen), seen.estimate.problem.frequencies
    used = len(measured[seen.estimate.modes])
    more = f"use <modes> {min(2 * used, len(measured))}, or " if used < len(measured) else ""
    remedy = (found.remedy if isinstance(found.remedy, str) else found.remedy(seen)).replace(MORE_MODES, more)
    return found.code, f"{words}; {remedy}" if remedy else words
