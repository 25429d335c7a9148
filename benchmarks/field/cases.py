"""Make a measurement and the truth from the description of a case. Every draw is fixed by the seed."""

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fdcal.acoustics.measure import draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.model.measurement import save_measurement
from fdcal_bench.draw import Scenario, draw
from fdcal_bench.study import Study, load_study

from .boxes import image_source_field, pyroomacoustics_field
from .constants import SOUND_SPEED
from .faults import FAULTS, Recording
from .finite_elements import SHAPES, SolvedRoom, solved_room
from .geometries import geometry, spread_known
from .placement import Placement, moved_sources, place
from .rectangle import rectangle_field
from .scatterer import scattered_field
from .spec import Spec

BELOW_LIMIT = 0.97  # of Eq. 9: the highest frequency of a case


@dataclass(frozen=True)
class Case:
    """A measurement file's content, and what the score needs.

    spec : Spec; table : keys and arrays of a measurement file; positions : (N, D) float64, metres, the truth;
    known : (A,) int64, microphones whose positions are given; named : microphones that a fault concerns
    """

    spec: Spec
    table: dict[str, np.ndarray]
    positions: np.ndarray
    known: np.ndarray
    named: tuple[int, ...]


class NoCaseError(RuntimeError):
    """The draws found no room for the array and its source, or no frequency."""


def build(spec: Spec, folder: Path) -> Case:
    """Return the case of `spec`; `folder` keeps the solutions of the finite-element rooms. Raises NoCaseError."""
    if spec.scenario is not None:
        return _of_scenario(spec, spec.scenario)
    rng = np.random.default_rng([77, spec.seed])
    array = geometry(spec.geometry, spec.count, spec.size, rng, spec.dimension)
    room = solved_room(spec.room, folder) if spec.room in SHAPES else None
    placed = place(spec, array, rng, None if room is None else room.room.shape)
    if placed is None:
        raise NoCaseError("no room for the array and its source")
    reflection = rng.uniform(*spec.reflection, (3, 2))
    highest = spec.highest if spec.beyond else min(spec.highest, BELOW_LIMIT * frequency_limit(spec, array))
    takes = None
    if room is not None:
        frequencies, wavenumbers, pressures = _in_shape(spec, placed, room, highest)
    elif spec.takes == 1:
        frequencies, wavenumbers, pressures = _in_box(spec, placed, reflection, highest, rng)
    else:
        placements = moved_sources(spec, placed, np.random.default_rng([78, spec.seed]))
        if len(placements) < spec.takes:
            raise NoCaseError("no room for the sources of all takes")
        every = [_in_box(spec, one, reflection, highest, rng) for one in placements]
        takes = np.repeat(np.arange(len(every)), [len(f) for f, _, _ in every])
        frequencies, wavenumbers, pressures = map(np.concatenate, zip(*every, strict=True))
        order = np.argsort(frequencies, kind="stable")
        takes, frequencies, wavenumbers, pressures = (a[order] for a in (takes, frequencies, wavenumbers, pressures))
    if not len(frequencies):
        raise NoCaseError("the mean power has no peak")
    truth = placed.points[:, : array.shape[1]]
    known = _known(spec, truth, rng)
    power = np.mean(np.abs(pressures) ** 2, axis=1)
    recording = Recording(frequencies, pressures, power, known, truth[known].copy(), wavenumbers)
    if spec.fault is not None:
        recording = FAULTS[spec.fault[0]](recording, spec.fault[1], rng)
    table = _table(spec, recording, array.shape[1], takes, rng)
    if takes is not None:
        table["takes"] = takes
    return Case(spec, table, truth, known, recording.named)


@cache
def calibration_study() -> Study:
    """Return the study whose scenarios are families of cases as well."""
    return load_study(Path(__file__).parents[2] / "studies" / "calibration.toml")


def _of_scenario(spec: Spec, scenario: Scenario) -> Case:
    """Return the draw of a scenario, as `fdcal study` calibrates it."""
    drawn, file = draw(scenario, spec.seed), io.BytesIO()
    measurement = drawn.measurement
    save_measurement(measurement, file)
    file.seek(0)
    table = {key: value for key, value in np.load(file).items() if key != "positions"}
    return Case(spec, table, measurement.positions, measurement.known, tuple(map(int, drawn.faulty | drawn.misplaced)))


def frequency_limit(spec: Spec, array: np.ndarray) -> float:
    """Return the highest frequency that the array interpolates, Hz: Eq. 9, and the corresponding limit in space."""
    count, radius = len(array), np.linalg.norm(array - array.mean(axis=0), axis=1).max()
    if spec.dimension == 2:
        return (count - 1) * SOUND_SPEED / (4 * np.pi * radius)
    order = np.sqrt(count) - 1 if array.shape[1] == 3 else (np.sqrt(8 * count + 1) - 3) / 2
    return order * SOUND_SPEED / (2 * np.pi * radius)


