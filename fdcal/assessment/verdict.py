"""Whether an array found can be trusted, as a fixed code and in plain words. The figures are those of
`fdcal.assessment.diagnostics`.

good                nothing speaks against it
odd_channel         a microphone that hears what no microphone there could
too_noisy           hardly anything but noise
known_position      a known microphone that is not where it is told to be, or whose channel is another's
undersampled        frequencies in use that the array cannot interpolate (Eq. 9)
not_converged       the solver stopped while microphones still moved
sound_speed         the known microphones agree with each other at another speed of sound
model_mismatch      the pressures are no sound field without sources at these microphones
ambiguous           another array explains the pressures nearly as well, or the positions are hardly determined
scale_undetermined  the shape is right, its size hardly determined
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import array_f_max
from ..cost.likelihood import newton_terms
from ..cost.noise_model import NOISE
from ..model.gauge import align, position_errors
from ..model.problem import Problem
from ..model.validation import frozen_array
from ..solvers.levenberg_marquardt import FIRST_DAMPING, damped_step
from .diagnostics import Diagnostics, diagnose
from .uncertainty import one_sigma, pressures_and_field

# Part of a channel's power that the others do not foretell; the same over the median channel's, and over what they
# cannot foretell where it was put: far out in a sparse array that is much.
ODD = 0.1, 4.0, 3.0
FLED = 0.5, 3.0  # part of its variance that they cannot foretell; likewise
SURPRISE = 3.0  # times 1 + 3 / sqrt(M): a channel's mean squared surprise over the median channel's
FAINT = 1e-4  # noise below this part of the power shows the limits of the real kernel, not of the model
RESIDUAL = 2.0  # residual over the noise told
UNTOLD = 3e-3  # part of the power that may be left unexplained where the measurement says that there is no noise
NOISY = 0.3  # part of the power
SPEED = 0.01, 0.15, 4.0  # least and greatest relative error that is taken for one of the sound speed; in sigmas
MOVED = 0.01, 5.0  # metres and sigmas that a known microphone is away
LOOSE = 0.1  # one sigma over the array's root mean square radius
SCALE = 0.05  # one sigma of the size, relative
AWAY = 20.0  # sigmas of the least certain microphone: known ones further from a line tell its sides apart
RIVAL = 6.0  # difference of -log density below which another array is as good


@dataclass(frozen=True)
class Verdict:
    """What to think of an array found.

    Attributes
    ----------
    code : one of those above
    text : what it means and what to do, one line
    uncertainty : (N,) float64, metres, one sigma: square root of the trace of the covariance; 0 for a known microphone
    covariance : (N, D, D) float64, metres^2
    residual_to_noise : float, reduced chi-square
    """

    code: str
    text: str
    uncertainty: np.ndarray
    covariance: np.ndarray
    residual_to_noise: float


def judge(
    problem: Problem,
    positions,
    modes: slice,
    noise: np.ndarray | None = None,
    names: Sequence[str] | None = None,
    converged: bool = True,
    rivals: Sequence[tuple[np.ndarray, float]] = (),
) -> Verdict:
    """Verdict on `positions` (N, D), metres.

    noise : (M,) float64, supposed by the solver of all measured modes, in the unit of abs(problem.pressures)**2
    names : (N,) of the microphones; their numbers unless given
    rivals : other minima that the solver met: positions (N, D) and by how much their cost is higher
    """
    positions = np.asarray(positions, float)
    names = [str(n) for n in range(len(positions))] if names is None else list(names)
    evidence = diagnose(problem, positions, modes, noise)
    others = [*rivals, *_mirrored(problem, positions, modes, noise, evidence)]
    findings = (
        ("odd_channel", _odd(problem, evidence, names)),
        ("too_noisy", _noisy(evidence)),
        ("known_position", _known(problem, evidence, names, wide=True)),
        ("undersampled", _undersampled(problem, positions, modes)),
        ("not_converged", "" if converged else "the solver stopped while microphones still moved; use other --modes"),
        ("sound_speed", _sound_speed(problem, evidence)),
        ("known_position", _known(problem, evidence, names)),
        ("model_mismatch", _mismatch(problem, evidence, names, modes)),
        ("ambiguous", _ambiguous(problem, positions, evidence, others)),
        ("scale_undetermined", _scale(problem, evidence)),
        ("good", _good(problem, evidence)),
    )
    code, text = next(finding for finding in findings if finding[1])
    uncertainty = frozen_array(one_sigma(evidence.covariance), float)
    return Verdict(code, text, uncertainty, frozen_array(evidence.covariance, float), evidence.residual_to_noise)


def _undersampled(problem: Problem, positions, modes: slice) -> str:
    limit = array_f_max(positions, problem.sound_speed, problem.dimension)
    used = problem.frequencies[modes]
    if used[-1] <= limit:
        return ""
    below = int(np.sum(problem.frequencies <= limit))
    remedy = f"use --modes {below}, or" if below >= 8 else "use"
    return (
        f"{len(positions)} microphones so far apart interpolate up to {limit:.0f} Hz (Eq. 9), but modes up to"
        f" {used[-1]:.0f} Hz are in use; {remedy} more microphones closer together"
    )


def _odd(problem: Problem, evidence: Diagnostics, names) -> str:
    share, alone = evidence.unforetold, evidence.alone
    odd = _strange(evidence) | (alone > max(FLED[0], FLED[1] * np.median(alone)))
    odd[problem.known] = False
    worst = np.flatnonzero(odd)
    worst = worst[np.argsort(-share[worst])]
    if not len(worst) or len(worst) > max(2, len(names) // 5):
        return ""
    named = [names[n] for n in worst]
    return (
        f"microphone {_list(named)}: not what the others foretell there; another kind of channel, gain, phase, or"
        f" place; leave it out with --exclude {','.join(named)}"
    )


def _strange(evidence: Diagnostics) -> np.ndarray:
    """(N,) bool, whether a channel holds much that the others do not foretell."""
    share = evidence.unforetold
    return (share > max(ODD[0], ODD[1] * np.median(share))) & (share > ODD[2] * evidence.alone)


def _known(problem: Problem, evidence: Diagnostics, names, wide: bool = False) -> str:
    """Known microphones out of place; with `wide` only those that cannot be a sound speed told a little wrong."""
    out = _strange(evidence)[problem.known]
    if not wide:
        out |= (evidence.known_shift > MOVED[0]) & (evidence.known_chance > MOVED[1])
    if not np.any(out):
        return ""
    named = [names[n] for n in problem.known[out]]
    return (
        f"known microphone {_list(named)}: not where told to be by what all hear; a wrong position, or a channel"
        " swapped with another's; check the positions and the cables of the known microphones"
    )


def _noisy(evidence: Diagnostics) -> str:
    if evidence.noise_share <= NOISY:
        return ""
    share = 100 * evidence.noise_share
    return f"about {share:.0f} % of the power is noise or unexplained; measure longer, louder, or use fewer --modes"


def _sound_speed(problem: Problem, evidence: Diagnostics) -> str:
    wrong, sigma = evidence.sound_speed, evidence.sound_speed_sigma
    if not (SPEED[0] < abs(wrong) < SPEED[1] and abs(wrong) > SPEED[2] * sigma):
        return ""
    return (
        f"the known microphones speak for a sound speed of about {problem.sound_speed * (1 + wrong):.0f} m/s, not"
        f" {problem.sound_speed:.0f} m/s; correct it, or add --estimate-sound-speed"
    )


def _mismatch(problem: Problem, evidence: Diagnostics, names, modes: slice) -> str:
    told = problem.noise_power
    cause = "a source or an obstacle inside the array, odd channels, or positions not found yet (try another solver)"
    if np.isfinite(evidence.strain):  # the real kernel, of which the rest speaks, leaves more than there is noise
        misfit = f"no sound field without sources explains the pressures (misfit {evidence.strain:.2g}, 1 is expected)"
        if evidence.strain > NOISE.chi_square or evidence.noise_share <= UNTOLD:
            return f"{misfit}: {cause}" if evidence.strain > NOISE.chi_square else ""
    if evidence.noise_share < FAINT and evidence.residual_to_noise < RESIDUAL:
        return ""
    if told is not None and np.all(told[modes] > 0) and evidence.residual_to_noise > RESIDUAL:
        return f"the residual is {evidence.residual_to_noise:.2g} times what the noise explains: {cause}"
    if told is not None and not np.any(told[modes]) and evidence.noise_share > UNTOLD:
        share = f"{100 * evidence.noise_share:.1g} % of the power"
        return f"{share} is left unexplained, though the measurement is said to be free of noise: {cause}"
    ratio = evidence.surprise / np.median(evidence.surprise)
    count = len(problem.frequencies[modes])
    worst = [n for n in np.argsort(-ratio) if ratio[n] > SURPRISE * (1 + 3 / np.sqrt(count))][:3]
    if not worst:
        return ""
    return f"no sound field without sources explains microphone {_list([names[n] for n in worst])}: {cause}"


def _ambiguous(problem: Problem, positions, evidence: Diagnostics, others) -> str:
    size = np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1)))
    sigma = one_sigma(evidence.covariance)
    if np.sqrt(np.mean(sigma**2)) > LOOSE * size and not _unscaled(problem, evidence):
        return (
            f"the positions are uncertain by {100 * np.sqrt(np.mean(sigma**2)):.2g} cm; use more --modes, more known"
            " microphones, or less noise"
        )
    for rival, higher in others:
        away = np.sqrt(
            np.mean(position_errors(rival if len(problem.known) else align(rival, positions), positions) ** 2)
        )
        if higher < RIVAL and away > max(3 * np.sqrt(np.mean(sigma**2)), 0.01 * size):
            return (
                f"another array, {100 * away:.2g} cm away, explains the pressures as well; use more --modes, or known"
                " microphones that lie less on one line"
            )
    return ""


def _unscaled(problem: Problem, evidence: Diagnostics) -> bool:
    """Whether only an uncertain wavenumber tells the size: always so for a plane in space, blind."""
    flat = problem.array_dimension < problem.dimension
    return len(problem.known) < 2 and (flat or evidence.scale > SCALE)


def _scale(problem: Problem, evidence: Diagnostics) -> str:
    if not _unscaled(problem, evidence):
        return ""
    return "the shape is found but its scale is not determined; name known microphones, or give one --distance"


def _good(problem: Problem, evidence: Diagnostics) -> str:
    sigma = one_sigma(evidence.covariance)
    told = problem.noise_power is not None and np.any(problem.noise_power > 0)
    return (
        f"nothing speaks against these positions; one sigma {1e3 * np.sqrt(np.mean(sigma**2)):.2g} mm, residual"
        f" {evidence.residual_to_noise:.2g} times the noise {'told' if told else 'estimated from the residual itself'}"
    )


def _mirrored(problem: Problem, positions, modes: slice, noise, evidence) -> list[tuple[np.ndarray, float]]:
    """The array mirrored at the line or plane nearest to the known microphones, settled there, and its extra cost.

    Known microphones that lie nearly on one line leave the side open. Where the nearest line or plane misses them by
    more than AWAY times what a microphone is uncertain by, they do not.
    """
    known = problem.known
    if len(known) < 2 or not len(problem.free):
        return []
    p, field = pressures_and_field(problem, positions, modes, noise)
    centre = positions[known].mean(axis=0)
    normal = np.linalg.svd(positions[known] - centre)[2][-1]
    if np.abs((positions[known] - centre) @ normal).max() > AWAY * one_sigma(evidence.covariance).max():
        return []
    other = positions - 2 * np.outer((positions - centre) @ normal, normal)
    other[known] = positions[known]
    D = positions.shape[1]
    basis = np.eye(positions.size)[:, (D * problem.free[:, None] + np.arange(D)).ravel()]
    damping, cost = FIRST_DAMPING, newton_terms(positions, p, field)[0]
    for _ in range(6):
        trial = damped_step(other, p, field, basis, damping)
        other, damping = trial.positions, trial.damping
    return [(other, float(trial.cost - cost))]


def _list(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
