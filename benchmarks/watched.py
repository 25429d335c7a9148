"""Run `fdcal view` and log when the effect of a client's message is published to the pages.

A program: python -m benchmarks.watched LOG view SCENE ...

A line of LOG is JSON: the time (s of `time.perf_counter`), the event, and a value. "received" is when a slider's
message comes in, before any callback; "shown" when the main loop has published what it asks for; "turn" a turn of the
main loop while the solver runs; "map" a new map, with its number of modes and points; "moved" a message of a mouse that
drags a microphone.

On SIGUSR1 a microphone is dragged for DRAG seconds, from "drag" to "dropped", with MOVES_PER_SECOND moves per second.
"""

import json
import math
import signal
import sys
import threading
import time
from typing import Any

import viser

from fdcal.commands.cli import main
from fdcal.viewer.drop import MicrophonePicker
from fdcal.viewer.page import Page
from fdcal.viewer.panels import SolverTab
from fdcal.viewer.session_view import Viewer
from fdcal.viewer.tabs.map import MapTab

DRAG, MOVES_PER_SECOND = 6.0, 60  # s, 1/s


class Watch:
    """Notes what happens; `waits` are the effects still to be seen, by their slider."""

    def __init__(self, path: str):
        self._file, self._came, self.waits, self._floor = open(path, "w"), 0.0, {}, None
        self.page: Any = None

    def note(self, what: str, value=None, at: float | None = None) -> None:
        self._file.write(json.dumps([time.perf_counter() if at is None else at, what, value]) + "\n")
        self._file.flush()

    def came(self) -> None:
        self._came = time.perf_counter()

    def ask(self, slider: str, reached) -> None:
        """Note a slider's message, whose effect is published as soon as `reached(viewer)` is true."""
        self.waits[slider] = reached
        self.note("received", slider, self._came)

    def look(self, viewer: Viewer) -> None:
        """Note which effects are published; called after a tick of the main loop."""
        for slider, reached in list(self.waits.items()):
            if reached(viewer) and self.waits.get(slider) is reached:
                self.waits.pop(slider)
                self.note("shown", slider)
        floor = viewer.snapshot.picture.floor
        if floor is not None and floor is not self._floor:
            self.note("map", [len(viewer.binding.choices.modes or ()), int(floor.rgb.shape[0])])
        self._floor = floor

    def drag(self, *_) -> None:
        threading.Thread(target=self._drag, daemon=True).start()

    def _drag(self) -> None:
        binding, gesture = self.page.viewer.binding, object()
        state, start = binding.session.view.state, time.perf_counter()
        moved = next(n for n in binding.run.problem.free if n != binding.choices.microphone)
        x, y = state.positions[moved][:2]
        self.note("drag")
        while (t := time.perf_counter() - start) < DRAG:
            binding.session.place(int(moved), (x + 0.1 * math.sin(3 * t), y + 0.1 * math.cos(3 * t)), gesture)
            time.sleep(1 / MOVES_PER_SECOND)
        self.note("dropped")


def watch(log: Watch) -> None:
    """Replace functions of the program by ones that also note events."""
    before, viewer_tick, page_tick = viser._gui_api.GuiApi._handle_gui_updates, Viewer.tick, Page.tick

    async def handle(self, client_id, message):
        log.came()
        await before(self, client_id, message)

    def watched_viewer_tick(self, now):
        viewer_tick(self, now)
        log.look(self)

    def watched_page_tick(self, now):
        log.page = self
        page_tick(self, now)
        if self.viewer is not None and self.viewer.binding.session.view.running:
            log.note("turn")

    viser._gui_api.GuiApi._handle_gui_updates = handle
    Viewer.tick, Page.tick = watched_viewer_tick, watched_page_tick
    _watch_sliders(log)


def _watch_sliders(log: Watch) -> None:
    use, choose = SolverTab.use_modes, MapTab.pick
    drag = MicrophonePicker._drag

    def watched_drag(self, event, move):
        log.note("moved")
        drag(self, event, move)

    def use_modes(self, first: int, last: int, automatic: bool | None = None) -> None:
        log.ask("Last freq.", lambda viewer: viewer.snapshot.view.state.last == last)
        use(self, first, last, automatic)

    def pick(self, number: int) -> None:
        log.ask(
            "Microphone",
            lambda viewer: viewer.snapshot.microphone == number and viewer.snapshot.picture.floor is not None,
        )
        choose(self, number)

    SolverTab.use_modes, MapTab.pick = use_modes, pick
    MicrophonePicker._drag = watched_drag


if __name__ == "__main__":
    log = Watch(sys.argv[1])
    watch(log)
    signal.signal(signal.SIGUSR1, log.drag)
    sys.argv = ["fdcal", *sys.argv[2:]]
    main()
