"""The page and its main loop, which last while sessions replace each other.

`Page.open(request)` shows another session; tabs, lessons and links call it. The present session keeps running until
the next one is ready (`SessionSwitcher`). If that cannot be opened, the panels give the reason in one line. Otherwise
its controls replace the old ones. Browsers stay connected, and the chosen tabs stay chosen.
"""

import collections
import logging
import math
import time
from collections.abc import Callable, Sequence

import viser

from ..session.lesson import Lesson
from ..session.sources import OpenRequest
from ..session.worker import Flag
from .address import AddressBar
from .explore import Explore
from .own_files import OwnFiles
from .panels import Panels
from .prepare import Preparation, SessionSwitcher, Then
from .scene3d import SceneNodes
from .scheduler import Memo
from .server import content
from .server.process import release_memory
from .session_view import Viewer
from .tabs import help
from .tabs.lessons import LessonsTab

CLOSE_TIME = 1.2  # s that the page waits for threads at the end
COMPILING = "Finishing a compilation; Ctrl-C again does not wait ..."
RATE = 25.0  # checks for changes, and updates of the screen, per second
IDLE_RATE = 5.0  # the same after some time without a change; users and the solver wake the loop at once
MAX_RATE = 50.0  # updates per second while the loop is woken
SETTLING = 5.0  # s of updates after the last change, longer than the delay of any update
CANVAS_INTERVAL = 1.0  # s between two checks of the sizes of all canvases
RELEASE_DELAY = 1.5  # s from the end of a session, within which its threads end, until its memory is released

log = logging.getLogger(__name__)


