"""Listening back: what the microphones, where they were found, tell of the sound field between them.

Of each frequency the expansion of Eq. 2 is fitted to the pressures with the weight that its coefficients deserve as
those of a diffuse field in noise, so that an order too many does no harm. In other words the conditional mean of a
Gaussian process whose covariance is s W W^H + v I; k may be complex.

    alpha = A^-1 W^H p,    A = W^H W + mu I,    mu = v / s,    p(x) = w(x)^T alpha,    sigma(x)^2 = v w^T A^-1 w*

    W, w     dictionary at the microphones and at x, about the centre of the array (Eq. 4, or its like in space)
    s, v     power of the field and of the noise
    C        W W^H + mu I; leaving microphone n out, the others foretell p_n but for (C^-1 p)_n / (C^-1)_nn

Nothing of it needs the true positions, so `left_out` checks a calibration in the field. It is a little optimistic: the
microphone left out stands where its own pressures, among others, have put it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from ..acoustics.fourier_bessel import fourier_bessel, max_order
from ..acoustics.spherical_harmonics import spherical_bessel
from ..cost.likelihood import DiffuseField
from ..cost.low_rank_covariance import AMPLE, circular, spherical
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import frozen_array
from .uncertainty import pressures_and_field

LESS = 3.0  # less noise is supposed than there is: a room's field is less isotropic than this prior
BLOCK = 4096  # points at a time


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
    noise : float, v
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
        """Pressure (C,) complex128 and its one sigma (C,) float64 at `points` (C, D), metres."""
        pressure, sigma = np.empty(len(points), complex), np.empty(len(points))
        for start in range(0, len(points), BLOCK):
            block = slice(start, start + BLOCK)
            w = dictionary(points[block], self.wavenumber, self.order, self.centre, self.dimension)
            spread = solve_triangular(self.factor, w.conj().T, lower=True)
            pressure[block] = w @ self.coefficients
            sigma[block] = np.sqrt(self.noise * np.sum(np.abs(spread) ** 2, axis=0))
        return pressure, sigma


def dictionary(points, wavenumber: complex, order: int, centre, dimension: int) -> np.ndarray:
    """W of a sound field of two or three dimensions at `points` (C, D), metres : (C, K) complex128."""
    functions = fourier_bessel if dimension == 2 else spherical_bessel
    return functions(np.asarray(points, float), complex(wavenumber), order, centre)


def expansions(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> list[Expansion]:
    """The field of every one of `modes`, about microphones at `positions` (N, D), metres.

    noise : (M,) float64 of all measured modes, in the unit of abs(problem.pressures)**2; estimated unless given
    """
    positions = np.asarray(positions, float)
    pressures, field = pressures_and_field(problem, positions, modes, noise)
    centre = frozen_array(positions.mean(axis=0), float)
    every = zip(problem.wavenumbers[modes], _orders(field, positions), pressures, field.power, field.noise, strict=True)
    return [_fit(positions, complex(k), order, centre, p, v, s, problem.dimension) for k, order, p, s, v in every]


def _fit(positions, k: complex, order: int, centre, p, v: float, s: float, dimension: int) -> Expansion:
    W = dictionary(positions, k, order, centre, dimension)
    A = W.conj().T @ W
    A[np.diag_indices(len(A))] += v / (LESS * s)
    G = cholesky(A, lower=True)
    alpha = solve_triangular(G, solve_triangular(G, W.conj().T @ p, lower=True), lower=True, trans="C")
    return Expansion(k, order, centre, alpha, G, float(v), dimension)


def leave_one_out_errors(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> np.ndarray:
    """Pressure of each microphone less what all the others foretell there : (modes, N) complex128.

    Arguments as of `expansions`; the unit is that of problem.pressures.
    """
    positions = np.asarray(positions, float)
    pressures, field = pressures_and_field(problem, positions, modes, noise)
    errors = np.empty_like(pressures)
    every = zip(problem.wavenumbers[modes], _orders(field, positions), pressures, field.power, field.noise, strict=True)
    for error, (k, order, p, s, v) in zip(errors, every, strict=True):
        mu = v / (LESS * s)
        if problem.dimension == 2:  # C^-1 = (I - W A^-1 W^H) / mu
            W = circular(positions, complex(k), order, positions.mean(axis=0))
            WH = W.conj().T
            B = np.linalg.solve(WH @ W + mu * np.eye(len(WH)), WH)
            error[:] = (p - W @ (B @ p)) / (1 - np.sum(W.T * B, axis=0))
        else:
            inverse = np.linalg.inv(spherical(positions, k, order, positions.mean(axis=0)) + mu * np.eye(len(p)))
            error[:] = inverse @ p / np.diag(inverse)
    return errors


def _orders(field: DiffuseField, positions) -> list[int]:
    """L of every mode, about the centre of mass."""
    reach = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return max_order(field.wavenumbers, reach, AMPLE).tolist()


@dataclass(frozen=True)
class CrossValidation:
    """How well microphones are foretold by the others: error over pressure, in decibels.

    Attributes
    ----------
    overall : float, power of the error over power of the pressures, every mode counting alike
    microphones : (N,) float64, likewise of each microphone
    modes : (modes in use,) float64, of each frequency
    """

    overall: float
    microphones: np.ndarray
    modes: np.ndarray


def cross_validate(problem: Problem, positions, modes: slice, noise: np.ndarray | None = None) -> CrossValidation:
    """Normalised leave-one-out error; arguments as of `expansions`."""
    return summarise(problem.pressures[modes], leave_one_out_errors(problem, positions, modes, noise))


def summarise(p: np.ndarray, errors: np.ndarray) -> CrossValidation:
    """Report on errors (modes, N) of pressures, in the same unit."""
    power = mode_power(p)[:, None]
    heard, missed = np.abs(p) ** 2 / power, np.abs(errors) ** 2 / power
    return CrossValidation(
        overall=float(_decibels(missed.sum() / heard.sum())),
        microphones=frozen_array(_decibels(missed.sum(axis=0) / heard.sum(axis=0)), float),
        modes=frozen_array(_decibels(missed.mean(axis=1)), float),
    )


def _decibels(ratio):
    return 10 * np.log10(np.maximum(ratio, 1e-30))
