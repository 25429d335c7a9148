"""Whether an array estimated in a room of known size can be trusted, and its mirror images.

good             no check contradicts it
odd_channel      a microphone whose pressures no position in the room explains
too_noisy        hardly anything but noise
room_size        the pressures are those of a room of another size (or of another speed of sound)
not_converged    the solver stopped while microphones still moved
known_position   a known microphone is estimated elsewhere than given
model_mismatch   the pressures are not those of one source in an empty rectangular room of about this size
ambiguous        the positions are hardly determined

One sigma is that of the exact model with its source, walls and loudness unknown, enlarged by the excess residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.room_symmetry import RoomSymmetry, room_symmetries
from ..model.problem import Problem
from ..model.validation import frozen_array
from ..solvers.levenberg_marquardt import DAMPING
from ..solvers.room.fit import Exact, bounded_step, degrees_of_freedom, exact
from ..solvers.room.solver import scaled
from .ambiguity import rms_radius
from .error_ellipses import one_sigma
from .findings import precision, root_mean_square
from .thresholds import LIMITS, ROOM_LIMITS
from .uncertainty import bounded_inverse
from .verdict import Verdict

MAX_SIZE_STEPS = 12  # of the fit of the size
SIZE_TOLERANCE = 1e-5  # metres: a shorter step ends that fit


@dataclass(frozen=True)
class RoomVerdict:
    """The verdict, and the other estimates in a known room.

    Attributes
    ----------
    verdict : fdcal.assessment.verdict.Verdict
    leave_one_out_errors : (modes, N) complex128, pressure of each microphone less its prediction by the others, with
        every mode scaled to unit RMS
    source : (D,) float64, metres
    admittance : complex, of the walls
    images : symmetries of the room, the identity first
    """

    verdict: Verdict
    leave_one_out_errors: np.ndarray
    source: np.ndarray
    admittance: complex
    images: list[RoomSymmetry]


@dataclass(frozen=True)
class SizeFit:
    """The room that fits best.

    Attributes
    ----------
    change : (D,) float64, relative change of each length
    sigma : (D,) float64, one sigma of it
    residual : float, reduced chi-square with these lengths
    """

    change: np.ndarray
    sigma: np.ndarray
    residual: float


def judge(problem: Problem, state, names: Sequence[str]) -> RoomVerdict:
    """Return the verdict on the last state of solver "room": the first finding in the order below.

    Parameters
    ----------
    state : fdcal.solvers.room.solver.State
    names : (N,) names of the microphones
    """
    size, (N, D) = state.settings.room, state.positions.shape
    p, noise, k = scaled(problem, state, state.modes)
    fit = exact(state.theta, p, noise, k, size)
    residual = float(np.sum(np.abs(fit.residual) ** 2)) / degrees_of_freedom(len(p), N, D)
    blocks = _covariances(fit, (N, D), residual)
    sigma = one_sigma(blocks)
    better = _fitted_size(state.theta, p, noise, k, size, residual)
    share = float(np.exp(np.mean(np.log(noise)))) * (residual if state.noise.given else 1.0)
    noisy = f"{100 * share:.0f} % of the power is unexplained" if share > LIMITS.noise_share else ""
    found = (
        ("odd_channel", _odd_channel(fit, names)),
        ("too_noisy", noisy),
        ("room_size", _room_size(better, size, residual)),
        ("model_mismatch", _model_mismatch(state.noise.given, residual, share)),
        ("not_converged", "" if state.converged else "the solver stopped while microphones still moved"),
        ("known_position", _known_position(problem, state.positions, sigma, names)),
        ("ambiguous", _ambiguous(state.positions, sigma)),
        ("good", _good(sigma, residual, size, state.noise.given)),
    )
    code, message = next(finding for finding in found if finding[1])
    verdict = Verdict(code, message, frozen_array(sigma, float), frozen_array(blocks, float), residual)
    source, admittance = state.walls[:D], complex(*state.walls[D:])
    return RoomVerdict(verdict, _leave_one_out_errors(fit, p), source, admittance, room_symmetries(size))


def _covariances(fit: Exact, shape: tuple[int, int], residual: float) -> np.ndarray:
    """Return the covariance of each position, (N, D, D) metres^2, enlarged by the excess residual."""
    N, D = shape
    covariance = bounded_inverse(fit.terms.curvature) * max(1.0, residual)
    return np.array([covariance[D * n : D * n + D, D * n : D * n + D] for n in range(N)])


def _leave_one_out_errors(fit: Exact, pressures) -> np.ndarray:
    """Return the pressure of each microphone less its prediction by the others : (M, N) complex128."""
    part = np.abs(fit.fitted) ** 2
    leverage = part / part.sum(axis=1, keepdims=True)
    return (pressures - fit.fitted) / np.maximum(1 - leverage, 1e-9)


def _fitted_size(theta, pressures, noise, wavenumbers, size, residual: float) -> SizeFit:
    """Return the lengths of the room that fit best, everything else adapting to them.

    It starts at the solution `theta` with the given size. Where its reduced chi-square `residual` is small, one step is
    enough.
    """
    N, D = pressures.shape[1], len(size)
    grown, damping = np.concatenate([theta, np.zeros(D)]), DAMPING.first
    model = pressures, noise, wavenumbers, size
    for _ in range(MAX_SIZE_STEPS if residual > LIMITS.residual_to_noise else 1):
        terms, free = exact(grown, *model).terms, (-np.inf, np.inf)
        step = bounded_step(grown, terms, lambda y: exact(y, *model, False).cost, free, N * D, damping, max_step=0.5)
        grown, damping = step.unknowns, step.damping
        if step.moved < SIZE_TOLERANCE:
            break
    after = step.cost / degrees_of_freedom(len(pressures), N, D)
    sigma = np.sqrt(np.diag(bounded_inverse(terms.curvature))[-D:] * max(1.0, after))
    return SizeFit(grown[-D:], sigma, after)


def _odd_channel(fit: Exact, names: Sequence[str]) -> str:
    part = np.sum(np.abs(fit.residual) ** 2, axis=0)
    worst = int(part.argmax())
    large = part[worst] >= ROOM_LIMITS.odd_residual * np.median(part)
    beyond_noise = part[worst] >= LIMITS.residual_to_noise * len(fit.residual)
    if len(part) < ROOM_LIMITS.odd_microphones or not (large and beyond_noise):
        return ""
    name = names[worst]
    return f"microphone {name}: no place in this room explains its recording; leave it out with <exclude> {name}"


def _room_size(better: SizeFit, size, residual: float) -> str:
    change = np.abs(better.change)
    clear = (change > ROOM_LIMITS.size_error) & (change > ROOM_LIMITS.size_sigmas * better.sigma)
    improves = better.residual <= ROOM_LIMITS.size_improvement * residual
    if not clear.any() or (residual > LIMITS.residual_to_noise and not improves):
        return ""
    lengths = " x ".join(f"{length * (1 + more):.3f}" for length, more in zip(size, better.change, strict=True))
    return f"a room of {lengths} m explains the pressures better: correct <room>, or the sound speed"


def _model_mismatch(noise_given: bool, residual: float, share: float) -> str:
    causes = "another size or shape, objects in the room, several sources, a source within a metre, or odd channels"
    if noise_given and residual > LIMITS.residual_to_noise:
        return f"the residual is {residual:.2g} times what the noise explains: {causes}"
    if not noise_given and share > LIMITS.unexplained_share:
        return f"{100 * share:.2g} % of the power is left unexplained; if that is not noise: {causes}"
    return ""


def _known_position(problem: Problem, positions, sigma: np.ndarray, names: Sequence[str]) -> str:
    away = np.linalg.norm(positions[problem.known] - problem.known_positions, axis=1)
    out = away > np.maximum(LIMITS.known_shift, LIMITS.known_sigmas * sigma[problem.known])
    if not out.any():
        return ""
    named = ", ".join(f"{names[n]} ({100 * d:.2g} cm)" for n, d in zip(problem.known[out], away[out], strict=True))
    return (
        f"known microphones are estimated elsewhere than given: {named}; are the positions measured from a corner of"
        " the room?"
    )


def _ambiguous(positions, sigma: np.ndarray) -> str:
    rms = root_mean_square(sigma)
    if rms <= min(ROOM_LIMITS.sigma, LIMITS.relative_sigma * rms_radius(positions)):
        return ""
    return f"the positions are uncertain by {100 * rms:.2g} cm; use more <modes>, or less noise"


def _good(sigma: np.ndarray, residual: float, size, noise_given: bool) -> str:
    count = len(room_symmetries(size))
    return (
        f"nothing speaks against these positions up to the room's {count} symmetries;"
        f" {precision(sigma, residual, noise_given)}"
    )
