"""The noise and the position error that make the pressures most likely at given positions.

share     power of the noise over that of the pressures, one value for all modes
spread    error of the positions beside it. An error e of a microphone changes its pressure by the gradient of the
          field there, of power k^2 / D: at rough positions high modes fit badly and low ones do not.
values    eigenvalues of the kernel at the positions; |u^H p|^2 is the power of the pressures along its eigenvectors
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.threads import parallel_map
from ..model.power import mode_power
from .likelihood import kernel
from .mode_sums import as_columns, blocks, worth_threads

MOST_NOISE = 0.5  # greatest share that is estimated


@dataclass(frozen=True)
class NoiseThresholds:
    """Limits on the noise's share of the power (dimensionless), and the least fit that is accepted.

    Attributes
    ----------
    diffuse_floor : least share with the kernel of a diffuse field, which leaves that much of a windowed field unfitted
    near_field_floor : least share with complex wavenumbers and near sources, which fit more
    near_field_2d, near_field_3d : shares at or below which a near source and damping matter, by the field's dimension
    chi_square_floor : least share that the normalised chi-square is computed with
    chi_square : greatest normalised chi-square of positions that are accepted
    """

    diffuse_floor: float = 1e-6
    near_field_floor: float = 1e-10
    near_field_2d: float = 1e-5
    near_field_3d: float = 2e-6
    chi_square_floor: float = 1e-8
    chi_square: float = 3.0

    def near_field(self, dimension: int) -> float:
        """Return the share at or below which a near source and damping matter in a field of 2 or 3 dimensions."""
        return self.near_field_2d if dimension == 2 else self.near_field_3d


NOISE = NoiseThresholds()


@dataclass(frozen=True)
class NoiseEstimate:
    """The residual at given positions, split into noise and position error.

    Attributes
    ----------
    noise : noise's share of the power of every mode, from `NoiseThresholds.diffuse_floor` (or `near_field_floor`)
        to MOST_NOISE
    spread : metres, one sigma of the position of a microphone; its share of the power grows as k^2
    cost : -log of the probability density, up to a constant that depends on the numbers of modes and microphones alone
    chi_square : normalised chi-square, p^H C^-1 p over the number of pressures with the given noise and no spread;
        1 is expected
    dimension : 2 or 3, of the sound field
    """

    noise: float
    spread: float
    cost: float
    chi_square: float
    dimension: int

    def shares(self, wavenumbers, spread: bool = True) -> np.ndarray:
        """Return the unexplained share of the power of every mode.

        Parameters
        ----------
        wavenumbers : (M,) complex128 or float64, rad/m
        spread : whether the share of the position error is added to that of the noise

        Returns
        -------
        (M,) float64, at most MOST_NOISE
        """
        more = (np.real(wavenumbers) * self.spread) ** 2 / self.dimension if spread else 0.0
        return np.minimum(self.noise + more, MOST_NOISE) + np.zeros(len(wavenumbers))


def estimate_noise(
    positions, pressures, wavenumbers, dimension: int, near_field: bool = False, given_share: float = 0.0
) -> NoiseEstimate:
    """Return the noise share and the position error of greatest likelihood.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128, rad/m
    dimension : 2 or 3, of the sound field
    near_field : as of `fdcal.cost.likelihood.diffuse_field`
    given_share : noise's share of the power that the normalised chi-square is computed with, at least
        `NoiseThresholds.chi_square_floor`
    """
    from scipy.optimize import minimize  # takes longer to load than the rest of the solvers; a first picture needs none

    power = mode_power(pressures)
    values, along = _spectra(positions, pressures, wavenumbers, dimension, near_field)
    along = along / power[:, None]
    slope = np.real(wavenumbers)[:, None] ** 2 / dimension
    least = NOISE.near_field_floor if near_field else NOISE.diffuse_floor
    given_share = max(given_share, NOISE.chi_square_floor)

    def cost(logs) -> float:
        noise, spread = np.exp(logs)
        share = np.clip(noise + slope * spread, least, MOST_NOISE)
        spectrum = (1 - share) * values + share
        return float(np.sum(np.log(spectrum) + along / spectrum))

    top = float(slope.max())
    bounds = [(np.log(least), np.log(MOST_NOISE)), (np.log(least / top), np.log(MOST_NOISE / top))]
    grid = [np.linspace(*bound, 7) for bound in bounds]
    start = min(((a, b) for a in grid[0] for b in grid[1]), key=cost)
    best = minimize(cost, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 0.05, "fatol": 0.1})
    noise, variance = np.exp(best.x)
    chi_square = float(np.mean(along / ((1 - given_share) * values + given_share)))
    return NoiseEstimate(float(noise), float(np.sqrt(variance)), float(best.fun), chi_square, dimension)


def estimate_noise_share(positions, pressures, wavenumbers, dimension: int) -> float:
    """Return the noise's share of the power, as `estimate_noise` finds it for positions without error.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128, rad/m; the real parts count
    dimension : 2 or 3, of the sound field
    """
    from scipy.optimize import fminbound

    power = mode_power(pressures)
    values, along = _spectra(positions, pressures, wavenumbers, dimension, False)
    along = along / power[:, None]

    def cost(log_share: float) -> float:
        spectrum = (1 - np.exp(log_share)) * values + np.exp(log_share)
        return float(np.sum(np.log(spectrum) + along / spectrum))

    bounds = np.log(NOISE.diffuse_floor), np.log(MOST_NOISE)
    return float(np.exp(fminbound(cost, *bounds)))


def _spectra(positions, pressures, wavenumbers, dimension: int, near_field: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of the kernel and |u^H p|^2 along its eigenvectors : two (M, N) float64 arrays."""
    damped = near_field and np.any(np.imag(wavenumbers))
    k = np.asarray(wavenumbers) if damped else np.real(wavenumbers)
    if dimension == 2 or near_field:
        from .low_rank_covariance import expansion_spectra

        return expansion_spectra(positions, pressures, k, dimension, near_field)
    distance = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    numbers = distance.size

    def of_block(m: slice) -> tuple[np.ndarray, np.ndarray]:
        values, vectors = np.linalg.eigh(kernel(np.multiply.outer(k[m], distance), dimension))
        found = np.matmul(vectors.swapaxes(1, 2), as_columns(pressures[m], float))
        return np.maximum(values, 0.0), np.sum(found**2, axis=2)

    spectra = parallel_map(of_block, blocks(len(k), numbers), worth_threads(len(k), numbers))
    return np.concatenate([values for values, _ in spectra]), np.concatenate([along for _, along in spectra])
