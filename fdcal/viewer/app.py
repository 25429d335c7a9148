"""The page's owner: opens the server, prepares the session in the background, then copies what is new to the screen.

Three owners share nothing that changes: viser's loop bounds what clients send and puts commands on the session's
queue, the solver thread publishes frozen states, and the main thread, here, copies the newest of them to the screen.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import viser

from ..cost import usable_modes
from ..offscreen import render_png
from ..picture import (
    Floor,
    Picture,
    backdrop,
    headline,
    with_ellipses,
    with_estimate,
    with_floor,
    with_trails,
)
from ..scene import Scene
from ..worker import LatestWorker
from . import words
from .controls import Controls
from .desk import Choices
from .hands import Hands
from .maps import Map, MapRequest, Maps
from .preparing import Interrupt, Work, prepare
from .safety import open_server, quietly
from .side import SidePanel
from .spreads import Errors, Spreads
from .stage import Stage

RATE = 25.0  # times a second that the screen is brought up to date
FAULT_SHOWN = 10.0  # s at least that a fault of this loop stays in the status lines
TRAIL = 200  # states that a trail goes back
LOOK_ROUND = 1.0  # s between two looks at the sizes of all canvases
MOST_EXPORTS = 8  # pictures that may wait to be drawn
RIGHT_WIDTH = 330.0  # pixels, of the main panel

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Drawn:
    """What is on the screen: a picture and the state that it shows."""

    picture: Picture
    state: object


def serve(
    scene: Scene, host: str = "127.0.0.1", port: int = 8080, on_ready: Callable[[str], None] | None = None
) -> None:
    """Show a scene at http://host:port (0 takes a free port) until Ctrl-C.

    `on_ready` is called with the address as soon as a page can be opened; the simulation may still run then.
    Raises InputError (address, scene) and StorageError.
    """
    with Interrupt() as interrupt:
        server = open_server(host, port)
        closers: list[Callable] = [lambda: quietly(server.stop)]
        try:
            _dress(server, scene)
            if on_ready is not None:
                on_ready(address(host, server.get_port()))
            work = prepare(server, scene, closers, interrupt)
            if work is not None:
                Viewer(server, work, closers).run(interrupt)
        finally:
            for close in reversed(closers):
                close()


def _dress(server: viser.ViserServer, scene: Scene) -> None:
    """Theme and place of the main panel."""
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.gui.set_panel_label(f"fdcal · {scene.name}")
    server.gui.main_panel.dock_right()
    server.gui.main_panel.set_width(RIGHT_WIDTH)


def address(host: str, port: int) -> str:
    """The address to type into a browser on this machine."""
    name = "127.0.0.1" if host in ("", "0.0.0.0") else "[::1]" if host == "::" else f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}"


class Viewer:
    """The main loop and what it has shown so far."""

    def __init__(self, server: viser.ViserServer, work: Work, closers: list[Callable]):
        self._work, self._server = work, server
        self._stage = Stage(server)
        self._still: dict[bool, Picture] = {}
        self._maps, self._exports = Maps(work), LatestWorker(self._export, "fdcal-export", MOST_EXPORTS)
        closers += [lambda: self._maps.close(0.5), lambda: self._exports.close(0.1)]
        modes = usable_modes(work.problem, work.scene.solver.order_offset)
        self._controls = Controls(
            server.gui, work.session, work.measurement, modes, work.scene.solver.weights,
            self._stage.place, self._ask_for_export,
        )  # fmt: skip
        self._side = SidePanel(server.gui, self._controls.desk, work.problem, self._controls.map)
        self._spreads = Spreads(work)
        closers.append(lambda: self._spreads.close(0.5))
        self._fault, self._fault_time, self._looked = "", 0.0, 0.0
        self._followed = self._controls.choices.microphone
        self._turn, self._state = 0, work.session.view.state
        self._key: tuple = ()  # of what is drawn
        self._drawn = Drawn(self._compose(self._state, self._controls.choices, self._followed, None), self._state)
        picture = self._drawn.picture
        self._hands = Hands(server, self._controls.desk, picture, self._controls.map.pick)
        self._stage.open_at(picture)
        self._stage.show(picture)
        self._welcome(server)

    def _welcome(self, server: viser.ViserServer) -> None:
        """Each page gets a camera that fits its canvas, whose size is only known once the panels stand."""

        @server.on_client_connect
        async def _(client: viser.ClientHandle) -> None:
            self._stage.place(client, "top")

            @client.camera.on_update
            async def _(_) -> None:
                self._stage.keep_placed(client)

        @server.on_client_disconnect
        async def _(client: viser.ClientHandle) -> None:
            self._stage.forget(client)
            self._hands.forget(client.client_id)

    def run(self, interrupt: Interrupt) -> None:
        """Copy the newest state to the screen until interrupted."""
        due = time.perf_counter()
        while not interrupt.came:
            self._guarded_tick(time.perf_counter())
            due = max(due + 1 / RATE, time.perf_counter())
            time.sleep(max(due - time.perf_counter(), 0.0))

    def _guarded_tick(self, now: float) -> None:
        """A fault of this loop is logged once and told in the status lines; the page lives on."""
        try:
            self.tick(now)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if text != self._fault:
                log.exception("the page could not be brought up to date")
            self._fault, self._fault_time = text, now
            with contextlib.suppress(Exception):
                self._controls.bar.report(self._work.session.view, text)
        else:
            if now - self._fault_time > FAULT_SHOWN:
                self._fault = ""

    def tick(self, now: float) -> None:
        """Bring the screen up to date once."""
        view, choices = self._work.session.view, self._controls.choices
        if view.state is not self._state:
            self._turn, self._state = self._turn + 1, view.state
        follow = choices.follow and view.running and choices.shown
        if follow or not choices.follow or view.state.moved < 0:
            self._followed = choices.microphone if not choices.follow else self._followed
        else:
            self._followed = view.state.moved
        drawn, trouble = self._map(view, choices, follow, now)
        if follow and drawn is not None:
            self._followed = drawn.request.microphone  # a running solver is faster than its maps
        floor = drawn.floor if drawn else None
        errors = self._spreads.of(view.state, view.running, now)
        if self._key != (key := (self._turn, choices, self._followed, id(floor), id(errors))):
            picture = self._compose(view.state, choices, self._followed, floor)
            self._drawn = Drawn(self._trace(picture, view, choices, floor, errors), view.state)
            self._stage.show(self._drawn.picture)
            self._hands.show(view.state.positions, floor)
            self._key = key
        self._controls.show(view, self._followed, drawn, trouble, self._fault)
        self._side.show(view, drawn, self._followed, errors, now)
        if now - self._looked > LOOK_ROUND:
            self._looked = now
            self._stage.keep_all_placed(self._server.get_clients().values())

    def _map(self, view, choices: Choices, follow: bool, now: float) -> tuple[Map | None, str]:
        """The map to show, and why there is none."""
        if not choices.shown:
            return None, ""
        state = view.state
        modes = choices.modes or tuple(range(state.first, state.last + 1))
        microphone = state.moved if follow and state.moved >= 0 else self._followed
        wanted = MapRequest(
            self._turn, microphone, modes, choices.modes is not None, choices.look, follow, state, view.history.lineage
        )
        return self._maps.newest(wanted, view.running, now)

    def _compose(self, state, choices: Choices, microphone: int, floor: Floor | None) -> Picture:
        dark, measurement = choices.look.dark, self._work.measurement
        if floor is not None and floor.heights is not None:
            still = backdrop(self._work.scene, measurement, dark, floor)
        else:
            if dark not in self._still:
                self._still[dark] = backdrop(self._work.scene, measurement, dark)
            still = self._still[dark]
        return with_floor(with_estimate(still, measurement, state.positions, microphone, floor), floor)

    def _trace(self, picture: Picture, view, choices: Choices, floor: Floor | None, errors: Errors | None) -> Picture:
        """The picture with trails and error ellipses where they are wanted."""
        if choices.trails:
            past = view.history[max(view.index + 1 - TRAIL, 0) : view.index + 1]
            picture = with_trails(picture, np.array([state.positions for state in past]), floor)
        if choices.ellipses and errors is not None:
            picture = with_ellipses(picture, view.state.positions, errors.axes, floor)
        return picture

    def _ask_for_export(self, client: viser.ClientHandle, choices: Choices) -> None:
        """On viser's loop: what is drawn now, with a title that tells of just that."""
        if self._exports.full:
            client.add_notification("Too many pictures are waiting", "Try again in a moment.", color="red")
            return
        drawn, measurement = self._drawn, self._work.measurement
        state = drawn.state
        modes = words.modes_text(measurement, state.first, state.last)
        title = f"{self._work.scene.title}: step {state.step}, {modes}\n{headline(measurement, state.positions)}"
        client.add_notification(
            "Drawing the picture", "It is offered for download when it is done.", auto_close_seconds=4
        )
        self._exports.request(client, replace(drawn.picture, title=title), choices, f"fdcal-step-{state.step}.png")

    def _export(self, client: viser.ClientHandle, picture: Picture, choices: Choices, name: str) -> None:
        """On the exports' thread: the picture as a PNG for one page, drawn in a child process."""
        try:
            png = render_png(picture, choices.export_size, choices.export_view)
        except OSError as error:
            client.add_notification("No picture", str(error), color="red")
            return
        client.send_file_download(name, png, save_immediately=True)
