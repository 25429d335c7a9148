"""The covariance through the dictionary: cost, gradient and Gauss-Newton matrix of all positions.

C = s W W^H + v I with an order so high that W W^H is the kernel of a diffuse field; the formulas are those of
`fdcal.cost.low_rank_terms`. The rank is 2L + 1 only, so that a step costs O(M N L^2 + M N^2 (L + D^2)). Real and
complex wavenumbers are supported. In three dimensions W W^H comes as a series, `fdcal.cost.spherical_covariance`.

A source close to the array excites high orders more than a diffuse field does, by |H_l(k rho)|, rho its distance.
With `near_field` the columns of W are multiplied by that factor, for rho = 1.5 R, where it is above 1: a prior that
allows for such a source, needed where the noise is so low that its field counts. In two dimensions W has the columns
of `fdcal.cost.circular_waves`.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.special import hankel1, spherical_jn, spherical_yn

from ..acoustics.fourier_bessel import max_order
from ..acoustics.threads import parallel_map
from ..model.validation import frozen_array
from .circular_waves import circular_waves, combined_waves
from .low_rank_terms import low_rank_terms
from .mode_sums import ModeTerms, blocks, over_blocks, worth_threads
from .spherical_covariance import series_covariance, series_terms

EXTRA_ORDERS = 8  # beyond ceil(k R) about the centre of mass: the rest of W W^H is below 1e-9
NEAR_FIELD_ORDERS = 16  # the same with near sources: the rest of the power of one at 1.75 R is below 1e-10
SOURCE_DISTANCE = 1.5  # times R: nearest source that the near-field prior allows for
ZERO = 1e-13  # of the largest eigenvalue: what is below counts as zero
LEAST_WEIGHT = 1e-11  # least mu = v / s; below it rounding errors of A are not small beside it


def expansion_terms(
    positions, pressures, wavenumbers, power, noise, dimension, log_det, near_field=False, reference=None, derivatives=2
) -> ModeTerms:
    """Return the cost of every mode, its gradient and the Gauss-Newton matrix of all modes.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) float64 or complex128, rad/m
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    dimension : 2 or 3, of the sound field
    log_det : True for the likelihood; False for the projection, sum_m p^H P p (Eq. 7 with Tikhonov weight v / s)
    near_field : whether a source may be close to the array
    reference : (N, D) float64, metres, or None, positions that give the centre and the distance of a source
    derivatives : 0 for the cost alone, 1 for its gradient, too, 2 for all

    Returns
    -------
    ModeTerms

    Raises
    ------
    numpy.linalg.LinAlgError
        A position is not finite.
    """
    x, k, p = np.asarray(positions, float), np.asarray(wavenumbers), np.asarray(pressures, complex)
    centre, orders, gains = expansion_centre(x, k, dimension, near_field, reference)
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = np.ones_like(noise) if log_det else noise

    def of_block(m: slice) -> ModeTerms:
        if dimension == 3:
            block = p[m], k[m], orders[m], gains[m], power[m], noise[m], scale[m]
            return series_terms(x, centre, *block, float(log_det), derivatives)
        W, dW = combined_waves(*circular_waves(x, centre, k[m], orders[m], gains[m], derivatives > 0))
        return low_rank_terms(W, dW, p[m], noise[m] / power[m], scale[m] / noise[m], float(log_det), derivatives)

    return over_blocks(of_block, len(k), numbers_of(x, k, orders, dimension))


def expansion_centre(x, k, dimension: int, near_field: bool, reference=None):
    """Return the centre (D,), the orders (M,) and the gain of every order (M, L + 1).

    The centre is a little off the centre of mass, so that no microphone stands on it: directions are undefined there.
    """
    reference = x if reference is None else reference
    centre = reference.mean(axis=0)
    reach = float(np.linalg.norm(reference - centre, axis=1).max())
    centre = centre + 1e-3 * reach * np.array([0.61, 0.37, 0.7])[: len(centre)]
    furthest = float(np.linalg.norm(x - centre, axis=1).max())
    if not np.isfinite(furthest):
        raise np.linalg.LinAlgError("positions are not finite")
    orders = max_order(k, furthest, NEAR_FIELD_ORDERS if near_field else EXTRA_ORDERS)
    gains = np.ones((len(k), int(orders.max()) + 1))
    if near_field and reach > 0:
        z = np.real(k) * SOURCE_DISTANCE * reach
        gains = _loudness(tuple(z.tolist()), gains.shape[1], dimension)
    return centre, orders, gains


@functools.lru_cache(maxsize=4)
def _loudness(z: tuple[float, ...], count: int, dimension: int) -> np.ndarray:
    """Return |h_l(z)| for l = 0..count - 1, at least 1 : (M, count) float64, read-only; trials of a step share it."""
    l, column = np.arange(count), np.array(z)[:, None]  # noqa: E741
    loud = np.abs(hankel1(l, column)) if dimension == 2 else np.hypot(spherical_jn(l, column), spherical_yn(l, column))
    return frozen_array(np.clip(loud, 1.0, 1e100), float)


def numbers_of(x, k, orders, dimension: int) -> int:
    """Return the size of the dictionary, or in space of the covariance, of one mode, in float64."""
    columns = 2 * int(np.max(orders)) + 1 if dimension == 2 else len(x)
    return len(x) * columns * (2 if np.iscomplexobj(k) else 1)


def expansion_spectra(
    positions, pressures, wavenumbers, dimension: int, near_field=False
) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues of W W^H of every mode, and |u^H p|^2 along its eigenvectors u.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) float64 or complex128, rad/m
    dimension : 2 or 3, of the sound field
    near_field : whether a source may be close to the array

    Returns
    -------
    two (M, N) float64 arrays; where eigenvalues are zero, the rest of |p|^2 is spread evenly over them
    """
    x, k, p = np.asarray(positions, float), np.asarray(wavenumbers), np.asarray(pressures)
    centre, orders, gains = expansion_centre(x, k, dimension, near_field)

    def of_block(m: slice) -> tuple[np.ndarray, np.ndarray]:
        if dimension == 2:
            return spectra_along(combined_waves(*circular_waves(x, centre, k[m], orders[m], gains[m], False))[0], p[m])
        values, vectors = np.linalg.eigh(series_covariance(x, centre, k[m], orders[m], gains[m], False)[0])
        return np.maximum(values, 0.0), np.abs(np.einsum("mni,mn->mi", np.conj(vectors), p[m])) ** 2

    numbers = numbers_of(x, k, orders, dimension)
    found = parallel_map(of_block, blocks(len(k), numbers), worth_threads(len(k), numbers))
    return np.concatenate([values for values, _ in found]), np.concatenate([along for _, along in found])


def spectra_along(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return eigenvalues of W W^H and the power of p along its eigenvectors, from the small W^H W; W is (M, r, N)."""
    M, r, N = W.shape
    WH = np.conj(W)
    values, vectors = np.linalg.eigh(WH @ W.swapaxes(1, 2))
    fits = (values > ZERO * values[:, -1:]) & (np.arange(r) >= r - N)
    found = np.matmul(vectors.conj().swapaxes(1, 2), WH @ p[..., None])[..., 0]
    along = np.where(fits, np.abs(found) ** 2 / np.where(fits, values, 1.0), 0.0)
    rest = np.maximum(np.sum(np.abs(p) ** 2, axis=1) - along.sum(axis=1), 0.0)
    spread = rest / np.maximum(N - fits.sum(axis=1), 1)
    out = np.zeros((2, M, N))
    out[1] = spread[:, None]
    kept = min(r, N)
    out[0, :, :kept] = np.where(fits, values, 0.0)[:, r - kept :]
    out[1, :, :kept] = np.where(fits, along, spread[:, None])[:, r - kept :]
    return out[0], out[1]
