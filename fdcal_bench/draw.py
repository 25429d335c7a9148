"""The one synthetic draw: an array, a room, sources, noise, faulty channels and given positions of a scenario.

A draw has a room of lengths that differ by up to 10 % from those of the scenario, an array that is drawn, turned and
placed in it, a source at a random place for each take, noise, gains, and errors of the given positions. The field is
the closed form of `fdcal.acoustics.box_field`, which shares no function with the solvers.
"""

import itertools
import zlib
from dataclasses import MISSING, dataclass, fields, replace
from typing import Annotated, Literal

import numpy as np

from fdcal.acoustics.box_field import point_source_pressures
from fdcal.acoustics.dictionary import array_f_max
from fdcal.acoustics.measure import draw_measurement
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.model.arrays import ball, circle, hull_meets, random_source
from fdcal.model.measurement import Measurement
from fdcal.model.problem import mode_power
from fdcal.model.quantities import Count, Hertz, Metres
from fdcal.model.scene import Room
from fdcal.model.validation import InputError, check, within
from fdcal.session.scene_edits import spread_out

CLEARANCE_M = 0.7  # minimum distance of a source from every microphone
FROM_WALL_M = 0.3  # minimum distance of a microphone from every wall
ROOM_SPREAD = 0.1  # largest relative deviation of the lengths of a room
BELOW_LIMIT = 0.9  # highest frequency over what the array can interpolate (Eq. 9)
GRADIENT_M = 0.02  # distance of the two monopoles of a cardioid source
SOUND_SPEED = 343.0  # m/s
RIGID_DECAY = 3.0  # 1/s, decay rate between rigid walls: the weight of recordings of 4 s


@dataclass(frozen=True)
class Scenario:
    """What all draws of a scenario have in common."""

    name: str
    array: Literal["disc", "circle", "ball", "sphere", "plane"]
    microphones: Count
    radius: Metres
    room: tuple[Metres, ...]  # lengths, two or three, metres
    modes: Count  # frequencies of a take, evenly spaced, a little displaced at random
    low: Hertz = 40.0
    high: Hertz = 300.0  # or 0.9 times what the array can interpolate (Eq. 9), if that is lower
    snr_db: Annotated[float, within(0, 120, "dB")] = 40.0
    noise: Literal["reported", "auto"] = "auto"  # whether the solver is given the power of the noise
    takes: Count = 1  # places of the source
    known: Annotated[int, within(0)] = 4  # microphones whose positions are given; 0: blind
    known_error: Annotated[float, within(0, 1, "m")] = 0.0  # standard deviation of the error of a given coordinate
    misplaced: Annotated[float, within(0, 10, "m")] = 0.0  # error of one given position
    gain_db: Annotated[float, within(0, 40, "dB")] = 0.0  # standard deviation of the channels' gains
    phase_deg: Annotated[float, within(0, 180, "degrees")] = 0.0  # standard deviation of their phases
    inverted: Annotated[int, within(0)] = 0  # channels of inverted polarity
    dead: Annotated[int, within(0)] = 0  # channels without signal
    # pairs of a frequency, Hz, and the fraction of the energy that the walls absorb there at normal incidence; without
    # any the walls are rigid, and the decay is that of a recording of four seconds
    absorption: tuple[tuple[float, float], ...] = ()
    cardioid: bool = False  # whether the source is a cardioid that faces a random direction
    sound_speed_error: Annotated[float, within(-0.1, 0.1)] = 0.0  # relative, of the sound speed given to the solver
    # one sigma of given coordinates and of the sound speed as stated to the solver; left out: nothing is stated
    known_sigma: Annotated[float, within(0, 1, "m")] | None = None
    sound_speed_sigma: Annotated[float, within(1e-6, 0.1)] | None = None

    @staticmethod
    def optional(table: dict) -> list[str]:
        """Return the keys that may be missing: those that have a default."""
        return [one.name for one in fields(Scenario) if one.default is not MISSING]

    def __post_init__(self):
        check(self, f"scenarios.{self.name}.")
        flat = self.array in ("disc", "circle")
        if len(self.room) != (2 if flat else 3):
            remedy = f"give {'two' if flat else 'three'} lengths for an array of the form {self.array}"
            raise InputError(f"the room of scenario {self.name} has {len(self.room)} lengths", remedy, key="room")
        band = self.low >= self.high
        falling = any(a[0] >= b[0] for a, b in itertools.pairwise(self.absorption))
        if band or falling or not all(0 < a < 1 for _, a in self.absorption):
            problem = f"scenario {self.name} needs low below high, and absorption from 0 to 1 at rising frequencies"
            raise InputError(problem, key="low" if band else "absorption")
        if self.known + self.inverted + self.dead > self.microphones or (self.misplaced and not self.known):
            problem = f"scenario {self.name} has too few microphones for the known and the faulty ones"
            raise InputError(problem, "use more microphones", key="microphones")


@dataclass(frozen=True)
class Draw:
    """One draw: the measurement for the solver, and its faults."""

    measurement: Measurement
    faulty: frozenset[str]  # names of the channels that are inverted or dead
    misplaced: frozenset[str]  # names of the microphones whose given position is wrong


