"""The picture of one session: what never moves is kept, the rest is drawn over it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..assessment.findings import root_mean_square
from ..graphics.overlays import (
    ellipse_scale,
    with_bound,
    with_comparison,
    with_cut,
    with_ellipses,
    with_odd_channels,
    with_trails,
    with_volume,
)
from ..graphics.picture import static_picture, with_estimate, with_floor
from ..graphics.primitives import Floor, Picture
from ..graphics.surroundings import with_display_domain
from ..graphics.volume import Volume, faded
from ..model.lengths import length_text
from ..session.history import SessionView
from .background.comparison import RunSummary
from .background.cost_map import CostMap
from .background.map_request import MapStyle
from .background.planned_array import PlannedArray
from .background.prepare import PreparedRun
from .background.uncertainty import PositionUncertainty
from .gui.choices import Choices

TRAIL_STATES = 200  # states over which a trail extends


class SessionPicture:
    """Draws the states of a session.

    `places` (N, D) float64, metres, where the microphones were drawn last.
    """

    def __init__(self, run: PreparedRun):
        self._run = run
        start = np.asarray(run.session.view.history[0].positions)
        self._measurement = with_display_domain(run.measurement, start)
        self.places = start
        self._static: dict[tuple, Picture] = {}  # by whether the page is dark, and for a projector, and by the take
        self._faded: tuple[Floor, Floor] | None = None  # a map, and the same with another opacity
        self._faded_volume: tuple[Volume, float, bool, Volume] | None = None  # likewise, on a dark page or not

    def draw(
        self,
        view: SessionView,
        choices: Choices,
        microphone: int,
        floor: Floor | None = None,
        uncertainty: PositionUncertainty | None = None,
        runs: tuple[RunSummary, ...] = (),
        volume: Volume | None = None,
        planned: PlannedArray | None = None,
    ) -> Picture:
        """Return the picture of the state that is shown.

        `microphone`: whose map is shown, counted from 0; `floor`: the map, or None; `uncertainty`: PositionUncertainty
        of the state, or None; `runs`: of a comparison, whose estimates are marked; `volume`: the cost in space, or
        None; `planned`: drawn in place of the estimates where the user plans, or None.
        """
        if choices.plan.shown:
            return self._drawn_plan(choices, planned)
        self.places = positions = view.state.positions
        static = self._static_picture(choices, floor)
        by = slice(None) if uncertainty is None else self._sought(uncertainty)
        picture = with_floor(with_estimate(static, self._measurement, positions, microphone, floor, by), floor)
        picture = with_volume(picture, volume)
        if choices.trails:
            past = view.history[max(view.index + 1 - TRAIL_STATES, 0) : view.index + 1]
            picture = with_trails(picture, np.array([state.positions for state in past]), floor)
        if choices.ellipses and uncertainty is not None:
            picture = self._with_ellipses(picture, positions, uncertainty, floor, choices.ellipse_scale)
        if uncertainty is not None and uncertainty.channels is not None:
            picture = with_odd_channels(picture, positions, self._odd(uncertainty), floor)
        if choices.cut is not None:
            picture = with_cut(picture, choices.cut, floor)
        return with_comparison(picture, {run.name: run.positions for run in runs}, self._run.problem.free, floor)

    def _drawn_plan(self, choices: Choices, planned: PlannedArray | None) -> Picture:
        """Return the picture of the planned array; `planned` may be of places a moment ago, or None."""
        plan, measurement = choices.plan, self._measurement
        positions, known = plan.placed(measurement.positions), np.array(plan.known, int)
        array = replace(measurement, positions=positions, known=known, known_positions=positions[known])
        picture = static_picture(self._run.known_scene, array, choices.style.dark, None, choices.lecture, choices.take)
        axes = np.zeros((0, 2, 2)) if planned is None else planned.axes
        self.places = positions
        return with_bound(picture, positions, axes)

    def _with_ellipses(
        self, picture: Picture, positions: np.ndarray, found: PositionUncertainty, floor: Floor | None, scale: float
    ) -> Picture:
        """Return the picture with error ellipses `scale` times enlarged, 0 for as much as makes them visible."""
        extent = max(picture.focus[2] - picture.focus[0], picture.focus[3] - picture.focus[1])
        scale = scale or ellipse_scale(found.axes, extent)
        sigma = root_mean_square(found.sigma[self._sought(found)])  # as the verdict has it
        return with_ellipses(picture, positions, found.axes, floor, scale, f"one sigma {length_text(sigma, 2)}")

    def _sought(self, found: PositionUncertainty) -> np.ndarray:
        """Return the microphones sought that have a sound channel, else all : (K,) int64."""
        every = np.arange(len(found.sigma))
        sought = np.setdiff1d(every, [*self._run.problem.known, *self._odd(found)])
        return sought if len(sought) else every

    def _odd(self, found: PositionUncertainty) -> list[int]:
        """Return the microphones with a faulty channel."""
        names = set() if found.channels is None else {fault.name for fault in found.channels.faults}
        return [n for n, name in enumerate(self._measurement.names) if name in names]

    def _static_picture(self, choices: Choices, floor: Floor | None) -> Picture:
        """Return what does not move; over a relief it follows the heights of the map."""
        scene, measurement = self._run.known_scene, self._measurement
        dark, lecture, take = key = choices.style.dark, choices.lecture, choices.take
        if floor is not None and floor.heights is not None:
            return static_picture(scene, measurement, dark, floor, lecture, take)
        if key not in self._static:
            self._static[key] = static_picture(scene, measurement, dark, None, lecture, take)
        return self._static[key]

    def faded(self, floor: Floor, opacity: float) -> Floor:
        """Return a map with an opacity, 0 to 1; the same object for the same arguments as last time."""
        if self._faded is None or self._faded[0] is not floor or self._faded[1].opacity != opacity:
            self._faded = floor, replace(floor, opacity=opacity)
        return self._faded[1]

    def faded_parts(self, drawn: CostMap | None, style: MapStyle) -> tuple[Floor | None, Volume | None]:
        """Return the map on the floor and the volume in space with the opacity of a style; None for what is missing."""
        floor, volume = (None, None) if drawn is None else (drawn.floor, drawn.volume)
        return (
            None if floor is None else self.faded(floor, style.opacity),
            None if volume is None else self.faded_volume(volume, style.opacity, style.dark),
        )

    def faded_volume(self, volume: Volume, opacity: float, dark: bool) -> Volume:
        """Return a volume with an opacity, 0 to 1; the same object for the same arguments as last time."""
        last = self._faded_volume
        if last is None or last[0] is not volume or last[1:3] != (opacity, dark):
            self._faded_volume = last = volume, opacity, dark, faded(volume, opacity, dark)
        return last[3]
