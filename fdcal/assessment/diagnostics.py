"""What speaks for and against positions that were found: numbers, without a judgement.

C, u   covariance of the pressures of one mode at the positions found; C^-1 p
d      diagonal of C^-1; u_n / d_n is the pressure at microphone n less what all the others foretell of it, with
       the variance 1 / d_n (leave-one-out, in closed form)
v      noise power; v u is the residual of the field that fits best, with the expected square v^2 d
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.leave_one_out import precision_terms
from ..cost.likelihood import DiffuseField
from ..cost.noise_model import NOISE, estimate_noise
from ..model.gauge import fixes_gauge
from ..model.power import mode_power
from ..model.problem import Problem
from .uncertainty import Information, information, pressures_and_field, robust_covariance, scale_sigma, step_along

STRAIN_MODES = 24  # at most


@dataclass(frozen=True)
class Diagnostics:
    """Figures of an array found.

    Attributes
    ----------
    covariance : (N, D, D) float64, metres^2
    scale : float, one sigma of the array's size, relative
    residual_to_noise : float, reduced chi-square: squared residual over what the noise supposed leaves of it, with the
        degrees of freedom of field and coordinates taken off
    noise_share : float, noise supposed over power of the pressures, geometric mean over the modes
    surprise : (N,) float64, squared leave-one-out residual over its variance, mean over the modes; 1 is expected
    unforetold : (N,) float64, squared leave-one-out residual over the microphone's power
    alone : (N,) float64, part of the variance of a microphone that the others cannot foretell where it was put; 1 for
        one that has fled from the array
    strain : float, p^H C^-1 p over the number of pressures, 1 is expected; of the near model, and nan where there is so
        much noise that the solver does without it
    sound_speed, sound_speed_sigma : float, relative error of the sound speed told, and its one sigma; nan where known
        microphones do not tell
    known_shift, known_chance : (A,) float64, how far each known microphone would move if it might, metres, and that
        in sigmas; nan where the others do not hold it
    """

    covariance: np.ndarray
    scale: float
    residual_to_noise: float
    noise_share: float
    surprise: np.ndarray
    unforetold: np.ndarray
    alone: np.ndarray
    strain: float
    sound_speed: float
    sound_speed_sigma: float
    known_shift: np.ndarray
    known_chance: np.ndarray


def diagnose(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> Diagnostics:
    """Evidence on `positions` (N, D), metres, from the modes in use.

    noise : (M,) float64, that the solver supposed of all measured modes, or None to estimate it here
    """
    positions = np.asarray(positions, float)
    p, field = pressures_and_field(problem, positions, modes, noise)
    found = information(positions, p, field, problem.known)
    sound_speed, sigma = _sound_speed(found, positions, problem.known)
    shift, chance = _known(found, positions, problem.known)
    power = mode_power(p)
    return Diagnostics(
        covariance=robust_covariance(found),
        scale=scale_sigma(found, positions) if len(problem.known) < 2 else 0.0,
        noise_share=float(np.exp(np.mean(np.log(field.noise / power)))),
        **_residuals(positions, p, field, found.basis.shape[1]),
        strain=_strain(problem, positions, modes, noise),
        sound_speed=sound_speed,
        sound_speed_sigma=sigma,
        known_shift=shift,
        known_chance=chance,
    )


def _residuals(positions, p, field: DiffuseField, coordinates: int) -> dict:
    """residual_to_noise, surprise, unforetold and alone of `Diagnostics`."""
    u, d = precision_terms(positions, p, field)
    v = field.noise[:, None]
    freedom = np.sum(v * d) - coordinates / 2  # in complex numbers
    foretold = np.abs(u / d) ** 2
    return {
        "residual_to_noise": float(np.sum(v * np.abs(u) ** 2) / max(freedom, 1.0)),
        "surprise": np.mean(np.abs(u) ** 2 / d, axis=0),
        "unforetold": np.sum(foretold / field.power[:, None], axis=0)
        / np.sum(np.abs(p) ** 2 / field.power[:, None], axis=0),
        "alone": np.mean(1 / (d * (field.power[:, None] + v)), axis=0),
    }


def _strain(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> float:
    """`Diagnostics.strain`, of a part of the modes, evenly taken."""
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    told = problem.noise_power if noise is None else noise
    if told is None:
        return np.nan
    share = float(np.median(np.asarray(told)[modes] / mode_power(p)))
    if share > NOISE.near_field(problem.dimension):
        return np.nan
    some = slice(None, None, max(1, -(-len(p) // STRAIN_MODES)))
    return estimate_noise(positions, p[some], k[some], problem.dimension, True, share).chi_square


def _sound_speed(found: Information, positions, known) -> tuple[float, float]:
    """Relative error of the sound speed told: wavenumbers times 1 + e are distances times 1 + e."""
    N, D = found.shape
    if len(known) < 2:
        return np.nan, np.nan
    larger = np.zeros((N, D))
    larger[known] = positions[known] - positions[known].mean(axis=0)
    e, variance = step_along(found, larger.reshape(-1, 1))
    return float(-e[0]), float(np.sqrt(variance[0, 0]))


def _known(found: Information, positions, known) -> tuple[np.ndarray, np.ndarray]:
    """known_shift and known_chance of `Diagnostics`."""
    N, D = found.shape
    shift, chance = np.full(len(known), np.nan), np.full(len(known), np.nan)
    if len(known) > D and fixes_gauge(positions[known]):
        for i, n in enumerate(known):
            step, variance = step_along(found, np.eye(N * D)[:, D * n : D * (n + 1)])
            shift[i] = np.linalg.norm(step)
            chance[i] = np.sqrt(step @ np.linalg.solve(variance, step))
    return shift, chance
