"""The opening of the page: a film, and the scene of the session behind it.

In the film, modes are added to a map with many minima until one is left, and a microphone rolls into it. The film is
part of the page's HTML: each browser plays it from its beginning without a message from the server (`film.js`), and a
touch or a key ends it in this browser. `docs/opening.py` writes the files, so that nothing has to be simulated.
"""

from dataclasses import replace
from pathlib import Path

from ..model.measurement import load_measurement
from ..model.scene import load_scene
from ..session.sources import OpenRequest

SCENE, MICROPHONE, MODE = "fig1_square", 16, 92  # the mode whose map has the most minima
MEASUREMENT, FILM, SCRIPT = (
    Path(__file__).with_name(name) for name in ("opening_measurement.npz", "opening.html", "film.js")
)


def film_html() -> str:
    """Return the film as a part of the page."""
    return f"{FILM.read_text(encoding='utf-8')}<script>{SCRIPT.read_text(encoding='utf-8')}</script>"


def opening_request() -> OpenRequest:
    """Return the request for the session of the opening: one mode in relief, with its many minima.

    The method minimises the maps of the film, in its order.
    """
    scene = load_scene(SCENE)
    order = {"modes": MODE, "mode_order": "descending", "ample_modes": 1, "known_weight": 1.0}
    scene = replace(scene, solver=replace(scene.solver, **order))
    choices = {"kind": "relief", "microphone": MICROPHONE, "follow": False, "modes": (MODE,), "descending": True}
    return OpenRequest(scene, measurement=load_measurement(MEASUREMENT), choices=choices)
