"""One calibration of a study, as a row of its table."""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ...acoustics.measure import cached_recordings, measured, sound_field
from ...acoustics.spectrum import ModalPressures
from ...assessment.study_statistics import scored
from ...assessment.uncertainty import Prior, diffuse_information, position_bound
from ...model.arrays import positions_of, random_source
from ...model.scene import Scene
from ...model.settings import SolverSettings
from ...model.storage import cache_key
from ...model.validation import InputError
from ..calibration_run import solve
from ..sources import CalibrationInput
from .definition import SETTING, Study, code_version, scene_at
from .setting import draw

KEPT_FIELDS = 6  # sound fields that a process keeps: a few megabytes
_fields: dict[str, tuple[ModalPressures, ...]] = {}


def run_task(study: Study, number: int) -> dict[str, Any]:
    """Return the row of the calibration `number`; a draw that the solver refuses is a row, too."""
    draw, index = divmod(number, study.points)
    point, seed = study.point(index), study.seed + draw
    row: dict[str, Any] = {"task": number, "draw": draw, "seed": seed, **asdict(code_version())}
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


NOBODY = frozenset[str]()


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
    return inputs, scene.measurement.snr_db, frozenset(map(str, (*scene.faults.inverted, *scene.faults.dead))), NOBODY


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
    size, least = scene.room.size, study.drawn.least_distance
    places = [
        random_source(size, microphones, least, rng, lambda at: _allowed(_moved(scene, [at])))
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
