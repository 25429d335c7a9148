"""The page and its main loop, which continue when one session replaces another.

`Page.open(request)` shows another session; tabs, lessons and links call it. The present session keeps running until
the next one is ready (`SessionSwitcher`). If the next one cannot be opened, the panels give the reason in one line.
Otherwise its controls replace the old ones. Browsers stay connected, and the chosen tabs stay chosen.

`AddressBar` keeps the view in the page's address after #: a link opens the same view (`fdcal.model.address`). In a
lesson the page writes lesson and part, which determine everything else. Otherwise it writes scene, method, step,
microphone (unless the map follows the solver), modes and map. Each browser adds its camera. The key "layout",
"explore" or "expert", belongs to one browser (`server/page.js`); the server only fits its camera.
"""

import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from urllib.parse import quote, urlencode

import viser

from .. import solvers
from ..graphics.camera import Camera
from ..model.address import ADDRESS, SOLVER, parse_address
from ..model.scene import load_scene, scene_names
from ..model.validation import InputError, modes_text, parse_modes, require_choice
from ..session.lesson import Lesson, LessonSetting
from ..session.sources import OpenRequest, scene_request
from ..session.worker import Flag, Memo
from .explore import Explore, OwnFiles
from .html import of_browsers
from .panels import Panels
from .prepare import Preparation, SessionSwitcher
from .scene3d import SceneNodes
from .server import content
from .server.client_values import MAX_COORDINATE, MIN_LENGTH
from .server.process import release_memory
from .session_view import Viewer
from .tabs.lessons import LessonsTab, apply_setting, plain_choices

CLOSE_TIME = 1.2  # s, longest time that the page waits for threads at the end
COMPILING = "Finishing a compilation; press Ctrl-C again to exit without waiting ..."
RATE = 25.0  # checks for changes, and updates of the screen, per second
IDLE_RATE = 5.0  # the same after some time without a change; users and the solver wake the loop at once
MAX_RATE = 50.0  # updates per second while the loop is woken
SETTLING = 5.0  # s for which updates continue after the last change; longer than the delay of any update
CANVAS_INTERVAL = 1.0  # s between two checks of the sizes of all canvases
RELEASE_DELAY = 1.5  # s from the end of a session to the release of its memory; its threads end meanwhile

log = logging.getLogger(__name__)


