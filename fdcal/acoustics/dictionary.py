"""The dictionary W of a sound field without sources, of either dimension: rows at any points."""

from __future__ import annotations

import numpy as np

from .fourier_bessel import fourier_bessel
from .spherical_harmonics import spherical_bessel


def dictionary(points, wavenumber: complex, order: int, centre, dimension: int) -> np.ndarray:
    """Return the rows of W at some points.

    `points` (C, D) float64, metres; in a field of three dimensions D = 2 means a plane through `centre`; `wavenumber`:
    k, rad/m, real or complex; `order`: L; `centre` (D,) float64, metres; `dimension`: 2 for `fourier_bessel` (Eq. 4), 3
    for `spherical_bessel`. Returns (C, K) complex128.
    """
    functions = fourier_bessel if dimension == 2 else spherical_bessel
    return functions(np.asarray(points, float), complex(wavenumber), order, centre)
