"""The sound field inside the array, on a lattice: what `fdcal field` writes.

FieldMap     pressures at some of the measured frequencies, NaN outside the array
field_map    from calibrated positions
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay, QhullError

from ..model.measurement import Measurement
from ..model.power import mode_power
from ..model.validation import InputError, require_positive
from .cross_validation import expansions

CELLS = 60  # of the lattice along the longest side, unless a step is given
MOST_POINTS = 500_000
NEAR = 0.05  # of a frequency asked for: the nearest one measured is taken for it within this much
EDGE = 1e-9  # of the array's extent: microphones on its hull are inside


@dataclass(frozen=True)
class FieldMap:
    """Pressures on a lattice inside an array.

    Attributes
    ----------
    axes : D arrays of float64, metres, the coordinates of the lattice
    frequencies : (F,) float64, Hz
    pressure : (F, nx, ny[, nz]) complex128, in the measurement's unit, time sign exp(+j w t); NaN outside the array
    uncertainty : the same shape, float64, one sigma
    microphones : (N, D) float64, metres
    """

    axes: tuple[np.ndarray, ...]
    frequencies: np.ndarray
    pressure: np.ndarray
    uncertainty: np.ndarray
    microphones: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Which points of the lattice lie in the convex hull of the array : (nx, ny[, nz]) bool."""
        return np.isfinite(self.uncertainty[0])

    @property
    def points(self) -> np.ndarray:
        """(P, D) float64, metres, those inside, the last coordinate fastest."""
        return np.stack([grid[self.inside] for grid in np.meshgrid(*self.axes, indexing="ij")], axis=-1)


def field_map(
    measurement: Measurement, positions, wanted, step: float | None = None, speed: float | None = None
) -> FieldMap:
    """The field at the frequencies `wanted`, Hz, of microphones at `positions` (N, D), metres.

    step : metres, of the lattice; a sixtieth of the longest side unless given
    speed : m/s, of sound, in place of the measurement's

    Raises InputError for a frequency that was not measured, a step too fine, microphones that enclose nothing.
    """
    positions = np.asarray(positions, float)
    modes = _nearest(measurement, wanted)
    axes, inside = _lattice(positions, step)
    shape = (len(modes), *inside.shape)
    pressure, uncertainty = np.full(shape, complex(np.nan, np.nan)), np.full(shape, np.nan)
    points = np.stack([grid[inside] for grid in np.meshgrid(*axes, indexing="ij")], axis=-1)
    problem = measurement.problem("unit", "none")
    if speed is not None:
        problem = _at_speed(problem, speed)
    unit = _rms(measurement.pressures)
    for i, m in enumerate(modes):
        (expansion,) = expansions(problem, positions, slice(m, m + 1), problem.noise_power)
        values, sigma = expansion.at(points)
        pressure[i, inside], uncertainty[i, inside] = unit[m] * values, unit[m] * sigma
    return FieldMap(axes, measurement.frequencies[modes], pressure, uncertainty, positions)


def _at_speed(problem, speed: float):
    return replace(problem, wavenumbers=problem.wavenumbers * (problem.sound_speed / speed), sound_speed=speed)


def _rms(pressures: np.ndarray) -> np.ndarray:
    """Root mean square (M,) of pressures (M, N) in any unit."""
    largest = np.abs(pressures).max(axis=1)
    return largest * np.sqrt(mode_power(pressures / largest[:, None]))


def _nearest(measurement: Measurement, wanted) -> list[int]:
    """Numbers of the measured frequencies nearest to those wanted, each once."""
    measured = measurement.frequencies
    if wanted is None:  # lowest, middle and highest
        return sorted({0, len(measured) // 2, len(measured) - 1})
    for f in wanted:
        require_positive("--frequencies", f, "Hz")
        nearest = float(measured[np.argmin(np.abs(measured - f))])
        if abs(nearest - f) > NEAR * f:
            raise InputError(
                f"--frequencies {f:g}: nothing was measured there, the nearest is {nearest:.4g} Hz; the"
                f" {len(measured)} measured go from {measured[0]:.4g} to {measured[-1]:.4g} Hz"
            )
    return sorted({int(np.argmin(np.abs(measured - f))) for f in wanted})


def _lattice(positions: np.ndarray, step: float | None) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Axes of a lattice over the array, and which of its points are inside."""
    low, extent = positions.min(axis=0), np.ptp(positions, axis=0)
    step = extent.max() / CELLS if step is None else step
    require_positive("--step", float(step), "m")
    counts = np.maximum(np.ceil(extent / step * (1 - EDGE)).astype(float) + 1, 2)
    if np.prod(counts) > MOST_POINTS:
        raise InputError(
            f"--step {step:g} m makes {np.prod(counts):.3g} points; use a larger one ({MOST_POINTS} at most)"
        )
    margin = ((counts - 1) * step - extent) / 2
    axes = tuple(a - m + step * np.arange(int(n)) for a, m, n in zip(low, margin, counts, strict=True))
    try:
        hull = Delaunay(positions)
    except QhullError:
        raise InputError("the microphones lie on a line or in a plane and enclose no field") from None
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return axes, hull.find_simplex(points, tol=EDGE) >= 0
