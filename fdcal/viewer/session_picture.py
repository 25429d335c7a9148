"""The picture of one session: what never moves is kept, the rest is drawn over it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..graphics.framing import with_display_domain
from ..graphics.overlays import with_comparison, with_ellipses, with_odd_channels, with_trails
from ..graphics.picture import static_picture, with_estimate, with_floor
from ..graphics.primitives import Floor, Picture
from ..session.history import SessionView
from .background.comparison import RunSummary
from .background.prepare import PreparedRun
from .background.uncertainty import PositionUncertainty
from .gui.choices import Choices

TRAIL_STATES = 200  # states over which a trail extends


class SessionPicture:
    """Draws the states of a session."""

    def __init__(self, run: PreparedRun):
        self._run = run
        start = np.asarray(run.session.view.history[0].positions)
        self._measurement = with_display_domain(run.measurement, start)
        self._static: dict[bool, Picture] = {}  # by whether the page is dark
        self._faded: tuple[Floor, Floor] | None = None  # a map, and the same with another opacity

    def draw(
        self,
        view: SessionView,
        choices: Choices,
        microphone: int,
        floor: Floor | None = None,
        uncertainty: PositionUncertainty | None = None,
        runs: tuple[RunSummary, ...] = (),
    ) -> Picture:
        """Return the picture of the state that is shown.

        Parameters
        ----------
        view : SessionView
        choices : Choices
        microphone : int, whose map is shown, counted from 0
        floor : the map, or None
        uncertainty : PositionUncertainty of the state, or None
        runs : of a comparison, whose estimates are marked

        Returns
        -------
        Picture
        """
        positions = view.state.positions
        static = self._static_picture(choices.style.dark, floor)
        picture = with_floor(with_estimate(static, self._measurement, positions, microphone, floor), floor)
        if choices.trails:
            past = view.history[max(view.index + 1 - TRAIL_STATES, 0) : view.index + 1]
            picture = with_trails(picture, np.array([state.positions for state in past]), floor)
        if choices.ellipses and uncertainty is not None:
            picture = with_ellipses(picture, positions, uncertainty.axes, floor)
        if uncertainty is not None and uncertainty.channels is not None:
            odd = {fault.name for fault in uncertainty.channels.faults}
            numbers = [n for n, name in enumerate(self._measurement.names) if name in odd]
            picture = with_odd_channels(picture, positions, numbers, floor)
        return with_comparison(picture, {run.name: run.positions for run in runs}, self._run.problem.free, floor)

    def _static_picture(self, dark: bool, floor: Floor | None) -> Picture:
        """Return what does not move; over a relief it follows the heights of the map."""
        scene, measurement = self._run.known_scene, self._measurement
        if floor is not None and floor.heights is not None:
            return static_picture(scene, measurement, dark, floor)
        if dark not in self._static:
            self._static[dark] = static_picture(scene, measurement, dark)
        return self._static[dark]

    def faded(self, floor: Floor, opacity: float) -> Floor:
        """Return a map with an opacity, 0 to 1; the same object for the same arguments as last time."""
        if self._faded is None or self._faded[0] is not floor or self._faded[1].opacity != opacity:
            self._faded = floor, replace(floor, opacity=opacity)
        return self._faded[1]
