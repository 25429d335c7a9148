"""The single checks of a verdict. Each returns a message, or "" where there is nothing to report.

The arguments of a remedy stand in angle brackets, as in `fdcal.model.validation.InputError`. In every function
`figures` are the `Diagnostics` of the array and `names` the (N,) names of its microphones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..acoustics import single_wave
from ..acoustics.fourier_bessel import array_f_max
from ..cost.noise_model import NOISE
from ..model.lengths import length_text
from ..model.problem import Problem
from .diagnostics import Diagnostics
from .error_ellipses import one_sigma
from .finding_texts import CAUSES, contradicted, enumerated, mostly_noise, unexplained, unfitted
from .thresholds import LIMITS

MODES_MARGIN = 0.9  # of the highest frequency that the array found can interpolate, in the remedy
FEWEST_MODES = 8  # with fewer modes below the limit, fewer modes are no remedy
SCALE_UNDETERMINED = (
    "nothing speaks against the shape of the array, but its size is hardly determined; name known microphones, or give"
    " one <distance> with <estimate_sound_speed>"
)
NOT_CONVERGED = "the solver stopped while microphones still moved; use other <modes>"
SINGLE_WAVE = f"{single_wave.PROBLEM}; {single_wave.REMEDY}"


def undersampled(problem: Problem, positions: np.ndarray, modes: slice) -> str:
    """Report modes above f_max (Eq. 9) that are in use.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes : slice, the modes in use
    """
    limit = array_f_max(positions, problem.sound_speed, problem.dimension)
    used = problem.frequencies[modes]
    if used[-1] <= limit:
        return ""
    below = modes_below_limit(problem, positions)
    remedy = f"use <modes> {below}, or" if below >= FEWEST_MODES else "use"
    return (
        f"{len(positions)} microphones so far apart interpolate up to {limit:.0f} Hz (Eq. 9), but modes up to"
        f" {used[-1]:.0f} Hz are in use; {remedy} more microphones closer together"
    )


def modes_below_limit(problem: Problem, positions: np.ndarray) -> int:
    """Return the number of modes below f_max (Eq. 9) of an array found at `positions` (N, D), metres.

    The array is another with other modes: MODES_MARGIN below the limit ends the search in one step.
    """
    limit = array_f_max(positions, problem.sound_speed, problem.dimension)
    return int(np.sum(problem.frequencies <= MODES_MARGIN * limit))


def odd_channel(problem: Problem, figures: Diagnostics, names: Sequence[str]) -> str:
    """Report free microphones that recorded what the others cannot predict, unless these are many."""
    share, far = figures.unpredicted_share, figures.unpredictable_share
    odd = _unpredicted(figures)
    odd |= far > max(LIMITS.unpredictable_share, LIMITS.unpredictable_to_median * np.median(far))
    odd[problem.known] = False
    worst = np.flatnonzero(odd)
    worst = worst[np.argsort(-share[worst])]
    if not len(worst) or len(worst) > max(LIMITS.odd_channels, len(names) // LIMITS.odd_one_in):
        return ""
    named = [names[int(n)] for n in worst]
    return (
        f"microphone {enumerated(named)}: the others do not predict what it recorded; another kind of channel, gain,"
        f" phase, or position; leave it out with <exclude> {','.join(named)}"
    )


def _unpredicted(figures: Diagnostics) -> np.ndarray:
    """Return whether the others fail to predict each channel : (N,) bool."""
    share = figures.unpredicted_share
    large = share > max(LIMITS.unpredicted_share, LIMITS.unpredicted_to_median * np.median(share))
    return large & (share > LIMITS.unpredicted_to_unpredictable * figures.unpredictable_share)


def known_position(problem: Problem, figures: Diagnostics, names: Sequence[str], clear_only: bool = False) -> str:
    """Report known microphones that are elsewhere than given.

    Parameters
    ----------
    clear_only : whether to leave out shifts that a small error of the sound speed could cause
    """
    out = _unpredicted(figures)[problem.known]
    if not clear_only:
        out |= (figures.known_shift > LIMITS.known_shift) & (figures.known_mahalanobis > LIMITS.known_sigmas)
    if not np.any(out):
        return ""
    return contradicted([names[int(n)] for n in problem.known[out]])


def too_noisy(figures: Diagnostics) -> str:
    """Report that most of the power is noise."""
    return "" if figures.noise_share <= LIMITS.noise_share else mostly_noise(figures.noise_share)


def sound_speed(problem: Problem, figures: Diagnostics) -> str:
    """Report that the known microphones contradict the sound speed."""
    error, sigma = figures.sound_speed_error, figures.sound_speed_sigma
    plausible = LIMITS.sound_speed_least < abs(error) < LIMITS.sound_speed_most
    if not (plausible and abs(error) > LIMITS.sound_speed_sigmas * sigma):
        return ""
    return (
        f"the known microphones indicate a sound speed of about {problem.sound_speed * (1 + error):.0f} m/s, not"
        f" {problem.sound_speed:.0f} m/s; correct it, or add <estimate_sound_speed>"
    )


def implied_speed(sound_speed: float, stretch: float | None, scale_sigma: float, given: str = "distance") -> str:
    """Report given lengths from which a sound speed follows that the air can hardly have.

    Parameters
    ----------
    sound_speed : of the measurement, m/s
    stretch : the sound speed that follows over that of the measurement; None where no distance is given
    scale_sigma : one sigma of the size of the array, relative
    given : what has them, a distance or a position
    """
    uncertain = LIMITS.implied_speed + LIMITS.sound_speed_sigmas * scale_sigma
    if stretch is None or abs(stretch - 1) <= min(uncertain, LIMITS.sound_speed_most):
        return ""
    return (
        f"with the {given} given the sound speed would be {sound_speed * stretch:.0f} m/s, not"
        f" {sound_speed:.0f} m/s; the {given} or the sound speed is wrong, or the array was not"
        " found"
    )


def model_mismatch(problem: Problem, figures: Diagnostics, names: Sequence[str], modes: slice) -> str:
    """Report that no sound field without sources fits the pressures.

    Parameters
    ----------
    modes : slice, the modes in use
    """
    if np.isfinite(figures.chi_square):
        # Where this figure exists, the others show the limits of the real kernel rather than of the positions.
        if figures.chi_square > NOISE.chi_square:
            return (
                "no sound field without sources explains the pressures"
                f" (misfit {figures.chi_square:.2g}, 1 is expected): {CAUSES}"
            )
        if figures.noise_share <= LIMITS.unexplained_share:
            return ""
    if figures.noise_share < LIMITS.kernel_share and figures.residual_to_noise < LIMITS.residual_to_noise:
        return ""
    return _excess_residual(problem, figures, modes) or _unfitted_channels(figures, names, modes, problem)


def _excess_residual(problem: Problem, figures: Diagnostics, modes: slice) -> str:
    """Report that the residual exceeds the given noise."""
    given = problem.noise_power
    if given is None:
        return ""
    if np.all(given[modes] > 0) and figures.residual_to_noise > LIMITS.residual_to_noise:
        return f"the residual is {figures.residual_to_noise:.2g} times what the noise explains: {CAUSES}"
    if not np.any(given[modes]) and figures.noise_share > LIMITS.unexplained_share:
        return unexplained(figures.noise_share)
    return ""


def _unfitted_channels(figures: Diagnostics, names: Sequence[str], modes: slice, problem: Problem) -> str:
    """Report the channels, three at most, with a studentised residual far above the median."""
    ratio = figures.studentised_residual / np.median(figures.studentised_residual)
    count = len(problem.frequencies[modes])
    limit = LIMITS.studentised_to_median * (1 + LIMITS.studentised_modes / np.sqrt(count))
    worst = [names[int(n)] for n in np.argsort(-ratio) if ratio[n] > limit][:3]
    return unfitted(worst) if worst else ""


def only_wavenumber_scales(problem: Problem, figures: Diagnostics) -> bool:
    """Return whether the size of the array follows from the wavenumber alone, and that hardly.

    It is always so for an array in a plane of a field of three dimensions without known microphones.
    """
    flat = problem.array_dimension < problem.dimension
    return len(problem.known) < 2 and (flat or figures.scale_sigma > LIMITS.scale_sigma)


def hardly_determined(sigma: float) -> str:
    """Return the message of positions with so large a one sigma, metres."""
    return (
        f"the positions are uncertain by {100 * sigma:.2g} cm; use more <modes>, more known microphones, or less noise"
    )


def equally_likely(away: float) -> str:
    """Return the message of another array so far away, metres, that fits as well."""
    return (
        f"another array, {100 * away:.2g} cm away, explains the pressures as well; use more <modes>, or known"
        " microphones that lie less on one line"
    )


def scale_undetermined(problem: Problem, figures: Diagnostics, sized: bool = False) -> str:
    """Report that the size of the array is hardly determined, unless it is `sized` by a given distance."""
    if sized or not only_wavenumber_scales(problem, figures):
        return ""
    return SCALE_UNDETERMINED


def good(problem: Problem, figures: Diagnostics) -> str:
    """Return the message of an array that no check contradicts."""
    given = problem.noise_power is not None and np.any(problem.noise_power > 0)
    return "nothing speaks against these positions; " + precision(
        one_sigma(figures.covariance), figures.residual_to_noise, bool(given)
    )


def precision(sigma: np.ndarray, residual_to_noise: float, given: bool) -> str:
    """Return the uncertainty in words, and where the noise is given the residual over it (reduced chi-square).

    Parameters
    ----------
    sigma : (N,) float64, metres; 0 for a known microphone that the solver held, which does not count
    given : whether the noise is given; a residual over the noise that was estimated from it tells nothing
    """
    sought = sigma[sigma > 0] if np.any(sigma > 0) else sigma
    text = f"one sigma {length_text(root_mean_square(sought), 2)}"
    return f"{text}, residual {residual_to_noise:.2g} times the noise given" if given else text


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of some values."""
    return float(np.sqrt(np.mean(values**2)))
