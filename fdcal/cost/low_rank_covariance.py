"""The covariance through the dictionary: cost, gradient and Gauss-Newton matrix of all positions, compiled.

C = s W W^H + v I with an order so high that W W^H is the kernel of a diffuse field; the formulas are those of
`fdcal.cost.newton_kernels`. The rank is 2L + 1 only, so that a step costs O(M N L^2 + M N^2 (L + D^2)). Real and
complex wavenumbers are supported. In three dimensions W W^H comes as a series, `fdcal.cost.spherical_covariance`.

A source close to the array excites high orders more than a diffuse field does, by |H_l(k rho)|, rho its distance.
With `near_field` the columns of W are multiplied by that factor, for rho = 1.5 R, where it is above 1: a prior that
allows for such a source, needed where the noise is so low that its field counts.

In two dimensions W has the columns J_0, sqrt(2) J_l cos(l theta), sqrt(2) J_l sin(l theta): those of Eq. 4 after a
unitary map, which leaves W W^H unchanged, and real for a real k.
"""

from __future__ import annotations

import numpy as np
from scipy.special import hankel1, spherical_jn, spherical_yn

from ..acoustics.compiled import compiled, parallel_map, sum_over_modes, writable
from ..acoustics.fourier_bessel import max_order
from .bessel_kernels import fill_bessel
from .newton_kernels import add_mode
from .spherical_covariance import series_modes, spherical_gram

EXTRA_ORDERS = 8  # beyond ceil(k R) about the centre of mass: the rest of W W^H is below 1e-9
NEAR_FIELD_ORDERS = 16  # the same with near sources: the rest of the power of one at 1.75 R is below 1e-10
SOURCE_DISTANCE = 1.5  # times R: nearest source that the near-field prior allows for
LEAST_WEIGHT = 1e-11  # least mu = v / s; below it rounding errors of A are not small beside it


def expansion_terms(
    positions, pressures, wavenumbers, power, noise, dimension, log_det, near_field=False, reference=None, derivatives=2
):
    """Return the cost summed over modes, its gradient and its Gauss-Newton matrix.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) float64 or complex128, rad/m
    power, noise : (M,) float64, s and v, in the unit of abs(pressures)**2
    dimension : 2 or 3, of the sound field
    log_det : True for the likelihood; False for the projection, sum_m p^H P p (Eq. 7 with Tikhonov weight v / s)
    near_field : whether a source may be close to the array
    about : (N, D) float64, metres, or None, positions that give the centre and the distance of a source
    derivatives : 0 for the cost alone, 1 for its gradient, too, 2 for all

    Returns
    -------
    cost : float
    gradient : (N, D) float64, 1/m
    curvature : (N, D, N, D) float64, 1/m^2

    Raises
    ------
    numpy.linalg.LinAlgError
        A position is not finite.
    """
    x, k, p = writable(positions, float), writable(wavenumbers), writable(pressures, complex)
    centre, orders, gains = expansion_centre(x, k, dimension, near_field, reference)
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = np.ones_like(noise) if log_det else noise
    if dimension == 2:
        modes = p, k, orders, gains, noise / power, scale / noise
        return sum_over_modes(_circular_modes, (x, centre), modes, (float(log_det), derivatives), derivatives)
    modes = p, k.astype(complex), orders, gains, power, noise, scale
    return sum_over_modes(series_modes, (x, centre), modes, (float(log_det), derivatives), derivatives)


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
        l, z = np.arange(gains.shape[1]), np.real(k)[:, None] * SOURCE_DISTANCE * reach  # noqa: E741
        loud = np.abs(hankel1(l, z)) if dimension == 2 else np.hypot(spherical_jn(l, z), spherical_yn(l, z))
        gains = np.clip(loud, 1.0, 1e100)
    return centre, orders, gains


@compiled
def _circular_modes(x, centre, p, k, orders, gains, mu, scale, log_det, derivatives, cost, gradient, H):
    for m in range(len(k)):
        r = 2 * orders[m] + 1
        W, dW = np.empty((len(x), r), k.dtype), np.empty((2, len(x), r), k.dtype)
        fill_circular(x, centre, k[m], orders[m], gains[m], derivatives > 0, W, dW)
        add_mode(W, dW, p[m], mu[m], scale[m], log_det, derivatives, cost, gradient, H)


