"""A room of known size: 8 microphones at 30 frequencies, 40 dB, nothing else known; positions up to the room's mirrors.

Draws of size, source and microphones: anywhere in the room, or (every second) within a square of 1 m. The field is
that of `fdcal.acoustics.box_field`, with rigid walls in the plane and absorbing ones in space. The solver uses another
formula and does not know the walls.
"""

import os
import time
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import draw_measurement
from fdcal.acoustics.room_modes import nearest_symmetry
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.assessment.assess import assess
from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power
from fdcal.model.scene import Room
from fdcal.model.settings import SolverSettings
from fdcal.solvers import load
from fdcal.solvers import run as states

from .draws import eigenfrequencies, pooled
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "20"))
COUNT, MODES, SPEED, DECAY = 8, 30, 343.0, 3.0
ENOUGH = 0.01  # metres
ADMITTANCE = 0.01


def drawn(seed: int, D: int = 2, snr_db: float = 40.0) -> tuple[Measurement, tuple[float, ...]]:
    """A measurement and the size of its room, metres."""
    rng = np.random.default_rng([seed, 17, D])
    size = rng.uniform([4.0, 3.0, 2.4][:D], [8.0, 6.0, 3.2][:D])
    centre = rng.uniform(0.75, size - 0.75) if seed % 2 else size / 2
    half = np.full(D, 0.5) if seed % 2 else size / 2 - 0.3
    positions = centre + rng.uniform(-half, half, (COUNT, D))
    source = rng.uniform(0.2, size - 0.2)
    while np.linalg.norm(positions - source, axis=1).min() < 1.0:
        source = rng.uniform(0.2, size - 0.2)
    f = eigenfrequencies(tuple(size), MODES, SPEED, False)
    k = (2 * np.pi * f - 1j * DECAY) / SPEED
    lengths = tuple(size.tolist())
    room = Room(size=lengths) if D == 2 else Room(size=lengths, walls="absorbing", admittance=ADMITTANCE)
    p = point_source_pressures(room, source, positions, k)
    noise = mode_power(p) * 10 ** (-snr_db / 10)
    described = {"sound_speed": SPEED, "dimension": D, "positions": positions}
    return draw_measurement(ModalPressures(f, k, p), noise, rng, **described), lengths


def found(measurement: Measurement, size) -> SimpleNamespace:
    """RMS error in the nearest symmetry, metres, verdict, seconds and one sigma."""
    start = time.perf_counter()
    problem = measurement.problem()
    for state in states(problem, SolverSettings(name="room", modes=MODES, room=size), 0):  # noqa: B007, the last one counts
        pass
    assessed = assess(load("room").result(problem, state), measurement.names)
    image = nearest_symmetry(state.positions, measurement.positions, size)
    errors = np.linalg.norm(image.apply(state.positions) - measurement.positions, axis=1)
    seconds = time.perf_counter() - start
    return SimpleNamespace(
        rms=pooled(errors), code=assessed.verdict, seconds=seconds, sigma=pooled(assessed.uncertainty)
    )


def run() -> Iterator[Figure]:
    yield from _right("plane, rigid", 2, DRAWS, round(0.9 * DRAWS))
    yield from _right(f"space, walls of admittance {ADMITTANCE:g}", 3, max(1, DRAWS // 4), None)
    for wrong in (1.01, 0.99):
        yield from _wrong(wrong)


def _right(words: str, D: int, draws: int, wanted: int | None) -> Iterator[Figure]:
    outcomes = [found(*drawn(seed, D)) for seed in range(draws)]
    near = [o for o in outcomes if o.rms <= ENOUGH]
    target = ("", None) if wanted is None else (f"at least {wanted}", len(near) >= wanted)
    yield Figure(f"{words}: within 1 cm RMS, of {draws} draws", len(near), "draws", *target)
    yield Figure(f"{words}: RMS error of these", 1e3 * pooled([o.rms for o in near]), "mm")
    yield Figure(f"{words}: worst", 1e3 * max(o.rms for o in outcomes), "mm")
    yield Figure(f"{words}: reported standard deviation", 1e3 * pooled([o.sigma for o in near]), "mm")
    yield Figure(f"{words}: verdict good and within 1 cm", sum(o.code == "good" for o in near), "draws")
    confident = sum(o.code == "good" for o in outcomes if o.rms > ENOUGH)
    yield Figure(f"{words}: verdict good and wrong", confident, "draws", "0", confident == 0)
    yield Figure(f"{words}: median time", float(np.median([o.seconds for o in outcomes])), "s")


def _wrong(factor: float) -> Iterator[Figure]:
    """Yield the figures with a given room size that is wrong by a factor."""
    outcomes = []
    for seed in range(max(1, DRAWS // 4)):
        measurement, size = drawn(seed)
        outcomes.append(found(measurement, tuple(factor * length for length in size)))
    words = f"plane, given size {100 * (factor - 1):+.0f} % wrong"
    good = sum(o.code == "good" for o in outcomes)
    yield Figure(f"{words}: verdict good, of {len(outcomes)} draws", good, "draws", "0", good == 0)
    yield Figure(f"{words}: verdict room_size", sum(o.code == "room_size" for o in outcomes), "draws")
    yield Figure(f"{words}: median error", 1e3 * float(np.median([o.rms for o in outcomes])), "mm")
