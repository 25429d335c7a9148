"""The dictionary W of a sound field in three dimensions: spherical Bessel functions and spherical harmonics.

    W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n),    l = 0..L,  m = -l..l

k               wavenumber, rad/m, may be complex (time sign exp(+j w t))
L               maximum order, `fdcal.acoustics.fourier_bessel.max_order`; (L + 1)^2 functions
r, theta, phi   spherical coordinates of a microphone about the centre of the expansion, theta from the z axis
Y_lm            orthonormal over the sphere, with the sign of Condon and Shortley

With sqrt(4 pi), W W^H tends to sin(k d) / (k d) for real k as L grows, whatever the centre (the addition theorem):
the covariance of a diffuse field of unit power. That of a complex k depends on the centre.

Microphones in a plane measure a field of three dimensions, too. On the plane through the centre the functions with
l + m odd are zero and those with l + m even remain, (L + 1)(L + 2) / 2 of them. Positions with two coordinates are
taken to lie in that plane.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.special import sph_harm_y_all, spherical_jn


@functools.lru_cache(maxsize=256)
def degrees(order: int, planar: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return degree l and order m of every column of W, l ascending, then m.

    `order`: L; `planar`: only the columns with l + m even. Returns two (K,) int64 arrays, read-only.
    """
    l = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)  # noqa: E741
    m = np.arange(len(l)) - l * (l + 1)
    kept = (l + m) % 2 == 0 if planar else slice(None)
    found = l[kept], m[kept]
    for array in found:
        array.setflags(write=False)
    return found


def spherical_bessel(positions, wavenumber: complex, order: int, centre) -> np.ndarray:
    """Return the dictionary W[n, (l, m)] = sqrt(4 pi) j_l(k r_n) Y_lm(theta_n, phi_n), columns as in `degrees`.

    `positions` (N, 3) or (N, 2) float64, metres; (N, 2) in a plane through `centre`; `wavenumber`: float or complex k,
    rad/m.; `order`: L; `centre` (3,) or (2,) float64, origin of r, metres. Returns (N, K) complex128, K = (L + 1)^2, or
    (L + 1)(L + 2) / 2 in a plane.

    Examples
    --------
    >>> np.abs(spherical_bessel(np.zeros((1, 3)), 1.0, 1, (0.0, 0.0, 0.0)))
    array([[1., 0., 0., 0.]])
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
