"""Types of arrays by what they hold; their shapes and units stand in the docstrings, or beside the fields."""

from typing import TypeAlias

import numpy as np

Reals: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64]]
Complexes: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.complex128]]
# as wavenumbers, which are complex where waves are damped
Numbers: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.float64 | np.complex128]]
Integers: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.int64]]
Bools: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
