"""The sound field inside the array on a lattice, as `fdcal field` writes it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import Delaunay, QhullError

from ..model.measurement import Measurement
from ..model.power import mode_power
from ..model.problem import Problem
from ..model.validation import InputError, require_positive
from .cross_validation import expansions

CELLS = 60  # of the lattice along the longest side, unless a step is given
MOST_POINTS = 500_000  # of the lattice
FREQUENCY_TOLERANCE = 0.05  # relative: the nearest measured frequency must be this close to the one asked for
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
        """Points of the lattice that lie in the convex hull of the array : (nx, ny[, nz]) bool."""
        return np.isfinite(self.uncertainty[0])

    @property
    def points(self) -> np.ndarray:
        """Points inside the array, (P, D) float64, metres, the last coordinate fastest."""
        return np.stack([grid[self.inside] for grid in np.meshgrid(*self.axes, indexing="ij")], axis=-1)


def field_map(
    measurement: Measurement, positions, wanted, step: float | None = None, speed: float | None = None
) -> FieldMap:
    """Return the field between the microphones at some of the measured frequencies.

    Parameters
    ----------
    positions : (N, D) float64, metres
    wanted : frequencies, Hz; None for the lowest, the middle and the highest
    step : metres, of the lattice; by default a sixtieth of the longest side
    speed : m/s, of sound, in place of the measurement's

    Raises
    ------
    InputError
        A frequency was not measured, the step is too fine, or the microphones enclose no area or volume.
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


def _at_speed(problem: Problem, speed: float) -> Problem:
    return replace(problem, wavenumbers=problem.wavenumbers * (problem.sound_speed / speed), sound_speed=speed)


def _rms(pressures: np.ndarray) -> np.ndarray:
    """Return the root mean square (M,) of pressures (M, N), also where their squares would overflow."""
    largest = np.abs(pressures).max(axis=1)
    return largest * np.sqrt(mode_power(pressures / largest[:, None]))


def _nearest(measurement: Measurement, wanted) -> list[int]:
    """Return the numbers of the measured frequencies nearest to those wanted, each once."""
    measured = measurement.frequencies
    if wanted is None:
        return sorted({0, len(measured) // 2, len(measured) - 1})
    for f in wanted:
        require_positive("frequencies", f, "Hz")
        nearest = float(measured[np.argmin(np.abs(measured - f))])
        if abs(nearest - f) > FREQUENCY_TOLERANCE * f:
            raise InputError(
                f"frequencies = {f:g} Hz: nothing was measured there, the nearest is {nearest:.4g} Hz",
                f"choose <frequencies> of the {len(measured)} from {measured[0]:.4g} to {measured[-1]:.4g} Hz",
                key="frequencies",
                value=f,
            )
    return sorted({int(np.argmin(np.abs(measured - f))) for f in wanted})


def _lattice(positions: np.ndarray, step: float | None) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Return the axes of a lattice over the array, and which of its points are inside."""
    low, extent = positions.min(axis=0), np.ptp(positions, axis=0)
    step = float(extent.max() / CELLS if step is None else step)
    require_positive("step", step, "m")
    counts = np.maximum(np.ceil(extent / step * (1 - EDGE)).astype(float) + 1, 2)
    if np.prod(counts) > MOST_POINTS:
        raise InputError(
            f"step = {step:g} m makes {np.prod(counts):.3g} points, more than {MOST_POINTS}",
            "use a larger one for <step>",
            key="step",
            value=step,
        )
    margin = ((counts - 1) * step - extent) / 2
    axes = tuple(a - m + step * np.arange(int(n)) for a, m, n in zip(low, margin, counts, strict=True))
    try:
        hull = Delaunay(positions)
    except QhullError:
        raise InputError(
            "the microphones lie on a line or in a plane and enclose no field", "use an array that does"
        ) from None
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return axes, hull.find_simplex(points, tol=EDGE) >= 0
