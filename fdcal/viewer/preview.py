"""What the page shows while the first session is prepared: the room and its microphones.

This module is imported before the solvers, so that the page has a picture within the second that their import takes.
"""

from ..acoustics.measure import load_cached_measurement
from ..graphics.picture import static_picture
from ..model.measurement import Measurement
from ..model.scene import MeasuredScene
from ..session.sources import OpenRequest, as_given
from .scene3d.nodes import SceneNodes


def show_cached(nodes: SceneNodes, request: OpenRequest) -> None:
    """Show a request that needs no simulation; show nothing where the scene has to be simulated first."""
    measurement = request.measurement or load_cached_measurement(request.scene)
    if measurement is not None:
        show_room(nodes, request, as_given(request.scene, measurement))


def show_room(nodes: SceneNodes, request: OpenRequest, measurement: Measurement) -> None:
    """Show the room and the microphones; the microphones alone where the room is not known.

    `measurement`: as it is drawn.
    """
    known_scene = None if isinstance(request.scene, MeasuredScene) else request.scene
    picture = static_picture(known_scene, measurement, request.choices.get("dark") is True)
    nodes.cameras.set_initial(picture)
    nodes.show(picture)
