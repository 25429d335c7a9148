"""The prediction of each microphone by the others, from the sound field between them.

The expansion of Eq. 2 is fitted to the pressures of each frequency. The prior of its coefficients is a diffuse field in
noise, so that a high order does no harm. The fit is the conditional mean of a Gaussian process with the covariance
s W W^H + v I; k may be complex. The leave-one-out error of p_n is

    (C^-1 p)_n / (C^-1)_nn,    C = W W^H + mu I,    mu = v / (NOISE_DEFLATION s)

    W        dictionary at the microphones, about the centre of the array (Eq. 4, or its equivalent in space)
    s, v     power of the field and of the noise

Cross-validation does not need the true positions and can therefore check every calibration. It is slightly optimistic,
because the pressures of a microphone were used to estimate its position.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..cost.kernels import applied, blocks, hermitian_inverses
from ..cost.likelihood import FieldModel, field_covariance, isotropic_field
from ..cost.noise import DIFFUSE_FLOOR, estimate_noise
from ..model.problem import Problem, mode_power
from ..model.validation import frozen_array

NOISE_DEFLATION = 3.0  # divisor of the noise in mu, because a room's field is less isotropic than this prior
TINY = np.finfo(float).tiny


def leave_one_out_errors(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None = None, healthy: np.ndarray | None = None
) -> np.ndarray:
    """Return the pressure of each microphone minus its prediction by the others : (modes, N) complex128.

    positions : (N, D), metres; noise : (M,), noise power, estimated if None; healthy : (N,) bool, microphones from
    which the others are predicted, None for all
    """
    x, errors = np.asarray(positions, float), np.array(problem.pressures[modes])
    seen = np.ones(len(x), bool) if healthy is None else healthy
    some = replace(problem, pressures=problem.pressures[:, seen])
    field = replace(_field(some, x[seen], modes, noise), wavenumbers=problem.wavenumbers[modes], about=x[seen])
    mu, diagonal = field.noise / (NOISE_DEFLATION * field.power), np.arange(int(np.sum(seen)))
    for m in blocks(len(errors), 2 * len(x) ** 2):
        K = field_covariance(x, field, m, False)[0]
        C = K[:, seen][:, :, seen]
        C[:, diagonal, diagonal] += mu[m, None]
        inverse = hermitian_inverses(np.ascontiguousarray(C))[0]
        u = applied(inverse, errors[m][:, seen])
        errors[m, ~seen] -= applied(np.ascontiguousarray(K[:, ~seen][:, :, seen]), u)
        errors[m, seen] = u / np.real(inverse[:, diagonal, diagonal])
    return errors


def _field(problem: Problem, positions, modes: slice, noise: np.ndarray | None) -> FieldModel:
    """Return an isotropic field of the modes in use, with the `noise` (M,) or, without it, with the estimated noise."""
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    power = mode_power(p)
    if noise is None:
        unit = p / np.sqrt(power)[:, None]
        field = isotropic_field(unit, k, np.zeros(len(p)), problem.dimension)
        v = estimate_noise(positions, unit, field, DIFFUSE_FLOOR).alone * power
    else:
        v = np.maximum(np.asarray(noise)[modes], DIFFUSE_FLOOR * power)
    return isotropic_field(p, k, v, problem.dimension)


@dataclass(frozen=True)
class CrossValidation:
    """Leave-one-out prediction error relative to the pressure, in decibels."""

    overall: float  # power of the error divided by that of the pressures, every mode with the same weight
    microphones: np.ndarray  # (N,) float64, the same for each microphone
    modes: np.ndarray  # (modes in use,) float64, the same for each mode


def cross_validate(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None = None, healthy: np.ndarray | None = None
) -> CrossValidation:
    """Return the normalised leave-one-out errors of the pressures of some modes.

    problem : a problem whose pressures were divided by the gains of the channels; positions, modes, noise, healthy :
    see `leave_one_out_errors`. If too few channels are healthy to predict the others, all channels are used.
    """
    if healthy is not None and (np.all(healthy) or np.sum(healthy) <= problem.array_dimension):
        healthy = None
    return summarise(problem.pressures[modes], leave_one_out_errors(problem, positions, modes, noise, healthy), healthy)


def summarise(pressures: np.ndarray, errors: np.ndarray, healthy: np.ndarray | None = None) -> CrossValidation:
    """Return normalised powers of the leave-one-out errors (M, N); averages are over the `healthy` microphones."""
    counted = slice(None) if healthy is None else healthy
    power = mode_power(pressures[:, counted])[:, None]
    signal, error = np.abs(pressures) ** 2 / power, np.abs(errors) ** 2 / power
    return CrossValidation(
        overall=float(_decibels(error[:, counted].sum() / signal[:, counted].sum())),
        microphones=frozen_array(_decibels(error.sum(axis=0) / np.maximum(signal.sum(axis=0), TINY)), float),
        modes=frozen_array(_decibels(error[:, counted].mean(axis=1)), float),
    )


def _decibels(ratio):
    return 10 * np.log10(np.maximum(ratio, 1e-30))