def draw(scenario: Scenario, seed: int) -> Draw:
    """Return the draw of a seed. Raises InputError if the room has no place for array and source.

    The draw also depends on the name of the scenario, so that two scenarios have independent draws of the same seed.
    """
    rng = np.random.default_rng([seed, 11, zlib.crc32(scenario.name.encode())])
    size = np.array(scenario.room) * rng.uniform(1 - ROOM_SPREAD, 1 + ROOM_SPREAD, len(scenario.room))
    placed = _array(scenario, size, rng)
    x = placed[:, :2] if scenario.array == "plane" else placed
    N, D = x.shape
    high = min(scenario.high, BELOW_LIMIT * array_f_max(x, SOUND_SPEED, len(size)))
    even = np.linspace(scenario.low, high, scenario.modes + 1)
    frequencies = even[:-1] + (even[1] - even[0]) * rng.uniform(0.2, 0.8, scenario.modes)
    decay = 0.0 if scenario.absorption else RIGID_DECAY
    k = (2 * np.pi * frequencies - 1j * decay) / SOUND_SPEED
    known = np.array(spread_out(x, scenario.known), np.int64)
    given = x[known] + scenario.known_error * rng.normal(size=(len(known), D))
    wrong = frozenset[str]()
    if scenario.misplaced:
        i, away = int(rng.integers(len(known))), rng.normal(size=D)
        given[i] += scenario.misplaced * away / np.linalg.norm(away)
        wrong = frozenset({str(known[i])})
    faulty = rng.permutation(np.setdiff1d(np.arange(N), known))[: scenario.inverted + scenario.dead].tolist()
    gains = 10 ** (scenario.gain_db / 20 * rng.normal(size=N)) * np.exp(
        1j * np.radians(scenario.phase_deg * rng.normal(size=N))
    )
    gains[faulty[: scenario.inverted]] *= -1
    takes = list[Measurement]()
    for _ in range(scenario.takes):
        clean = _field(scenario, size, placed, frequencies, k, rng)
        clean /= np.sqrt(mode_power(clean))[:, None]
        take = draw_measurement(
            ModalPressures(frequencies, k, clean),
            np.full(len(frequencies), 10 ** (-scenario.snr_db / 10)),
            rng,
            gains=gains,
            dead=faulty[scenario.inverted :],
            sound_speed=SOUND_SPEED,
            sound_speed_error=scenario.sound_speed_error,
            dimension=len(size),
            array_dimension=D,
            positions=x,
            known=known,
            known_positions=given,
        )
        takes.append(take if scenario.noise == "reported" else replace(take, noise_power=None))
    measurement = takes[0] if len(takes) == 1 else Measurement.from_takes(takes)
    return Draw(measurement, frozenset(map(str, faulty)), wrong)


def _array(scenario: Scenario, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the microphones in the room : (N, 2 or 3) float64, metres."""
    N, R = scenario.microphones, scenario.radius
    if scenario.array == "circle":
        x = circle(N, R)
    elif scenario.array in ("disc", "plane"):
        angle, reach = 2 * np.pi * rng.random(N), R * np.sqrt(rng.random(N))
        x = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])
        x = x if scenario.array == "disc" else np.column_stack([x, np.zeros(N)])
    else:
        x = ball(N, R, rng)
        x = x if scenario.array == "ball" else R * x / np.linalg.norm(x, axis=1, keepdims=True)
    if scenario.array != "plane":
        Q, upper = np.linalg.qr(rng.normal(size=(len(size),) * 2))
        x = x @ (Q * np.sign(np.diag(upper))).T
    low, high = FROM_WALL_M - x.min(axis=0), size - FROM_WALL_M - x.max(axis=0)
    if np.any(low > high):
        raise InputError(f"the array of scenario {scenario.name} does not fit into its room", "use a larger one")
    return x + rng.uniform(low, high)


def _field(scenario: Scenario, size, places, frequencies, k, rng: np.random.Generator) -> np.ndarray:
    """Return the pressures of a source at a random place : (M, N) complex128, any unit."""
    source = random_source(size, places, CLEARANCE_M, rng, lambda at: not hull_meets(places[:, :2], at[None, :2]))
    if source is None:
        problem = f"no place of the room of scenario {scenario.name} is {CLEARANCE_M:g} m from the array"
        raise InputError(problem, "use a larger one", key="room")
    room = Room(size=tuple(size.tolist()))

    def monopole(at: np.ndarray) -> np.ndarray:
        if not scenario.absorption:
            return point_source_pressures(room, at, places, k)
        given, absorbed = np.array(scenario.absorption).T
        rows = list[np.ndarray]()
        for one, fraction in zip(k, np.interp(np.log(frequencies), np.log(given), absorbed).tolist(), strict=True):
            absorbing = replace(room, walls="absorbing", admittance=admittance_of(fraction))
            rows.append(point_source_pressures(absorbing, at, places, one[None])[0])
        return np.array(rows)

    p = monopole(source)
    if scenario.cardioid:  # two monopoles, the one behind delayed and inverted: k d (1 + cos angle) for small k d
        facing = rng.normal(size=len(size))
        behind = np.clip(source - GRADIENT_M * facing / np.linalg.norm(facing), 0.02, size - 0.02)
        p = p - np.exp(-1j * k * np.linalg.norm(behind - source))[:, None] * monopole(behind)
    return p


def admittance_of(absorption: float) -> float:
    """Return the admittance of walls that absorb a fraction of the energy at normal incidence."""
    reflection = (1 - absorption) ** 0.5
    return (1 - reflection) / (1 + reflection)
