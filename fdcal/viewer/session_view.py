"""One session on the screen: the newest state is copied there by the main loop, with its map and its curves.

Three owners share nothing that changes: viser's loop bounds what clients send and puts commands on the session's
queue, the solver thread publishes frozen states, and the main thread, here, copies the newest of them to the screen.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import viser

from ..graphics.framing import with_display_domain
from ..graphics.overlays import with_comparison, with_ellipses, with_trails
from ..graphics.picture import static_picture, with_estimate, with_floor
from ..graphics.primitives import Floor, Picture
from ..session.request import OpenRequest
from .background.comparison import ComparisonWorker
from .background.cost_maps import CostMap, CostMapRequest, CostMapWorker
from .background.exports import Exports, ViewSnapshot
from .background.prepare import PreparedRun
from .background.uncertainty import PositionUncertainty, UncertaintyWorker
from .gui.binding import Binding, Choices
from .gui.layout import SessionFolders
from .main_panel import MainPanel
from .scene3d.nodes import SceneNodes
from .scene3d.picking import MicrophonePicker
from .side_panel import SidePanel

FAULT_SHOWN = 10.0  # s at least that a fault of the page stays in the status lines
TRAIL = 200  # states that a trail goes back

log = logging.getLogger(__name__)


def most_modes(work: PreparedRun) -> int:
    """Return how many modes can be in use."""
    return work.solver.usable_modes(work.problem, work.scene.solver)


class Viewer:
    """One session on the screen: its controls, and what has been shown of it so far."""

    def __init__(
        self,
        server: viser.ViserServer,
        work: PreparedRun,
        folders: SessionFolders,
        nodes: SceneNodes,
        open_other: Callable[[OpenRequest], None] = lambda opening: None,
        before: Choices | None = None,
        hasten: Callable[[], None] = lambda: None,
    ):
        self._work, self._nodes, self._folders = work, nodes, folders
        modes = most_modes(work)
        self.binding = Binding(folders.gui, work, modes, open_other, before, hasten)
        self._still: dict[bool, Picture] = {}
        self._veiled: tuple = (None, 1.0, None)  # a map, the opacity it is shown with, and the map with that
        self._fault, self._fault_time = "", 0.0
        self._followed = self.binding.choices.microphone
        self._revision, self._state = 0, work.session.view.state
        self._key: tuple = ()  # of what is drawn
        self._drawable = with_display_domain(work.measurement, np.asarray(work.session.view.history[0].positions))
        picture = self._compose(self._state, self.binding.choices, self._followed, None)
        self.snapshot = ViewSnapshot(work, picture, work.session.view, self.binding.choices, self._followed, None)
        self.main_panel = MainPanel(self._folders, self.binding, nodes.cameras.ask, self._export)
        self._comparison = ComparisonWorker(work)
        self.side_panel = SidePanel(self._folders, self.binding, work.problem, self.main_panel.map, self._comparison)
        self._maps = CostMapWorker(work, hasten)  # threads last: what is above may refuse
        self._uncertainty = UncertaintyWorker(work)
        self._exports = Exports()
        nodes.show(self.snapshot.picture)
        name = f"/picking/{folders.number}"
        self._picker = MicrophonePicker(server, self.binding, self.snapshot.picture, self.main_panel.map.pick, name)

    @property
    def picture(self) -> Picture:
        """What is on the screen."""
        return self.snapshot.picture

    def redraw(self) -> None:
        """Draw everything anew with the next tick."""
        self._key = ()

    def forget(self, client: viser.ClientHandle) -> None:
        """A page has closed."""
        self._picker.forget(client.client_id)

    def take_down(self) -> None:
        """Take away what the panels show of this session; in the scene another one takes its place."""
        self._picker.remove()
        self._folders.remove()

    def close(self, timeout: float = 1.0) -> None:
        """End the threads after what they are at; all together in no more than `timeout`, s."""
        owners, end = (
            (self._maps, self._uncertainty, self._comparison, self.side_panel.map_grid, self._work.session),
            time.perf_counter() + timeout,
        )
        if self._work.warmup is not None:
            self._work.warmup.close(0.0)
        for owner in (*owners, self._exports):  # all are asked to stop before any is waited for
            owner.close(0.0)
        for owner in owners:
            owner.close(max((end - time.perf_counter()) / 2, 0.0))  # some are two threads

    def guarded_tick(self, now: float) -> None:
        """A fault of this loop is logged once and told in the status lines; the page lives on."""
        try:
            self.tick(now)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if text != self._fault:
                log.exception("the page could not be brought up to date")
            self._fault, self._fault_time = text, now
            with contextlib.suppress(Exception):
                self.main_panel.bar.report(self._work.session.view, text)
        else:
            if now - self._fault_time > FAULT_SHOWN:
                self._fault = ""

    def tick(self, now: float) -> None:
        """Bring the screen up to date once."""
        view, choices = self._work.session.view, self.binding.choices
        if view.state is not self._state:
            self._revision, self._state = self._revision + 1, view.state
        follow = choices.follow and view.running and choices.shown
        if follow or not choices.follow or view.state.moved < 0:
            self._followed = choices.microphone if not choices.follow else self._followed
        else:
            self._followed = view.state.moved
        drawn, trouble = self._map(view, choices, follow, now)
        if follow and drawn is not None:
            self._followed = drawn.request.microphone  # a running solver is faster than its maps
        floor = self._seen_through(drawn.floor, choices.look.opacity) if drawn else None
        errors = self._uncertainty.of(view.state, view.running, now)
        runners = self._comparison.update(now)
        marked = self.side_panel.race.marked(runners)
        if self._key != (key := (self._revision, choices, self._followed, id(floor), id(errors), id(marked))):
            picture = self._compose(view.state, choices, self._followed, floor)
            picture = self._trace(picture, view, choices, floor, errors)
            placed = {runner.name: runner.positions for runner in marked}
            picture = with_comparison(picture, placed, self._work.problem.free, floor)
            sigma = None if errors is None else errors.sigma
            self.snapshot = ViewSnapshot(self._work, picture, view, choices, self._followed, sigma)
            self._nodes.show(self.snapshot.picture)
            self._picker.show(view.state.positions, floor)
            self._key = key
        compiling = self._work.warmup.text if self._work.warmup else ""
        self.main_panel.show(view, self._followed, drawn, trouble, self._fault, compiling)
        self.side_panel.show(view, drawn, self._followed, errors, now)
        self.side_panel.race.show(runners, now)

    def _map(self, view, choices: Choices, follow: bool, now: float) -> tuple[CostMap | None, str]:
        """The map to show, and why there is none."""
        if not choices.shown or self._work.problem.search is None:
            return None, ""
        state = view.state
        modes = choices.modes or tuple(range(state.first, state.last + 1))
        microphone = state.moved if follow and state.moved >= 0 else self._followed
        look = replace(choices.look, opacity=1.0)  # which needs no other map
        wanted = CostMapRequest(
            self._revision, microphone, modes, choices.modes is not None, look, follow, state, view.history.lineage
        )
        return self._maps.newest(wanted, view.running, now)

    def _seen_through(self, floor: Floor, opacity: float) -> Floor:
        """A map with the opacity that is wanted."""
        if self._veiled[0] is not floor or self._veiled[1] != opacity:
            self._veiled = floor, opacity, replace(floor, opacity=opacity)
        return self._veiled[2]

    def _compose(self, state, choices: Choices, microphone: int, floor: Floor | None) -> Picture:
        dark, measurement = choices.look.dark, self._drawable
        if floor is not None and floor.heights is not None:
            still = static_picture(self._work.known_scene, measurement, dark, floor)
        else:
            if dark not in self._still:
                self._still[dark] = static_picture(self._work.known_scene, measurement, dark)
            still = self._still[dark]
        return with_floor(with_estimate(still, measurement, state.positions, microphone, floor), floor)

    def _trace(
        self, picture: Picture, view, choices: Choices, floor: Floor | None, errors: PositionUncertainty | None
    ) -> Picture:
        """The picture with trails and error ellipses where they are wanted."""
        if choices.trails:
            past = view.history[max(view.index + 1 - TRAIL, 0) : view.index + 1]
            picture = with_trails(picture, np.array([state.positions for state in past]), floor)
        if choices.ellipses and errors is not None:
            picture = with_ellipses(picture, view.state.positions, errors.axes, floor)
        return picture

    def _export(self, client: viser.ClientHandle, kind: str) -> None:
        """On viser's loop: a file of what is drawn now."""
        self._exports.ask(client, kind, replace(self.snapshot, choices=self.binding.choices))
