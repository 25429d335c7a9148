"""The page: what stays while sessions come and go, and the main loop.

`Page.open(opening)` is the one entry point that shows something else: the panels, a lesson and a session file use it.
The present session stays and keeps running until the next one is ready (`session_switch`). If the next one cannot be
opened, the status bar says why in one line. Otherwise its controls replace the old ones in the panels
(`layout.SessionFolders`). Browsers stay connected, and the chosen tabs stay chosen.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import viser

from ..session.lesson import Lesson
from ..session.request import OpenRequest
from ..session.worker import WakeEvent
from .background.prepare import PreparedRun
from .gui.binding import Binding
from .gui.layout import Panels, SessionFolders
from .hotkeys import add_keys
from .preview import first_look
from .scene3d.nodes import SceneNodes
from .server.signals import Interrupt
from .session_switch import SessionSwitcher, StatusBar
from .session_view import Viewer
from .tabs.help import add_help
from .tabs.lessons import LessonsTab

LONGEST = 1.2  # s that threads are waited for at the end
RATE = 25.0  # times a second that the screen is brought up to date
HASTE = 50.0  # times a second at most where a hand waits for something
LOOK_ROUND = 1.0  # s between two looks at the sizes of all canvases


class Page:
    """Owns the panels' frame, the scene, and the session that is shown."""

    def __init__(self, server: viser.ViserServer, nodes: SceneNodes, lessons: Sequence[Lesson] = ()):
        self._server, self.nodes, self.panels, self.switcher = server, nodes, Panels(server.gui), SessionSwitcher()
        self.status_bar = StatusBar(self.panels, self.switcher)
        self.viewer: Viewer | None = None
        self.lessons = LessonsTab(self, lessons)
        with self.panels.tab("Help"):
            add_help(server.gui)
        add_keys(server.gui, self)
        self._told, self._looked, self._wake = "", 0.0, WakeEvent()
        self._welcome(server)

    def open(self, opening: OpenRequest) -> None:
        """Show something else as soon as it is ready. Any thread; the last one asked for counts."""
        self.switcher.open(opening)

    @property
    def binding(self) -> Binding | None:
        """The session that is shown, and the choices made for it; None before there is one."""
        return None if self.viewer is None else self.viewer.binding

    def _welcome(self, server: viser.ViserServer) -> None:
        """Each page gets a camera that fits its canvas, whose size is only known once the panels stand."""

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.ask(client, "top")

            @client.camera.on_update
            async def _(_) -> None:
                self.nodes.cameras.ask(client)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self.nodes.cameras.forget(client)
            if self.viewer is not None:
                self.viewer.forget(client)

    def run(self, interrupt: Interrupt) -> None:
        """Bring the screen up to date until interrupted. Raises what keeps the first session from being."""
        due = time.perf_counter()
        while not interrupt.received:
            began = time.perf_counter()
            self.turn(began)
            due = max(due + 1 / RATE, time.perf_counter())
            if self._wake.wait(due - time.perf_counter()):
                due = began + 1 / HASTE
                time.sleep(max(due - time.perf_counter(), 0.0))

    def turn(self, now: float) -> None:
        """Once round the loop."""
        work = self.switcher.take()
        first = self.viewer is None
        if first:
            self._tell_terminal()
            if self.switcher.cause is not None:
                raise self.switcher.cause
        if work is not None:
            self._exchange(work)
        self.status_bar.show(first)
        if self.viewer is not None:
            self.viewer.guarded_tick(now)
        elif self.nodes.is_empty and self.switcher.measured is not None:
            first_look(self.nodes, *self.switcher.measured)
            self.nodes.cameras.place_all("top")  # of pages that came before there was anything to place them by
        self.lessons.show(self._server.get_event_loop().call_soon_threadsafe)
        clients = self._server.get_clients().values()
        self.nodes.cameras.answer(clients)
        if now - self._looked > LOOK_ROUND:
            self._looked = now
            self.nodes.cameras.keep_all_placed(clients)

    def _exchange(self, work: PreparedRun) -> None:
        """The new session on the page in place of the old one, which stays where the new one cannot be shown."""
        old, folders = self.viewer, SessionFolders(self.panels)
        try:
            with self._server.atomic():
                before = old and old.binding.choices
                new = Viewer(self._server, work, folders, self.nodes, self.open, before, self._wake.set)
                if old is not None:
                    old.take_down()
        except Exception as error:
            folders.remove()
            work.session.close(0.5)
            if old is None:
                raise
            self.switcher.refuse(error)
            old.redraw()
            return
        self.viewer = new
        self._server.gui.set_panel_label(f"fdcal · {work.scene.name}")
        if old is not None:
            old.close()
        if old is None or old.picture.focus != new.picture.focus:
            self.nodes.cameras.open_at(new.picture)
            for client in self._server.get_clients().values():
                self.nodes.cameras.place(client, "top")

    def _tell_terminal(self) -> None:
        """How far the first session is; the line is taken away when there is one, or none will be."""
        progress = self.switcher.progress
        text = "" if progress is None else progress.text
        if text != self._told:
            self._told = text
            print(f"\r{text:<40}" if text else f"\r{'':<40}\r", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """End all threads but the server's."""
        if self._told:
            print(f"\r{'':<40}\r", end="", file=sys.stderr, flush=True)
        end = time.perf_counter() + LONGEST
        self.switcher.close(LONGEST)
        if self.viewer is not None:
            self.viewer.close(max(end - time.perf_counter(), 0.2))
            from ..acoustics.compiled import shut_down_threads  # loaded by the session that was shown

            shut_down_threads()