class Page:
    """Owns the panels, the scene, and the session that is shown.

    `lessons` are listed in this order. `on_progress` is called with the progress of the first session in words, and
    with "" when it is ready or refused. `takes_files`: whether users may upload files, which requires that no other
    machine can reach the page. `viewer` belongs to the session that is shown, or is None.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        nodes: SceneNodes,
        lessons: Sequence[Lesson] = (),
        on_progress: Callable[[str], None] = lambda text: None,
        takes_files: bool = False,
    ):
        self._server, self.nodes, self.wake = server, nodes, Flag()
        self._call = server.get_event_loop().call_soon_threadsafe
        self.switcher = SessionSwitcher(self._call)
        self.panels = Panels(server.gui, self.wake.set, self.switcher.cancel)
        self.viewer: Viewer | None = None
        self.lessons = LessonsTab(self, lessons)
        with self.panels.tabs["Help"]:
            server.gui.add_html(help.text())
        help.add_keys(server.gui, self.panels.overlay)
        self.own_files = OwnFiles(server, self.open, self.wake.set) if takes_files else None
        self.explore = Explore(self, self.lessons, self.own_files)
        self.address, self._dark = AddressBar(self, self.lessons), False
        self._first: viser.ClientHandle | None = None  # the browser that determines whether the page is dark
        self.panels.overlay.otherwise = self.carry_out
        self.panels.overlay.on("dark", lambda client, value: self._prefer(client, value == "on"))
        self.panels.overlay.on("face", lambda client, value: nodes.cameras.show_face(client, value == "expert"))
        self._progress, self._on_progress, self._faults = "", on_progress, dict[str, str]()
        self._checked = 0.0
        self._releases: collections.deque[float] = collections.deque()  # when each is due, one for each session

        # Each browser gets a camera that fits its canvas, whose size is known only when the panels are laid out.
        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.request(client, self.nodes.cameras.view)
            # viser drops messages that a browser sends before its camera; from now on its commands arrive.
            client.gui.add_html(content("greeting", self.panels.overlay.start), visible=False)

            @client.camera.on_update
            async def _(_) -> None:
                self.nodes.cameras.request(client)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.forget(client)
            if self.own_files is not None:
                self.own_files.forget(client.client_id)
            if self.viewer is not None:
                self.viewer.picker.forget(client.client_id)

    def open(self, request: OpenRequest, then: Then = lambda viewer: None) -> None:
        """Show another session as soon as it is ready; any thread may call this, and the last request is executed.

        `then` is called once on viser's event loop: with the viewer of that session, or with None if it is not shown.
        """
        self.switcher.open(request, then)

    def carry_out(self, client: viser.ClientHandle, command: str, value: str = "") -> None:
        """Execute a command of the session (`Binding.commands`), if it exists; on viser's event loop."""
        if self.viewer is not None and command in self.viewer.binding.commands:
            self.viewer.binding.carry_out(client, command, value)

    def _prefer(self, client: viser.ClientHandle | None, dark: bool) -> None:
        """Follow a browser's preference for a dark page, unless a user has chosen; on viser's event loop.

        All browsers share the theme, and the first one that has connected decides.
        """
        if client is not self._first and self._first in self._server.get_clients().values():
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
            if now - self._checked > CANVAS_INTERVAL:  # canvases change their sizes without notice
                self._checked = now
                self.nodes.cameras.follow_all(self._server.get_clients().values())
            next_check = max(next_check + 1 / (RATE if now < idle_from else IDLE_RATE), time.perf_counter())
            if self.wake.wait(next_check - time.perf_counter()):
                next_check = now + 1 / MAX_RATE
                time.sleep(max(next_check - time.perf_counter(), 0.0))

    @property
    def changed(self) -> bool:
        """Whether the screen may be outdated, or shows something that moves."""
        woken = self.wake.is_set()
        if woken:  # an unconditional `clear` could lose a wake-up that arrives in between
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
            self.viewer.tabs.run_bar.status.visible = self.switcher.current is None  # else the status bar is shown
            self.nodes.cameras.lecture = self.viewer.binding.choices.lecture
            self.nodes.cameras.caption = self.lessons.progress.lesson is not None
            self.viewer.guarded_tick(now)
        elif self.nodes.is_empty and (current := self.switcher.current) is not None:
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
        self.nodes.cameras.process_requests(self._server.get_clients().values())
        if self._releases and now > self._releases[0]:
            while self._releases and now > self._releases[0]:
                self._releases.popleft()
            release_memory(self._server)

    def _replace_session(self, prepared: Preparation) -> None:
        """Show a new session in place of the old one, which stays where the new one cannot be shown."""
        old, run = self.viewer, prepared.run
        assert run is not None
        try:
            with self._server.atomic():
                before = old and old.binding.choices
                new = Viewer(self._server, run, self.panels, self.nodes, self.open, before, self.wake.set)
                if old is not None:
                    old.take_down()
        except Exception as error:
            run.session.close(0.5)
            if old is None:
                raise
            self.switcher.refuse(prepared, error)
            old.drawn = Memo()
            return
        self.viewer = new
        self._server.gui.set_panel_label(f"fdcal · {run.scene.name}")
        if old is not None:
            old.close()
        elif self._dark:
            self._call(self._prefer, self._first, True)
        if old is None or old.snapshot.picture.focus != new.snapshot.picture.focus:
            in_relief = old is None and new.binding.choices.kind == "relief"
            self.nodes.cameras.view = view = "close" if in_relief else "top"
            self.nodes.cameras.set_initial(new.snapshot.picture)
            for client in self._server.get_clients().values():
                self.nodes.cameras.place(client, view)
        self._releases.append(time.perf_counter() + RELEASE_DELAY)
        self._call(prepared.then, new)

    def _report_progress(self, text: str | None = None) -> None:
        """Report the progress of the first session, or `text`, where it has changed."""
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
            self.viewer.close(CLOSE_TIME)
        self.switcher.close(CLOSE_TIME)
        self._report_progress("")
        if self.viewer is not None:
            from ..acoustics.compiled import shut_down_threads  # loaded by the session that was shown

            shut_down_threads()
