"""The dictionary W of a sound field without sources, in two dimensions and in three (Eqs. 2 to 4, 8, 9 of the paper).

    W[n, l]      = J_l(k r_n) exp(j l theta_n)                          in a plane,  l = -L..L
    W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n)           in space,    l = 0..L,  m = -l..l

k               wavenumber, rad/m, may be complex (time sign exp(+j w t))
L               maximum order (Eq. 3): 2 L + 1 functions in a plane (Eq. 8), (L + 1)^2 in space
R               radius of the expansion, metres
r, theta, phi   coordinates of a microphone about the centre of the expansion; in space theta is from the z axis
Y_lm            orthonormal over the sphere, with the sign of Condon and Shortley

With sqrt(4 pi), W W^H tends to sin(k d) / (k d) for real k as L grows, whatever the centre (the addition theorem): the
covariance of a diffuse field of unit power. That of a complex k depends on the centre.

Microphones in a plane measure a field of three dimensions, too. On the plane through the centre the functions with
l + m odd are zero and those with l + m even remain, (L + 1)(L + 2) / 2 of them. Positions with two coordinates are
taken to lie in that plane.
"""

import functools

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import jv, sph_harm_y_all, spherical_jn

from ..model.types import Numbers, Reals

NO_EXTENT = 1e-9  # metres: an array of this radius has all its microphones in one place


def max_order(wavenumbers: Numbers | complex, radius: float, offset: int = 0) -> np.ndarray:
    """Return the order L = ceil(Re(k) R) + offset of the expansion (Eq. 3); k in rad/m, R in metres.

    The truncation error of the paper's, 0, exceeds the effect of a centimetre in the low modes, which 2 avoids.
    """
    return np.ceil(np.real(wavenumbers) * radius).astype(np.int64) + offset


def f_max(count: int, radius: float, sound_speed: float, dimension: int = 2, planar: bool = False) -> float:
    """Return the highest frequency that an array can interpolate (Eq. 9).

    It is that of the order L = k R at which the functions are as many as the microphones: 2 L + 1 = N in a plane,
    that is f_max = (N - 1) c / (4 pi R); (L + 1)^2 = N in space; (L + 1)(L + 2) / 2 = N for a plane in space.

    `count`: N; `radius`: R, metres; `sound_speed`: c, m/s. Infinite for a radius below 1 nm, as of microphones that all
    start in one place. Returns Hz.
    """
    if radius < NO_EXTENT:
        return float("inf")
    if dimension == 2:
        order = (count - 1) / 2
    else:
        order = (np.sqrt(8 * count + 1) - 3) / 2 if planar else np.sqrt(count) - 1
    return float(order * sound_speed / (2 * np.pi * radius))


def array_f_max(positions: Reals, sound_speed: float, dimension: int) -> float:
    """Return `f_max`, Hz, of an array (N, D), metres, R being its largest distance from the centre of mass."""
    positions = np.asarray(positions, float)
    radius = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())
    return f_max(len(positions), radius, sound_speed, dimension, positions.shape[1] < dimension)


def fourier_bessel(positions: np.ndarray, wavenumber: complex, order: int, centre: ArrayLike) -> np.ndarray:
    """Return W[n, l] = J_l(k r_n) exp(j l theta_n), l = -L..L (Eq. 4), of (N, 2) metres : (N, 2L + 1) complex128."""
    offsets = np.asarray(positions) - np.asarray(centre)
    r = np.hypot(offsets[:, 0], offsets[:, 1])
    theta = np.arctan2(offsets[:, 1], offsets[:, 0])
    k = wavenumber if np.imag(wavenumber) else np.real(wavenumber)
    l = np.arange(order + 1)  # noqa: E741
    J = jv(l, k * r[:, None])
    return join_orders(J, np.exp(1j * l * theta[:, None]))


def join_orders(J: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Return W of orders -L..L from J_l and exp(j l theta) of orders 0..L, each (..., L + 1); J_{-l} = (-1)^l J_l."""
    sign = (-1.0) ** np.arange(J.shape[-1] - 1, 0, -1)
    return np.concatenate([sign * (J * phase.conj())[..., :0:-1], J * phase], axis=-1)


@functools.lru_cache(maxsize=256)
def degrees(order: int, planar: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return degree l and order m, each (K,), of every column of W; `planar`: only the columns with l + m even."""
    l = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)  # noqa: E741
    m = np.arange(len(l)) - l * (l + 1)
    kept = (l + m) % 2 == 0 if planar else slice(None)
    found = l[kept], m[kept]
    for array in found:
        array.setflags(write=False)
    return found


def spherical_bessel(positions: Reals, wavenumber: complex, order: int, centre: ArrayLike) -> np.ndarray:
    """Return W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n) : (N, K) complex128, columns as in `degrees`.

    `positions` (N, 3), or (N, 2) in a plane through `centre`, metres.
    """
    offsets = np.asarray(positions, float) - np.asarray(centre, float)
    l, m = degrees(order, offsets.shape[1] == 2)  # noqa: E741
    x, y = offsets[:, 0], offsets[:, 1]
    across = np.hypot(x, y)
    height = np.zeros_like(x) if offsets.shape[1] == 2 else offsets[:, 2]
    k = wavenumber if np.imag(wavenumber) else np.real(wavenumber)
    j = spherical_jn(np.arange(order + 1), k * np.hypot(across, height)[:, None])
    Y = sph_harm_y_all(order, order, np.arctan2(across, height), np.arctan2(y, x))  # (L + 1, 2L + 1, N), m = -1 last
    return np.sqrt(4 * np.pi) * j[:, l] * Y[l, m].T


def dictionary(points: Reals, wavenumber: complex, order: int, centre: ArrayLike, dimension: int) -> np.ndarray:
    """Return the rows of W at points (C, D), metres, in a field of 2 or 3 dimensions : (C, K) complex128."""
    functions = fourier_bessel if dimension == 2 else spherical_bessel
    return functions(np.asarray(points, float), complex(wavenumber), order, centre)
