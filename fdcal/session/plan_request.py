"""What a plan is asked for: array, room, noise, given positions.

The array comes from a table, a geometry of Acoular, a scene, or words such as "circle 16 0.2".
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from ..acoustics.dictionary import array_f_max
from ..acoustics.room_modes import independent_frequencies
from ..assessment.uncertainty import Prior
from ..model.arrays import WALL_DISTANCE_M, ball, box, circle, positions_of, rectangle
from ..model.measurement import checked_known
from ..model.scene import Array, MeasuredScene, Scene, load_scene, scene_names
from ..model.validation import InputError, Metres, MetresPerSecond, Seconds, Seed, check, frozen_array, refusal, within
from ..recordings.formats.positions import READERS, read_positions
from ..recordings.frequencies import default_max_rows

FLAT_M = 1e-6  # heights that differ by less are one plane
FORMS = ("circle", "rectangle", "ball", "box")
VERTICAL = "vertical"  # after a circle or a rectangle: it stands upright, along x and z
EXAMPLES = '"circle 16 0.2", "rectangle 4x4 0.6x0.6 vertical", "ball 32 0.3" or "box 32 0.6x0.6x0.4"'


@dataclass(frozen=True)
class Layout:
    """The microphones of a plan."""

    name: str  # of the file or scene, or the words
    names: tuple[str, ...]  # (N,) tuple of str
    positions: np.ndarray  # (N, D) float64, metres; D is 2 for a plane array, whose coordinates are in its plane
    scene: Scene | None = None
    # (2, 3) float64, unit vectors in space along the coordinates of a plane array that is not level; None of any other
    axes: np.ndarray | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # metres, where the coordinates of such an array are 0

    def in_space(self, height: float) -> np.ndarray:
        """Return the microphones in space : (N, 3) float64, metres; `height`: of a plane array that is level."""
        if self.axes is not None:
            return self.origin + self.positions @ self.axes
        N, D = self.positions.shape
        return np.column_stack([self.positions, np.full(N, height)]) if D == 2 else self.positions


def read_layout(text: str, seed: int = 0) -> Layout:
    """Return the array of a table or geometry, a scene, or a geometry in words.

    Words are its name as in scenes, then count and radius, or shape and size, metres; `seed`: of "ball" and "box".
    """
    words = text.split()
    if Path(text).suffix.lower() in READERS:
        placed = read_positions(text)
        return _of_table(Path(text).name, placed.names, np.asarray(placed.positions, float))
    if len(words) > 1 or text in FORMS:
        upright = words[-1] == VERTICAL and words[0] in ("circle", "rectangle")
        positions = _of_words(words[:-1] if upright else words, text, seed)
        names = tuple(map(str, range(len(positions))))
        axes = frozen_array([[1, 0, 0], [0, 0, 1]], float) if upright else None
        return Layout(text, names, frozen_array(positions, float), axes=axes)
    if text in scene_names() or text.lower().endswith(".toml"):
        scene = load_scene(text)
        if not isinstance(scene, MeasuredScene):
            positions = positions_of(scene)
            return Layout(scene.name, tuple(map(str, range(len(positions)))), positions, scene)
        from ..acoustics.measure import cached_measurement  # brings the signal library, which no other layout needs

        measurement = cached_measurement(scene)
        if measurement.positions is not None:
            return Layout(scene.name, measurement.names, measurement.positions)
        problem = f"{scene.name} is a measurement without positions"
        raise InputError(problem, "give a table of them, or another scene", key="layout", value=scene.name)
    files = f"a file of positions ({', '.join(sorted(READERS))})"
    remedy = f"give {files}, a scene ({', '.join(scene_names())}), or a geometry as {EXAMPLES}"
    raise InputError(f'"{text}" names no array', remedy, key="layout", value=text)


def _of_table(name: str, names: tuple[str, ...], x: np.ndarray) -> Layout:
    """Return the array at positions (N, 3), metres, by two coordinates where it is plane: x and y where it is level."""
    if np.ptp(x[:, 2]) < FLAT_M:
        return Layout(name, names, frozen_array(x[:, :2], float))
    centre = x.mean(axis=0)
    _, _, axes = np.linalg.svd(x - centre)
    if len(x) <= 3 or np.abs((x - centre) @ axes[2]).max() >= FLAT_M:
        return Layout(name, names, frozen_array(x, float))
    level = np.cross([0.0, 0.0, 1.0], axes[2])
    level = level * np.copysign(1 / np.linalg.norm(level), level[np.argmax(np.abs(level))])
    upward = np.cross(axes[2], level)
    plane = frozen_array([level, upward if upward[2] > 0 else -upward], float)
    return Layout(name, names, frozen_array((x - centre) @ plane.T, float), axes=plane, origin=tuple(centre.tolist()))


def _of_words(words: list[str], text: str, seed: int) -> np.ndarray:
    refused = InputError(f'"{text}" is no geometry', f"write it as {EXAMPLES}", key="layout", value=text)
    if words[0] not in FORMS or len(words) != 3:
        raise refused
    try:
        counts = tuple(map(int, words[1].lower().split("x")))
        lengths = tuple(map(float, words[2].lower().split("x")))
    except ValueError:
        raise refused from None
    kind, rng = words[0], np.random.default_rng(seed)
    if kind == "rectangle":
        array = Array(kind, shape=counts, size=lengths)
        return rectangle(array.shape or (), array.size or ())
    if kind == "box":
        array = Array(kind, count=counts[0], size=lengths)
        return box(array.count or 0, array.size, rng)
    array = Array(kind, count=counts[0], radius=lengths[0])
    if kind == "circle":
        return circle(array.count or 0, array.radius or 0.0)
    return ball(array.count or 0, array.radius or 0.0, rng)


ONE_PLACE = 1e-6  # of the array's extent: microphones that are closer count as one


@dataclass(frozen=True)
class PlanLimits:
    """What is assumed where nothing is given, and how much is computed."""

    low: float = 20.0  # lowest frequency by default
    # highest frequency by default, relative to what the array can interpolate (Eq. 9): there the functions are as many
    # as the microphones, and the pressures predict nothing
    high: float = 0.7
    # frequencies times microphones of which the information is computed; more are accounted for by scaling it
    work: int = 3000
    min_frequencies: int = 16  # of them at least
    clearance: float = 0.7  # least distance of a source from the microphones in a room, metres
    # centre of an array in a room where its own coordinates do not lie inside, relative to the room's lengths
    place: tuple[float, float, float] = (0.43, 0.46, 0.45)
    max_microphones: int = 300  # of a plan
    max_takes: int = 100  # likewise
    max_snr_db: float = 120.0  # dB
    wide: float = 5.0  # width of an array from which a refusal asks for its unit, metres


PLAN_LIMITS = PlanLimits()


MIN_FREQUENCIES = 3  # of a calibration


@dataclass(frozen=True)
class PlanRequest:
    """An array, and the circumstances of its calibration."""

    layout: Layout
    # (2,) or (3,) tuple of float, metres, lengths of a rectangular room; None for a diffuse field in space
    room: tuple[Metres, ...] | None = None
    reverberation_time: Seconds = 0.5
    snr_db: float = 30.0  # signal-to-noise ratio of each frequency
    # (2,) tuple of float, Hz; from 20 Hz to 0.7 times what the array can interpolate (Eq. 9) unless given. Of
    # frequencies above what it can interpolate none is used
    band: tuple[float, float] | None = None
    known: tuple[int, ...] = ()  # (A,) tuple of int, microphones whose positions are given
    # one sigma of each of their coordinates; 0 for exact ones
    known_sigma: Annotated[float, within(0, 1e12, "m")] = 0.0
    # spread of the channels' gains; 0 for equal channels
    gain_sigma_db: Annotated[float, within(0, 1e12, "dB")] = 0.0
    sound_speed: MetresPerSecond = 343.0
    accuracy: Metres = 0.01  # that is wanted
    seed: Seed = 0  # of the places of the source
    # the lowest so many independent frequencies of the band, evenly over these at most as many as an import takes
    modes: Annotated[int, within(MIN_FREQUENCIES)] | None = None
    # places of the source, each recorded by itself at `snr_db`; every take has all frequencies
    takes: Annotated[int, within(1, PLAN_LIMITS.max_takes)] = 1
    # what the source plays: "impulse" stands for sweeps and claps, too, whose arrival times count
    kind: Literal["stationary", "impulse"] = "stationary"

    def __post_init__(self):
        x, room = self.layout.positions, self.room
        (N, D), least, most = x.shape, x.shape[1] + 3, PLAN_LIMITS.max_microphones
        if not least <= N <= most:
            raise InputError(f"the layout has {N} microphones", f"give {least} to {most}", key="layout", value=N)
        pairs = np.triu_indices(N, 1)
        apart = np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=-1)
        if apart.min() <= ONE_PLACE * apart.max():
            first, second = (self.layout.names[rows[np.argmin(apart)]] for rows in pairs)
            problem = f"microphones {first} and {second} are at one place"
            raise InputError(problem, "move them apart, or leave one out", key="layout")
        check(self, names={"snr_db": "snr", "band": "frequencies"})
        if not 0 < self.snr_db <= PLAN_LIMITS.max_snr_db:
            remedy = f"use more than 0 and at most {PLAN_LIMITS.max_snr_db:g}"
            raise refusal("snr", self.snr_db, "is out of range", remedy, "dB")
        if room is not None and len(room) not in (2, 3):
            raise refusal("room", list(room), f"has {len(room)} lengths", "give <room> two or three")
        if room is not None and len(room) < (D if self.layout.axes is None else 3):
            raise InputError("the array has heights and the room has none", "give <room> three lengths", key="room")
        if self.kind == "impulse" and room is None:
            problem = "arrival times of impulses depend on where in the room the source can be"
            raise InputError(problem, "give <room>", key="room")
        checked_known(self.known, None, self.layout.positions, N, D)
        if self.known_sigma and not self.known:
            why = "is of given positions, and none is given"
            raise refusal("known_sigma", self.known_sigma, why, "give <known>, or leave out <known_sigma>", "m")
        extent = np.ptp(self.stated_places, axis=0)
        if room is not None and np.any(extent > np.array(room) - 2 * WALL_DISTANCE_M):
            array, size = (" x ".join(f"{length:.3g}" for length in lengths) for lengths in (extent, room))
            problem = (
                f"the array, {array} m, does not fit into the room, {size} m, {WALL_DISTANCE_M:g} m from its walls"
            )
            raise InputError(problem, "give a smaller array or a larger <room>, both in metres", key="room", value=room)
        if len(self.frequencies) < MIN_FREQUENCIES:
            low, high = self.limits
            problem = f"{low:.1f} to {high:.1f} Hz with a reverberation time of {self.reverberation_time:g} s hold"
            problem += f" {len(self.frequencies)} independent frequencies, and a calibration needs {MIN_FREQUENCIES}"
            remedy = "use a wider band (<frequencies>), or a smaller array, whose band reaches higher" + self._width
            raise InputError(problem, remedy, key="frequencies")

    @property
    def stated_places(self) -> np.ndarray:
        """The microphones by their own coordinates, in as many as the room has : (N, 2 or 3) float64, metres."""
        size = self.room or ()
        return self.layout.in_space(PLAN_LIMITS.place[2] * size[2]) if len(size) == 3 else self.layout.positions

    @property
    def dimension(self) -> int:
        """Of the sound field, 2 or 3."""
        return 3 if self.room is None else len(self.room)

    @property
    def is_plane_in_room(self) -> bool:
        """Whether the array is plane and the room has three dimensions."""
        return self.room is not None and len(self.room) == 3 and self.layout.positions.shape[1] == 2

    @property
    def f_max(self) -> float:
        """The highest frequency that the array can interpolate (Eq. 9), Hz."""
        return array_f_max(self.layout.positions, self.sound_speed, self.dimension)

    @property
    def limits(self) -> tuple[float, float]:
        """The band in use, Hz: of the one that was given, what the array can interpolate."""
        low, high = self.band or (min(PLAN_LIMITS.low, self.f_max / 10), PLAN_LIMITS.high * self.f_max)
        if not 0 < low < high:
            remedy = "give <frequencies> as LO:HI with LO below HI"
            raise InputError(f"{low:g} to {high:g} Hz is no band", remedy, key="frequencies")
        if low >= self.f_max:
            problem = f"the array interpolates up to {self.f_max:.0f} Hz, and the band begins at {low:g} Hz"
            remedy = "use a lower band (<frequencies>), a smaller array or more microphones" + self._width
            raise InputError(problem, remedy, key="frequencies", value=self.band)
        return low, min(high, self.f_max)

    @property
    def _width(self) -> str:
        """What a remedy adds for an array so wide that its positions may be in another unit than metres."""
        width = float(np.ptp(self.layout.positions, axis=0).max())
        wide = f"; the array is {width:.3g} m wide: give its positions in metres, not in centimetres or millimetres"
        return wide if width > PLAN_LIMITS.wide else ""

    @property
    def band_frequencies(self) -> np.ndarray:
        """All independent frequencies of the band, the lowest `modes` of them where that is given : float64, Hz."""
        return independent_frequencies(*self.limits, self.reverberation_time, self.sound_speed, self.room)[: self.modes]

    @property
    def frequencies(self) -> np.ndarray:
        """The frequencies of one take : (M,) float64, Hz: of the band evenly at most as many as an import takes."""
        return evenly(self.band_frequencies, default_max_rows(len(self.layout.names), self.takes))

    @property
    def rows(self) -> int:
        """Frequencies of all takes together: the fields of two takes are independent draws."""
        return self.takes * len(self.frequencies)

    @property
    def prior(self) -> Prior:
        """What is given beside the pressures."""
        return Prior(np.array(self.known, int), self.known_sigma, self.gain_sigma_db * np.log(10) / 20)


def evenly(f: np.ndarray, most: int) -> np.ndarray:
    """Return at most so many of some frequencies, evenly taken."""
    return f[np.unique(np.linspace(0, len(f) - 1, min(len(f), most)).round().astype(int))]
