"""What the plot commands compute before they draw: positions, a summed cost landscape, a map of the sound field."""

from __future__ import annotations

import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.field_map import FieldMap, field_map
from ..cost.mode_limits import require_modes, search_lattice
from ..graphics.units import error_summary
from ..model.measurement import Measurement
from ..model.validation import InputError
from ..session.sources import CalibrationInput


def shown_positions(measurement: Measurement, result: Calibration | None) -> np.ndarray:
    """Return the positions of a result, or the true ones without a result.

    Returns
    -------
    (N, D) float64
        Metres; those of a blind result are moved as a whole onto the true positions, where these are known.

    Raises
    ------
    InputError
        There are neither a result nor true positions, or the result is of another measurement.
    """
    if result is not None:
        return result.positions_for(measurement)
    if measurement.positions is None:
        raise InputError("the measurement holds no true positions", "give those of a result: <result>", key="result")
    return measurement.positions


def error_title(measurement: Measurement, result: Calibration) -> str:
    """Return the errors of a result in words, over the microphones that `fdcal calibrate` averages."""
    given = [n for n, name in enumerate(measurement.names) if name in (result.known or ())]
    return error_summary(measurement, result.positions_for(measurement), result.counted(given))


def summed_landscape(inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int) -> np.ndarray:
    """Return what a step of solver descent on one microphone minimises: the sum over the lowest modes.

    Parameters
    ----------
    inputs : CalibrationInput
    positions : (N, D) float64
        Metres.
    n : int
        The microphone that is moved.
    modes : int
        How many modes are summed, from the lowest up.

    Returns
    -------
    (ny, nx) float64
        Cost on the search lattice.
    """
    from ..cost.lattice_search import lattice_landscape  # compiled code, which reading a file does not need
    from ..solvers.descent.state import order_offset_of

    problem, settings = inputs.measurement.problem(inputs.settings.weights), inputs.settings
    offset = order_offset_of(settings, modes)
    require_modes(problem, offset, modes)
    lattice = search_lattice(problem, offset)
    centre = lattice.nearest(np.mean(positions, axis=0))
    maps = lattice_landscape(problem, lattice, positions, n, centre, slice(0, modes), settings.known_weight)
    return maps.sum(axis=0)


def field_inside(
    measurement: Measurement, result: Calibration | None, frequencies: list[float] | None, step: float | None
) -> FieldMap:
    """Return the sound field inside the array, from the positions of a result or the true ones.

    Parameters
    ----------
    measurement : Measurement
        Without the microphones that the result leaves out.
    result : Calibration or None
    frequencies : list of float or None
        Hz; the lowest, middle and highest unless given.
    step : float or None
        Of the lattice, metres.
    """
    positions = shown_positions(measurement, result)
    if frequencies is None and result is not None:
        frequencies = [result.frequencies[i] for i in (0, len(result.frequencies) // 2, -1)]
    return field_map(measurement, positions, frequencies, step, None if result is None else result.sound_speed)
