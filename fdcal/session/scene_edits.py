"""Changes of a scene without editing its file: of single keys, or of parameters on which several keys depend.

The search domain and the radius R of the expansion scale with the array. If the number of known microphones changes,
microphones far from each other become the known ones.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np

from ..model.arrays import positions_of
from ..model.quantities import Count, Metres, Seed, Whole
from ..model.scene import WALLS, Array, Gauge, MeasuredScene, Scene
from ..model.settings import ALL_MODES, Search
from ..model.validation import InputError, build, check, refusal, require_choice, within


def table_of(scene: Scene) -> dict[str, Any]:
    """Return the scene as tomllib would read it from a file: a dict of texts, numbers, lists and dicts, without None.

    `fdcal.model.validation.build(Scene, table)` returns the same scene.
    """
    table = plain(asdict(scene))
    if scene.solver.modes == ALL_MODES:
        del table["solver"]["modes"]
    return table


def edited(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return `scene` with some keys changed, such as {"room.walls": "absorbing", "seed": 3}; None removes a key.

    Raises InputError for a key or a value that a scene cannot have, and for a measured scene unless the key is title,
    seed or one of the solver.
    """
    table = table_of(scene)
    for key, value in changes.items():
        if isinstance(scene, MeasuredScene) and key.split(".")[0] not in ("solver", "seed", "title"):
            raise InputError(f"{key} of a measurement cannot be changed", "use a scene that is simulated", key=key)
        change(table, key, value)
    return build(type(scene), table)