class Page:
    """Owns the panels, the scene, and the session that is shown.

    `lessons` are listed in this order. `on_progress` is called with the progress of the first session in words, and
    with "" when it is ready or refused. `takes_files`: whether users may upload files, which requires that no other
    machine can reach the page. `named`: scene with which the server was started, "" for none. `viewer` is that of the
    session that is shown, or None.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        nodes: SceneNodes,
        lessons: Sequence[Lesson] = (),
        on_progress: Callable[[str], None] = lambda text: None,
        takes_files: bool = False,
        named: str = "",
    ):
        self.server, self.nodes, self.wake = server, nodes, Flag()
        self._call = server.get_event_loop().call_soon_threadsafe
        self.switcher = SessionSwitcher(self._call)
        self.open = self.switcher.open  # any thread may call this, and the last request is executed
        self.panels = Panels(server.gui, self.wake.set, self.switcher.cancel)
        self.viewer: Viewer | None = None
        self.lessons = LessonsTab(self, lessons)
        self.own_files = OwnFiles(server, self.open, self.wake.set) if takes_files else None
        self.explore = Explore(self, self.lessons, self.own_files)
        self.address, self._dark = AddressBar(self, self.lessons), False
        self._first: viser.ClientHandle | None = None  # the browser that determines whether the page is dark
        self.panels.overlay.acts["dark"] = lambda client, value: self._prefer(client, value == "on")
        self.panels.overlay.acts["layout"] = nodes.cameras.show_layout
        self._progress, self._on_progress, self._faults = "", on_progress, dict[str, str]()
        self._checked = 0.0
        self._release_at = math.inf  # when the memory of the last session that was replaced is released

        # Each browser gets a camera that fits its canvas, whose size is known only when the panels are laid out.
        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.request(client, self.nodes.cameras.view)
            # viser drops what a browser sends before its camera. The greeting says that commands arrive from now on.
            greeting = f"start={self.panels.overlay.start}&scene={quote(named)}"
            client.gui.add_html(content("greeting", greeting), visible=False)
            client.camera.on_update(of_browsers(lambda camera: nodes.cameras.request(client)))

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.pages.pop(client.client_id, None)
            if self.own_files is not None:
                self.own_files.forget(client.client_id)
            if self.viewer is not None:
                self.viewer.picker.forget(client.client_id)

    def _prefer(self, client: viser.ClientHandle | None, dark: bool) -> None:
        """Follow a browser's preference for a dark page, unless a user has chosen; on viser's event loop.

        All browsers share the theme, and the first one that has connected decides.
        """
        if client is not self._first and self._first in self.server.get_clients().values():
            return
        self._first, self._dark = client, dark
        if self.viewer is None:
            self.panels.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)
        elif not self.viewer.binding.choices.themed:
            self.viewer.tabs.view.darken(dark, preferred=True)

    def run(self, interrupt: Flag) -> None:
        """Update the screen until interrupted, and do nothing while nothing changes.

        InputError or StorageError if the first request cannot be shown.
        """
        idle_from, next_check = math.inf, 0.0
        while not interrupt.is_set():
            now = time.perf_counter()
            if self.changed:
                idle_from = now + SETTLING
            if now < idle_from:
                self.tick(now)
            if now - self._checked > CANVAS_INTERVAL:  # a canvas may change its size without a message
                self._checked = now
                self.nodes.cameras.follow_all(self.server.get_clients().values())
            next_check = max(next_check + 1 / (RATE if now < idle_from else IDLE_RATE), time.perf_counter())
            if self.wake.wait(next_check - time.perf_counter()):
                next_check = now + 1 / MAX_RATE
                time.sleep(max(next_check - time.perf_counter(), 0.0))

    @property
    def changed(self) -> bool:
        """Whether the screen may be outdated, or something on it moves."""
        woken = self.wake.is_set()
        if woken:  # an unconditional `clear` could lose a wake-up that arrives after `is_set`
            self.wake.clear()
        viewer, cameras = self.viewer, self.nodes.cameras
        return woken or viewer is None or viewer.changing or not self.switcher.idle or bool(cameras.requests)

    def tick(self, now: float) -> None:
        """Update the screen once, at the time `now`, s."""
        prepared = self.switcher.poll()
        first = self.viewer is None
        self.nodes.remove_old(now)
        if first and self.switcher.error is not None:
            self._report_progress()
            raise self.switcher.error
        if prepared is not None:
            self._replace_session(prepared)
        self.panels.show_progress(self.switcher.current, self.switcher.error, first)
        if first:
            self._report_progress()
        if self.viewer is not None:
            self.viewer.tabs.run_bar.status.visible = self.switcher.current is None  # else the progress is shown
            self.nodes.cameras.lecture = self.viewer.binding.choices.lecture
            self.nodes.cameras.caption = self.lessons.progress.lesson is not None
            self.viewer.guarded_tick(now)
        elif self.nodes.cameras.picture is None and (current := self.switcher.current) is not None:
            if current.measurement is not None:
                self.nodes.show_room(current.request, current.measurement)
                self.nodes.cameras.request_all("top")  # for browsers that connected before there was a picture
        parts = ("lessons", self.lessons.show), ("address", self.address.show), ("canvas", self.explore.show)
        for part, update in parts:
            try:
                update()
            except Exception as error:  # logged once, and the page continues
                if self._faults.get(part) != repr(error):
                    log.exception("the %s could not be updated", part)
                self._faults[part] = repr(error)
        self.nodes.cameras.process_requests(self.server.get_clients().values())
        if now > self._release_at:
            self._release_at = math.inf
            release_memory(self.server)

    def _replace_session(self, prepared: Preparation) -> None:
        """Show a new session in place of the old one; if that is not possible, the old one stays."""
        old, run = self.viewer, prepared.run
        assert run is not None
        try:
            with self.server.atomic():
                new = Viewer(self, run, old and old.binding.choices)
                if old is not None:  # remove its controls and handles
                    old.picker.handles.remove()
                    self.panels.overlay.show("words", "")
                    old.binding.remove()
        except Exception as error:
            run.session.close(0.5)
            if old is None:
                raise
            self.switcher.refuse(prepared, error)
            old.drawn = Memo()
            return
        self.viewer, self.panels.overlay.otherwise = new, new.binding.carry_out
        self.server.gui.set_panel_label(f"fdcal · {run.scene.name}")
        if old is not None:
            old.binding.threads.close(1.0)
        if self._first is not None:  # its preference may have changed while the session was built
            self._call(lambda: self._prefer(self._first, self._dark))
        if old is None or old.snapshot.picture.focus != new.snapshot.picture.focus:
            in_relief = old is None and new.binding.choices.kind == "relief"
            self.nodes.cameras.view = view = "close" if in_relief else "top"
            self.nodes.cameras.set_initial(new.snapshot.picture)
            for client in self.server.get_clients().values():
                self.nodes.cameras.place(client, view)
        self._release_at = time.perf_counter() + RELEASE_DELAY
        self._call(prepared.then, new)

    def _report_progress(self, text: str | None = None) -> None:
        """Report the progress of the first session, or `text`, if it has changed."""
        current = self.switcher.current
        text = text if text is not None else "" if current is None else current.text
        if text != self._progress:
            self._progress = text
            self._on_progress(text)

    def close(self) -> None:
        """End all threads except those of the server."""
        self._report_progress(COMPILING if self.switcher.compiling else "")
        if self.own_files is not None:
            self.own_files.close()
        if self.viewer is not None:
            self.viewer.binding.threads.close(CLOSE_TIME)
        self.switcher.close(CLOSE_TIME)
        self._report_progress("")
        if self.viewer is not None:
            from ..acoustics.compiled import shut_down_threads  # loaded by the session that was shown

            shut_down_threads()


MAX_MODES_TEXT = 60  # characters of the modes in an address; with more, a command with the camera would be too long


def camera_of(address: Mapping[str, str]) -> Camera | None:
    """Return the camera in an address, None if there is none; InputError for a camera that is not possible."""
    text = address.get("view", "")
    if text.count(",") < 9:
        return None
    x, y, z, u, v, w, a, b, c, fov = numbers = [float(number) for number in text.split(",")]
    aims = math.dist((x, y, z), (u, v, w)) > MIN_LENGTH and math.hypot(a, b, c) > MIN_LENGTH and 0 < fov < math.pi
    if not aims or max(map(abs, numbers)) > MAX_COORDINATE:
        raise InputError(f'the address has "view={text}", which is not a possible camera', "leave it out", key="view")
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
    """Opens links, and updates the addresses of all browsers; all methods but `show` run on viser's event loop."""

    def __init__(self, page: Page, lessons: LessonsTab):
        self._page, self._lessons = page, lessons
        self._asked: tuple[viser.ClientHandle, Mapping[str, str]] | None = None  # a link that waits for a session
        page.panels.overlay.acts["open"] = lambda client, text: self.open(client, parse_address(text))

    def open(self, client: viser.ClientHandle, asked: Mapping[str, str]) -> None:
        """Show what a link names, in the browser that has followed it and in all others.

        InputError if there is no such scene, method, lesson, microphone or mode.
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
                lessons.open(lesson, part, lambda: self._set(client, asked))
            except InputError as error:  # shown in the status line, too: the film covers a notification
                self._page.switcher.error = error
                raise
            return
        if lessons.progress.lesson is not None and scene:
            lessons.leave()
        if scene in ("", own):
            if method in ("", viewer.run.scene.solver.name):
                self._set(client, asked)
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
                self._page.panels.overlay.guarded(client, lambda: self._set(client, asked))

        self._page.open(replace(request, choices=plain_choices()), then)

    def _set(self, client: viser.ClientHandle, asked: Mapping[str, str]) -> None:
        """Apply the parts of an address that differ from what is shown, so that reloading a page changes nothing."""
        viewer = self._page.viewer
        assert viewer is not None  # the session of the address is shown
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
