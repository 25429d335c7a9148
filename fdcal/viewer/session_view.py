"""One session on the screen: its newest state, the map, the verdict and the tabs.

Three threads share no mutable data. viser's event loop checks the messages of clients and puts commands on the
session's queue, the solver thread publishes frozen states, and the main thread shows the newest state here.
"""

import contextlib
import logging
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import viser

from ..assessment.findings import root_mean_square
from ..assessment.uncertainty import confidence_factor, ellipse_axes
from ..assessment.words import count_label
from ..graphics import picture as pictures
from ..graphics.primitives import Picture
from ..graphics.snapshot import legend_of
from ..graphics.volume import brightened
from ..model.settings import search_around
from ..model.validation import Reals, length_text
from ..session.calibration_run import Assessment, assess_state, healthy_microphones
from ..session.process import one_blas_thread
from ..session.session import SessionView
from ..session.sources import CalibrationInput, OpenRequest
from ..session.worker import Flag, Memo, Scheduler
from ..solvers.interface import RunState
from .cost_maps import CostMap, CostMapRequest, CostMapWorker
from .drop import Drop, MicrophonePicker, MovingMicrophone
from .html import CONTROLS, canvas_legend
from .panels import Panels, Tabs
from .prepare import DisplayFrame, PreparedRun, SessionSwitcher, Then
from .scene3d import SceneNodes
from .state import Binding, Choices, PageState


def ellipses_of(found: Assessment | None, frame: DisplayFrame | None = None, positions: Any = None) -> Reals | None:
    """Return the half axes of the 95 % ellipses at the end of a run; None before it, or if they are unknown.

    `found` is the assessment of the state on the screen, or None; `frame` is the frame in which the page draws the
    `positions` of the state.
    """
    if found is None or not np.isfinite(found.covariance).all():
        return None
    axes = ellipse_axes(found.covariance, confidence_factor(0.95, found.covariance.shape[-1]))
    return axes if frame is None else frame.axes(positions, axes)


VERDICT_DELAY = 0.3  # s without a change before the verdict is computed


class VerdictWorker:
    """Assesses the end of a run on a thread of the session."""

    def __init__(self, run: PreparedRun, threads: Scheduler):
        self._run, self._state, self._since = run, None, 0.0
        self._requested: RunState | None = None  # compared by identity
        self._lineage, self._sought = None, run.sought  # those of the last verdict
        self._worker = threads.worker(self._compute)

    def of(self, view: SessionView, now: float) -> tuple[Assessment | None, bool, np.ndarray]:
        """Return the assessment of the shown state, whether it is still expected, and the microphones to average over.

        The assessment is None before the end of a run. Errors are averaged over the microphones that are sought, except
        those whose channels the last assessment of this run found faulty. `now`: time, s.
        """
        state = view.state
        if state is not self._state:
            self._state, self._since = state, now
        if state.finished and now - self._since > VERDICT_DELAY and not view.running and state is not self._requested:
            self._requested = state
            self._worker.request(state)
        latest = self._worker.latest
        latest = None if latest is None or latest.request[0] is not state else latest
        found = None if latest is None else latest.result
        if found is not None or view.lineage is not self._lineage:
            self._lineage = view.lineage
            self._sought = healthy_microphones(self._run.sought, self._run.measurement.names, found)
        return found, latest is None and state.finished and not view.running, self._sought

    def _compute(self, state: RunState) -> Assessment:
        run = self._run
        inputs = CalibrationInput(run.scene.name, run.known_scene, run.measurement, state.settings, state.seed)
        with one_blas_thread():
            return assess_state(inputs, run.problem, state, CONTROLS)


TRAIL_STATES = 200  # largest number of states over which a trail extends