def change(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a key such as "room.walls" of the table of a scene; None removes it."""
    *path, last = key.split(".")
    for depth, part in enumerate(path, 1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            above = ".".join(path[:depth])
            raise InputError(f"{key} is not a key of a scene", f"set {above}, which is a value", key=key)
    table.pop(last, None)
    if value is not None:
        table[last] = plain(value)


def plain(value: Any) -> Any:
    """Return mappings and tuples as dicts and lists, without keys whose value is None."""
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items() if inner is not None}
    return [plain(inner) for inner in value] if isinstance(value, (tuple, list)) else value


FINEST = 1.5  # an array enlarged by this factor or more gets a coarser lattice


@dataclass(frozen=True)
class SceneParameters:
    """The parameters of a scene that can be changed."""

    microphones: Count  # N; a regular array takes the nearest number that fills its rows
    # metres: radius of a circle or ball, half the longest side of a rectangle, plane or box, or the greatest distance
    # of given positions from their mean
    radius: Metres
    # "rigid", "pressure-release" or "absorbing"; "unknown" in a measured room, whose walls and absorption are fixed
    walls: str
    # fraction of the energy that absorbing walls absorb at normal incidence, 1 - r^2
    absorption: Annotated[float, within(0, 1)]
    snr_db: float  # decibels, inf for no noise
    sound_speed_error: float  # relative error of the sound speed given to the solver, positive if it is too high
    known: Whole  # number of known microphones
    seed: Seed  # of random microphones, noise and random starts

    def __post_init__(self):
        check(self)


def parameters_of(scene: Scene) -> SceneParameters:
    """Return the present parameters of a scene."""
    array, count = scene.array, scene.array.number
    if array.radius is not None:
        radius = array.radius
    elif array.size is not None:
        radius = max(array.size) / 2
    else:
        points = np.array(array.positions)
        radius = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    reflection = (1 - scene.room.admittance) / (1 + scene.room.admittance)
    return SceneParameters(
        microphones=count,
        radius=radius,
        walls=scene.room.walls,
        absorption=1 - reflection**2,
        snr_db=scene.measurement.snr_db,
        sound_speed_error=scene.measurement.sound_speed_error,
        known=len(scene.gauge.indices(count)),
        seed=scene.seed,
    )


def with_parameters(scene: Scene, parameters: SceneParameters) -> Scene:
    """Return `scene` with other parameters and a title that lists the changes; it is checked without a simulation."""
    before = parameters_of(scene)
    if parameters == before:
        return scene
    array = _array(scene.array, parameters, before)
    snr_db, error = parameters.snr_db, parameters.sound_speed_error
    changed = replace(
        scene,
        title=_title(scene, parameters, before, array.number),
        room=replace(scene.room, walls=parameters.walls, admittance=_admittance(parameters, before, scene)),
        array=array,
        search=_search(scene, parameters.radius / before.radius),
        measurement=replace(scene.measurement, snr_db=snr_db, sound_speed_error=error),
        seed=parameters.seed,
    )  # fmt: skip
    count, known, lowest = array.number, parameters.known, min_known(changed)
    if (known, count) != (before.known, before.microphones):  # else the known microphones stay the same
        if not lowest <= known < count:
            raise refusal("known", known, f"is impossible for {count} microphones", f"use {lowest} to {count - 1}")
        positions = positions_of(replace(changed, gauge=Gauge(free=(0,))))
        changed = replace(changed, gauge=Gauge(known=spread_out(positions, known)))
    positions_of(changed)
    return changed


def min_known(scene: Scene) -> int:
    """Return the number of known microphones that fix translation, rotation and mirror image; 0 for a room in 3-D."""
    return 0 if scene.room.dimension == 3 else scene.array.dimension + 1


def _array(array: Array, parameters: SceneParameters, before: SceneParameters) -> Array:
    """Return the array with another number of microphones and another size."""
    q = parameters.radius / before.radius
    if array.positions is not None:
        if parameters.microphones != before.microphones:
            why = f"are not the {before.microphones} whose positions the scene gives"
            raise refusal("microphones", parameters.microphones, why, "choose another scene")
        points = np.array(array.positions)
        middle = points.mean(axis=0)
        return replace(array, positions=tuple(map(tuple, (middle + q * (points - middle)).tolist())))
    if array.radius is not None:
        return replace(array, count=parameters.microphones, radius=parameters.radius)
    size = tuple(q * length for length in array.size or ())
    if array.count is not None:
        return replace(array, count=parameters.microphones, size=size)
    shape, extra, wanted, count = array.shape or (), array.random, parameters.microphones, before.microphones
    regular = math.prod(shape)  # number of microphones of the regular part; the others are random
    if wanted != count and extra and wanted > regular:
        extra = wanted - regular
    elif wanted != count:
        shape = tuple(max(2, round(side * math.sqrt(wanted / count))) for side in shape)
        extra = max(1, wanted - math.prod(shape)) if extra else 0
    return replace(array, size=size, shape=shape, random=extra)


def _admittance(parameters: SceneParameters, before: SceneParameters, scene: Scene) -> float:
    if scene.room.response is not None:  # its walls are unknown
        return 0.0
    require_choice("walls", parameters.walls, WALLS)
    if parameters.walls != "absorbing":
        return 0.0
    if (parameters.walls, parameters.absorption) == (before.walls, before.absorption):
        return scene.room.admittance
    if not 0 < parameters.absorption <= 1:
        problem = f"absorption = {100 * parameters.absorption:g} % is impossible for absorbing walls"
        raise InputError(problem, "use more than 0 % and at most 100 %", key="absorption")
    reflection = math.sqrt(1 - parameters.absorption)
    return (1 - reflection) / (1 + reflection)


def _search(scene: Scene, q: float) -> Search | None:
    """Return the search domain for an array `q` times as large, with the same centre and on centres of grid cells."""
    old = scene.search
    if old is None or q == 1:
        return old
    step = old.step * 2 ** max(0, math.floor(math.log2(q / FINEST) + 1))
    unit = max(step, scene.room.cell or step)
    middle = np.add(old.origin, np.divide(old.size, 2))
    half = np.maximum(np.round(q * np.divide(old.size, 2) / unit), 1) * unit
    origin, size = (tuple(round(float(x), 9) for x in values) for values in (middle - half, 2 * half))
    return Search(origin, size, step, old.radius * q)


def spread_out(positions: np.ndarray, count: int) -> tuple[int, ...]:
    """Return the numbers of `count` microphones far from each other, ascending; `positions` (N, D), metres.

    They are chosen one after another, each as far as possible from those that are already chosen.
    """
    chosen: list[int] = []
    apart = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
    for _ in range(count):
        chosen.append(int(np.argmax(apart)))
        distance = np.linalg.norm(positions - positions[chosen[-1]], axis=1)
        apart = distance if len(chosen) == 1 else np.minimum(apart, distance)
    return tuple(sorted(chosen))


def _title(scene: Scene, parameters: SceneParameters, before: SceneParameters, count: int) -> str:
    """Return the name of the scene and the parameters that have been changed, now or before."""
    old, new = (
        (
            f"{one.microphones} microphones",
            f"radius {one.radius:.4g} m",
            f"{one.walls} walls",
            f"absorption {100 * one.absorption:.3g} %" if one.walls == "absorbing" else "",
            "no noise" if one.snr_db == math.inf else f"SNR {one.snr_db:g} dB",
            f"sound speed {100 * one.sound_speed_error:+.3g} %",
            f"{one.known} known",
            f"seed {one.seed}",
        )
        for one in (before, replace(parameters, microphones=count))
    )
    earlier = scene.title.partition(", changed: ")[2].split(", ")
    changed = [text for text, was in zip(new, old, strict=True) if text and (text != was or text in earlier)]
    return f"{scene.name}, changed: {', '.join(changed)}" if changed else scene.title
