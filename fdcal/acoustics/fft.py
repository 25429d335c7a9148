"""SciPy's transforms of real signals, with types: its dispatch layer hides them from type checkers."""

from __future__ import annotations

import numpy as np
from scipy import fft


def fast_length(least: int) -> int:
    """Return the smallest length of at least `least` whose transform is fast."""
    length: int | None = fft.next_fast_len(least, real=True)
    return least if length is None else length


def rfft(values, length: int | None = None) -> np.ndarray:
    """Return the transform of real `values` along the last axis, padded to `length` : complex."""
    return np.asarray(fft.rfft(values, length))


def irfft(spectrum, length: int) -> np.ndarray:
    """Return the real signal of a `spectrum` along the last axis : (..., length)."""
    return np.asarray(fft.irfft(spectrum, length))
