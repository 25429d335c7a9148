"""The covariance through the dictionary: cost, gradient and Gauss-Newton matrix of all positions, compiled.

With C = s W W^H + v I, mu = v / s and the order ample,

    A = W^H W + mu I = G G^H,    Q = W G^-H,    P = I - Q Q^H = v C^-1,    alpha = A^-1 W^H p,    r = P p = p - W alpha

    cost          sum_m p^H P p / v + log det (A / mu)        (the second term in a likelihood alone)
    gradient      -2 Re [conj(g_a) r] / v + 2 Re diag(D_a W A^-1 W^H),    g_a = D_a W alpha, slope of the fitted field
    curvature     2 Re [conj(g_a,i) P_ij g_b,j] / v           (Gauss-Newton; Kaufman's in a projection)

Of rank 2L + 1 only, so a step costs O(M N L^2 + M N^2 (L + D^2)). Complex wavenumbers are served as well as real ones.
A source close to the array excites high orders more than a diffuse field does, by |H_l(k rho)|, rho its distance.
With `near_field` the columns of W are multiplied by that factor, for rho = 1.5 R, where it is above 1: a prior that
allows for such a source, needed where the noise is so low that its field counts.

In two dimensions W has the columns J_0, sqrt(2) J_l cos(l theta), sqrt(2) J_l sin(l theta): those of Eq. 4 after a
unitary map, which changes no W W^H, and real for a real k.
"""

from __future__ import annotations

import numpy as np
from scipy.special import hankel1, spherical_jn, spherical_yn

from ..acoustics.compiled import add_curvature, adjoint, compiled, lower_inverse, parallel_map, sum_over_modes, writable
from ..acoustics.fourier_bessel import max_order
from .spherical_covariance import directions, series, series_modes

AMPLE = 8  # orders beyond ceil(k R) about the centre of mass: the rest of W W^H is below 1e-9
NEAR_ORDERS = 16  # the same where sources are near: at 1.75 R what is left of their power is below 1e-10
NEAREST = 1.5  # times R: how near
LEAST_WEIGHT = 1e-11  # of mu; below it rounding errors of A are no longer small beside it


def expansion_terms(
    positions, pressures, wavenumbers, power, noise, dimension, log_det, near_field=False, about=None, derivatives=2
):
    """Cost summed over modes, its gradient and its Gauss-Newton matrix.

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

    Raises numpy.linalg.LinAlgError where the positions are not finite.
    """
    x, k, p = writable(positions, float), writable(wavenumbers), writable(pressures, complex)
    centre, orders, gains = _about_centre(x, k, dimension, near_field, about)
    noise = np.maximum(noise, LEAST_WEIGHT * power)
    scale = np.ones_like(noise) if log_det else noise
    if dimension == 2:
        modes = p, k, orders, gains, noise / power, scale / noise
        return sum_over_modes(_circular_modes, (x, centre), modes, (float(log_det), derivatives), derivatives)
    modes = p, k.astype(complex), orders, gains, power, noise, scale
    return sum_over_modes(series_modes, (x, centre), modes, (float(log_det), derivatives), derivatives)


def _about_centre(x, k, dimension: int, near_field: bool, about=None):
    """Centre (D,), orders (M,) and the gain of every order (M, L + 1).

    The centre is the centre of mass and a little aside, where no microphone stands: there is no direction at it.
    """
    about = x if about is None else about
    centre = about.mean(axis=0)
    reach = float(np.linalg.norm(about - centre, axis=1).max())
    centre = centre + 1e-3 * reach * np.array([0.61, 0.37, 0.7])[: len(centre)]
    furthest = float(np.linalg.norm(x - centre, axis=1).max())
    if not np.isfinite(furthest):
        raise np.linalg.LinAlgError("positions are not finite")
    orders = max_order(k, furthest, NEAR_ORDERS if near_field else AMPLE)
    gains = np.ones((len(k), int(orders.max()) + 1))
    if near_field and reach > 0:
        l, z = np.arange(gains.shape[1]), np.real(k)[:, None] * NEAREST * reach  # noqa: E741
        loud = np.abs(hankel1(l, z)) if dimension == 2 else np.hypot(spherical_jn(l, z), spherical_yn(l, z))
        gains = np.clip(loud, 1.0, 1e100)
    return centre, orders, gains


@compiled
def _circular_modes(x, centre, p, k, orders, gains, mu, scale, log_det, derivatives, cost, gradient, H):
    for m in range(len(k)):
        r = 2 * orders[m] + 1
        W, dW = np.empty((len(x), r), k.dtype), np.empty((2, len(x), r), k.dtype)
        _circular(x, centre, k[m], orders[m], gains[m], derivatives > 0, W, dW)
        add_mode(W, dW, p[m], mu[m], scale[m], log_det, derivatives, cost, gradient, H)


@compiled
def _circular(x, centre, k, L, gain, slopes, W, dW):
    """W (N, 2L + 1) and its derivatives (2, N, 2L + 1), if wanted; d/dx and d/dy as in `fourier_bessel_gradient`."""
    J = np.empty(L + 2, W.dtype)
    root = np.sqrt(2.0)
    for n in range(len(x)):
        dx, dy = x[n, 0] - centre[0], x[n, 1] - centre[1]
        r = np.hypot(dx, dy)
        bessel_orders_of(k * r, L + 1, J)
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


