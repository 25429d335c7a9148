"""The disk cache of simulated recordings and of whole measurements.

cached_recordings         recordings of a scene's simulation
cached_measurement        measurement of a scene
load_cached_measurement   the same, only if it is in the cache
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..model.arrays import positions_of
from ..model.faults import Faults
from ..model.measured_room import response_digest
from ..model.measured_scene import MeasuredScene
from ..model.measurement import Measurement
from ..model.measurement_file import load_measurement, save_measurement
from ..model.scene import Scene
from ..model.storage import cache_key, load_cached, load_or_make
from ..model.validation import InputError
from .measure import each_take, measured, require_measurable, sound_field


def cached_recordings(scene: Scene, progress=None) -> np.ndarray:
    """Return what the scene's microphones record: from the cache, or simulated and stored there.

    `scene`: of two dimensions, with one place of the source; `progress`: called with the fraction that is done. Returns
    (N, T) float64. Raises InputError: as `fdcal.acoustics.fdtd.simulate` does.
    """
    positions = positions_of(scene)
    key = cache_key("recordings", dataclasses.asdict(scene.room), scene.emitter.table(), positions.tolist())

    def make() -> np.ndarray:
        from .fdtd import simulate

        return simulate(scene.room, scene.emitter, positions, progress)

    return load_or_make(f"{key}.npy", make, np.load, np.save)


def cached_measurement(scene: Scene, progress=None) -> Measurement:
    """Return what `measure` returns for the scene: from the cache, or computed and stored there.

    That of a measured scene is read from its file.

    `progress`: called with the fraction that is done. Raises InputError: as `measure` does.
    """
    if isinstance(scene, MeasuredScene):
        return _recorded(scene)
    require_measurable(scene)

    def write(file, measurement: Measurement) -> None:
        save_measurement(measurement, file)

    def make() -> Measurement:
        fields = []
        for scene_of_take, done in each_take(scene, progress):
            recordings = cached_recordings(scene_of_take, done) if scene.room.dimension == 2 else None
            fields.append(sound_field(scene_of_take, recordings, done))
        return measured(scene, fields)

    return load_or_make(_measurement_name(scene), make, load_measurement, write)


def load_cached_measurement(scene: Scene) -> Measurement | None:
    """Return the measurement of the scene if it is in the cache, else None."""
    if isinstance(scene, MeasuredScene):
        return _recorded(scene)
    return load_cached(_measurement_name(scene), load_measurement)


def _recorded(scene: MeasuredScene) -> Measurement:
    if not scene.file:
        raise InputError(f"{scene.name} is a measurement, which cannot be simulated", "open its file", key="scene")
    return load_measurement(scene.file)


def _measurement_name(scene: Scene) -> str:
    table = dataclasses.asdict(scene)
    for name in ("name", "title", "solver"):  # these do not affect what is measured
        del table[name]
    table["source"] = scene.source and scene.source.table()
    if scene.faults == Faults():
        del table["faults"]
    if scene.room.response is not None:  # the file may change, and its path does not matter
        table["room"]["response"] = response_digest(scene.room.response)
    return f"{cache_key('measurement with its spectrum', table)}.npz"
