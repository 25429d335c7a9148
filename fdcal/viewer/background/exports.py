"""Files of what is shown, made one after the other on a thread of their own and sent to the page that asked.

A `Moment` is all that a file tells of; `KINDS` says which files there are and what makes each.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import viser

from ...assessment import position_table
from ...cost import landscapes
from ...graphics import paraview
from ...graphics.heatmap import cost_label
from ...graphics.landscape_figure import Panels, draw_landscape, few_panels, figure_bytes
from ...graphics.picture import Picture, headline, heights_of
from ...graphics.replay import replay
from ...graphics.snapshot_process import render_png
from ...model.validation import InputError
from ...session import session_file
from ...session.history import SessionView
from ...session.request import OpenRequest
from ...session.worker import LatestWorker
from ..gui import html
from ..gui.binding import PICTURE, Choices, choices_told
from .prepare import Work

MOST = 8  # files that may wait to be made
LONGEST_NAME = 60  # characters of a scene in the name of a file

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Moment:
    """What is on the screen at one moment.

    Attributes
    ----------
    work : Work
    picture : Picture, as drawn
    view : SessionView, whose state the picture shows
    choices : Choices
    microphone : int, the one looked at
    sigma : (N,) float64, metres, one standard deviation of each microphone's place, or None
    """

    work: Work
    picture: Picture
    view: SessionView
    choices: Choices
    microphone: int
    sigma: np.ndarray | None

    @property
    def caption(self) -> str:
        """Scene, step and modes in words."""
        state = self.view.state
        modes = html.modes_text(self.work.measurement, state.first, state.last)
        return f"{self.work.scene.title}: step {state.step}, {modes}"

    @property
    def height(self) -> float:
        """Of a plane array, metres."""
        return heights_of(self.work.told, self.work.measurement)[0]


def _picture(moment: Moment) -> bytes:
    """Drawn anew in a child process."""
    title = f"{moment.caption}\n{headline(moment.work.measurement, moment.view.state.positions)}"
    choices = moment.choices
    return render_png(replace(moment.picture, title=title), choices.export_size, choices.export_view)


def _panels(moment: Moment, most: int) -> Panels:
    """Maps of the microphone looked at, of the modes of the map on the page."""
    work, state, n = moment.work, moment.view.state, moment.microphone
    if work.problem.search is None:
        raise InputError("there is no map without a search domain")
    modes = moment.choices.modes or tuple(range(state.first, state.last + 1))
    maps = landscapes.each_mode(work.problem, work.solver, state, n, modes)
    return few_panels(maps, modes, work.measurement.frequencies, n, work.problem.search, most)


def _figure(kind: str) -> Callable[[Moment], bytes]:
    def make(moment: Moment) -> bytes:
        measurement, n = moment.work.measurement, moment.microphone
        truth = None if measurement.positions is None else measurement.positions[n][:2]
        heading = f"Cost of moving microphone {measurement.names[n]}\n{moment.caption}"
        label = cost_label(moment.work.scene.solver.weights)
        return figure_bytes(draw_landscape(_panels(moment, 8), truth, label, heading), kind)

    return make


def _map(moment: Moment) -> bytes:
    place = moment.view.state.positions[moment.microphone]
    height = float(place[2]) if len(place) == 3 else moment.height
    return paraview.landscape(_panels(moment, moment.work.measurement.pressures.shape[0]), height).encode()


def _table(moment: Moment) -> bytes:
    return position_table.table(moment.work.measurement, moment.view.state.positions, moment.sigma).encode()


def _cloud(moment: Moment) -> bytes:
    found = moment.view.state.positions
    return paraview.cloud(moment.work.measurement, found, moment.sigma, moment.height).encode()


def _replay(moment: Moment) -> bytes:
    scene, measurement = moment.work.scene, moment.work.measurement
    told, history = moment.work.told, moment.view.history
    return replay(told, measurement, history, scene.title, scene.solver.weights).encode()


def _session(moment: Moment) -> bytes:
    """With the settings and the seed that the states tell, which a reset may have changed."""
    work, view = moment.work, moment.view
    scene = replace(work.scene, solver=getattr(view.state, "settings", work.scene.solver))
    told = choices_told(moment.choices)
    return session_file.write(
        OpenRequest(scene, view.state.seed, work.measurement, tuple(view.history), view.index, told)
    )


@dataclass(frozen=True)
class Kind:
    """A kind of file: what ends its name, what it is, what makes it, and whether that takes seconds."""

    ending: str
    told: str
    make: Callable[[Moment], bytes]
    slow: bool = False


KINDS = {
    PICTURE: Kind(".png", "What is shown, drawn anew off-screen in about 5 s.", _picture, slow=True),
    "Maps as in Fig. 1 (PNG)": Kind(
        "-maps.png",
        "Maps of the microphone looked at: single modes, eight at most, and their sum.",
        _figure("png"),
        slow=True,
    ),
    "Maps as in Fig. 1 (SVG)": Kind("-maps.svg", "The same as a drawing, for print.", _figure("svg"), slow=True),
    "Map (VTI for ParaView)": Kind(
        "-map.vti", "The numbers of all maps of the microphone looked at, and of their sum.", _map
    ),
    "Microphones (CSV)": Kind(
        "-microphones.csv", "Supposed and true places, error and, once finished, uncertainty: metres.", _table
    ),
    "Microphones (VTP for ParaView)": Kind(
        "-microphones.vtp", "Supposed, true and known microphones as points, with error vectors.", _cloud
    ),
    "Replay (HTML)": Kind(
        "-replay.html", "The whole run as one page that plays in any browser, without a server or a network.", _replay
    ),
    "Session (ZIP)": Kind(
        "-session.zip", "All of this to go on another day, where it was left: fdcal view FILE.zip", _session
    ),
}


def file_name(moment: Moment, kind: Kind) -> str:
    """Scene and step, with nothing that a file system or a browser could take for more than a name."""
    scene = re.sub(r"[^A-Za-z0-9_-]+", "_", moment.work.scene.name)[:LONGEST_NAME].strip("_") or "scene"
    return f"fdcal-{scene}-step-{moment.view.state.step}{kind.ending}"


class Exports:
    """Makes files in the order in which they were asked for, a bounded number of which may wait."""

    def __init__(self):
        self.worker = LatestWorker(self._make, "fdcal-export", MOST)

    def ask(self, client: viser.ClientHandle, label: str, moment: Moment) -> None:
        """Have a file of one of KINDS made for one page; told there at once that it is under way, or refused."""
        if self.worker.full:
            client.add_notification("Too many files are waiting", "Try again in a moment.", color="red")
            return
        kind = KINDS[label]
        if kind.slow:
            client.add_notification("Drawing", "It is offered for download when it is done.", auto_close_seconds=4)
        self.worker.request(client, kind, moment)

    def _make(self, client: viser.ClientHandle, kind: Kind, moment: Moment) -> None:
        """On the exports' thread. A page that has closed meanwhile gets nothing, and harms nobody."""
        try:
            content = kind.make(moment)
        except (InputError, OSError) as error:
            client.add_notification("Nothing is saved", str(error)[:400], color="red")
            return
        except Exception as error:
            log.exception("a file could not be made")
            client.add_notification("Nothing is saved", f"{error!r}"[:300] + "; details in the log", color="red")
            return
        client.send_file_download(file_name(moment, kind), content, save_immediately=True)

    def close(self, timeout: float) -> bool:
        """End the thread after the file under way."""
        return self.worker.close(timeout)