@compiled
def bessel_orders_of(z, top, J):
    """J_0..J_top of one number into J (top + 1,): Miller's recurrence down, normalised by J_0 + 2 (J_2 + ...) = 1."""
    if abs(z) < 0.2:
        _bessel_series(z, top, J)
        return
    start = top + int(abs(z)) + 24
    start += start % 2
    above, here, total, twice = 0 * z, 1e-290 + 0 * z, 0 * z, 2 / z
    for l in range(start, 0, -1):  # noqa: E741
        if l <= top:
            J[l] = here
        if l % 2 == 0:
            total += 2 * here
        above, here = here, l * twice * here - above
        if abs(here.real) > 1e250 or abs(here.imag) > 1e250:
            here, above, total = here * 1e-250, above * 1e-250, total * 1e-250
            for i in range(l, top + 1):
                J[i] *= 1e-250
    J[0] = here
    total += here
    for i in range(top + 1):
        J[i] /= total


@compiled
def _bessel_series(z, top, J):
    half = z / 2
    lead = 1.0 + 0 * z
    for l in range(top + 1):  # noqa: E741
        term, total = lead, lead
        for t in range(1, 7):
            term = -term * half * half / (t * (t + l))
            total = total + term
        J[l] = total
        lead = lead * half / (l + 1)


@compiled
def add_mode(W, dW, p, mu, scale, log_det, derivatives, cost, gradient, H):
    """Add one mode to `cost` (1,), `gradient` (N, D) and `H` (D, D, N, N), a <= b, as many as `derivatives` tells."""
    N, r = W.shape
    P = np.empty((N, 2), W.dtype)  # BLAS takes no mixture of types
    for i in range(N):
        P[i, 0], P[i, 1] = p[i].real, p[i].imag
    WH = adjoint(W)
    A = WH @ W
    for i in range(r):
        A[i, i] += mu
    G = np.linalg.cholesky(A)
    if log_det != 0:
        for i in range(r):
            cost[0] += log_det * np.log(G[i, i].real ** 2 / mu)
    X = lower_inverse(G)
    XH = adjoint(X)
    parts = XH @ (X @ (WH @ P))
    fit = W @ parts
    alpha, residual = parts[:, 0] + 1j * parts[:, 1], p - (fit[:, 0] + 1j * fit[:, 1])
    cost[0] += scale * _misfit(residual, alpha, mu)
    if derivatives == 0:
        return
    Q = W @ XH
    T = Q @ X
    D = len(dW)
    g = np.empty((2, D, N))
    for a in range(D):
        for i in range(N):
            slope, widening = 0j, 0.0
            for q in range(r):
                slope += dW[a, i, q] * alpha[q]
                widening += (dW[a, i, q] * np.conj(T[i, q])).real
            g[0, a, i], g[1, a, i] = slope.real, slope.imag
            gradient[i, a] += 2 * log_det * widening - 2 * scale * (np.conj(slope) * residual[i]).real
    if derivatives < 2:
        return
    add_curvature(H, g, Q @ adjoint(Q), -2 * scale)
    for a in range(D):
        for b in range(a, D):
            for i in range(N):
                H[a, b, i, i] += 2 * scale * (g[0, a, i] * g[0, b, i] + g[1, a, i] * g[1, b, i])


@compiled
def _misfit(residual, alpha, mu):
    """p^H P p = |p - W alpha|^2 + mu |alpha|^2, which small errors of alpha do not change."""
    total = 0.0
    for value in residual:
        total += abs(value) ** 2
    for value in alpha:
        total += mu * abs(value) ** 2
    return total


def expansion_spectra(
    positions, pressures, wavenumbers, dimension: int, near_field=False
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of every mode the N eigenvalues of C for s = 1, v = 0, and |u^H p|^2 along its eigenvectors u.

    Returns
    -------
    list of two (N,) float64 arrays a mode; eigenvalues of zero may share what is left of p equally
    """
    x, k = writable(positions, float), writable(wavenumbers)
    centre, orders, gains = _about_centre(x, k, dimension, near_field)

    def of_mode(mode) -> tuple[np.ndarray, np.ndarray]:
        kk, order, gain, p = mode
        if dimension == 2:
            return _along(circular(x, kk, order, centre, gain), p)
        values, vectors = np.linalg.eigh(spherical(x, kk, order, centre, gain))
        return np.maximum(values, 0.0), np.abs(vectors.conj().T @ p) ** 2

    return parallel_map(of_mode, zip(k, orders.tolist(), gains, pressures, strict=True))


def circular(points, k, order: int, centre, gain=None) -> np.ndarray:
    """W of one mode in two dimensions : (N, 2L + 1), real for a real k; `gain` (L + 1,) of every order."""
    x, centre = writable(points, float), writable(centre, float)
    W = np.empty((len(x), 2 * order + 1), np.asarray(k).dtype)
    _circular(x, centre, k, order, np.ones(order + 1) if gain is None else gain, False, W, np.empty((2, 0, 0), W.dtype))
    return W


def spherical(points, k, order: int, centre, gain=None) -> np.ndarray:
    """W W^H of one mode in three dimensions : (N, N) complex128; `gain` (L + 1,) of every order."""
    x, centre = writable(points, float), writable(centre, float)
    C = np.empty((len(x), len(x)), complex)
    gain = np.ones(order + 1) if gain is None else gain
    series(*directions(x, centre), complex(k), order, gain, False, C, C.copy(), C.copy())
    return C


def _along(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    WH = W.conj().T
    values, vectors = np.linalg.eigh(WH @ W)
    some = max(int(np.argmax(values > 1e-13 * values[-1])), len(values) - len(p))  # the first of those that count
    values = values[some:]
    along = np.abs(vectors[:, some:].conj().T @ (WH @ p)) ** 2 / values
    rest = max(float(np.sum(np.abs(p) ** 2) - along.sum()), 0.0)
    zeros = len(p) - len(values)
    return np.append(values, np.zeros(zeros)), np.append(along, np.full(zeros, rest / max(zeros, 1)))
