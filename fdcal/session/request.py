"""Requests to open a page: a scene, perhaps changed, and where its session begins."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from ..model.declared import build
from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.scene_file import MeasuredScene, placeholder_scene
from ..model.settings import ALL_MODES
from ..model.validation import InputError, refusal

if TYPE_CHECKING:
    from .sources import CalibrationInput


@dataclass(frozen=True)
class OpenRequest:
    """A request to open a page, or to replace what it shows."""

    scene: Scene  # Scene; its `solver` says which solver there is and how it starts. See `edited`
    # of the solver's start; the scene's unless given. The scene's draws microphones and noise
    start_seed: int | None = None
    measurement: Measurement | None = None  # in place of the scene's own, which is simulated or taken from the cache
    # states of the solver, oldest first, that the history holds from the beginning; the start unless given
    states: tuple = ()
    index: int | None = None  # which of them is shown; the last unless given
    # what the page's controls say, by the names of `viewer.desk.Choices` and `viewer.maps.Look`; of those not named,
    # the looks of the page before are kept
    choices: Mapping[str, Any] = field(default_factory=dict)
    play: bool = False  # whether the solver starts to run at once
    fewer_modes: bool = False  # whether the number of modes is reduced to those available

    def __post_init__(self):
        if self.start_seed is not None and self.start_seed < 0:
            raise refusal("start_seed", self.start_seed, "must not be negative", "use 0 or more")
        if self.index is not None and not 0 <= self.index < len(self.states):
            count = len(self.states)
            remedy = f"use 0 to {count - 1}" if count else "give states, or no index"
            raise refusal("index", self.index, f"is none of the {count} states", remedy)

    @property
    def seed(self) -> int:
        """Seed of the solver's start."""
        return self.scene.seed if self.start_seed is None else self.start_seed


def measurement_request(inputs: CalibrationInput) -> OpenRequest:
    """Return the request for a page that shows a measurement, which has no scene."""
    settings = replace(inputs.settings, modes=ALL_MODES) if inputs.all_modes else inputs.settings
    scene = placeholder_scene(inputs.measurement, inputs.name, settings, inputs.seed)
    return OpenRequest(scene, measurement=inputs.measurement, fewer_modes=True)


def as_given(scene: Scene, measurement: Measurement) -> Measurement:
    """Return the measurement that a page shows: without known microphones if the solver is given none."""
    if scene.solver.known != "none":
        return measurement
    return replace(measurement, known=(), known_positions=None)


def table_of(scene: Scene) -> dict[str, Any]:
    """Return the scene as tomllib reads it, without keys that are None : dict of texts, numbers, lists and dicts.

    `fdcal.model.declared.build(Scene, table)` makes the same scene of it.
    """
    table = plain(dataclasses.asdict(scene))
    if scene.solver.modes == ALL_MODES:
        del table["solver"]["modes"]
    return table


def edited(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """Return `scene` with some keys changed, as {"room.walls": "absorbing", "seed": 3}; None removes a key."""
    table = table_of(scene)
    for key, value in changes.items():
        *path, last = key.split(".")
        if isinstance(scene, MeasuredScene) and key.split(".")[0] not in ("solver", "seed", "title"):
            problem = f"{key} cannot be changed: the scene is a measurement"
            raise InputError(problem, "change solver or seed, or take a scene that is simulated", key=key, value=value)
        inner = table
        for part in path:
            inner = inner.setdefault(part, {})
            if not isinstance(inner, dict):
                remedy = f"{part} is a value, not a table; set {part} itself"
                raise InputError(f"{key} is not a key of a scene", remedy, key=key, value=value)
        inner.pop(last, None)
        if value is not None:
            inner[last] = plain(value)
    return build(type(scene), table)


def plain(value: Any) -> Any:
    """Return mappings and tuples as dicts and lists, without keys whose value is None."""
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items() if inner is not None}
    return [plain(inner) for inner in value] if isinstance(value, (tuple, list)) else value
