"""What the simulated microphones of a scene measure at the modes of its room, before noise."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class ModalPressures(NamedTuple):
    """Pressures at the peaks of the spectrum."""

    frequencies: np.ndarray  # (M,) float64, Hz, ascending
    wavenumbers: np.ndarray  # (M,) complex128 k, rad/m.
    pressures: np.ndarray  # (M, N) complex128, any one unit; 1/m in closed form
    # (2, F) float64, the spectrum that the peaks were picked from: Hz and the mean power of the microphones
    spectrum: np.ndarray
