"""A scene: every physical constant of a run.

    room            outline, walls, sound speed, grid cell
    source          position or, one for each take, positions; band, sampling rate, duration
    array           geometry of the microphones
    gauge           the known microphones that fix translation, rotation and mirror
    search          lattice of candidate positions, expansion radius R of Eq. 3
    measurement     how pressures are derived from recordings: SNR, mode picking, wavenumber
    solver          which solver, how many modes, order rule
    faults          channels that are inverted or dead, spread of gains and phases

Lengths are metres, frequencies hertz, speeds metres per second. `fdcal.model.scene_file` reads a scene from TOML.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from .array_layout import Array, Gauge
from .declared import Seed, check
from .room import Room, Source, is_no_pair
from .settings import KNOWN_ROOM_SOLVERS, Faults, Search, Sensing, SolverSettings
from .validation import LIMITS, InputError, refusal, require_point


@dataclass(frozen=True)
class Scene:
    """Everything that a run depends on.

    Attributes
    ----------
    name, title : str
        The name is that of the file; the title is shown.
    room, source, array, gauge, search, measurement, solver, faults
        See the module. `search` may be None in a room of three dimensions; `source` is None in a measured room.
    seed : int
        Of everything random: microphones, noise and random starts.

    Examples
    --------
    >>> from fdcal.acoustics.measure import measure
    >>> from fdcal.model.scene_file import load_scene
    >>> measure(load_scene("tiny")).count
    16
    """

    name: str
    title: str
    room: Room
    source: Source | None = field(default=None, kw_only=True)
    array: Array
    gauge: Gauge
    search: Search | None = None
    measurement: Sensing = field(default_factory=Sensing)
    solver: SolverSettings = field(default_factory=SolverSettings)
    seed: Seed = 0
    faults: Faults = field(default_factory=Faults)

    @staticmethod
    def optional(table: dict[str, Any]) -> tuple[str, ...]:
        """Return the keys that a scene file may leave out; `load_scene` takes name and title from the file's name.

        Parameters
        ----------
        table : dict
            What the file holds.

        Returns
        -------
        tuple of str
        """
        room = table.get("room")
        measured = isinstance(room, str) or (isinstance(room, dict) and "response" in room)
        boxed = measured or (isinstance(room, dict) and is_no_pair(room.get("size")))
        return "name", "title", "faults", *(("source",) if measured else ()), *(("search",) if boxed else ())

    @property
    def emitter(self) -> Source:
        """The source; InputError in a measured room, which has an unknown one."""
        if self.source is None:
            raise InputError("source is missing", "add it to the scene", key="source")
        return self.source

    def takes(self) -> tuple[Scene, ...]:
        """Return the scene of each take: with the source at one of its places, as if that were the only one.

        Returns
        -------
        tuple of Scene
            One for each place of the source, in their order; the scene itself where there is one place.
        """
        if self.source is None or len(self.source.places) == 1:
            return (self,)
        return tuple(replace(self, source=source) for source in self.source.each())

    def __post_init__(self):
        check(self)
        self.faults.require_channels(self.array.number)
        self._check_source()
        self._check_dimensions()
        self._check_search()
        if self.room.dimension == 2:
            self._check_band()
        elif self.array.number > LIMITS.microphones_3d:
            problem = f"array has {self.array.number} microphones"
            remedy = f"use at most {LIMITS.microphones_3d} in a room of three dimensions"
            raise InputError(problem, remedy, key="array.count", value=self.array.number)
        if self.solver.name in KNOWN_ROOM_SOLVERS:
            require_rectangle(self)
            object.__setattr__(self, "solver", replace(self.solver, room=self.solver.room or self.room.size))

    def _check_source(self):
        D = self.room.dimension
        if self.room.response is not None:
            if self.source is not None:
                problem = "source has no meaning in a measured room, whose response contains the sound of its own"
                raise InputError(problem, "remove it", key="source")
            return
        key, position = self.emitter.keys[0], self.emitter.places[0]
        if len(position) != D:
            why = f"has {len(position)} numbers and the room has {D} lengths"
            raise refusal(key, list(position), why, "give as many coordinates")

    def _check_dimensions(self):
        D = self.room.dimension
        if self.array.room_dimension != D:
            wanted = '"ball", "box", "plane", or "positions" of three' if D == 3 else "a geometry of two"
            why = f"is of {self.array.room_dimension} dimensions and the room of {D}"
            raise refusal("array.geometry", self.array.geometry, why, f"use {wanted} coordinates")
        if D == 3 and self.measurement.wavenumber != "continuous":
            why, remedy = "has no meaning without a grid", 'a room of three lengths needs "continuous"'
            raise refusal("measurement.wavenumber", self.measurement.wavenumber, why, remedy)

    def _check_search(self):
        if self.search is None:
            if self.room.dimension == 2:
                raise InputError("search is missing", "add it to the scene", key="search")
            return
        require_point("search.origin", self.search.origin, (self.array.dimension,))
        require_point("search.size", self.search.size, (self.array.dimension,))

    def _check_band(self):
        sensing, band = self.measurement, self.emitter.band
        if not band.low <= sensing.lowest < sensing.highest <= band.high:
            problem = f"measurement.lowest = {sensing.lowest:g} Hz to measurement.highest = {sensing.highest:g} Hz"
            problem += (
                f" exceeds the band of the source, source.low = {band.low:g} Hz to source.high = {band.high:g} Hz"
            )
            remedy = "narrow the one or widen the other"
            raise InputError(problem, remedy, key="measurement.highest", value=sensing.highest)


def no_rectangle(scene: Scene) -> str:
    """Return why solver "room" cannot be used for the room of `scene`; "" if it can."""
    if scene.room.size is None:
        return "is no rectangle with room.size"
    if scene.source is not None and len(scene.source.places) > 1:
        return f"has a source at {len(scene.source.places)} places, and the solver seeks one"
    return 'has walls = "pressure-release"' if scene.room.walls == "pressure-release" else ""


def require_rectangle(scene: Scene) -> None:
    """Raise InputError for a room that solver "room" cannot be used for."""
    reason = no_rectangle(scene)
    if reason:
        remedy = 'use another solver: "room" is for rigid or absorbing rectangles'
        raise InputError(f"the room of {scene.name} {reason}", remedy, key="solver.name", value="room")
