"""The sound field between the microphones, and the prediction of each microphone by the others.

The expansion of Eq. 2 is fitted to the pressures of each frequency with a prior: the coefficients are those of a
diffuse field in noise, so that a high order does no harm. This is the conditional mean of a Gaussian process with the
covariance s W W^H + v I; k may be complex.

    alpha = A^-1 W^H p,    A = W^H W + mu I,    mu = v / s,    p(x) = w(x)^T alpha,    sigma(x)^2 = v w^T A^-1 w*

    W, w     dictionary at the microphones and at x, about the centre of the array (Eq. 4, or its like in space)
    s, v     power of the field and of the noise
    C        W W^H + mu I; the others predict p_n up to the leave-one-out error (C^-1 p)_n / (C^-1)_nn

Neither needs the true positions, so that cross-validation checks a calibration in the field. It is a little optimistic:
the pressures of a microphone also helped to estimate its own position.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from ..acoustics.dictionary import dictionary
from ..acoustics.fourier_bessel import max_order
from ..cost.circular_waves import circular_waves, combined_waves
from ..cost.likelihood import DiffuseField
from ..cost.low_rank_covariance import EXTRA_ORDERS
from ..cost.mode_sums import blocks
from ..cost.spherical_covariance import series_covariance
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import frozen_array
from .uncertainty import pressures_and_field

NOISE_DEFLATION = 3.0  # times less noise is assumed: a room's field is less isotropic than this prior
BLOCK = 4096  # points evaluated at a time
TINY = np.finfo(float).tiny


@dataclass(frozen=True)
class Expansion:
    """The field of one frequency.

    Attributes
    ----------
    wavenumber : complex, rad/m
    order : L
    centre : (D,) float64, metres
    coefficients : (K,) complex128, alpha, in the unit of the pressures
    factor : (K, K) complex128, lower triangular, A = factor factor^H
    noise : float, v, in the unit of abs(pressures)**2
    dimension : 2 or 3, of the sound field
    """

    wavenumber: complex
    order: int
    centre: np.ndarray
    coefficients: np.ndarray
    factor: np.ndarray
    noise: float
    dimension: int

    def at(self, points) -> tuple[np.ndarray, np.ndarray]:
        """Return the pressure at some points and its standard deviation.

        Parameters
        ----------
        points : (C, D) float64, metres

        Returns
        -------
        pressure : (C,) complex128
        sigma : (C,) float64, one standard deviation, in the unit of the pressure
        """
        pressure, sigma = np.empty(len(points), complex), np.empty(len(points))
        for start in range(0, len(points), BLOCK):
            block = slice(start, start + BLOCK)
            w = dictionary(points[block], self.wavenumber, self.order, self.centre, self.dimension)
            whitened = solve_triangular(self.factor, w.conj().T, lower=True)
            pressure[block] = w @ self.coefficients
            sigma[block] = np.sqrt(self.noise * np.sum(np.abs(whitened) ** 2, axis=0))
        return pressure, sigma


def expansions(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> list[Expansion]:
    """Return the field of each mode, fitted to the microphones.

    Parameters
    ----------
    positions : (N, D) float64, metres
    modes : the modes to fit
    noise : (M,) float64, of all measured modes, in the unit of abs(problem.pressures)**2; None to estimate it
    """
    positions = np.asarray(positions, float)
    pressures, field = pressures_and_field(problem, positions, modes, noise)
    centre = frozen_array(positions.mean(axis=0), float)
    orders = _orders(field, positions).tolist()
    every = zip(problem.wavenumbers[modes], orders, pressures, field.power, field.noise, strict=True)
    return [_fit(positions, complex(k), order, centre, p, v, s, problem.dimension) for k, order, p, s, v in every]


def _fit(positions, k: complex, order: int, centre, p, v: float, s: float, dimension: int) -> Expansion:
    W = dictionary(positions, k, order, centre, dimension)
    A = W.conj().T @ W
    A[np.diag_indices(len(A))] += v / (NOISE_DEFLATION * s)
    G = cholesky(A, lower=True)
    alpha = solve_triangular(G, solve_triangular(G, W.conj().T @ p, lower=True), lower=True, trans=2)  # G^-H
    return Expansion(k, order, centre, alpha, G, float(v), dimension)


def leave_one_out_errors(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> np.ndarray:
    """Return the pressure of each microphone less its prediction by all the others.

    Parameters as of `expansions`.

    Returns
    -------
    (modes, N) complex128, in the unit of problem.pressures
    """
    positions = np.asarray(positions, float)
    pressures, field = pressures_and_field(problem, positions, modes, noise)
    centre, orders, k = positions.mean(axis=0), _orders(field, positions), problem.wavenumbers[modes]
    mu, errors = field.noise / (NOISE_DEFLATION * field.power), []
    for m in blocks(len(k), positions.size**2):
        gains = np.ones((len(k[m]), int(orders.max()) + 1))
        if problem.dimension == 2:
            W = circular_waves(positions, centre, k[m].astype(complex), orders[m], gains, False)[0]
            errors.append(_low_rank_errors(combined_waves(W)[0], pressures[m], mu[m]))
        else:
            K = series_covariance(positions, centre, k[m], orders[m], gains, False)[0]
            inverse = np.linalg.inv(K + mu[m, None, None] * np.eye(len(positions)))
            diagonal = np.diagonal(inverse, axis1=1, axis2=2)
            errors.append((inverse @ pressures[m, :, None])[..., 0] / diagonal)
    return np.concatenate(errors)


def _low_rank_errors(W, p, mu) -> np.ndarray:
    """C^-1 p over the diagonal of C^-1, with C^-1 = (I - W A^-1 W^H) / mu; W (M, r, N), p (M, N), mu (M,)."""
    WH = np.conj(W)
    B = np.linalg.solve(WH @ W.swapaxes(1, 2) + mu[:, None, None] * np.eye(W.shape[1]), WH)
    fitted = W.swapaxes(1, 2) @ (B @ p[..., None])
    return (p - fitted[..., 0]) / (1 - np.sum(W * B, axis=1))


def _orders(field: DiffuseField, positions) -> np.ndarray:
    """Return L of every mode, about the centre of mass."""
    radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return max_order(field.wavenumbers, radius, EXTRA_ORDERS)


@dataclass(frozen=True)
class CrossValidation:
    """Leave-one-out prediction error over pressure, in decibels.

    Attributes
    ----------
    overall : float, power of the error over power of the pressures, every mode with the same weight
    microphones : (N,) float64, likewise of each microphone
    modes : (modes in use,) float64, of each frequency
    """

    overall: float
    microphones: np.ndarray
    modes: np.ndarray


def cross_validate(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> CrossValidation:
    """Return the normalised leave-one-out errors; parameters as of `expansions`."""
    return summarise(problem.pressures[modes], leave_one_out_errors(problem, positions, modes, noise))


def cross_validate_healthy(problem: Problem, positions, modes: slice, healthy: np.ndarray) -> CrossValidation:
    """Return the normalised leave-one-out errors where some channels are faulty.

    The healthy microphones predict each other and the faulty ones; the figures of the array and of each frequency are
    those of the healthy microphones alone.

    Parameters
    ----------
    problem : Problem, with pressures divided by the gains of the channels
    positions : (N, D) float64, metres
    modes : slice, the modes in use
    healthy : (N,) bool
    """
    positions = np.asarray(positions, float)
    if np.all(healthy) or np.sum(healthy) <= problem.array_dimension:
        return cross_validate(problem, positions, modes)
    some = replace(problem, pressures=problem.pressures[:, healthy])
    found = cross_validate(some, positions[healthy], modes)
    predicted = _predicted(some, positions, healthy, modes)
    p = problem.pressures[modes][:, ~healthy]
    power = mode_power(some.pressures[modes])[:, None]
    error, signal = (np.sum(np.abs(x) ** 2 / power, axis=0) for x in (p - predicted, p))
    microphones = np.empty(len(positions))
    microphones[healthy], microphones[~healthy] = found.microphones, _decibels(error / np.maximum(signal, TINY))
    return CrossValidation(found.overall, frozen_array(microphones, float), found.modes)


def _predicted(problem: Problem, positions, healthy: np.ndarray, modes: slice) -> np.ndarray:
    """Return what the healthy microphones predict of the others : (modes, F) complex128, F others.

    W_f W_h^H C^-1 p: equal to the expansion at these places, and quick at any order, since C is as large as the array.
    """
    pressures, field = pressures_and_field(problem, positions[healthy], modes, None)
    centre, orders = positions[healthy].mean(axis=0), _orders(field, positions[healthy]).tolist()
    mu, predicted = field.noise / (NOISE_DEFLATION * field.power), []
    for k, order, p, weight in zip(problem.wavenumbers[modes], orders, pressures, mu, strict=True):
        W = dictionary(positions, complex(k), order, centre, problem.dimension)
        WH = W[healthy].conj().T
        C = W[healthy] @ WH + weight * np.eye(len(p))
        predicted.append(W[~healthy] @ (WH @ np.linalg.solve(C, p)))
    return np.array(predicted)


def summarise(pressures: np.ndarray, errors: np.ndarray) -> CrossValidation:
    """Return the normalised powers of leave-one-out errors.

    Parameters
    ----------
    pressures : (M, N) complex128
    errors : (M, N) complex128, in the same unit
    """
    power = mode_power(pressures)[:, None]
    signal, error = np.abs(pressures) ** 2 / power, np.abs(errors) ** 2 / power
    return CrossValidation(
        overall=float(_decibels(error.sum() / signal.sum())),
        microphones=frozen_array(_decibels(error.sum(axis=0) / signal.sum(axis=0)), float),
        modes=frozen_array(_decibels(error.mean(axis=1)), float),
    )


def _decibels(ratio):
    return 10 * np.log10(np.maximum(ratio, 1e-30))
