"""What the plot commands compute before they draw: positions and a summed cost landscape."""

from pathlib import Path
from typing import Any

import numpy as np

from ..assessment.calibration import Calibration
from ..assessment.words import error_line
from ..cost.eq7 import ORDER_OFFSET, expansion_of, require_modes, require_plane_field
from ..cost.maps import cost_volume, descent_maps, minima_of
from ..graphics.heatmap import basin_floor, cost_floor
from ..graphics.picture import z_range_of
from ..graphics.volume import SampledVolume, Volume, basin_layer, layer_floor, sampled_volume, volume_of
from ..model.measurement import Measurement
from ..model.storage import write_atomically
from ..model.validation import InputError, parse_modes
from ..session.calibration_run import assess_state, healthy_microphones, problem_of
from ..session.sources import CalibrationInput


def shown_positions(measurement: Measurement, result: Calibration | None) -> np.ndarray:
    """Return the positions (N, D), metres, of a result, moved onto the true ones if it is blind; or the true ones."""
    if result is not None:
        return result.positions_for(measurement)
    if measurement.positions is None:
        raise InputError("the measurement holds no true positions", "give those of a result: <result>", key="result")
    return measurement.positions


def error_title(measurement: Measurement, result: Calibration) -> str:
    """Return the errors of a result in words, over the microphones that `fdcal calibrate` averages."""
    given = [n for n, name in enumerate(measurement.names) if name in (result.known or ())]
    compared = result.compared_with(measurement, given)
    errors = None if compared.errors is None else compared.errors[result.counted(given)]
    return error_line(errors, result.aligned, measurement.nominal)


def counted_microphones(inputs: CalibrationInput, state) -> np.ndarray:
    """Return the numbers (K,) of the microphones whose errors are averaged: those sought with healthy channels."""
    everything = np.arange(inputs.measurement.count)
    free = np.setdiff1d(everything, inputs.given)
    found = None if state.channels is None else assess_state(inputs, problem_of(inputs), state)
    return healthy_microphones(free if len(free) else everything, inputs.measurement.names, found)


def volume_around(inputs: CalibrationInput, positions: np.ndarray, n: int, modes: int) -> SampledVolume:
    """Return the cost of moving microphone `n` of an array in space (N, 3) through the search domain, as on the page.

    `modes`: how many are summed, from the lowest up, of those that the microphones can carry.
    """
    problem = inputs.measurement.problem(inputs.settings.weights)
    carried = expansion_of(problem, ORDER_OFFSET).carried.modes + 1
    used = carried[carried <= modes].tolist()
    if not used:
        raise InputError("the microphones are too few for any mode", "use a smaller <radius>", key="radius")
    terms = cost_volume(problem, positions, n, used, ORDER_OFFSET)
    sampled = None if terms is None else sampled_volume(terms)
    if sampled is None:
        raise ValueError("a volume without cancellation must be complete")
    return sampled


def map_of(
    inputs: CalibrationInput,
    positions: np.ndarray,
    n: int,
    modes: int,
    basins: bool,
    wave: str | None = None,
) -> dict[str, Any]:
    """Return the map of a microphone for a snapshot: {"floor": Floor} and, in space, {"volume": Volume}.

    `basins`: colour basins of attraction instead of the cost; the first is that of the true position, or of the
    estimate. `wave`: draw standing waves of these modes, such as "22, 38", instead.
    """
    measurement = inputs.measurement
    if measurement.search is None:
        problem = f"{inputs.name} has no search domain to draw a landscape on"
        raise InputError(problem, "leave out <microphone>", key="microphone")

    if wave is not None:
        from ..graphics.waves import MAX_WAVES, wave_floor

        if measurement.array_dimension == 3:
            raise InputError(f"{inputs.name} is an array in space", "give an array in a plane", key="wave", value=wave)
        numbers = parse_modes(wave, len(measurement.frequencies))
        if len(numbers) > MAX_WAVES:
            raise InputError(
                f"{len(numbers)} waves are too many", f"name 1 to {MAX_WAVES} modes", key="wave", value=wave
            )
        names = [(mode, f"mode {mode}, {measurement.frequencies[mode - 1]:.1f} Hz") for mode in numbers]
        problem, offset = measurement.problem(inputs.settings.weights), inputs.settings.order_offset
        return {"floor": wave_floor(problem, positions, n, names, offset)}

    from ..cost.basins import basins_of  # compiled code, which other commands do not need

    truth = measurement.positions
    place = (positions[n], "estimate") if truth is None else (truth[n], f"{measurement.reference} position")
    if measurement.array_dimension == 3:
        sampled, z = volume_around(inputs, positions, n, modes), float(positions[n, 2])
        height = z_range_of(inputs.scene, measurement)[0]
        if basins:
            layer = basin_layer(basins_of(sampled.cost), sampled.search, z, height, *place)
            return {"volume": Volume(None, None, (), sampled.minima), "floor": layer}
        volume = volume_of(sampled.cost, sampled.search, True, sampled.minima)
        return {"volume": volume, "floor": layer_floor(volume, sampled, z, height, True)}
    from ..solvers.descent import order_offset_of  # compiled code, which other commands do not need

    problem, settings = inputs.measurement.problem(inputs.settings.weights), inputs.settings
    offset = order_offset_of(settings, modes)
    require_plane_field(problem)
    require_modes(problem, offset, modes)
    # the cost that a step of descent minimises
    maps = descent_maps(problem, positions, n, range(1, modes + 1), offset, settings.known_weight)
    cost, search = maps.sum(axis=0), measurement.search
    minima = minima_of(cost, search)
    if not basins:
        return {"floor": cost_floor(cost, search, log=True, minima=minima)}
    return {"floor": basin_floor(basins_of(cost), search, minima, *place)}


def write_volume(path: Path, inputs: CalibrationInput, positions: np.ndarray, n: int, force: bool) -> None:
    """Write the cost of moving a microphone in space, summed over all modes, for ParaView."""
    from ..graphics.exports import volume_vti

    sampled = volume_around(inputs, positions, n, len(inputs.measurement.frequencies))
    text = volume_vti(sampled.cost, sampled.search)
    write_atomically(path, lambda file: file.write_text(text, encoding="ascii"), force)
    place = ", ".join(f"{x:.4g}" for x in sampled.minima.lowest[0])
    print(f"{path}: microphone {n}, least cost {sampled.cost.min():.3g} of the power at ({place}) m")
