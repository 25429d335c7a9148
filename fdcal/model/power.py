"""The mean power of a mode over the microphones, to which noise and residuals are related."""

from __future__ import annotations

import numpy as np


def mode_power(pressures) -> np.ndarray:
    """Return the mean of abs(pressures)**2 over the microphones, mode by mode.

    Parameters
    ----------
    pressures : (..., M, N) complex128
        Pressures of M modes at N microphones, in any unit.

    Returns
    -------
    (..., M) float64
        Mean power, in the squared unit of the pressures.
    """
    return np.mean(np.abs(pressures) ** 2, axis=-1)
