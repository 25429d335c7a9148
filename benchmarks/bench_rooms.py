"""Whether the accuracy depends on the walls: one array in absorbing, pressure-release, rigid and L-shaped rooms.

Array 2 in rooms simulated by finite differences, 57 frequencies of each; the solver does not know the walls. With noise
each room is compared with its own bound, computed from its pressures without noise. The accuracy counts as the same if
every error is within 1.3 times the bound and, without noise, at most twice that of the rigid room.
"""

import os
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fdcal.acoustics.measure import cached_measurement, draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.model.problem import mode_power
from fdcal.model.scene import Room, load_scene

from .draws import Draw, solve, summary
from .report import Figure

DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "5"))  # of noise
MODES = 57
SNR_DB = (40, 20)
SOURCE = (5.47, 0.53)  # metres, in all of the rooms, round the corner of the L
CORNERS = ((0.0, 0.0), (6.0, 0.0), (6.0, 3.0), (4.0, 3.0), (4.0, 5.0), (0.0, 5.0))
ROOMS = {
    "rigid": Room(size=(6.0, 5.0)),
    "absorbing": Room(size=(6.0, 5.0), walls="absorbing", admittance=0.005),
    "pressure-release": Room(size=(6.0, 5.0), walls="pressure-release"),
    "L-shaped": Room(outline=CORNERS, walls="rigid"),
}


def scene_in(room: Room):
    """Return the scene of array 2 in a room."""
    scene = load_scene("array2_random")
    return replace(scene, room=room, source=replace(scene.source, position=SOURCE))


def noisy(scene, snr_db: float, seed: int) -> Draw:
    """Return a measurement of the scene with the noise of a seed."""
    measurement = cached_measurement(scene)
    clean = measurement.pressures
    field = ModalPressures(measurement.frequencies, measurement.wavenumbers, clean)
    power, rng = mode_power(clean) * 10 ** (-snr_db / 10), np.random.default_rng([seed, 4])
    drawn = draw_measurement(field, power, rng, sound_speed=measurement.sound_speed)
    return Draw(replace(measurement, pressures=drawn.pressures, noise_power=power), clean)


def run() -> Iterator[Figure]:
    for known, words in (("all", "three known"), ("none", "blind")):
        rigid = np.nan
        for name, room in ROOMS.items():
            measurement = cached_measurement(scene_in(room))
            rms = 1e3 * solve(measurement, known, MODES).rms
            rigid = rms if name == "rigid" else rigid
            target, met = ("", None) if name == "rigid" else (f"at most {2 * rigid:.3g}", rms <= 2 * rigid)
            yield Figure(f"{name}, {words}, no noise: RMS error", rms, "mm", target, met)
        for snr in SNR_DB:
            for name, room in ROOMS.items():
                drawn = [noisy(scene_in(room), snr, seed) for seed in range(DRAWS)]
                yield from summary(f"{name}, {words}, {snr} dB", drawn, known, MODES)
