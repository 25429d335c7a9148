"""The view in the page's address after #: a link opens the same view.

scene        name of a scene that comes with fdcal, or of the one that is shown
microphone   whose map is shown, from 0; that which the solver moves unless given
modes        of the map, as "1-20", or "solver" for those in use
map          flat, relief, shape, basins, volume or none
view         the camera of this browser: position, target and upward direction, metres, and field of view, radians
lesson,step  name of a lesson, and the number of its step, from 1; it sets the rest by itself

"face", Explore or Expert, is of a browser alone, and never comes here (`server/page.js`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from urllib.parse import parse_qsl, quote

import viser

from ..graphics.camera import Camera
from ..model.scene import load_scene, scene_names
from ..model.validation import InputError, modes_text, parse_modes, shown
from ..session.lesson import IN_USE, MAPS, LessonSetting, Map
from ..session.sources import OpenRequest
from .gui.binding import kind_of
from .server.client_values import MAX_COORDINATE, MIN_LENGTH
from .session_view import Viewer
from .tabs.lessons import KINDS, LessonPage, LessonsTab, apply_setting, plain_choices

MAX_MODES_TEXT = 60  # characters of the modes of a map: with the camera a command has room for no more
MAX_NUMBER = 99_999  # of a microphone and of a step
SOLVER = "solver"  # the modes that the solver uses
MAP_NAMES = {kind: name for name, kind in KINDS.items()}


@dataclass(frozen=True)
class Address:
    """What an address names; None and "" leave the page as it is."""

    scene: str = ""
    microphone: int | None = None
    modes: str = ""
    map: Map | None = None
    view: Camera | None = None
    lesson: str = ""
    step: int = 1


def parse_address(text: str) -> Address:
    """Return what an address names. Raises InputError: a part that no address has, or a value that it cannot have."""
    values: dict = {}
    for name, value in parse_qsl(text, keep_blank_values=True):
        read = _PARTS.get(name)
        values[name] = None if read is None or name in values else read(value)
        if values[name] is None:
            remedy = f"use each of {', '.join(_PARTS)} once, as the page itself writes them"
            raise InputError(f'the address has "{shown(name)}={shown(value)}"', remedy, key=name, value=value)
    return Address(**values)


def _number(value: str) -> int | None:
    return int(value) if re.fullmatch(r"\d{1,6}", value) and int(value) <= MAX_NUMBER else None


def _modes(value: str) -> str | None:
    numbers = re.fullmatch(r"[\d, -]+", value) and len(value) <= MAX_MODES_TEXT
    return value if value == SOLVER or numbers else None


def _camera(value: str) -> Camera | None:
    try:
        x, y, z, u, v, w, a, b, c, fov = numbers = [float(number) for number in value.split(",")]
    except ValueError:
        return None
    sound = all(math.isfinite(number) and abs(number) <= MAX_COORDINATE for number in numbers)
    aims = math.dist((x, y, z), (u, v, w)) > MIN_LENGTH and math.hypot(a, b, c) > MIN_LENGTH
    return Camera((x, y, z), (u, v, w), (a, b, c), fov, 1.0) if sound and aims and 0 < fov < math.pi else None


_PARTS: dict[str, Callable[[str], object]] = {
    "scene": lambda value: value or None,
    "microphone": _number,
    "modes": _modes,
    "map": lambda value: value if value in MAPS else None,
    "view": _camera,
    "lesson": lambda value: value or None,
    "step": _number,
}


def address_of(viewer: Viewer, lesson: str = "", step: int = 1) -> str:
    """Return what the address says of a session, or of a lesson; the camera of each browser is added there."""
    if lesson:
        return f"lesson={quote(lesson)}&step={step}"
    choices = viewer.binding.choices
    parts = {"scene": quote(viewer.run.scene.name)}
    if not choices.follow:
        parts["microphone"] = str(choices.microphone)
    modes = SOLVER if choices.modes is None else modes_text(choices.modes).replace(" ", "")
    if len(modes) <= MAX_MODES_TEXT:  # a link with more could not be opened
        parts["modes"] = modes
    parts["map"] = MAP_NAMES[kind_of(choices)]
    return "&".join("=".join(part) for part in parts.items())


class AddressBar:
    """Shows what a link names, and keeps the address of all browsers; all but `tick` on viser's event loop."""

    def __init__(self, page: LessonPage, lessons: LessonsTab):
        self._page, self._lessons = page, lessons
        self._asked: tuple[viser.ClientHandle, Address] | None = None  # before there is a session
        # Until its scene is shown; without a request, that of a lesson.
        self._pending: tuple[OpenRequest | None, viser.ClientHandle, Address] | None = None
        page.panels.overlay.on("open", lambda client, text: self.open(client, parse_address(text)))

    def open(self, client: viser.ClientHandle, asked: Address) -> None:
        """Show what a link names, in the browser that has followed it and all others.

        Raises InputError: there is no such scene, lesson, microphone or mode.
        """
        viewer, lessons = self._page.viewer, self._lessons
        if viewer is None:
            self._asked = client, asked
            return
        name = viewer.run.scene.name
        if asked.lesson:
            lessons.open(asked.lesson, asked.step)
            self._pending = None, client, asked
        elif lessons.active and asked.scene:
            lessons.leave()
        if not asked.lesson and asked.scene not in ("", name):
            if asked.scene not in scene_names():
                remedy = f"use {', '.join(scene_names())}"
                raise InputError(f'the address names the scene "{shown(asked.scene)}"', remedy, key="scene")
            request = OpenRequest(load_scene(asked.scene), choices=plain_choices())
            self._page.open(request)
            self._pending = request, client, asked
        elif not asked.lesson:
            self._set(viewer, client, asked)

    def _set(self, viewer: Viewer, client: viser.ClientHandle, asked: Address) -> None:
        """Set what differs from what is shown: a page that is loaded again changes nothing."""
        binding, now = viewer.binding, parse_address(address_of(viewer))
        modes = asked.modes if asked.modes != now.modes and not asked.lesson else ""
        if modes and modes != SOLVER:
            parse_modes(modes, binding.modes)
        chosen = asked.microphone if asked.microphone != now.microphone and not asked.lesson else None
        if chosen is not None and chosen >= binding.measurement.count:
            remedy = f"use 0 to {binding.measurement.count - 1}"
            raise InputError(f"there is no microphone {chosen}", remedy, key="microphone")
        setting = LessonSetting(
            microphone=chosen,
            map_modes=(IN_USE if modes == SOLVER else modes) or None,
            map=asked.map if asked.map != now.map and not asked.lesson else None,
        )
        if setting != LessonSetting():
            apply_setting(setting, viewer.tabs, lambda view: None, restarted=False)
        if asked.view is not None:
            self._page.nodes.cameras.request(client, asked.view)

    def tick(self, call: Callable[[Callable[[], object]], object]) -> None:
        """Carry out what waits, and bring the address up to date; called by the main loop."""
        viewer, lesson = self._page.viewer, self._lessons.progress
        if viewer is None:
            return
        if self._asked is not None:
            (client, asked), self._asked = self._asked, None
            call(lambda: self._page.panels.overlay.guarded(client, lambda: self.open(client, asked)))
        elif self._pending is not None and (
            self._lessons.ready if self._pending[0] is None else viewer.binding.run.opening is self._pending[0]
        ):
            (_, client, asked), self._pending = self._pending, None
            call(lambda: self._page.panels.overlay.guarded(client, lambda: self._set(viewer, client, asked)))
        elif self._pending is not None and self._page.switcher.idle:
            self._pending = None
        elif self._pending is None and not viewer.tabs.sweep.playing:
            name = "" if lesson.lesson is None else lesson.lesson.name or lesson.lesson.title
            self._page.panels.overlay.show("address", address_of(viewer, name, lesson.number + 1).replace("&", "&amp;"))
