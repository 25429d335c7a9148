"""What a page shows before there is a session: the room and its microphones, while the solver is being prepared.

Loaded before the solvers are, so that there is something to be seen within the second that those take.
"""

from __future__ import annotations

from ..acoustics.measurement_cache import load_cached_measurement
from ..graphics.picture import static_picture
from ..model.measured_scene import MeasuredScene
from ..model.measurement import Measurement
from ..session.request import OpenRequest, as_given
from .scene3d.nodes import SceneNodes


def look_at_once(nodes: SceneNodes, opening: OpenRequest) -> None:
    """Show what needs no simulation; nothing where the scene has to be simulated first."""
    measurement = opening.measurement or load_cached_measurement(opening.scene)
    if measurement is not None:
        first_look(nodes, opening, as_given(opening.scene, measurement))


def first_look(nodes: SceneNodes, opening: OpenRequest, measurement: Measurement) -> None:
    """Show the room, without a scene the microphones alone."""
    known_scene = None if isinstance(opening.scene, MeasuredScene) else opening.scene
    picture = static_picture(known_scene, measurement, opening.choices.get("dark") is True)
    nodes.cameras.open_at(picture)
    nodes.show(picture)
