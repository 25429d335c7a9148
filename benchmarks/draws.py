"""Draws of arrays, sources and noise, rooms in closed form as truth, and the Cramer-Rao bound.

The rooms are rigid: 6 x 5 m in two dimensions, and the box of the scenes in three. Their sound decays as under the
exponential window. Pressures are those at the room's own frequencies, at least 1 Hz apart, exact to rounding; they use
no function of the solvers.

Sources stand anywhere in the room, not nearer than 0.2 m (3-D: 0.3 m) to a wall and 1.2 m to the centre of the array.
"""

import functools
import itertools
import os
import time
from dataclasses import dataclass, replace

import numpy as np

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.cost.likelihood import isotropic_field, likelihood_terms
from fdcal.model.arrays import positions_3d, positions_of
from fdcal.model.gauge import align, position_errors
from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power
from fdcal.model.scene import Scene, load_scene
from fdcal.model.settings import SolverSettings
from fdcal.model.validation import InputError
from fdcal.solvers import run

from .report import Figure

AWAY = 1.2  # metres, least distance of the source to the centre of the array
FROM_WALLS = {2: 0.2, 3: 0.3}  # metres
DECAY = {2: 3.0, 3: 1.5}  # 1/s, decay of recordings of 4 s and 8 s under the exponential window
FREE = 1000.0  # factor of the power of the field with which its coefficients are practically unknown
LOST = 3.0  # error over the bound from which a draw is lost
SOLVER = os.environ.get("FDCAL_BENCH_SOLVER", "robust")  # or joint, for the benchmarks that use this module


@dataclass(frozen=True)
class Draw:
    """A measurement, and its pressures without noise, (M, N) complex128, in the same unit."""

    measurement: Measurement
    clean: np.ndarray


def draw(name: str, seed: int, modes: int, snr_db: float = np.inf) -> Draw:
    """Return a draw of scene `name`: the seed determines source, noise and, if it is random, the array."""
    scene, field = _field(name, seed, modes)
    measurement = draw_measurement(
        field,
        mode_power(field.pressures) * 10 ** (-snr_db / 10),
        np.random.default_rng([seed, 3]),
        sound_speed=scene.room.sound_speed,
        dimension=scene.room.dimension,
        array_dimension=scene.array.dimension,
        positions=positions_of(scene),
        known=scene.gauge.indices(field.pressures.shape[1]),
        search=scene.search,
    )
    return Draw(measurement, field.pressures)


@functools.lru_cache(maxsize=64)
def _field(name: str, seed: int, modes: int) -> tuple[Scene, ModalPressures]:
    """Return the scene of a draw, and its field without noise."""
    scene = load_scene(name)
    position = source_of(scene, np.random.default_rng([seed, 2]))
    scene = replace(scene, seed=seed, source=replace(scene.source, position=position))
    D, c = scene.room.dimension, scene.room.sound_speed
    frequencies = eigenfrequencies(scene.room.size, modes, c, D == 3)
    k = (2 * np.pi * frequencies - 1j * DECAY[D]) / c
    places = positions_3d(scene) if D == 3 else positions_of(scene)
    return scene, ModalPressures(frequencies, k, point_source_pressures(scene.room, position, places, k))


def source_of(scene: Scene, rng: np.random.Generator) -> tuple[float, ...]:
    """Return a position of the source, metres."""
    size, gap = np.array(scene.room.size), FROM_WALLS[scene.room.dimension]
    while True:
        place = rng.uniform(gap, size - gap)
        if np.linalg.norm(place - scene.array.center) >= AWAY:
            return tuple(place.tolist())


def eigenfrequencies(size, count: int, c: float, spaced: bool, lowest=20.0, highest=300.0, apart=1.0) -> np.ndarray:
    """Return the `count` lowest of a rigid room, Hz, `apart` Hz apart; `spaced`: an even choice below `highest`."""
    numbers = np.array(list(itertools.product(range(40), repeat=len(size))))
    every = np.sort(c / 2 * np.linalg.norm(numbers / np.array(size), axis=1))
    chosen = [0.0]
    for f in every[every > lowest]:
        if f - chosen[-1] > apart:
            chosen.append(float(f))
    usable = np.array(chosen[1:])
    if spaced:
        usable = usable[usable < highest]
        return usable[np.round(np.linspace(0, len(usable) - 1, count)).astype(int)]
    return usable[:count]


def bound(drawn: Draw, known: str, modes: int) -> float:
    """Return the Cramer-Rao bound of the RMS position error, metres; the coefficients of the field are unknown.

    It follows from the curvature of the likelihood at the true positions and pressures, with FREE times the power of
    the field. Known microphones are left out, or with known = "none" translation and rotation.
    """
    m, clean = drawn.measurement, drawn.clean[:modes]
    power = mode_power(clean)
    scaled = clean / np.sqrt(power)[:, None]
    field = isotropic_field(scaled, m.wavenumbers[:modes], m.noise_power[:modes] / power, m.dimension)
    field = replace(field, power=FREE * np.ones(len(power)))
    H = likelihood_terms(m.positions, scaled, field).newton()[1]
    N, D = m.positions.shape
    free = np.setdiff1d(np.arange(N), m.known) if known == "all" else np.arange(N)
    values = np.linalg.eigvalsh(H[free][:, :, free].reshape(len(free) * D, -1))
    if known == "none":
        values = values[D * (D + 1) // 2 :]
    return float(np.sqrt(np.sum(1 / values) / N))


@dataclass(frozen=True)
class Outcome:
    """Positions (N, D), metres, aligned if blind; RMS error, metres; seconds of clock and processor; state."""

    positions: np.ndarray
    rms: float
    wall: float
    cpu: float
    state: object


def solve(measurement: Measurement, known: str, modes: int, **settings) -> Outcome:
    """Return the result of SOLVER for a measurement; NaN positions where it raises an error."""
    problem = measurement.problem(known=known)
    wall, cpu = time.perf_counter(), time.process_time()
    state, found = None, np.full(measurement.positions.shape, np.nan)
    try:
        for state in run(problem, SolverSettings(name=SOLVER, modes=modes, **settings), 0):  # noqa: B007, the last one counts
            pass
        found = state.positions
        found = align(found, measurement.positions) if known == "none" else found
    except (InputError, np.linalg.LinAlgError) as error:
        print(f"    {type(error).__name__}: {error}")
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    rms = pooled(position_errors(found, measurement.positions))
    return Outcome(found, rms, wall, cpu, state)


def pooled(values) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def summary(
    name: str, drawn: list[Draw], known: str, modes: int, limit: float | None = 1.3, **settings
) -> list[Figure]:
    """Return figures of the RMS error pooled over draws, of its ratio to the bound, and of the number of lost draws."""
    rms = [solve(d.measurement, known, modes, **settings).rms for d in drawn]
    least = [bound(d, known, modes) for d in drawn]
    ratio, lost = pooled(rms) / pooled(least), sum(not r <= LOST * b for r, b in zip(rms, least, strict=True))
    target, none = ("", "") if limit is None else (f"at most {limit:g}", "0")
    met, kept = (None, None) if limit is None else (ratio <= limit, lost == 0)
    return [
        Figure(f"{name}: RMS error, {len(drawn)} draws pooled", 1e3 * pooled(rms), "mm"),
        Figure(f"{name}: over the bound, {1e3 * pooled(least):.3g} mm", ratio, "times", target, met),
        Figure(f"{name}: lost, more than {LOST:g} times their bound", lost, "draws", none, kept),
    ]