class SessionPicture:
    """Draws the states of a session.

    `frame` is the frame in which the states are drawn; `places` (N, D) float64, metres, are the positions that were
    drawn last; `ball` is the microphone that was drawn as a ball, or None.
    """

    def __init__(self, run: PreparedRun, frame: DisplayFrame):
        self._run, self._frame = run, frame
        start = frame.positions(run.session.view.history[0].positions)
        measured = run.measurement
        shown = [start, np.reshape(measured.known_positions, (-1, start.shape[1]))]
        if measured.positions is not None and not measured.blind:
            shown.append(measured.positions)
        # a search domain for pictures only, if the measurement has none; the solver must not use it
        self._measurement = replace(measured, search=search_around(np.concatenate(shown), measured.search))
        self.places, self.ball = start, None
        self._static = Memo()

    def draw(self, page: PageState, moving: MovingMicrophone | None = None) -> Picture:
        """Return the picture of a state; `moving`: a microphone that is dragged or rolls, or None."""
        view, choices, microphone, found, axes = page.view, page.choices, page.microphone, page.found, page.axes
        floor, volume = (None, None) if page.drawn is None else (page.drawn.floor, page.drawn.volume)
        self.ball = None
        self.places = positions = np.array(view.state.positions, float)
        if moving is not None:
            positions[moving.microphone, : len(moving.place)] = moving.place
        scene, measurement = self._run.known_scene, self._measurement
        relief = None if floor is None or floor.heights is None else floor  # the true microphones stand on it
        style = choices.dark, relief, choices.lecture
        static = self._static(lambda: pictures.static_picture(scene, measurement, *style), *style)
        truth = measurement.positions  # an array without known microphones is moved onto them
        picture = pictures.with_estimate(static, measurement, positions, microphone, floor, truth, choices.marks)
        picture = pictures.with_volume(pictures.with_floor(picture, floor), volume)
        if moving is not None and moving.microphone == microphone:
            self.ball = microphone
            picture = pictures.with_ball(picture, moving.place, floor, moving.path, moving.text)
        elif (floor or volume) and microphone not in self._run.problem.known:
            self.ball = microphone
            picture = pictures.with_ball(picture, positions[microphone], floor)
        if choices.trails:
            past = view.history[max(view.index + 1 - TRAIL_STATES, 0) : view.index + 1]
            paths = np.array([self._frame.positions(state.positions) for state in past])
            picture = pictures.with_trails(picture, paths, floor)
        faults = () if found is None else found.channels.faults
        faulty = [measurement.names.index(fault.name) for fault in faults]
        if choices.ellipses and found is not None and axes is not None:
            extent = max(picture.focus[2] - picture.focus[0], picture.focus[3] - picture.focus[1])
            healthy = np.setdiff1d(every := np.arange(len(axes)), [*self._run.problem.known, *faulty])
            sigma = root_mean_square(found.uncertainty[healthy if len(healthy) else every])  # as in the verdict
            note, scale = f"one sigma {length_text(sigma, 2)}", pictures.ellipse_scale(axes, extent)
            picture = pictures.with_ellipses(picture, positions, axes, floor, scale, note)
        if axes is not None:
            picture = pictures.with_faulty_channels(picture, positions, faulty, floor)
        return picture


LEVEL = 1.0  # dB; if the costs of a map differ by less, all positions fit about equally well
RUN_INTERVAL = 0.15  # s, least time between two states that are shown while the solver runs
MOVE_TIME = 0.8  # s for which the move of one microphone is drawn
FAULT_TIME = 10.0  # s, least time for which an exception of the page stays in the status lines

log = logging.getLogger(__name__)


class PageParts(Protocol):
    """The parts of the page (`fdcal.viewer.page.Page`) that a session, the lessons and Explore use."""

    server: viser.ViserServer
    nodes: SceneNodes
    panels: Panels
    switcher: SessionSwitcher
    wake: Flag
    viewer: "Viewer | None"

    def open(self, request: OpenRequest, then: Then = ...) -> None: ...


