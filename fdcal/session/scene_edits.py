"""What of a scene can be turned by hand, without its file.

    knobs_of   where the knobs of a scene stand
    turned     the scene with its knobs put elsewhere; what depends on them follows

A larger array takes its search domain and the radius R of the expansion along. Other microphones that are known are as
far from one another as the array allows.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..model.arrays import positions_of
from ..model.scene import WALLS, Array, Gauge, Scene, Search
from ..model.validation import InputError, require_choice

FINEST = 1.5  # times as large, from which the lattice of the search domain gets coarser


@dataclass(frozen=True)
class Knobs:
    """What may be turned.

    Attributes
    ----------
    microphones : int, N; a regular array takes the nearest number that fills its rows
    radius : metres, of a circle or ball; half the longest side of a rectangle, plane or box; of positions, how far the
        farthest is from their middle
    walls : "rigid", "pressure-release" or "absorbing"
    absorption : share of a wave's energy that absorbing walls swallow at normal incidence, 1 - r^2
    snr_db : decibels, inf for no noise
    sound_speed_error : share by which the sound speed that solvers are told is too high
    known : int, number of known microphones
    seed : int, draws random microphones, noise and random starts
    """

    microphones: int
    radius: float
    walls: str
    absorption: float
    snr_db: float
    sound_speed_error: float
    known: int
    seed: int


def knobs_of(scene: Scene) -> Knobs:
    """Where the knobs of a scene stand."""
    count = _count(scene.array)
    reflection = (1 - scene.room.admittance) / (1 + scene.room.admittance)
    return Knobs(
        microphones=count,
        radius=_radius(scene.array),
        walls=scene.room.walls,
        absorption=1 - reflection**2,
        snr_db=scene.measurement.snr_db,
        sound_speed_error=scene.measurement.sound_speed_error,
        known=len(scene.gauge.indices(count)),
        seed=scene.seed,
    )


def turned(scene: Scene, knobs: Knobs) -> Scene:
    """`scene` with its knobs where `knobs` says, under a title that tells what has changed.

    Raises InputError for what cannot be, as far as it can be told without simulating.
    """
    before = knobs_of(scene)
    if knobs == before:
        return scene
    array = _array(scene.array, knobs, before)
    changed = replace(
        scene,
        title=_title(scene, knobs, before, _count(array)),
        room=replace(scene.room, walls=knobs.walls, admittance=_admittance(knobs, before, scene)),
        array=array,
        search=_search(scene, knobs.radius / before.radius),
        measurement=replace(
            scene.measurement, snr_db=knobs.snr_db, sound_speed_error=knobs.sound_speed_error
        ),
        seed=knobs.seed,
    )  # fmt: skip
    changed = replace(changed, gauge=_gauge(changed, knobs, before))
    positions_of(changed)
    return changed


def least_known(scene: Scene) -> int:
    """Known microphones that fix translation, rotation and mirror; a room of three dimensions can do without any."""
    return 0 if scene.room.dimension == 3 else scene.array.dimension + 1


def _count(array: Array) -> int:
    return (array.count or 0) + math.prod(array.shape or (0,)) + array.random + len(array.positions or ())


def _radius(array: Array) -> float:
    if array.radius is not None:
        return array.radius
    if array.size is not None:
        return max(array.size) / 2
    points = np.array(array.positions)
    return float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())


def _array(array: Array, knobs: Knobs, before: Knobs) -> Array:
    """The array with another number of microphones, and larger or smaller."""
    if not knobs.radius > 0:
        raise InputError(f"the array's radius = {knobs.radius:g} m must be above zero")
    q = knobs.radius / before.radius
    if array.positions is not None:
        if knobs.microphones != before.microphones:
            raise InputError("an array of given positions keeps its number of microphones; choose another scene")
        points = np.array(array.positions)
        middle = points.mean(axis=0)
        return replace(array, positions=tuple(map(tuple, (middle + q * (points - middle)).tolist())))
    if array.radius is not None:
        return replace(array, count=knobs.microphones, radius=knobs.radius)
    size = tuple(q * length for length in array.size)
    if array.count is not None:
        return replace(array, count=knobs.microphones, size=size)
    shape, extra = _rows(array, knobs.microphones, before.microphones)
    return replace(array, size=size, shape=shape, random=extra)


def _rows(array: Array, wanted: int, count: int) -> tuple[tuple[int, ...], int]:
    """Shape of the regular part, and how many random microphones there are besides."""
    regular = math.prod(array.shape)
    if wanted == count:
        return array.shape, array.random
    if array.random and wanted > regular:
        return array.shape, wanted - regular
    part = wanted * regular / count
    shape = tuple(max(2, round(side * math.sqrt(part / regular))) for side in array.shape)
    return shape, max(1, wanted - math.prod(shape)) if array.random else 0


def _admittance(knobs: Knobs, before: Knobs, scene: Scene) -> float:
    require_choice("walls", knobs.walls, WALLS)
    if knobs.walls != "absorbing":
        return 0.0
    if (knobs.walls, knobs.absorption) == (before.walls, before.absorption):
        return scene.room.admittance
    if not 0 < knobs.absorption <= 1:
        raise InputError(f"absorption = {100 * knobs.absorption:g} % of absorbing walls must be above 0, to 100 %")
    reflection = math.sqrt(1 - knobs.absorption)
    return (1 - reflection) / (1 + reflection)


def _search(scene: Scene, q: float) -> Search | None:
    """The search domain for an array `q` times as large, about the same middle and through the same cell centres."""
    old = scene.search
    if old is None or q == 1:
        return old
    step = old.step * 2 ** max(0, math.floor(math.log2(q / FINEST) + 1))
    unit = max(step, scene.room.cell or step)
    middle = np.add(old.origin, np.divide(old.size, 2))
    half = np.maximum(np.round(q * np.divide(old.size, 2) / unit), 1) * unit
    origin, size = (tuple(round(float(x), 9) for x in values) for values in (middle - half, 2 * half))
    return Search(origin, size, step, old.radius * q)


def _gauge(scene: Scene, knobs: Knobs, before: Knobs) -> Gauge:
    """The known microphones: as before where their number, and that of all, stays."""
    count = _count(scene.array)
    if (knobs.known, count) == (before.known, before.microphones):
        return scene.gauge
    if not least_known(scene) <= knobs.known < count:
        raise InputError(f"{knobs.known} known microphones of {count}: use {least_known(scene)} to {count - 1}")
    positions = positions_of(replace(scene, gauge=Gauge(free=(0,))))
    return Gauge(known=spread_out(positions, knobs.known))


def spread_out(positions: np.ndarray, count: int) -> tuple[int, ...]:
    """`count` of the microphones at (N, D) `positions`, each as far as can be from those before, ascending."""
    chosen: list[int] = []
    apart = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    for _ in range(count):
        chosen.append(int(np.argmax(apart)))
        distance = np.linalg.norm(positions - positions[chosen[-1]], axis=1)
        apart = distance if len(chosen) == 1 else np.minimum(apart, distance)
    return tuple(sorted(chosen))


def _title(scene: Scene, knobs: Knobs, before: Knobs, count: int) -> str:
    """What is not as in the scene's file, after its name."""
    words = {
        "microphones": f"{count} microphones",
        "radius": f"radius {knobs.radius:.3g} m",
        "walls": f"{knobs.walls} walls",
        "absorption": f"absorption {100 * knobs.absorption:.3g} %",
        "snr_db": "no noise" if knobs.snr_db == math.inf else f"SNR {knobs.snr_db:g} dB",
        "sound_speed_error": f"sound speed {100 * knobs.sound_speed_error:+.3g} %",
        "known": f"{knobs.known} known",
        "seed": f"seed {knobs.seed}",
    }
    old, new = asdict(before), asdict(knobs)
    told = [text for key, text in words.items() if old[key] != new[key]]
    if knobs.walls != "absorbing" and words["absorption"] in told:
        told.remove(words["absorption"])
    name = scene.title if ", changed: " in scene.title else f"{scene.name}, changed: "
    return name + ("" if name.endswith(": ") else ", ") + ", ".join(told)