@compiled
def fill_circular(x, centre, k, L, gain, slopes, W, dW):
    """Fill W (N, 2L + 1) and, if `slopes`, dW (2, N, 2L + 1), its derivatives along x and y, 1/m."""
    J = np.empty(L + 2, W.dtype)
    root = np.sqrt(2.0)
    for n in range(len(x)):
        dx, dy = x[n, 0] - centre[0], x[n, 1] - centre[1]
        r = np.hypot(dx, dy)
        fill_bessel(k * r, L + 1, J)
        c, s = (dx / r, dy / r) if r > 0 else (1.0, 0.0)
        W[n, 0] = gain[0] * J[0]
        if slopes:
            dW[0, n, 0], dW[1, n, 0] = -gain[0] * k * J[1] * c, -gain[0] * k * J[1] * s
        c_below, s_below, c_here, s_here = 1.0, 0.0, c, s  # cos and sin of (l - 1) theta and of l theta
        for l in range(1, L + 1):  # noqa: E741
            c_above, s_above = c_here * c - s_here * s, s_here * c + c_here * s
            factor = root * gain[l]
            W[n, 2 * l - 1], W[n, 2 * l] = factor * J[l] * c_here, factor * J[l] * s_here
            if slopes:
                below, above = factor * k / 2 * J[l - 1], factor * k / 2 * J[l + 1]
                dW[0, n, 2 * l - 1] = below * c_below - above * c_above
                dW[0, n, 2 * l] = below * s_below - above * s_above
                dW[1, n, 2 * l - 1] = -below * s_below - above * s_above
                dW[1, n, 2 * l] = below * c_below + above * c_above
            c_below, s_below, c_here, s_here = c_here, s_here, c_above, s_above


def expansion_spectra(
    positions, pressures, wavenumbers, dimension: int, near_field=False
) -> list[tuple[np.ndarray, np.ndarray]]:
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
    list of two (N,) float64 arrays per mode; where eigenvalues are zero, the rest of |p|^2 is spread evenly over them
    """
    x, k = writable(positions, float), writable(wavenumbers)
    centre, orders, gains = expansion_centre(x, k, dimension, near_field)

    def of_mode(mode) -> tuple[np.ndarray, np.ndarray]:
        kk, order, gain, p = mode
        if dimension == 2:
            return _along(circular_dictionary(x, kk, order, centre, gain), p)
        values, vectors = np.linalg.eigh(spherical_gram(x, kk, order, centre, gain))
        return np.maximum(values, 0.0), np.abs(vectors.conj().T @ p) ** 2

    return parallel_map(of_mode, zip(k, orders.tolist(), gains, pressures, strict=True))


def circular_dictionary(points, k, order: int, centre, gain=None) -> np.ndarray:
    """Return W of one mode in two dimensions, real for a real k; W W^H is that of Eq. 4.

    Parameters
    ----------
    points : (N, 2) float64, metres
    k : float or complex, rad/m
    order : L
    centre : (2,) float64, metres
    gain : (L + 1,) float64 or None, factor of each order

    Returns
    -------
    (N, 2L + 1) float64 or complex128, as `k`
    """
    x, centre = writable(points, float), writable(centre, float)
    W = np.empty((len(x), 2 * order + 1), np.asarray(k).dtype)
    fill_circular(
        x, centre, k, order, np.ones(order + 1) if gain is None else gain, False, W, np.empty((2, 0, 0), W.dtype)
    )
    return W


def _along(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues of W W^H and the power of p along its eigenvectors, from the small W^H W."""
    WH = W.conj().T
    values, vectors = np.linalg.eigh(WH @ W)
    first = max(int(np.argmax(values > 1e-13 * values[-1])), len(values) - len(p))  # the rest is numerically zero
    values = values[first:]
    along = np.abs(vectors[:, first:].conj().T @ (WH @ p)) ** 2 / values
    rest = max(float(np.sum(np.abs(p) ** 2) - along.sum()), 0.0)
    zeros = len(p) - len(values)
    return np.append(values, np.zeros(zeros)), np.append(along, np.full(zeros, rest / max(zeros, 1)))
