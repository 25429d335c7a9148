"""What the simulated microphones of a scene measure at the modes of its room, before noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ModalPressures(NamedTuple):
    """Pressures at the peaks of the spectrum.

    Attributes
    ----------
    frequencies : (M,) float64
        Hz, ascending.
    wavenumbers : (M,) complex128
        k, rad/m.
    pressures : (M, N) complex128
        Any one unit; 1/m in closed form.
    spectrum : (2, F) float64
        The spectrum that the peaks were picked from: Hz and the mean power of the microphones.
    """

    frequencies: np.ndarray
    wavenumbers: np.ndarray
    pressures: np.ndarray
    spectrum: np.ndarray
