"""Types of arrays by what they hold; shapes and units stand in the docstrings."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Reals: TypeAlias = NDArray[np.float64]
Complexes: TypeAlias = NDArray[np.complex128]
Numbers: TypeAlias = NDArray[np.float64 | np.complex128]  # as wavenumbers, which are complex where waves are damped
Integers: TypeAlias = NDArray[np.int64]
Bools: TypeAlias = NDArray[np.bool_]
