"""Circular waves about a centre, the dictionary of the likelihood in two dimensions, for many modes at once.

The columns are J_0, sqrt(2) J_l cos(l theta) and sqrt(2) J_l sin(l theta): those of Eq. 4 after a unitary map, which
leaves W W^H unchanged, and real for a real wavenumber. Matrices are kept transposed, (modes, columns, microphones):
the microphones are next to each other in memory.
"""

from __future__ import annotations

import numpy as np

from ..acoustics.bessel import bessel

MANY = 3  # waves for each microphone, from which on combinations of waves are used


def circular_waves(x, centre, k, orders, gains, slopes: bool) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the dictionary of every mode and its derivatives.

    Parameters
    ----------
    x : (N, 2) float64, metres
    centre : (2,) float64, metres
    k : (M,) float64 or complex128, rad/m
    orders : (M,) int, L of every mode; columns of higher orders are zero
    gains : (M, L + 1) float64, factor of every order, for the highest L
    slopes : bool, whether the derivatives are wanted

    Returns
    -------
    W : (M, 2L + 1, N), of the type of `k`
    dW : (2, M, 2L + 1, N) likewise, derivatives along x and y, 1/m; None unless wanted
    """
    L, offsets = int(np.max(orders, initial=0)), x - centre
    r = np.hypot(offsets[:, 0], offsets[:, 1])
    J = bessel(np.multiply.outer(k, r), L + 1)
    cosine, sine = _phases(offsets, r, L + 1)
    C, S = J * cosine[:, None], J * sine[:, None]
    factor = np.where(np.arange(L + 1) <= np.asarray(orders)[:, None], gains[:, : L + 1], 0.0)
    factor[:, 1:] *= np.sqrt(2.0)
    W = np.empty((len(k), 2 * L + 1, len(x)), J.dtype)
    np.multiply(C[: L + 1].swapaxes(0, 1), factor[:, :, None], out=W[:, : L + 1])
    np.multiply(S[1 : L + 1].swapaxes(0, 1), factor[:, 1:, None], out=W[:, L + 1 :])
    return W, (_slopes(C, S, factor * np.asarray(k)[:, None] / 2) if slopes else None)


def combined_waves(W: np.ndarray, dW: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the dictionary of many more waves than microphones in as many combinations of waves as microphones.

    The rows of W span N dimensions at most. In an orthonormal basis of these W W^H and dW W^H are the same, and so is
    all that depends on them; matrices of r x r would take far longer for an array of many wavelengths.

    Parameters
    ----------
    W : (M, r, N)
    dW : (2, M, r, N) or None

    Returns
    -------
    W : (M, N, N); as given, if there are not many more waves than microphones
    dW : (2, M, N, N) likewise, or None
    """
    if W.shape[1] <= MANY * W.shape[2]:
        return W, dW
    basis = np.linalg.qr(np.conj(W))[0].swapaxes(1, 2)
    return basis @ W, None if dW is None else basis @ dW


def _phases(offsets, r, top: int) -> tuple[np.ndarray, np.ndarray]:
    """cos(l theta) and sin(l theta) for l = 0..top : two (top + 1, N) float64; theta = 0 at the centre."""
    apart = np.maximum(r, np.finfo(float).tiny)
    first = np.where(r > 0, (offsets[:, 0] + 1j * offsets[:, 1]) / apart, 1.0)
    powers = np.empty((top + 1, len(r)), complex)
    powers[0], powers[1:] = 1.0, first
    powers = np.cumprod(powers, axis=0)
    return powers.real.copy(), powers.imag.copy()


def _slopes(C, S, half) -> np.ndarray:
    """dW from J_l cos(l theta) and J_l sin(l theta), l = 0..L+1; `half` (M, L + 1) is k / 2 times the factor."""
    C, S = C.swapaxes(0, 1), S.swapaxes(0, 1)
    L, half = half.shape[1] - 1, half[:, :, None]
    dW = np.empty((2, len(C), 2 * L + 1, C.shape[2]), C.dtype)
    for a, zero in enumerate((C, S)):
        np.multiply(zero[:, 1], -2 * half[:, 0], out=dW[a, :, 0])
        cosine, sine = dW[a, :, 1 : L + 1], dW[a, :, L + 1 :]
        if a == 0:
            np.subtract(C[:, :L], C[:, 2:], out=cosine)
            np.subtract(S[:, :L], S[:, 2:], out=sine)
        else:
            np.negative(np.add(S[:, :L], S[:, 2:], out=cosine), out=cosine)
            np.add(C[:, :L], C[:, 2:], out=sine)
        cosine *= half[:, 1:]
        sine *= half[:, 1:]
    return dW


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
    (N, 2L + 1) float64 or complex128, as `k`; cosine and sine of an order side by side, so that the first columns are
    the dictionary of a lower order
    """
    gains = np.ones((1, order + 1)) if gain is None else np.asarray(gain)[None]
    W, _ = circular_waves(np.asarray(points, float), np.asarray(centre), np.array([k]), [order], gains, False)
    out = np.empty(W.shape[:0:-1], W.dtype)
    out[:, 0], out[:, 1::2], out[:, 2::2] = W[0, 0], W[0, 1 : order + 1].T, W[0, order + 1 :].T
    return out