def _in_box(spec: Spec, placed: Placement, reflection, highest: float, rng):
    """Frequencies (M,), wavenumbers (M,) and pressures (M, N) in a rectangle or a box."""
    field = _field_of(spec, placed, reflection)
    decay = spec.decay if spec.dimension == 2 else 0.0
    if spec.frequencies == "peaks":
        frequencies = _peaks(spec, placed, reflection, highest, decay, rng)
    else:
        frequencies = np.linspace(spec.lowest, highest, spec.modes)
    wavenumbers = (2 * np.pi * frequencies - 1j * decay) / SOUND_SPEED
    pressures = field(placed.points, wavenumbers)
    if spec.scatterer is not None:
        radius, admittance = spec.scatterer
        centre = _scatterer_centre(spec, placed, rng)
        pressures = pressures + scattered_field(
            placed.points, centre, radius, admittance, wavenumbers, lambda points: field(points, wavenumbers)
        )
    return frequencies, wavenumbers, pressures


def _in_shape(spec: Spec, placed: Placement, room: SolvedRoom, highest: float):
    used = np.flatnonzero(room.frequencies <= highest)[: spec.modes]
    wavenumbers = room.wavenumbers[used]
    return room.frequencies[used], wavenumbers, room.room.pressures(placed.points, wavenumbers, room.solutions[used])


def _field_of(spec: Spec, placed: Placement, reflection, order: int | None = None) -> Callable:
    """The function of points (P, D) and wavenumbers (M,) that gives the pressures (M, P)."""
    if spec.dimension == 2:
        return lambda points, k: _rectangle(placed, points, k)
    if spec.room == "pyroomacoustics":
        return lambda points, k: pyroomacoustics_field(points, placed.source, placed.size, k, reflection)
    images = spec.order if order is None else order
    return lambda points, k: image_source_field(points, placed.source, placed.size, k, reflection, images)


def _rectangle(placed: Placement, points, k) -> np.ndarray:
    longest, nearest = placed.size.max(), np.abs(points - placed.source).max(axis=1).min()
    terms = int(32 * longest / (np.pi * nearest) + np.abs(k).max() * longest / np.pi + 20)
    pressures = rectangle_field(points, placed.source, placed.size, k, min(terms, 4000))
    if placed.second is not None:
        other = rectangle_field(points, placed.second, placed.size, k, min(3 * terms, 4000))
        pressures = pressures + 0.8 * np.exp(1j) * other
    return pressures


def _peaks(spec: Spec, placed: Placement, reflection, highest: float, decay: float, rng) -> np.ndarray:
    """Return the lowest local maxima of the mean power at a few microphones, Hz."""
    lattice = np.arange(spec.lowest, highest, 0.5 if spec.dimension == 2 else 1.0)
    few = placed.points[rng.permutation(len(placed.points))[: 8 if spec.dimension == 2 else 4]]
    field = _field_of(spec, placed, reflection, order=5)
    power = np.mean(np.abs(field(few, (2 * np.pi * lattice - 1j * decay) / SOUND_SPEED)) ** 2, axis=1)
    higher = (power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])
    return lattice[np.flatnonzero(higher)[: spec.modes] + 1]


def _scatterer_centre(spec: Spec, placed: Placement, rng) -> np.ndarray:
    """Return a place inside the array where no microphone is."""
    offset = spec.scatterer_offset * placed.radius * np.array([1.0, 0.3])
    centre = placed.points.mean(axis=0) + offset
    while np.linalg.norm(placed.points - centre, axis=1).min() < spec.scatterer[0] + 0.02:
        centre = centre + rng.uniform(-0.1, 0.1, 2)
    return centre


def _known(spec: Spec, truth: np.ndarray, rng) -> np.ndarray:
    known = spread_known(truth, spec.known, rng) if spec.known else np.zeros(0, int)
    if spec.neighbours:
        known = np.sort(np.argsort(np.linalg.norm(truth - truth[0], axis=1))[: spec.known])
    return known


def _table(spec: Spec, recording: Recording, array_dimension: int, takes, rng) -> dict[str, np.ndarray]:
    """Return the content of the measurement file, with noise."""
    pressures, noise = _with_noise(spec, recording, takes, rng)
    table = {
        "frequencies": recording.frequencies,
        "pressures": pressures,
        "sound_speed": np.float64(recording.sound_speed),
        "dimension": np.int64(spec.dimension),
    }
    if array_dimension != spec.dimension:
        table["array_dimension"] = np.int64(array_dimension)
    drifts = spec.fault is not None and spec.fault[0] == "drift"
    if (np.any(recording.wavenumbers.imag) and recording.reports_wavenumbers) or drifts:
        table["wavenumbers"] = recording.wavenumbers
    if noise is not None and recording.noise_factor is not None:
        table["noise_power"] = noise * recording.noise_factor
    elif noise is not None and spec.noise == "reported":
        table["noise_power"] = noise
    if len(recording.known):
        table |= {"known": recording.known, "known_positions": recording.given}
    return table


def _with_noise(spec: Spec, recording: Recording, takes, rng) -> tuple[np.ndarray, np.ndarray | None]:
    """Return pressures (M, N) with noise, and the power of the noise (M,), None if it is not known."""
    pressures, power = recording.pressures, recording.power
    if spec.snr is None:
        return pressures, np.zeros(len(power)) if spec.noise == "reported" else None
    ratio = 10 ** (-spec.snr / 10)
    level = np.full(len(power), ratio * np.exp(np.mean(np.log(power)))) if spec.noise == "floor" else ratio * power
    field = ModalPressures(recording.frequencies, recording.wavenumbers, pressures)
    drawn = draw_measurement(field, level, rng, sound_speed=recording.sound_speed, takes=takes)
    return drawn.pressures, level
