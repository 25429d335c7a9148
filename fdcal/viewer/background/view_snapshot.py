"""What is on the screen at one moment, and the map that belongs to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...graphics.primitives import Picture
from ...graphics.surroundings import z_range_of
from ...graphics.volume import Volume
from ...session.history import SessionView
from ..gui import html
from ..gui.choices import Choices
from .map_panels import map_modes
from .map_request import CostMapRequest
from .prepare import PreparedRun


@dataclass(frozen=True)
class ViewSnapshot:
    """What is on the screen at one moment."""

    run: PreparedRun
    picture: Picture  # as drawn
    view: SessionView  # whose state the picture shows
    choices: Choices
    microphone: int  # the selected one, counted from 0
    sigma: np.ndarray | None  # (N,) float64, metres, one standard deviation of each position, or None
    volume: Volume | None = None  # the cost in space that the picture shows, or None
    sought: np.ndarray | None = None  # numbers of the microphones whose errors count; those of the run unless given

    @property
    def counted(self) -> np.ndarray:
        """Numbers of the microphones whose errors count, and by which a blind array is aligned."""
        return self.run.sought if self.sought is None else self.sought

    @property
    def caption(self) -> str:
        """Scene, step and modes in words."""
        state = self.view.state
        modes = html.modes_text(self.run.measurement, state.first, state.last)
        return f"{self.run.scene.title}: step {state.step}, {modes}"

    @property
    def height(self) -> float:
        """Height of a plane array, metres."""
        return z_range_of(self.run.known_scene, self.run.measurement)[0]


def map_request(snapshot: ViewSnapshot) -> CostMapRequest:
    """Return the request for the map on the page."""
    state, choices = snapshot.view.state, snapshot.choices
    order_offset = choices.map_order
    return CostMapRequest(
        revision=0,
        microphone=snapshot.microphone,
        modes=map_modes(snapshot.run, state, choices.modes, order_offset, choices.take),
        order_offset=order_offset,
        custom_modes=choices.modes is not None,
        style=choices.style,
        follow=False,
        state=state,
        lineage=snapshot.view.history.lineage,
        take=choices.take,
    )
