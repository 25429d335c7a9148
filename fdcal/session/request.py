"""What a page can be asked to show: a scene, perhaps changed, and where its session begins.

OpenRequest    one request, plain data: of the command line, the page, a lesson, a session file
as_given    a measurement, as far as the solver is told of it
table_of   a scene as the table of its TOML file
edited     a scene with some keys changed, checked as if it had been read from a file
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..model.from_table import build
from ..model.measurement import Measurement
from ..model.scene import Scene
from ..model.validation import InputError


@dataclass(frozen=True)
class OpenRequest:
    """A page to be opened, or to be opened anew while it is looked at.

    Attributes
    ----------
    scene : Scene; its `solver` says which solver there is and how it starts. See `edited`
    start_seed : int or None, of the solver's start; the scene's unless given. The scene's draws microphones and noise
    measurement : Measurement or None, in place of the scene's own, which is simulated or taken from the cache
    states : states of the solver, oldest first, that the history holds from the beginning; the start unless given
    index : int or None, which of them is looked at; the last unless given
    choices : what the page's controls say, by the names of `viewer.desk.Choices` and `viewer.maps.Look`; of those not
        named, the looks of the page before are kept
    play : whether the solver runs at once
    fewer_modes : whether the solver takes as many modes as there are where there are less than it asks for
    """

    scene: Scene
    start_seed: int | None = None
    measurement: Measurement | None = None
    states: tuple = ()
    index: int | None = None
    choices: Mapping[str, Any] = field(default_factory=dict)
    play: bool = False
    fewer_modes: bool = False

    def __post_init__(self):
        if self.start_seed is not None and self.start_seed < 0:
            raise InputError(f"start_seed = {self.start_seed} must not be negative; use 0 or more")
        if self.index is not None and not 0 <= self.index < len(self.states):
            raise InputError(f"index = {self.index} is none of the {len(self.states)} states; use 0 or more")

    @property
    def seed(self) -> int:
        """Of the solver's start."""
        return self.scene.seed if self.start_seed is None else self.start_seed


def as_given(scene: Scene, measurement: Measurement) -> Measurement:
    """What a page scores and draws: of an array of which nothing is told, no microphone is known."""
    if scene.solver.known != "none":
        return measurement
    return dataclasses.replace(measurement, known=(), known_positions=None)


def table_of(scene: Scene) -> dict[str, Any]:
    """The scene as tomllib would read it, without what is left out : dict of texts, numbers, lists and dicts.

    `tables.build(Scene, table)` makes the same scene of it.
    """
    return plain(dataclasses.asdict(scene))


def edited(scene: Scene, changes: Mapping[str, Any]) -> Scene:
    """`scene` with some keys changed, as {"room.walls": "absorbing", "seed": 3}; None takes a key out.

    Raises InputError for unknown keys and values that cannot be, as `load_scene` does.
    """
    table = table_of(scene)
    for key, value in changes.items():
        *path, last = key.split(".")
        inner = table
        for part in path:
            inner = inner.setdefault(part, {})
            if not isinstance(inner, dict):
                raise InputError(f"{key} is not a key of a scene; {part} holds a value")
        inner.pop(last, None)
        if value is not None:
            inner[last] = plain(value)
    return build(Scene, table)


def plain(value):
    """Mappings and tuples as dicts and lists, whatever is None left out."""
    if isinstance(value, Mapping):
        return {key: plain(inner) for key, inner in value.items() if inner is not None}
    return [plain(inner) for inner in value] if isinstance(value, (tuple, list)) else value