class Viewer:
    """Owns the controls, the background threads and the picture of one session.

    The panels of `page` hold the controls, and its nodes show the picture; `before` are the choices of the session that
    was shown before, or None. InputError if the request of the run has choices that are not possible.

    `view` has the states that are shown; `snapshot` is the state of the page on the screen; `drawn` keeps the picture
    until something changes; `found` is the assessment of the state, or None; `wanted` is the request for the map of the
    state, or None; `fault` is the last exception of the page, as long as the status lines show it.
    """

    def __init__(self, page: PageParts, run: PreparedRun, before: Choices | None = None):
        self.run, self._page, self._server, panels = run, page, page.server, page.panels
        modes = run.solver.usable_modes(run.problem, run.scene.solver)
        call = self._server.get_event_loop().call_soon_threadsafe
        self.binding = Binding(panels.gui, run, modes, page.open, before, page.wake.set, call)
        self.fault, self._fault_time = "", 0.0
        self.view, self._viewed, self._costs = run.session.view, 0.0, -1  # view, its time, number of costs
        self._revision, self._state = 0, run.session.view.state  # number of states shown so far, the last one
        self._selected = self.binding.choices.microphone  # the microphone of the map
        # position from which the last step has moved a microphone, and the time of the step
        self._moved: tuple[np.ndarray, float] | None = None
        self.drawn, self._volume, self._ellipses = Memo(), Memo(), Memo()
        self.wanted: CostMapRequest | None = None
        self.found: Assessment | None = None
        try:
            binding, choices = self.binding, self.binding.choices
            self._picture = SessionPicture(run, binding.frame)
            view = binding.frame.view(run.session.view)
            self.snapshot = PageState(view, microphone=self._selected, run=run, choices=choices)
            picture = self._picture.draw(self.snapshot)
            self.snapshot = replace(self.snapshot, picture=picture)
            # The order of creation is the priority of the work on the threads.
            self.drop = Drop(binding, panels.overlay)
            self._verdict, self.maps = VerdictWorker(run, binding.threads), CostMapWorker(run, binding.threads)
            self.tabs = Tabs(panels, binding, page.nodes.cameras.request)
            self.tabs.run_bar.refresh()
            page.nodes.show(picture)
            self.picker = MicrophonePicker(self._server, binding, picture, self.drop)
            binding.threads.session, run.session.notify = run.session, page.wake.set
        except BaseException:
            self.binding.remove()
            self.binding.threads.close(0.0)
            raise

    @property
    def changing(self) -> bool:
        """Whether the screen is outdated, or will change without an action of a user."""
        view = self.run.session.view
        outdated = view is not self.view or view.costs.count != self._costs  # costs are added while the solver rests
        return outdated or view.running or self.tabs.sweep.playing is not None

    def guarded_tick(self, now: float) -> None:
        """`tick`; an exception is logged once and shown in the status lines, and the page continues."""
        try:
            self.tick(now)
        except Exception as error:
            text = f"{type(error).__name__}: {error}"
            if text != self.fault:
                log.exception("the page could not be updated")
            self.fault, self._fault_time = text, now
            with contextlib.suppress(Exception):
                self.tabs.run_bar.show_status(PageState(self.run.session.view, fault=text, run=self.run))
        else:
            if now - self._fault_time > FAULT_TIME:
                self.fault = ""

    def tick(self, now: float) -> None:
        """Bring the screen up to date at the time `now`, s."""
        choices, tabs, frame, newest = self.binding.choices, self.tabs, self.binding.frame, self.run.session.view
        running = newest.running and self.view.running
        stepped = newest.lineage is self.view.lineage  # else a user has changed the state, which is shown at once
        if not (running and stepped and 0 < now - self._viewed < RUN_INTERVAL):  # leaves processor time to the solver
            self.view, self._viewed, self._costs = newest, now, newest.costs.count
        newest = self.view
        found, assessing, sought = self._verdict.of(newest, now)
        if not choices.verdict:  # in a lesson that does not assess the result
            found, assessing, sought = None, False, self.run.sought
        if not np.array_equal(sought, frame.by):
            frame.by = sought
        view = frame.view(newest)
        if view.state is not self._state:
            one_moved = view.state.moved >= 0 and view.state.step == self._state.step + 1
            self._moved = (np.asarray(self._state.positions)[view.state.moved], now) if one_moved else None
            self._revision, self._state = self._revision + 1, view.state
        move = self._move(view, now)
        drawn, reason = self._select_map(view, choices, now, move is not None)
        if drawn is not None and drawn.volume is not None and choices.dark:
            drawn = self._volume(lambda: replace(drawn, volume=brightened(drawn.volume)), drawn)
        self.found = found
        axes = self._ellipses(lambda: ellipses_of(found, frame, newest.state.positions), found)
        state = PageState(
            view, now, self._revision, self._selected, drawn, reason, self.snapshot.picture, self.fault, found,
            axes, assessing, sought, self.run, choices,
        )  # fmt: skip
        with self._server.atomic():  # the costs beside the microphone and in large words change together
            self.snapshot = self._draw(state, self.drop.tick(newest, drawn, now) or move)
        tabs.show(self.snapshot)

    def _draw(self, state: PageState, moving: MovingMicrophone | None) -> PageState:
        """Draw the picture again if anything in it has changed; return the state with its picture."""
        choices, drawn, awaited = state.choices, state.drawn, "" if state.drawn is not None else state.reason
        if self.wanted is not None and drawn is None and not awaited:
            modes = count_label(self.run.measurement, self.wanted.modes)
            awaited = f"Computing the map of microphone {self.wanted.microphone}: {modes} ..."
        parts = *((None, None) if drawn is None else (drawn.floor, drawn.volume)), state.found, state.axes
        parts = state.revision, choices, state.microphone, moving, awaited, *parts
        if (picture := self.drawn.get(*parts)) is None:
            picture = self._picture.draw(state, moving)
            self._page.nodes.show(picture)
            legend = canvas_legend(picture.bar, legend_of(picture), self._hint(picture) or awaited)
            self._page.panels.overlay.show("legend", legend)
            self.picker.show(self._picture.places, picture.floor, self._picture.ball)
            self.drawn.keep(picture, *parts)
        return replace(state, picture=picture)

    def _hint(self, picture: Picture) -> str:
        """Return how to read a map of the cost, or why there is no map; "" in other cases."""
        if self.run.problem.search is None:
            return "No map: the file of this measurement has no search domain."
        if picture.bar is None or picture.bar.label.startswith("pressure"):
            return ""
        if "(dB)" in picture.bar.label and picture.bar.high - picture.bar.low < LEVEL:
            return "The map is almost level: all positions fit this microphone's recording about equally well."
        low = "low and dark" if picture.floor is not None and picture.floor.heights is not None else "dark"
        return f"Where the map is {low}, the position fits the recording of this microphone."

    def _move(self, view: SessionView, now: float) -> MovingMicrophone | None:
        """Return the microphone that the last step moved while it is drawn on its way; None once it has arrived."""
        if self._moved is None:
            return None
        (start, since), end, n = self._moved, np.asarray(view.state.positions)[view.state.moved], view.state.moved
        fraction = (now - since) / (RUN_INTERVAL if view.running else MOVE_TIME)
        if fraction >= 1:
            self._moved = None
            return None
        at, moved = start + fraction * (end - start), length_text(float(np.linalg.norm(end - start)), 2)
        return MovingMicrophone(n, tuple(at.tolist()), f"moves by {moved}", np.stack([start, end]))

    def _select_map(
        self, view: SessionView, choices: Choices, now: float, moving: bool = False
    ) -> tuple[CostMap | None, str]:
        """Select the microphone of the map; return the map, or None and the reason why there is none.

        If the map follows the solver, the microphone is the one that the next step moves or, while the move of the last
        step is drawn, the one that this step moved. While the solver runs, maps are slower than steps, and the
        microphone is that of the newest map.
        """
        following = choices.follow and view.running and choices.kind != "none"
        if not choices.follow:
            self._selected = choices.microphone
        elif not following:
            upcoming = -1 if moving else view.state.next_microphone(self.run.problem)
            upcoming = view.state.moved if upcoming < 0 else upcoming
            self._selected = self._selected if upcoming < 0 else upcoming
        if choices.kind == "none" or self.run.problem.search is None:
            self.wanted = None
            return None, ""
        microphone = view.state.moved if following and view.state.moved >= 0 else self._selected
        self.wanted = wanted = choices.map_request(self.run, view, microphone, self._revision, following)
        drawn, reason = self.tabs.sweep.map_for(wanted, *self.maps.newest(wanted, view.running, now))
        if following and drawn is not None:
            self._selected = drawn.request.microphone
        return drawn, reason
