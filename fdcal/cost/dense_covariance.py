"""The covariance through its kernel, sin(z) / z: cost, gradient and Gauss-Newton matrix of all positions.

The formulas of `fdcal.cost.likelihood` with dense matrices. In three dimensions the expansion has more functions than
there are microphones, so this takes fewer operations.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.sinc import sinc
from .full_rank_terms import full_rank_terms
from .mode_sums import ModeTerms, over_blocks


def dense_terms(positions, pressures, wavenumbers, power, noise, log_det: bool, derivatives=2) -> ModeTerms:
    """Return cost, gradient and curvature with real wavenumbers.

    Parameters
    ----------
    positions : (N, 3) or, in a plane of the field, (N, 2) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) float64, rad/m
    power, noise, log_det, derivatives : as of `fdcal.cost.low_rank_covariance.expansion_terms`

    Returns
    -------
    ModeTerms

    Raises
    ------
    numpy.linalg.LinAlgError
        A position is not finite, or C is singular.
    """
    x, p = np.asarray(positions, float), np.asarray(pressures, complex)
    pairs = np.tril_indices(len(x), -1)
    apart = np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=1)
    if not np.all(np.isfinite(apart)):
        raise np.linalg.LinAlgError("positions are not finite")
    scale = np.ones_like(noise) if log_det else noise

    def of_block(m: slice) -> ModeTerms:
        rest = power[m], noise[m], scale[m], float(log_det), derivatives
        return _terms(x, apart, pairs, p[m], wavenumbers[m], *rest)

    return over_blocks(of_block, len(p), len(x) * len(x))


def _terms(x, apart, pairs, p, k, power, noise, scale, log_det: float, derivatives: int) -> ModeTerms:
    """Terms of some modes; `apart` (P,), metres, are the distances of `pairs`."""
    N, x = len(x), x - x.mean(axis=0)
    kappa, over = sinc(np.multiply.outer(k, apart))
    diagonal = np.arange(N)
    C = _symmetric(kappa * power[:, None], pairs, N)
    C[:, diagonal, diagonal] = (power + noise)[:, None]

    def slopes(inverse, u) -> tuple[np.ndarray, np.ndarray]:
        """D_a = S (x_i - x_j)_a."""
        S = _symmetric(over * (power * k**2)[:, None], pairs, N)
        moments = np.concatenate([u[..., None], u[..., None] * x], axis=-1)
        Su = np.ascontiguousarray(S @ np.ascontiguousarray(moments).view(float)).view(complex)
        rows = (S * inverse) @ np.column_stack([np.ones(N), x])
        g, widening = x * Su[..., :1] - Su[..., 1:], x * rows[..., :1] - rows[..., 1:]
        return np.moveaxis(g, 2, 0), np.moveaxis(widening, 2, 0)

    return full_rank_terms(C, p, noise, scale, log_det, derivatives, slopes)


def _symmetric(values, pairs, N: int) -> np.ndarray:
    """Symmetric matrices (M, N, N) with `values` (M, P) at the pairs and zeros on the diagonal."""
    A = np.zeros((len(values), N, N))
    A[:, pairs[0], pairs[1]] = values
    A[:, pairs[1], pairs[0]] = values
    return A
