"""What the plot commands compute before they draw: positions, a summed cost landscape, a map of the sound field."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.field import FieldMap, field_map
from ..cost.expansion import require_modes, require_plane_field
from ..graphics.picture import errors_in_words
from ..model.measurement import Measurement
from ..model.validation import InputError
from ..session.calibration_run import assess_state, healthy_microphones, problem_of
from ..session.sources import CalibrationInput

if TYPE_CHECKING:
    from pathlib import Path

    from ..graphics.primitives import Floor
    from ..graphics.volume import SampledVolume, Volume
    from ..model.settings import Search


def shown_positions(measurement: Measurement, result: Calibration | None) -> np.ndarray:
    """Return the positions (N, D), metres, of a result, a blind one moved onto the true ones; or the true ones."""
    if result is not None:
        return result.positions_for(measurement)
    if measurement.positions is None:
        raise InputError("the measurement holds no true positions", "give those of a result: <result>", key="result")
    return measurement.positions


def error_title(measurement: Measurement, result: Calibration) -> str:
    """Return the errors of a result in words, over the microphones that `fdcal calibrate` averages."""
    given = [n for n, name in enumerate(measurement.names) if name in (result.known or ())]
    compared = result.compared_with(measurement, given)
    if compared.errors is None:
        return "true positions unknown"
    return errors_in_words(compared.errors[result.counted(given)], result.aligned, measurement.nominal)


def counted_microphones(inputs: CalibrationInput, state) -> np.ndarray:
    """Return the numbers (K,) of the microphones whose errors are averaged: those sought with healthy channels."""
    everything = np.arange(inputs.measurement.count)
    free = np.setdiff1d(everything, inputs.given)
    found = None if state.channels is None else assess_state(inputs, problem_of(inputs), state)
    return healthy_microphones(free if len(free) else everything, inputs.measurement.names, found)


def summed_landscape(inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int) -> np.ndarray:
    """Return what a step of solver descent on microphone `n` minimises: the sum over the lowest modes : (ny, nx)."""
    from ..cost.maps import descent_maps  # compiled code, which reading a file does not need
    from ..solvers.descent import order_offset_of

    problem, settings = inputs.measurement.problem(inputs.settings.weights), inputs.settings
    offset = order_offset_of(settings, modes)
    require_plane_field(problem)
    require_modes(problem, offset, modes)
    return descent_maps(problem, positions, n, range(1, modes + 1), offset, settings.known_weight).sum(axis=0)


def volume_around(inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int) -> SampledVolume:
    """Return the cost of moving microphone `n` of an array in space (N, 3) through the search domain, as on the page.

    `modes`: how many are summed, from the lowest up, of those that the microphones can carry.
    """
    from ..cost.expansion import expansion_of
    from ..cost.maps import cost_volume
    from ..cost.reference_cost import ORDER_OFFSET
    from ..graphics.volume import sampled_volume

    problem = inputs.measurement.problem(inputs.settings.weights)
    carried = expansion_of(problem, ORDER_OFFSET).carried.modes + 1
    used = carried[carried <= modes].tolist()
    if not used:
        raise InputError("the microphones are too few for any mode", "use a smaller <radius>", key="radius")
    terms = cost_volume(problem, positions, n, used, ORDER_OFFSET)
    sampled = None if terms is None else sampled_volume(terms)
    if sampled is None:
        raise ValueError("a volume that nobody cancels is complete")
    return sampled


def place_of_basin(measurement: Measurement, positions: np.ndarray, n: int) -> tuple[np.ndarray, str]:
    """Return the true position of a microphone and its name, or its position (D,), metres, where that is unknown."""
    if measurement.positions is None:
        return positions[n], "estimate"
    return measurement.positions[n], f"{measurement.reference} position"


def floor_of(cost: np.ndarray, search: Search, basin: tuple[np.ndarray, str] | None) -> Floor:
    """Return a map on the floor of a cost (ny, nx), or of its basins, that of a place with a name first."""
    from ..cost.basins import basins_of
    from ..cost.maps import minima_of
    from ..graphics.basin_map import basin_floor
    from ..graphics.heatmap import cost_floor

    minima = minima_of(cost, search)
    if basin is None:
        return cost_floor(cost, search, log=True, minima=minima)
    return basin_floor(basins_of(cost), search, minima, *basin)


def map_of(
    inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int, plane: tuple[str, float | None], basins: bool
) -> dict[str, Any]:
    """Return what a snapshot shows of the cost of a microphone: {"floor": Floor} or, in space, {"volume": Volume}.

    `plane`: axis across the slice through a volume, and its place along it, metres, None for that of the microphone.
    """
    measurement = inputs.measurement
    if measurement.search is None:
        problem = f"{inputs.name} has no search domain to draw a landscape on"
        raise InputError(problem, "leave out <microphone>", key="microphone")
    basin = place_of_basin(measurement, positions, n) if basins else None
    if measurement.array_dimension == 3:
        return {"volume": sliced_volume(volume_around(inputs, positions, n, modes), positions[n], *plane, basin)}
    return {"floor": floor_of(summed_landscape(inputs, positions, n, modes), measurement.search, basin)}


def sliced_volume(
    sampled: SampledVolume, place, axis: str, position: float | None, basin: tuple[np.ndarray, str] | None
) -> Volume:
    """Return a volume with a slice across an axis, at `position` or through the microphone at `place` (3,), metres."""
    from ..cost.basins import basins_of
    from ..graphics.basin_map import basin_slice
    from ..graphics.volume import drawn_volume, sliced

    through = float(place["xyz".find(axis)]) if position is None else position
    if basin is not None:
        return basin_slice(basins_of(sampled.cost), sampled.search, axis, through, sampled.minima, *basin)
    return sliced(drawn_volume(sampled), sampled, axis, through)


def write_volume(
    path: Path, inputs: CalibrationInput, positions: np.ndarray, n: int, force: bool, basins: bool
) -> None:
    """Write the cost of moving a microphone in space, and its basins, summed over all modes, for ParaView."""
    from ..graphics.exports import volume_vti
    from ..model.storage import write_atomically

    sampled = volume_around(inputs, positions, n, len(inputs.measurement.frequencies))
    text = volume_vti(sampled.cost, sampled.search, basins)
    write_atomically(path, lambda file: file.write_text(text, encoding="ascii"), force)
    place = ", ".join(f"{x:.4g}" for x in sampled.minima.lowest[0])
    print(f"{path}: microphone {n}, least cost {sampled.cost.min():.3g} of the power at ({place}) m")


def field_inside(
    measurement: Measurement, result: Calibration | None, frequencies: list[float] | None, step: float | None
) -> FieldMap:
    """Return the sound field inside the array, from the positions of a result or the true ones."""
    positions = shown_positions(measurement, result)
    if frequencies is None and result is not None:
        frequencies = [result.frequencies[i] for i in (0, len(result.frequencies) // 2, -1)]
    return field_map(measurement, positions, frequencies, step, None if result is None else result.sound_speed)
