"""Whether an array found in a room of known size can be trusted, and its mirror images.

good             nothing speaks against it
odd_channel      a microphone whose pressures the room cannot explain anywhere near where it was put
too_noisy        hardly anything but noise
room_size        the pressures are those of a room of another size (or of another speed of sound)
not_converged    the solver stopped while microphones still moved
known_position   a known microphone is found elsewhere than it is told to be
model_mismatch   the pressures are not those of one source in an empty rectangular room of about this size
ambiguous        the positions are hardly determined

One sigma is that of the exact model with its source, walls and loudness unknown, enlarged by what is left unexplained.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.room_modes import RoomSymmetry, room_symmetries
from ..model.problem import Problem
from ..model.validation import frozen_array
from ..solvers.room.fit import FIRST_DAMPING, Exact, damped, exact
from ..solvers.room.state import freedom, scaled
from .uncertainty import SINGULAR
from .verdict import LOOSE, MOVED, NOISY, RESIDUAL, UNTOLD, Verdict

ODD = 6.0  # times the median microphone's part of the residual
RESIZED = 2e-3, 5.0  # relative length and sigmas by which a room is of another size
LOOSEST = 0.1  # metres: one sigma
RESIZING_STEPS = 12


@dataclass(frozen=True)
class RoomVerdict:
    """Verdict, and what else a known room tells.

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


def judge(problem: Problem, state, names: Sequence[str]) -> RoomVerdict:
    """Verdict on the end of solver "room"."""
    size, (N, D) = state.settings.room, state.positions.shape
    p, noise, k = scaled(problem, state, state.modes)
    fit = exact(state.theta, p, noise, k, size)
    free = freedom(len(p), N, D)
    left = float(np.sum(np.abs(fit.residual) ** 2)) / free
    curvature = fit.terms(state.theta, N, D).curvature
    covariance = _inverse(curvature) * max(1.0, left)
    blocks = np.array([covariance[D * n : D * n + D, D * n : D * n + D] for n in range(N)])
    sigma = np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))
    lengths = fitted_size(state.theta, p, noise, k, size, left)
    share = float(np.exp(np.mean(np.log(noise)))) * (left if state.noise_told else 1.0)
    findings = (
        ("odd_channel", _odd(fit, names)),
        ("too_noisy", f"{100 * share:.0f} % of the power is unexplained" if share > NOISY else ""),
        ("room_size", _size(lengths, size, left)),
        ("model_mismatch", _mismatch(state.noise_told, left, share)),
        ("not_converged", "" if state.converged else "the solver stopped while microphones still moved"),
        ("known_position", _known(problem, state.positions, sigma, names)),
        ("ambiguous", _loose(state.positions, sigma)),
        ("good", _good(sigma, left, size, state.noise_told)),
    )
    code, text = next(finding for finding in findings if finding[1])
    verdict = Verdict(code, text, frozen_array(sigma, float), frozen_array(blocks, float), left)
    place, walls = state.walls[:D], complex(*state.walls[D:])
    return RoomVerdict(verdict, leave_one_out_errors(fit, p), place, walls, room_symmetries(size))


def leave_one_out_errors(fit: Exact, pressures) -> np.ndarray:
    """Pressure of each microphone less what the others foretell there : (modes, N) complex128."""
    part = np.abs(fit.fitted) ** 2
    leverage = part / part.sum(axis=1, keepdims=True)
    return (pressures - fit.fitted) / np.maximum(1 - leverage, 1e-9)


def fitted_size(theta, pressures, noise, wavenumbers, size, left: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Relative lengths of the room that fit best, (D,) beyond 1, one sigma (D,), and what they leave of the residual.

    left : what the size told leaves; with little, one step tells.
    """
    N, D = pressures.shape[1], len(size)
    grown = np.concatenate([theta, np.zeros(D)])
    damping, step = FIRST_DAMPING, None

    def cost(y) -> float:
        return exact(y, pressures, noise, wavenumbers, size, False).terms(y, N, D).cost

    for _ in range(RESIZING_STEPS if left > RESIDUAL else 1):
        terms = exact(grown, pressures, noise, wavenumbers, size).terms(grown, N, D)
        step = damped(grown, terms, cost, lambda y: y, N * D, damping, 0.5)
        grown, damping = step.theta, step.damping
        if step.moved < 1e-5:
            break
    after = step.cost / freedom(len(pressures), N, D)
    sigma = np.sqrt(np.diag(_inverse(terms.curvature))[-D:] * max(1.0, after))
    return grown[-D:], sigma, after


def _inverse(curvature: np.ndarray) -> np.ndarray:
    """Inverse, a direction that the pressures hardly see as uncertain as numbers can tell."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors / np.maximum(values, SINGULAR * values[-1])) @ vectors.T


def _odd(fit: Exact, names) -> str:
    part = np.sum(np.abs(fit.residual) ** 2, axis=0)
    worst = int(part.argmax())
    if len(part) < 5 or part[worst] < ODD * np.median(part) or part[worst] < RESIDUAL * len(fit.residual):
        return ""
    name = names[worst]
    return f"microphone {name}: no place in this room explains what it hears; leave it out with --exclude {name}"


def _size(found, size, left: float) -> str:
    longer, sigma, after = found
    clear = (np.abs(longer) > RESIZED[0]) & (np.abs(longer) > RESIZED[1] * sigma)
    if not clear.any() or (left > RESIDUAL and after > 0.5 * left):
        return ""
    better = " x ".join(f"{length * (1 + more):.3f}" for length, more in zip(size, longer, strict=True))
    return f"a room of {better} m explains the pressures better: correct --room, or the sound speed"


def _mismatch(told: bool, left: float, share: float) -> str:
    cause = "another size or shape, things in the room, several sources, a source within a metre, or odd channels"
    if told and left > RESIDUAL:
        return f"the residual is {left:.2g} times what the noise explains: {cause}"
    if not told and share > UNTOLD:
        return f"{100 * share:.2g} % of the power is left unexplained; if that is not noise: {cause}"
    return ""


def _known(problem: Problem, positions, sigma, names) -> str:
    away = np.linalg.norm(positions[problem.known] - problem.known_positions, axis=1)
    out = away > np.maximum(MOVED[0], MOVED[1] * sigma[problem.known])
    if not out.any():
        return ""
    named = ", ".join(f"{names[n]} ({100 * d:.2g} cm)" for n, d in zip(problem.known[out], away[out], strict=True))
    return f"known microphones are found elsewhere than told: {named}; are they counted from a corner of the room?"


def _loose(positions, sigma) -> str:
    size = np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1)))
    rms = float(np.sqrt(np.mean(sigma**2)))
    if rms <= min(LOOSEST, LOOSE * size):
        return ""
    return f"the positions are uncertain by {100 * rms:.2g} cm; use more --modes, or less noise"


def _good(sigma, left: float, size, told: bool) -> str:
    return (
        f"nothing speaks against these positions up to the room's {len(room_symmetries(size))} symmetries; one sigma"
        f" {1e3 * np.sqrt(np.mean(sigma**2)):.2g} mm, residual {left:.2g} times the noise"
        f" {'told' if told else 'estimated from the residual itself'}"
    )
