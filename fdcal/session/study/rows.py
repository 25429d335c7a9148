"""One calibration of a study, as a row of its table.

A draw of a setting has a room of lengths that differ by up to 10 % from those of the setting, an array that is drawn,
turned and placed in it, a source at a random place for each take, noise, gains, and errors of the given positions. The
field is the closed form of `fdcal.acoustics.box_field`, which shares no function with the solvers. A draw of a scene is
simulated, perhaps with its source at a random place.
"""

import json
import time
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from ...acoustics.box_field import point_source_pressures
from ...acoustics.dictionary import array_f_max
from ...acoustics.measure import cached_recordings, measured, sound_field
from ...acoustics.spectrum import ModalPressures
from ...assessment.study_statistics import scored
from ...assessment.uncertainty import Prior, diffuse_information, position_bound
from ...model.arrays import ball, circle, encloses, positions_of, random_source
from ...model.measurement import Measurement
from ...model.problem import mode_power
from ...model.room import Room
from ...model.scene import Scene
from ...model.settings import DEAD_FRACTION, SolverSettings
from ...model.storage import cache_key
from ...model.validation import InputError
from ..calibration_run import solve
from ..scene_edits import spread_out
from ..sources import CalibrationInput
from . import RIGID_DECAY, SETTING, Setting, Study, admittance_of, code_version, scene_at

CLEARANCE_M = 0.7  # minimum distance of a source from every microphone
FROM_WALL_M = 0.3  # minimum distance of a microphone from every wall
ROOM_SPREAD = 0.1  # by which the lengths of a room differ at most, relative
BELOW_LIMIT = 0.9  # highest frequency over what the array can interpolate (Eq. 9)
GRADIENT_M = 0.02  # between the two monopoles of a cardioid source
SOUND_SPEED = 343.0  # m/s


@dataclass(frozen=True)
class Draw:
    """One draw: what the solver gets, and what is wrong with it."""

    measurement: Measurement
    faulty: frozenset[str]  # names of the channels that are inverted or dead
    misplaced: frozenset[str]  # names of the microphones whose given position is wrong


def draw(setting: Setting, seed: int) -> Draw:
    """Return the draw of a seed. Raises InputError where the room has no place for array and source.

    The name of the setting counts as well, so that the draws of two settings are independent where their seeds are not.
    """
    rng = np.random.default_rng([seed, 11, zlib.crc32(setting.name.encode())])
    size = np.array(setting.room) * rng.uniform(1 - ROOM_SPREAD, 1 + ROOM_SPREAD, len(setting.room))
    placed = _array(setting, size, rng)
    x = placed[:, :2] if setting.array == "plane" else placed
    N, D = x.shape
    frequencies = _frequencies(setting, x, len(size), rng)
    decay = 0.0 if setting.absorption else RIGID_DECAY
    k = (2 * np.pi * frequencies - 1j * decay) / SOUND_SPEED
    known = np.array(spread_out(x, setting.known), np.int64)
    given = x[known] + setting.known_error * rng.normal(size=(len(known), D))
    wrong = frozenset[str]()
    if setting.misplaced:
        i, away = int(rng.integers(len(known))), rng.normal(size=D)
        given[i] += setting.misplaced * away / np.linalg.norm(away)
        wrong = frozenset({str(known[i])})
    sick = rng.permutation(np.setdiff1d(np.arange(N), known))[: setting.inverted + setting.dead]
    gains = 10 ** (setting.gain_db / 20 * rng.normal(size=N)) * np.exp(
        1j * np.radians(setting.phase_deg * rng.normal(size=N))
    )
    gains[sick[: setting.inverted]] *= -1
    dead = sick[setting.inverted :]
    noise, factor = 10 ** (-setting.snr_db / 10), 1 + setting.sound_speed_error
    takes = list[Measurement]()
    for _ in range(setting.takes):
        clean = _field(setting, size, placed, frequencies, k, rng)
        clean /= np.sqrt(mode_power(clean))[:, None]
        parts = rng.normal(scale=np.sqrt(0.5), size=(2, *clean.shape))
        pressures = clean * gains
        pressures[:, dead] *= np.sqrt(DEAD_FRACTION)
        takes.append(
            Measurement(
                frequencies=frequencies,
                pressures=pressures + np.sqrt(noise) * (parts[0] + 1j * parts[1]),
                sound_speed=factor * SOUND_SPEED,
                dimension=len(size),
                array_dimension=D,
                wavenumbers=k / factor,
                noise_power=np.full(len(frequencies), noise) if setting.noise == "reported" else None,
                positions=x,
                known=known,
                known_positions=given,
            )
        )
    measurement = takes[0] if len(takes) == 1 else Measurement.from_takes(takes)
    return Draw(measurement, frozenset(map(str, sick.tolist())), wrong)


