"""The figures that support or contradict estimated positions, without a judgement.

C, u   covariance of the pressures of one mode at the estimated positions; C^-1 p
d      diagonal of C^-1. u_n / d_n is the leave-one-out error of microphone n, its pressure less the prediction by all
       the others, with the variance 1 / d_n.
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

CHI_SQUARE_MODES = 24  # at most, to save time


@dataclass(frozen=True)
class Diagnostics:
    """Figures on an estimated array.

    Attributes
    ----------
    covariance : (N, D, D) float64, metres^2
    scale_sigma : float, one sigma of the array's size, relative
    residual_to_noise : float, reduced chi-square: squared residual over its expectation for the noise assumed, with the
        degrees of freedom of field and coordinates taken off
    noise_share : float, noise assumed over power of the pressures, geometric mean over the modes
    studentised_residual : (N,) float64, squared leave-one-out error over its variance, mean over the modes; 1 is
        expected
    unpredicted_share : (N,) float64, power of the leave-one-out error over the power of the microphone
    unpredictable_share : (N,) float64, share of the variance of a microphone that the others cannot predict at its
        estimated position; 1 for a microphone far from all others
    chi_square : float, normalised chi-square, p^H C^-1 p over the number of pressures, with the near-field model; 1 is
        expected; nan where there is so much noise that the solver does without that model
    sound_speed_error, sound_speed_sigma : float, relative error of the given sound speed, and its one sigma; nan where
        known microphones do not determine it
    known_shift : (A,) float64, metres, how far each known microphone would move if it were free; nan where the others
        do not determine its position
    known_mahalanobis : (A,) float64, Mahalanobis distance of that shift, in sigmas
    """

    covariance: np.ndarray
    scale_sigma: float
    residual_to_noise: float
    noise_share: float
    studentised_residual: np.ndarray
    unpredicted_share: np.ndarray
    unpredictable_share: np.ndarray
    chi_square: float
    sound_speed_error: float
    sound_speed_sigma: float
    known_shift: np.ndarray
    known_mahalanobis: np.ndarray


def diagnose(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> Diagnostics:
    """Return the figures on estimated positions, from the modes in use.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes : slice, the modes in use
    noise : (M,) float64, assumed by the solver of all measured modes, in the unit of abs(problem.pressures)**2; None to
        estimate it here
    """
    positions = np.asarray(positions, float)
    p, field = pressures_and_field(problem, positions, modes, noise)
    found = information(positions, p, field, problem.known)
    sound_speed_error, sigma = _sound_speed(found, positions, problem.known)
    shift, mahalanobis = _known(found, positions, problem.known)
    power = mode_power(p)
    return Diagnostics(
        covariance=robust_covariance(found),
        scale_sigma=scale_sigma(found, positions) if len(problem.known) < 2 else 0.0,
        noise_share=float(np.exp(np.mean(np.log(field.noise / power)))),
        **_residuals(positions, p, field, found.basis.shape[1]),
        chi_square=_chi_square(problem, positions, modes, noise),
        sound_speed_error=sound_speed_error,
        sound_speed_sigma=sigma,
        known_shift=shift,
        known_mahalanobis=mahalanobis,
    )


def _residuals(positions, p, field: DiffuseField, coordinates: int) -> dict:
    """Return residual_to_noise, studentised_residual, unpredicted_share and unpredictable_share of `Diagnostics`."""
    u, d = precision_terms(positions, p, field)
    v = field.noise[:, None]
    freedom = np.sum(v * d) - coordinates / 2  # in complex numbers
    errors = np.abs(u / d) ** 2
    return {
        "residual_to_noise": float(np.sum(v * np.abs(u) ** 2) / max(freedom, 1.0)),
        "studentised_residual": np.mean(np.abs(u) ** 2 / d, axis=0),
        "unpredicted_share": np.sum(errors / field.power[:, None], axis=0)
        / np.sum(np.abs(p) ** 2 / field.power[:, None], axis=0),
        "unpredictable_share": np.mean(1 / (d * (field.power[:, None] + v)), axis=0),
    }


def _chi_square(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> float:
    """Return `Diagnostics.chi_square` of evenly spaced modes."""
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    given = problem.noise_power if noise is None else noise
    if given is None:
        return np.nan
    share = float(np.median(np.asarray(given)[modes] / mode_power(p)))
    if share > NOISE.near_field(problem.dimension):
        return np.nan
    some = slice(None, None, max(1, -(-len(p) // CHI_SQUARE_MODES)))
    return estimate_noise(positions, p[some], k[some], problem.dimension, True, share).chi_square


def _sound_speed(found: Information, positions, known) -> tuple[float, float]:
    """Return the relative error of the given sound speed: wavenumbers times 1 + e are distances times 1 + e."""
    N, D = found.shape
    if len(known) < 2:
        return np.nan, np.nan
    larger = np.zeros((N, D))
    larger[known] = positions[known] - positions[known].mean(axis=0)
    e, variance = step_along(found, larger.reshape(-1, 1))
    return float(-e[0]), float(np.sqrt(variance[0, 0]))


def _known(found: Information, positions, known) -> tuple[np.ndarray, np.ndarray]:
    """Return known_shift and known_mahalanobis of `Diagnostics`."""
    N, D = found.shape
    shift, mahalanobis = np.full(len(known), np.nan), np.full(len(known), np.nan)
    if len(known) > D and fixes_gauge(positions[known]):
        for i, n in enumerate(known):
            step, variance = step_along(found, np.eye(N * D)[:, D * n : D * (n + 1)])
            shift[i] = np.linalg.norm(step)
            mahalanobis[i] = np.sqrt(step @ np.linalg.solve(variance, step))
    return shift, mahalanobis
