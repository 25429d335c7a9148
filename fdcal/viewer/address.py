"""The view in the page's address after #: a link opens the same view (`fdcal.model.address`).

In a lesson the page writes lesson and part, which determine everything else. Otherwise it writes scene, method, step,
microphone (none where the map follows the solver), modes and map. Each browser adds its camera. The key "face", Explore
or Expert, belongs to one browser and is not sent to the server (`server/page.js`).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any
from urllib.parse import quote, urlencode

import viser

from .. import solvers
from ..graphics.camera import Camera
from ..model.address import ADDRESS, SOLVER, parse_address
from ..model.scene import load_scene, scene_names
from ..model.validation import InputError, modes_text, parse_modes, require_choice
from ..session.lesson import LessonSetting
from ..session.sources import OpenRequest, scene_request
from .server.client_values import MAX_COORDINATE, MIN_LENGTH
from .session_view import Viewer
from .tabs.lessons import LessonsTab, apply_setting, plain_choices

MAX_MODES_TEXT = 60  # characters of the modes of a map: a command with the camera has no room for more


def camera_of(address: Mapping[str, str]) -> Camera | None:
    """Return the camera in an address; None if there is none; InputError for a camera without a direction."""
    text = address.get("view", "")
    if text.count(",") < 9:
        return None
    x, y, z, u, v, w, a, b, c, fov = numbers = [float(number) for number in text.split(",")]
    aims = math.dist((x, y, z), (u, v, w)) > MIN_LENGTH and math.hypot(a, b, c) > MIN_LENGTH and 0 < fov < math.pi
    if not aims or max(map(abs, numbers)) > MAX_COORDINATE:
        raise InputError(f'the address has "view={text}", which looks at nothing', "leave it out", key="view")
    return Camera((x, y, z), (u, v, w), (a, b, c), fov, 1.0)


def address_of(viewer: Viewer, lesson: str = "", part: int = 1) -> str:
    """Return the address of the view of a session, or of a lesson; each browser adds its camera."""
    if lesson:
        return f"lesson={quote(lesson)}&part={part}"
    choices, state = viewer.binding.choices, viewer.run.session.view.state
    parts = {"scene": quote(viewer.run.scene.name), "method": viewer.run.scene.solver.name}
    if state.step and not viewer.run.session.view.running:
        parts["step"] = str(state.step)
    if not choices.follow:
        parts["microphone"] = str(choices.microphone)
    modes = SOLVER if choices.modes is None else modes_text(choices.modes).replace(" ", "")
    if len(modes) <= MAX_MODES_TEXT:  # a link with more could not be opened
        parts["modes"] = modes
    parts["map"] = choices.kind
    return "&".join("=".join(part) for part in parts.items())


class AddressBar:
    """Opens links, and keeps the addresses of all browsers up to date; all but `show` runs on viser's event loop."""

    def __init__(self, page: Any, lessons: LessonsTab):
        self._page, self._lessons = page, lessons
        self._asked: tuple[viser.ClientHandle, Mapping[str, str]] | None = None  # a link that waits for a session
        page.panels.overlay.on("open", lambda client, text: self.open(client, parse_address(text)))

    def open(self, client: viser.ClientHandle, asked: Mapping[str, str]) -> None:
        """Show what a link names, in the browser that has followed it and all others.

        InputError if there is no such scene, lesson, microphone or mode.
        """
        viewer, lessons = self._page.viewer, self._lessons
        if viewer is None:
            self._asked = client, asked
            return
        camera_of(asked)
        lesson, scene, own = asked.get("lesson", ""), asked.get("scene", ""), viewer.run.scene.name
        method = asked.get("method", "")
        if method:
            require_choice("method", method, solvers.names())
        if lesson:
            part = int(asked.get("part", "1").partition(",")[0])
            try:
                lessons.open(lesson, part, lambda: self._set(self._page.viewer, client, asked))
            except InputError as error:  # in the status line, too: the film of the opening covers a notification
                self._page.switcher.error = error
                raise
            return
        if lessons.progress.lesson is not None and scene:
            lessons.leave()
        if scene in ("", own):
            if method in ("", viewer.run.scene.solver.name):
                self._set(viewer, client, asked)
                return
            request = OpenRequest(viewer.run.scene, measurement=viewer.run.measurement, fewer_modes=True)
        else:
            require_choice("scene", scene, scene_names())
            request = scene_request(load_scene(scene))
        if method and method != request.scene.solver.name:
            solver = replace(request.scene.solver, name=method, start=None)
            request = replace(request, scene=replace(request.scene, solver=solver))

        def then(shown: Viewer | None) -> None:
            if shown is not None:
                self._page.panels.overlay.guarded(client, lambda: self._set(shown, client, asked))

        self._page.open(replace(request, choices=plain_choices()), then)

    def _set(self, viewer: Viewer, client: viser.ClientHandle, asked: Mapping[str, str]) -> None:
        """Apply the parts of an address that differ from what is shown, so that reloading a page changes nothing."""
        binding, now, camera = viewer.binding, parse_address(address_of(viewer)), camera_of(asked)
        keys = {"view"} if "lesson" in asked else set(ADDRESS) - {"scene", "method", "lesson", "part"}
        new = {key: asked[key] for key in ADDRESS if key in keys & asked.keys() and asked[key] != now.get(key)}
        count, microphone = binding.measurement.count, new.get("microphone", "none")
        if microphone != "none" and int(microphone) >= count:
            raise InputError(f"there is no microphone {microphone}", f"use 0 to {count - 1}", key="microphone")
        if new.get("modes", SOLVER) != SOLVER:
            parse_modes(new["modes"], binding.modes)
        cameras = self._page.nodes.cameras
        if camera is not None:
            cameras.request(client, camera)
            del new["view"]
        if new:
            setting = LessonSetting(frame=urlencode(new))
            apply_setting(setting, viewer.tabs, lambda view: cameras.request(client, view), restarted=False)

    def show(self) -> None:
        """Open the link that waits, or bring the address up to date; called by the main loop."""
        viewer, overlay, lesson = self._page.viewer, self._page.panels.overlay, self._lessons.progress
        if viewer is not None and self._asked is not None:
            (client, asked), self._asked = self._asked, None
            viewer.binding.call(lambda: overlay.guarded(client, lambda: self.open(client, asked)))
        elif viewer is not None and self._page.switcher.idle and viewer.tabs.sweep.playing is None:
            name = "" if lesson.lesson is None else lesson.lesson.name or lesson.lesson.title
            overlay.show("address", address_of(viewer, name, lesson.number + 1).replace("&", "&amp;"))
