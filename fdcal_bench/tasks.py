"""One calibration of a study, as a row of its table.

A draw of a scene is simulated, perhaps with its source at a random place; `draw` gives a draw of a scenario.
"""

import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from fdcal.acoustics.measure import cached_recordings, measured, sound_field
from fdcal.acoustics.spectrum import ModalPressures
from fdcal.assessment.uncertainty import Prior, diffuse_information, position_bound
from fdcal.model.arrays import positions_of, random_source
from fdcal.model.scene import Scene
from fdcal.model.settings import SolverSettings
from fdcal.model.storage import cache_key
from fdcal.model.validation import InputError
from fdcal.session.calibration_run import solve
from fdcal.session.sources import CalibrationInput

from .code import CodeVersion, code_version
from .draw import Draw, draw
from .statistics import column_value, scored
from .study import SCENARIO, Study, scene_at

KEPT_FIELDS = 6  # sound fields that a process keeps: a few megabytes
_fields: dict[str, tuple[ModalPressures, ...]] = {}


def own_code() -> CodeVersion:
    """Return the code that a row depends on: that of fdcal, and of this folder."""
    return code_version(Path(__file__).parent)


def run_task(study: Study, number: int) -> dict[str, Any]:
    """Return the row of the calibration `number`; a draw that the solver refuses is a row, too."""
    repetition, index = divmod(number, study.points)
    point, seed = study.point(index), study.seed + repetition
    row: dict[str, Any] = {"task": number, "draw": repetition, "seed": seed, **asdict(own_code())}
    row |= {key: column_value(value) for key, value in point.items()}
    began = time.process_time()
    try:
        inputs, snr, drawn = posed(study, point, seed)
        simulated = time.process_time()
        found = solve(inputs)
    except InputError as error:
        return row | {"verdict": "refused", "reason": str(error), "seconds": time.process_time() - began}
    counted, uncertainty = found.counted(inputs.given), found.uncertainty
    return row | {
        "verdict": found.verdict,
        "rms_error_m": found.rms_error,
        "max_error_m": found.max_error,
        "claimed_sigma_m": None if uncertainty is None else float(np.sqrt(np.mean(uncertainty[counted] ** 2))),
        "bound_m": _bound(inputs, snr),
        **scored(found, drawn.measurement, inputs.given, drawn.faulty, drawn.misplaced),
        "microphones": drawn.measurement.count,
        "modes_used": len(found.frequencies),
        "seconds": time.process_time() - simulated,
    }


def posed(study: Study, point: dict[str, Any], seed: int) -> tuple[CalibrationInput, float, Draw]:
    """Return what is calibrated at a point, its signal-to-noise ratio, dB, and the draw."""
    if study.scenarios:
        scenario = study.scenario(point[SCENARIO])
        drawn = draw(scenario, seed)
        solver = SolverSettings(
            modes=len(drawn.measurement.frequencies),
            known="all" if scenario.known else "none",
            known_sigma=scenario.known_sigma,
            sound_speed_sigma=scenario.sound_speed_sigma,
        )
        name, scene, snr = scenario.name, None, scenario.snr_db
    else:
        scene = _with_source(study, scene_at(study, point, seed), seed)
        faulty = frozenset(map(str, (*scene.faults.inverted, *scene.faults.dead)))
        drawn = Draw(measured(scene, _sound_fields(scene)), faulty, frozenset())
        name, solver, snr = scene.name, scene.solver, scene.measurement.snr_db
    return CalibrationInput(name, scene, drawn.measurement, solver, seed, time_limit=study.time_limit), snr, drawn


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
    """Return the scene, with a source at a random place if the study asks for one."""
    if not study.drawn.source:
        return scene
    source, size = scene.source, scene.room.size
    if source is None or size is None:
        raise InputError("drawn.source needs a rectangular room with a source", "remove it", key="drawn.source")

    def moved(places: Sequence[np.ndarray]) -> Scene:
        points = tuple(tuple(place.tolist()) for place in places)
        one = points[0] if len(points) == 1 else None
        return replace(scene, source=replace(source, position=one, positions=() if one else points))

    def is_allowed(place: np.ndarray) -> bool:  # inside the room and outside the array
        try:
            positions_of(moved([place]))
        except InputError:
            return False
        return True

    rng, microphones, clearance = np.random.default_rng([seed, 5]), positions_of(scene), study.drawn.least_distance
    places = [random_source(size, microphones, clearance, rng, is_allowed) for _ in source.places]
    drawn = [place for place in places if place is not None]
    if len(drawn) < len(places):
        remedy = "make the room larger, or drawn.least_distance smaller"
        raise InputError("no place of the room is far enough from the array", remedy, key="drawn.least_distance")
    return moved(drawn)


def _bound(inputs: CalibrationInput, snr: float) -> float | None:
    """Return the Cramer-Rao bound, rms, metres, in a diffuse field, after the best alignment; None without noise."""
    if not np.isfinite(snr):
        return None
    measurement, noise = inputs.measurement, 10 ** (-snr / 10)
    k = np.real(measurement.wavenumbers[: inputs.settings.modes])
    information = diffuse_information(measurement.positions, k, noise / (1 + noise), measurement.dimension)
    return position_bound(information, Prior(np.array(inputs.given, int))).rms