def _array(setting: Setting, size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the microphones in the room : (N, 2 or 3) float64, metres."""
    N, R = setting.microphones, setting.radius
    if setting.array == "circle":
        x = circle(N, R)
    elif setting.array in ("disc", "plane"):
        angle, reach = 2 * np.pi * rng.random(N), R * np.sqrt(rng.random(N))
        x = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])
        x = x if setting.array == "disc" else np.column_stack([x, np.zeros(N)])
    else:
        x = ball(N, R, rng)
        x = x if setting.array == "ball" else R * x / np.linalg.norm(x, axis=1, keepdims=True)
    if setting.array != "plane":
        Q, upper = np.linalg.qr(rng.normal(size=(len(size),) * 2))
        x = x @ (Q * np.sign(np.diag(upper))).T
    low, high = FROM_WALL_M - x.min(axis=0), size - FROM_WALL_M - x.max(axis=0)
    if np.any(low > high):
        raise InputError(f"the array of setting {setting.name} does not fit into its room", "use a larger one")
    return x + rng.uniform(low, high)


def _frequencies(setting: Setting, x: np.ndarray, dimension: int, rng: np.random.Generator) -> np.ndarray:
    high = min(setting.high, BELOW_LIMIT * array_f_max(x, SOUND_SPEED, dimension))
    even = np.linspace(setting.low, high, setting.modes + 1)
    return even[:-1] + (even[1] - even[0]) * rng.uniform(0.2, 0.8, setting.modes)


def _field(setting: Setting, size, places, frequencies, k, rng: np.random.Generator) -> np.ndarray:
    """Return the pressures of a source at a random place : (M, N) complex128, any unit."""
    source = random_source(size, places, CLEARANCE_M, rng, lambda at: not encloses(places[:, :2], at[:2]))
    if source is None:
        problem = f"no place of the room of setting {setting.name} is {CLEARANCE_M:g} m from the array"
        raise InputError(problem, "use a larger one", key="room")
    p = _monopole(setting, size, source, places, frequencies, k)
    if setting.cardioid:  # two monopoles, the one behind delayed and inverted: k d (1 + cos angle) for small k d
        facing = rng.normal(size=len(size))
        behind = np.clip(source - GRADIENT_M * facing / np.linalg.norm(facing), 0.02, size - 0.02)
        late = np.exp(-1j * k * np.linalg.norm(behind - source))[:, None]
        p = p - late * _monopole(setting, size, behind, places, frequencies, k)
    return p


def _monopole(setting: Setting, size, source, places, frequencies, k) -> np.ndarray:
    room = Room(size=tuple(size.tolist()))
    if not setting.absorption:
        return point_source_pressures(room, source, places, k)
    at, absorbed = np.array(setting.absorption).T
    rows = list[np.ndarray]()
    for one, fraction in zip(k, np.interp(np.log(frequencies), np.log(at), absorbed).tolist(), strict=True):
        absorbing = replace(room, walls="absorbing", admittance=admittance_of(fraction))
        rows.append(point_source_pressures(absorbing, source, places, one[None])[0])
    return np.array(rows)


KEPT_FIELDS = 6  # sound fields that a process keeps: a few megabytes
_fields: dict[str, tuple[ModalPressures, ...]] = {}


def run_task(study: Study, number: int) -> dict[str, Any]:
    """Return the row of the calibration `number`; a draw that the solver refuses is a row, too."""
    repetition, index = divmod(number, study.points)
    point, seed = study.point(index), study.seed + repetition
    row: dict[str, Any] = {"task": number, "draw": repetition, "seed": seed, **asdict(code_version())}
    row |= {key: value if isinstance(value, (int, float, str)) else json.dumps(value) for key, value in point.items()}
    began = time.process_time()
    try:
        inputs, snr, faulty, misplaced = _posed(study, point, seed)
        simulated = time.process_time()
        found = solve(inputs)
    except InputError as error:
        return row | {"verdict": "refused", "reason": str(error), "seconds": time.process_time() - began}
    measurement, counted, uncertainty = inputs.measurement, found.counted(inputs.given), found.uncertainty
    return row | {
        "verdict": found.verdict,
        "rms_error_m": found.rms_error,
        "max_error_m": found.max_error,
        "claimed_sigma_m": None if uncertainty is None else float(np.sqrt(np.mean(uncertainty[counted] ** 2))),
        "bound_m": _bound(inputs, snr),
        **scored(found, measurement, inputs.given, faulty, misplaced),
        "microphones": measurement.count,
        "modes_used": len(found.frequencies),
        "seconds": time.process_time() - simulated,
    }


def _posed(
    study: Study, point: dict[str, Any], seed: int
) -> tuple[CalibrationInput, float, frozenset[str], frozenset[str]]:
    """Return what is calibrated, its signal-to-noise ratio, dB, and which channels and given positions are faulty."""
    if study.settings:
        setting = study.setting(point[SETTING])
        drawn = draw(setting, seed)
        solver = SolverSettings(
            modes=len(drawn.measurement.frequencies),
            known="all" if setting.known else "none",
            known_sigma=setting.known_sigma,
            sound_speed_sigma=setting.sound_speed_sigma,
        )
        inputs = CalibrationInput(setting.name, None, drawn.measurement, solver, seed, time_limit=study.time_limit)
        return inputs, setting.snr_db, drawn.faulty, drawn.misplaced
    scene = _with_source(study, scene_at(study, point, seed), seed)
    measurement = measured(scene, _sound_fields(scene))
    inputs = CalibrationInput(scene.name, scene, measurement, scene.solver, seed, time_limit=study.time_limit)
    return (
        inputs,
        scene.measurement.snr_db,
        frozenset(map(str, (*scene.faults.inverted, *scene.faults.dead))),
        frozenset(),
    )


def _sound_fields(scene: Scene) -> tuple[ModalPressures, ...]:
    """Return the sound field of each take of a scene, computed once for points that differ in noise or solver."""
    sensing = asdict(replace(scene.measurement, snr_db=0.0, sound_speed_error=0.0))
    key = cache_key("field", asdict(scene.room), scene.emitter.table(), positions_of(scene).tolist(), sensing)
    if key not in _fields:
        flat = scene.room.dimension == 2
        _fields[key] = tuple(sound_field(t, cached_recordings(t) if flat else None) for t in scene.takes())
        for old in list(_fields)[:-KEPT_FIELDS]:
            _fields.pop(old, None)
    return _fields[key]


def _with_source(study: Study, scene: Scene, seed: int) -> Scene:
    """Return the scene with the source of a draw, where the study draws it."""
    if not study.drawn.source:
        return scene
    if scene.source is None or scene.room.size is None:
        raise InputError("drawn.source needs a rectangular room with a source", "remove it", key="drawn.source")
    rng, microphones = np.random.default_rng([seed, 5]), positions_of(scene)
    size, clearance = scene.room.size, study.drawn.least_distance
    places = [
        random_source(size, microphones, clearance, rng, lambda at: _allowed(_moved(scene, [at])))
        for _ in scene.source.places
    ]
    drawn = [place for place in places if place is not None]
    if len(drawn) == len(places):
        return _moved(scene, drawn)
    remedy = "make the room larger, or drawn.least_distance smaller"
    raise InputError("no place of the room is far enough from the array", remedy, key="drawn.least_distance")


def _moved(scene: Scene, places: Sequence[np.ndarray]) -> Scene:
    """Return the scene with its source at other places."""
    assert scene.source is not None
    points = tuple(tuple(place.tolist()) for place in places)
    source = replace(scene.source, position=points[0] if len(points) == 1 else None)
    return replace(scene, source=replace(source, positions=points if len(points) > 1 else ()))


def _allowed(scene: Scene) -> bool:
    """Return whether the source of a scene is inside the room and outside the array."""
    try:
        positions_of(scene)
    except InputError:
        return False
    return True


def _bound(inputs: CalibrationInput, snr: float) -> float | None:
    """Return the Cramer-Rao bound, rms, metres, in a diffuse field, after the best alignment; None without noise."""
    if not np.isfinite(snr):
        return None
    measurement, noise = inputs.measurement, 10 ** (-snr / 10)
    k = np.real(measurement.wavenumbers[: inputs.settings.modes])
    information = diffuse_information(measurement.positions, k, noise / (1 + noise), measurement.dimension)
    return position_bound(information, Prior(np.array(inputs.given, int))).rms
