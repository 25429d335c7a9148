"""The first seconds of the page: modes are added to a map of many minima until one is left, and a microphone rolls in.

    Film     what is shown, read from a file that comes with fdcal: nothing is simulated or compiled before it plays
    Moment   what it shows at one time
    Opening  plays the film in the scene until somebody touches anything
    still    its first picture, which stands in the page's HTML (`app.STILL`) until the browser has drawn the scene

`docs/opening.py` writes the files. The film ends with one button; the session is shown when that is pressed.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..cost.scale import Minima
from ..graphics.camera import camera_for
from ..graphics.heatmap import cost_floor
from ..graphics.overlays import along, with_ball
from ..graphics.picture import compose
from ..graphics.primitives import Floor, Picture
from ..model.measurement import Measurement
from ..model.measurement_file import load_measurement
from ..model.scene_file import load_scene
from ..session.request import OpenRequest
from .gui.words import CanvasWords
from .scene3d.nodes import SceneNodes

SCENE, MICROPHONE = "fig1_square", 16
MEASUREMENT, MAPS = (Path(__file__).with_name(f"opening_{name}.npz") for name in ("measurement", "maps"))
STILL_SIZE, STILL_QUALITY = (1280, 720), 72  # pixels of the canvas whose picture it is a part of; of the WebP files
LOWEST = -160.0  # dB, that the file of the maps can hold
LEVELS = 2**16 - 1
NUMBERS = ("No", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine")


@dataclass(frozen=True)
class Film:
    """Maps of the sums of more and more modes, and the way of the microphone downhill over the last of them."""

    modes: np.ndarray  # (M,) int64, in the order in which they are added, counted from 1
    summed: np.ndarray  # (K,) int64, how many of them each map is the sum of, ascending from 1
    decibels: np.ndarray  # (K, ny, nx) float64, cost of each map over the search lattice, dB
    minima: tuple[Minima, ...]  # of each map
    path: np.ndarray  # (P, 2) float64, metres

    def save(self) -> None:
        """Write the film to its file."""
        np.savez_compressed(
            MAPS, modes=self.modes, summed=self.summed, path=self.path,
            places=np.concatenate([places for one in self.minima for places in (one.lowest, one.others)]),
            counts=[len(places) for one in self.minima for places in (one.lowest, one.others)],
            levels=np.rint(LEVELS * (1 - self.decibels / LOWEST)).astype(np.uint16),
        )  # fmt: skip

    @property
    def times(self) -> tuple[float, ...]:
        """When each map begins, s; those with several minima take three quarters of the time."""
        several = sum(one.count > 1 for one in self.minima) or 1
        stay = [FEW_TIME / several] * several
        rest = len(self.minima) - several
        return tuple(np.cumsum([0.0, *stay, *[ONE_TIME / max(rest, 1)] * rest]).tolist())

    @property
    def length(self) -> float:
        """Time until the microphone has come to rest, s."""
        return self.times[-1] + ROLL_TIME

    def at(self, time: float) -> Moment:
        """Return what is shown at a time, s."""
        starts = self.times
        index = min(int(np.searchsorted(starts, time, side="right")) - 1, len(self.minima) - 1)
        change = min((starts[index + 1] - starts[index]) / 2, CHANGE_TIME)
        share = np.clip((time - starts[index]) / change, 0.0, 1.0) if index else 1.0
        rolled = np.clip((time - starts[-1]) / ROLL_TIME, 0.0, 1.0)
        place = along(self.path, float(rolled))
        words = self._words(index if share > 0.5 else index - 1, float(rolled))
        return Moment(index, float(share * share * (3 - 2 * share)), place, words)

    def _words(self, index: int, rolled: float) -> str:
        modes, places = int(self.summed[index]), self.minima[index].count
        many = NUMBERS[modes] if modes < len(NUMBERS) else str(modes)
        words = f"{many} frequenc{'y' if modes == 1 else 'ies'}: {places} place{'' if places == 1 else 's'} fit"
        return words + ("s" if places == 1 else "") if rolled < 1 else FOUND


FEW_TIME, ONE_TIME = 10.0, 2.0  # s that all maps with several minima are shown, and those with one
CHANGE_TIME, ROLL_TIME = 1.2, 1.4  # s that one map takes to become the next, at most, and that the microphone rolls
FOUND = "The microphone is found"


@dataclass(frozen=True)
class Moment:
    """What the film shows at one time."""

    index: int  # of the map
    share: float  # 0 to 1, how far the map before has become this one
    place: np.ndarray  # (2,) float64, metres, of the microphone
    words: str


@functools.cache
def film() -> Film:
    """Return the film that comes with fdcal."""
    with np.load(MAPS) as file:
        places = np.split(file["places"], np.cumsum(file["counts"])[:-1])
        decibels = LOWEST * (1 - file["levels"] / LEVELS)
        minima = [
            Minima(*both, len(both[0]) + len(both[1]), None) for both in zip(places[::2], places[1::2], strict=True)
        ]
        return Film(file["modes"], file["summed"], decibels, tuple(minima), file["path"])


RELIEF_HEIGHT = 0.22  # of the highest cost, of the longer side of the map: so low that no hill hides a hole
MARGINS = (24, 24, 24, 128)  # pixels left, bottom, right and top of the map, for the words above it
FRAME_TIME = 0.12  # s between two pictures while the map changes
ABOUT = "Where is this microphone? Its recording fits where the map is dark."
COARSE = 2  # of the lattice of the map while it changes


class Projector:
    """Draws the film."""

    def __init__(self, measurement: Measurement):
        self._measurement, self.film = measurement, film()
        if measurement.search is None:
            raise ValueError("the scene of the opening has a search domain")
        self._search = measurement.search
        self._floor: tuple[tuple, Floor] | None = None  # the last map, and what it was drawn from

    def picture(self, moment: Moment, dark: bool = False) -> Picture:
        """Return the picture of a moment: the relief, the microphone on it, and the local minima once it stands."""
        positions = np.array(self._measurement.positions, float)
        positions[MICROPHONE] = moment.place
        floor = self.floor(moment)
        picture = compose(None, self._measurement, positions, MICROPHONE, floor, dark=dark)
        meshes = tuple(part for part in picture.meshes if not part.name.startswith(("microphones/e", "selected/")))
        return with_ball(replace(picture, meshes=meshes), moment.place, floor)

    def floor(self, moment: Moment) -> Floor:
        """Return the map of a moment; the same object for the same map as last time."""
        key = moment.index, moment.share
        if self._floor is None or self._floor[0] != key:
            self._floor = key, self._drawn(*key)
        return self._floor[1]

    def _drawn(self, index: int, share: float) -> Floor:
        still, decibels, search = share >= 1, self.film.decibels[index], self._search
        if not still:
            decibels = (share * decibels + (1 - share) * self.film.decibels[index - 1])[::COARSE, ::COARSE]
            search = replace(search, step=COARSE * search.step)
        minima = self.film.minima[index] if still else None
        floor = cost_floor(
            10 ** (decibels / 10), search, True, "cost, Eq. 7 (dB)",
            minima=minima, relief=True, relief_height=RELIEF_HEIGHT, decibels=True,
        )  # fmt: skip
        return replace(floor, show_minima=still)


def still(projector: Projector, dark: bool) -> np.ndarray:
    """Return the first picture of the film (H, W, 3) uint8: what fills a canvas of STILL_SIZE within MARGINS.

    It has no labels, and is no wider than its map: the page fits it into the MARGINS of any canvas, as the camera does.
    """
    from ..graphics.snapshot import draw

    moment = projector.film.at(0.0)
    picture = projector.picture(moment, dark)
    (left, bottom, right, top), (width, height) = MARGINS, STILL_SIZE
    camera = camera_for(picture, STILL_SIZE, "close", MARGINS)
    narrow = (camera_for(picture, (less, height), "close", MARGINS).height for less in range(height // 2, width, 2))
    width = height // 2 + 2 * next(i for i, seen in enumerate(narrow) if seen < 1.001 * camera.height)
    camera = camera_for(picture, (width, height), "close", MARGINS)
    bare = replace(picture, labels=(), floor=replace(projector.floor(moment), bar=None))
    return draw(bare, (width, height), "close", camera)[top : height - bottom, left : width - right]


class Opening:
    """Plays the film in the scene; called by the main loop.

    All browsers see the same moment of it. It begins with the first of them, and again when a browser comes to it that
    nobody else watches, as one that is loaded again; whoever touches anything ends it, for all and for good.

    `dark`: whether the page is; `request`: for the session that follows; `playing`: whether the film holds the scene,
    in which no session may draw then; `floor`: the map that is shown.
    """

    def __init__(self, nodes: SceneNodes):
        self.request = opening_request()
        if self.request.measurement is None:
            raise ValueError("the opening has a measurement")
        self._nodes, self._projector = nodes, Projector(self.request.measurement)
        self.dark, self.playing, self._began = False, True, -1.0  # and when the film began, s; before it, below 0
        self._drawn, self._key = 0.0, ()  # when the last picture was, s, and of what
        first = self._projector.film.at(0.0)
        self.floor, picture = self._projector.floor(first), self._projector.picture(first)
        nodes.cameras.view, nodes.cameras.margins = "close", MARGINS
        nodes.cameras.set_initial(picture)
        nodes.show(picture)

    @property
    def begins(self) -> bool:
        """Whether a browser that comes now sees the film from its beginning."""
        return self.playing and not self._nodes.cameras.placed

    def end(self) -> None:
        """Stop, and leave the scene to the session. Any thread."""
        self.playing = False

    def tick(self, words: CanvasWords, now: float) -> None:
        """Show what is due at the time `now`, s, with words on the canvas; the film waits for a browser that draws."""
        if self._nodes.cameras.user_moves:
            self.end()
        if not self.playing:
            if self._nodes.cameras.margins is MARGINS:  # once
                self._nodes.cameras.margins = None
                words.show("")
            return
        if not self._nodes.cameras.placed:
            self._began = -1.0
        elif self._began < 0:
            self._began = now
        time = now - self._began if self._began >= 0 else 0.0
        moment = self._projector.film.at(time)
        key = self.dark, moment.index, moment.share, *moment.place
        if key != self._key and (now - self._drawn >= FRAME_TIME or moment.share >= 1):
            self._drawn, self._key = now, key
            self.floor = self._projector.floor(moment)
            self._nodes.show(self._projector.picture(moment, self.dark))
        if time < self._projector.film.length:
            words.show(moment.words, ABOUT, {"Skip": self.end}, alone=True, quiet=True)
        else:
            words.show(moment.words, "Drag it away, and let it go.", {"Now you": self.end}, alone=True)


def opening_request() -> OpenRequest:
    """Return the request for the session of the opening: one mode in relief, with its many minima."""
    choices = {"relief": True, "relief_height": RELIEF_HEIGHT, "microphone": MICROPHONE, "follow": False}
    choices["modes"] = (int(film().modes[0]),)
    return OpenRequest(load_scene(SCENE), measurement=load_measurement(MEASUREMENT), choices=choices)
