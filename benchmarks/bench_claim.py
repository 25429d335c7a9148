"""One fixed array over draws of source and noise: squared error over claimed variance, where 1 is right.

24 microphones are in a disc of 0.5 m in a room of 6 x 5 m, and 32 in a ball of 0.4 m in a room of 4.6 x 3.8 x 2.7 m.
Six of each are given, the walls are rigid, and the noise is reported. The ratio of the means over the microphones that
are sought is averaged over draws; +- is its standard error. FDCAL_BENCH_DRAWS sets the draws, 25 unless given.
FDCAL_BENCH_KNOWN_SIGMA is the sigma, metres, that is stated for the given positions, although these are exact; by
default it is the solver's own.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

import fdcal
from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.measure import draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.assessment.uncertainty import confidence_factor
from fdcal.model.arrays import ball, random_source
from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power
from fdcal.model.scene import Room
from fdcal_bench.draw import RIGID_DECAY

from .report import Figure

ALONE = True
DRAWS = max(1, int(os.environ.get("FDCAL_BENCH_DRAWS", "25")))
KNOWN_SIGMA = os.environ.get("FDCAL_BENCH_KNOWN_SIGMA")
SNR_DB = (20.0, 30.0, 40.0, 60.0)
GIVEN = 6
C = 343.0  # m/s
CLEARANCE = 0.7  # m, of the source from every microphone
NOMINAL, LEAST_COVERED = 0.95, 90.0  # probability of the ellipses; percent


@dataclass(frozen=True)
class Fixed:
    """An array (N, D), metres, in its room, and the frequencies (M,), Hz, that are measured."""

    name: str
    room: tuple[float, ...]
    places: np.ndarray
    frequencies: np.ndarray

    def measured(self, snr_db: float, seed: int) -> Measurement:
        """Return what is recorded of a source at a random place."""
        rng, size = np.random.default_rng([seed, 31]), np.array(self.room)
        middle, reach = self.places.mean(axis=0), np.linalg.norm(self.places - self.places.mean(axis=0), axis=1).max()
        far = CLEARANCE + reach
        source = random_source(size, self.places, CLEARANCE, rng, lambda at: bool(np.linalg.norm(at - middle) > far))
        if source is None:
            raise ValueError(f"{self.name}: no place of the room is {CLEARANCE:g} m from the array")
        k = (2 * np.pi * self.frequencies - 1j * RIGID_DECAY) / C
        clean = point_source_pressures(Room(size=self.room), source, self.places, k)
        clean /= np.sqrt(mode_power(clean))[:, None]
        known = np.arange(GIVEN)
        return draw_measurement(
            ModalPressures(self.frequencies, k, clean),
            np.full(len(k), 10 ** (-snr_db / 10)),
            rng,
            sound_speed=C,
            dimension=len(self.room),
            array_dimension=len(self.room),
            positions=self.places,
            known=known,
            known_positions=self.places[known],
        )


def arrays() -> Iterator[Fixed]:
    rng = np.random.default_rng(31)
    angle, radius = 2 * np.pi * rng.random(24), 0.5 * np.sqrt(rng.random(24))
    disc = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)]) + (2.6, 2.2)
    yield Fixed("disc of 24", (6.0, 5.0), disc, np.linspace(40, 300, 40))
    yield Fixed("ball of 32", (4.6, 3.8, 2.7), ball(32, 0.4, rng) + (2.0, 1.7, 1.2), np.linspace(40, 350, 60))


def run() -> Iterator[Figure]:
    for array in arrays():
        for snr_db in SNR_DB:
            yield from _figures(array, snr_db)


def _figures(array: Fixed, snr_db: float) -> Iterator[Figure]:
    ratios, inside, good = [], 0, 0
    D = array.places.shape[1]
    for seed in range(DRAWS):
        stated = {} if KNOWN_SIGMA is None else {"known_sigma": float(KNOWN_SIGMA)}
        found = fdcal.calibrate(array.measured(snr_db, seed), **stated)
        assert found.covariance is not None  # of any result of `calibrate`
        e, covariance = (found.positions - array.places)[GIVEN:], found.covariance[GIVEN:]
        ratios.append(np.mean(np.sum(e**2, axis=1)) / np.mean(np.trace(covariance, axis1=1, axis2=2)))
        distance = np.einsum("na,nab,nb->n", e, np.linalg.inv(covariance), e)
        inside += int(np.sum(distance <= confidence_factor(NOMINAL, D) ** 2))
        good += found.verdict == "good"
    error = np.std(ratios, ddof=1) / np.sqrt(DRAWS) if DRAWS > 1 else np.nan
    name, share = f"{array.name}, {snr_db:g} dB", 100 * inside / (DRAWS * (len(array.places) - GIVEN))
    yield Figure(f"{name}: squared error over claimed variance, +- {error:.2g}", float(np.mean(ratios)), "", "1")
    yield Figure(f"{name}: inside the ellipses of 95 %", share, "%", "90 at least", share >= LEAST_COVERED)
    yield Figure(f"{name}: verdict good", good, f"of {DRAWS}")
