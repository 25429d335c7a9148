"""One session on the screen: the main loop copies its newest state there, with the map and the curves.

Three threads share no mutable data: viser's event loop checks what clients send and puts commands on the session's
queue, the solver thread publishes frozen states, and the main thread copies the newest of them to the screen here.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import replace

import viser

from ..graphics.primitives import Picture
from ..session.calibrate import Assessment
from ..session.history import SessionView
from ..session.request import OpenRequest
from .background.comparison import ComparisonWorker
from .background.cost_maps import CostMap, CostMapWorker
from .background.exports import Exports
from .background.map_panels import map_modes
from .background.map_request import CostMapRequest
from .background.prepare import PreparedRun
from .background.uncertainty import PositionUncertainty, uncertainty_of
from .background.verdict import VerdictWorker
from .background.view_snapshot import ViewSnapshot
from .canvas_panel import CanvasPanel
from .gui.binding import Binding
from .gui.choices import Choices
from .gui.layout import SessionFolders
from .main_panel import MainPanel
from .scene3d.line_handles import LineHandles
from .scene3d.nodes import SceneNodes
from .scene3d.picking import MicrophonePicker
from .session_picture import SessionPicture
from .side_panel import SidePanel

FAULT_TIME = 10.0  # s at least that a fault of the page stays in the status lines

log = logging.getLogger(__name__)


class Viewer:
    """Owns the controls, the background threads and the picture of one session.

    `folders`: SessionFolders for the controls; `nodes`: SceneNodes that show the picture; `open_other`: function that
    opens another session in place of this one; `before`: Choices of the session that was shown before, or None; `wake`:
    function that makes the main loop update the page at once. Raises InputError: the request of the run has choices
    that are not possible. `snapshot`: what is on the screen; `call`: runs a function on viser's event loop.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        run: PreparedRun,
        folders: SessionFolders,
        nodes: SceneNodes,
        open_other: Callable[[OpenRequest], None] = lambda request: None,
        before: Choices | None = None,
        wake: Callable[[], None] = lambda: None,
    ):
        self.run, self.nodes, self._folders = run, nodes, folders
        modes = run.solver.usable_modes(run.problem, run.scene.solver)
        self.binding = Binding(folders.gui, run, modes, open_other, before, wake)
        self._fault, self._fault_time = "", 0.0
        self._revision, self._state = 0, run.session.view.state  # counts the states that were shown
        self._selected = self.binding.choices.microphone  # the microphone of the map
        self._key: tuple = ()  # of what is drawn
        self._picture = SessionPicture(run)
        picture = self._picture.draw(run.session.view, self.binding.choices, self._selected)
        self.snapshot = ViewSnapshot(run, picture, run.session.view, self.binding.choices, self._selected, None)
        self.main_panel = MainPanel(folders, self.binding, nodes.cameras.request, self.export)
        self.comparison = ComparisonWorker(run)
        self.call = server.get_event_loop().call_soon_threadsafe
        self.side_panel = SidePanel(folders, self.binding, self.main_panel.map, self.comparison, self.call)
        self.canvas = CanvasPanel(folders, self.binding, self.main_panel, picture)
        self.maps = CostMapWorker(run, wake)  # threads last: what is above may raise
        self._verdict, self.exports = VerdictWorker(run, wake), Exports()
        self._assessed: tuple[Assessment | None, PositionUncertainty | None] = None, None  # of the last verdict
        self.main_panel.run_bar.apply_rate()
        nodes.show(picture)
        name = f"/picking/{folders.number}"
        self._picker = MicrophonePicker(server, self.binding, picture, self.main_panel.map.pick, name)
        self._line_handles = LineHandles(server, self.binding, picture, f"/cut_handles/{folders.number}")

    @property
    def picture(self) -> Picture:
        """The picture on the screen."""
        return self.snapshot.picture

    @property
    def fault(self) -> str:
        """The last exception of the page, as long as the status lines show it."""
        return self._fault

    def redraw(self) -> None:
        """Draw everything again with the next tick."""
        self._key = ()

    def forget(self, client: viser.ClientHandle) -> None:
        """Forget a browser that has closed the page."""
        self._picker.forget(client.client_id)

    def take_down(self) -> None:
        """Remove the controls of this session; another session takes its place in the scene."""
        self._picker.remove()
        self._line_handles.remove()
        self._folders.remove()

    def close(self, timeout: float = 1.0) -> None:
        """End all threads after the work in progress; wait `timeout` at most, s."""
        owners = (
            self.maps,
            self._verdict,
            self.comparison,
            self.side_panel.maps.worker,
            self.side_panel.sweep.worker,
            self.side_panel.cut.worker,
            self.side_panel.plan.worker,
            self.run.session,
        )
        end = time.perf_counter() + timeout
        if self.run.warmup is not None:
            self.run.warmup.close(0.0)  # the switcher waits for a compilation
        for owner in (*owners, self.exports):  # all are asked to stop before any is waited for
            owner.close(0.0)
        for owner in owners:
            owner.close(max((end - time.perf_counter()) / 2, 0.0))  # some own two threads

    def guarded_tick(self, now: float) -> None:
        """`tick`; an exception is logged once and shown in the status lines, and the page continues."""
        try:
            self.tick(now)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if text != self._fault:
                log.exception("the page could not be updated")
            self._fault, self._fault_time = text, now
            with contextlib.suppress(Exception):
                self.main_panel.run_bar.show_status(self.run.session.view, text)
        else:
            if now - self._fault_time > FAULT_TIME:
                self._fault = ""

    def tick(self, now: float) -> None:
        """Bring the screen up to date at the time `now`, s."""
        view, choices = self.run.session.view, self.binding.choices
        self.canvas.fold(self.nodes.cameras)
        if view.state is not self._state:
            self._revision, self._state = self._revision + 1, view.state
        drawn, reason = self._select_map(view, choices, now)
        floor, volume = self._picture.faded_parts(drawn, choices.style)
        found = self._verdict.of(view.state, view.running, now)
        if found is not self._assessed[0]:
            self._assessed = found, uncertainty_of(found)
        uncertainty = self._assessed[1]
        runs = self.comparison.update(now)
        marked = self.side_panel.comparison.marked(runs)
        planned = self.side_panel.plan.planned
        drawn_ids = (id(part) for part in (floor, volume, uncertainty, marked, planned))
        key = self._revision, choices, self._selected, *drawn_ids
        sought = self._verdict.sought(view, found)
        if key != self._key:
            picture = self._picture.draw(view, choices, self._selected, floor, uncertainty, marked, volume, planned)
            sigma = None if uncertainty is None else uncertainty.sigma
            self.snapshot = ViewSnapshot(self.run, picture, view, choices, self._selected, sigma, volume, sought)
            self.nodes.show(picture)
            self.canvas.show_picture(picture)
            self._picker.show(self._picture.places, picture.floor)
            self._line_handles.show(choices.cut, floor)
            self._key = key
        note = self.run.warmup.text if self.run.warmup else ""
        self.main_panel.run_bar.announce(self.side_panel.sweep.note)
        self.main_panel.show(view, self._selected, drawn, reason, self._fault, note, found, sought)
        self.main_panel.view.show(view, self.picture)
        self.canvas.show(view, self._fault, note, found, sought)
        self.side_panel.show(view, self._revision, drawn, self._selected, uncertainty, runs, now, sought)

    def _select_map(self, view: SessionView, choices: Choices, now: float) -> tuple[CostMap | None, str]:
        """Select the microphone of the map; return the map, or None and the reason why there is none.

        The map follows the solver, if the user wants it to. A running solver is faster than its maps: then the
        microphone is that of the newest map.
        """
        following = choices.follow and view.running and choices.shown
        if not choices.follow:
            self._selected = choices.microphone
        elif not following and view.state.moved >= 0:
            self._selected = view.state.moved
        drawn, reason = self._newest_map(view, choices, following, now)
        if following and drawn is not None:
            self._selected = drawn.request.microphone
        return drawn, reason

    def _newest_map(
        self, view: SessionView, choices: Choices, following: bool, now: float
    ) -> tuple[CostMap | None, str]:
        if not choices.shown or self.run.problem.search is None:
            return None, ""
        state, order_offset = view.state, choices.map_order
        wanted = CostMapRequest(
            revision=self._revision,
            microphone=state.moved if following and state.moved >= 0 else self._selected,
            modes=map_modes(self.run, state, choices.modes, order_offset, choices.take),
            order_offset=order_offset,
            custom_modes=choices.modes is not None,
            style=replace(choices.style, opacity=1.0),  # another opacity needs no other map
            follow=following,
            state=state,
            lineage=view.history.lineage,
            take=choices.take,
        )
        drawn, reason = self.maps.newest(wanted, view.running, now)
        return self.side_panel.sweep.map_for(wanted, drawn, reason)

    def export(self, client: viser.ClientHandle, kind: str) -> None:
        """Send a file of what is on the screen to one browser; on viser's event loop."""
        self.exports.ask(client, kind, replace(self.snapshot, choices=self.binding.choices))
