"""The tab View: the camera, the theme, what is drawn over the map, and files of what is on the screen.

Files are made one after the other on a thread, and each is sent to the browser that asked for it. A `PageState` holds
everything that goes into a file, and `KINDS` lists the kinds.
"""

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import viser

from ...assessment.result_file import position_table
from ...assessment.words import band_label, error_line, modes_label
from ...cost.maps import panels_of
from ...graphics.figures import landscape_bytes
from ...graphics.replay import replay_html
from ...graphics.snapshot import render_png
from ...model.libraries import call
from ...model.validation import InputError, evenly_spaced, require_choice
from ...session import session_file
from .. import html
from ..cost_maps import above_lowest, fine_maps, map_label
from ..state import PICTURE, VIEWS, Binding, PageState, Tab

ELLIPSES_LATER = "Ellipses appear when the solver has finished."


class ViewTab(Tab):
    """Owns the controls of the tab."""

    part, where = "view", "View"

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        camera = gui.add_button_group("Camera", tuple(VIEWS))  # a hint would cover the tabs above
        self.camera = binding.on(camera, lambda client, name: binding.tabs.look(client, VIEWS[name]), True, "look")
        gui.add_html(html.remark("Moves the camera in this window only: plan view, array, whole room."))
        self.dark = binding.checkbox("Dark page", lambda choices: choices.dark, self.darken, command="dark_page")
        hint = "Large type and no panels; the key H ends this mode as well"
        self.lecture = binding.choice("Lecture mode", "lecture", command="lecture", hint=hint)
        hint = "Path of each estimate over the last 200 states"
        self.trails = binding.choice("Trails", "trails", command="trails", hint=hint)
        self.ellipses = binding.choice("Error ellipses (95\N{NO-BREAK SPACE}%)", "ellipses", hint=ELLIPSES_LATER)
        self.refresh()

    def darken(self, dark: bool, preferred: bool = False) -> None:
        """Make page and map dark or light; `preferred`: whether a browser prefers this, and no user has chosen it."""
        self._binding.choose(dark=dark, themed=self._binding.choices.themed or not preferred)
        self.refresh()

    def refresh(self) -> None:
        """Let the theme follow the choices."""
        dark = self._binding.choices.dark
        self._binding.gui.configure_theme(dark_mode=dark, show_share_button=False, show_logo=False)


def caption(state: PageState) -> str:
    """Return scene, step and modes in words."""
    shown, measurement = state.view.state, state.run.measurement
    used = tuple(range(shown.first, shown.last + 1))
    modes = f"{modes_label(measurement, used)}, {band_label(measurement, used)}"
    return f"{state.run.scene.title}: step {shown.step}, {modes}"


MAX_WAITING = 8  # largest number of files that wait to be made
MAX_PANELS = 8  # largest number of maps of single modes in a figure
REPLAY_BYTES = 300_000  # largest size of a replay, so that it can be sent by mail
MAX_NAME = 60  # largest number of characters of the scene's name in the name of a file

log = logging.getLogger(__name__)


def _picture(snapshot: PageState) -> bytes:
    """Return the picture as PNG, drawn again in a child process."""
    measurement, counted = snapshot.run.measurement, snapshot.counted
    errors = measurement.errors(snapshot.view.state.positions, counted)
    line = error_line(None if errors is None else errors[counted], measurement.blind, measurement.nominal)
    title = "\n".join(filter(None, (caption(snapshot), line)))
    if snapshot.drawn is not None and snapshot.drawn.volume is not None:
        title += f"\nCost of moving microphone {measurement.names[snapshot.microphone]}"
    choices = snapshot.choices
    return render_png(replace(snapshot.picture, title=title), choices.export_size, choices.export_view)


def _figure(snapshot: PageState, file_format: str) -> bytes:
    measurement, n = snapshot.run.measurement, snapshot.microphone
    positions, truth = snapshot.view.state.positions, measurement.positions
    request = snapshot.choices.map_request(snapshot.run, snapshot.view, n)
    heading = f"Cost of moving microphone {measurement.names[n]}\n{caption(snapshot)}"
    drawn = {"truth": None if truth is None else truth[n][:2], "estimate": positions[n][:2], "heading": heading}
    drawn |= {"quantity": map_label(snapshot.run, request).partition(" (")[0]}
    kept = evenly_spaced(len(request.modes), MAX_PANELS)
    found = fine_maps(snapshot.run, request, kept=kept.tolist())
    assert found is not None  # only maps that can be cancelled may be incomplete
    (single, total, search), modes = found, [request.modes[i] for i in kept]
    panels = panels_of(single, total, modes, measurement.frequencies, n, search, len(request.modes))
    shown = np.stack([above_lowest(snapshot.run, request, one) for one in panels.maps])
    # In a separate process, because matplotlib keeps its fonts open for each thread that has drawn.
    return call(landscape_bytes, file_format, replace(panels, maps=shown), drawn)


def _table(snapshot: PageState) -> bytes:
    positions = snapshot.view.state.positions
    sigma = None if snapshot.found is None or snapshot.axes is None else snapshot.found.uncertainty
    return position_table(snapshot.run.measurement, positions, sigma, snapshot.counted).encode()


def _replay(snapshot: PageState) -> bytes:
    run, history = snapshot.run, snapshot.view.history
    return replay_html(
        run.known_scene, run.measurement, history, run.scene.title, run.reference_cost, run.sought,
        problem=run.problem, microphone=snapshot.microphone, max_bytes=REPLAY_BYTES,
    ).encode()  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """A kind of file."""

    ending: str  # end of the file's name
    description: str  # one sentence for the user
    make: Callable[[PageState], bytes]  # returns the content of the file
    slow: bool = False  # whether `make` takes seconds


KINDS = {
    PICTURE: Kind(".png", "What is shown, rendered in 3 s, in the camera view set in Expert.", _picture, slow=True),
    "Maps as in Fig. 1 (PNG)": Kind(
        "-maps.png",
        "Cost maps of the selected microphone: up to eight single frequencies, and the sum of all.",
        partial(_figure, file_format="png"),
        slow=True,
    ),
    "Maps as in Fig. 1 (SVG)": Kind(
        "-maps.svg", "The same figure as vector graphics, for print.", partial(_figure, file_format="svg"), slow=True
    ),
    "Microphones (CSV)": Kind(
        "-microphones.csv",
        "Estimated and true positions, errors and, once the solver has finished, uncertainties, in metres.",
        _table,
    ),
    "Replay (HTML)": Kind(
        "-replay.html", "The whole run as one page that plays in any browser, without a server or a network.", _replay
    ),
    "Session (ZIP)": Kind(
        "-session.zip",
        "Everything needed to resume later: fdcal view FILE.zip",
        lambda state: session_file.write(state.run.request_of(state.view, state.choices.to_save())),
    ),
}


def file_name(snapshot: PageState, kind: Kind) -> str:
    """Return a file name of scene and step, without characters that are special to a file system or a browser."""
    scene = re.sub(r"[^A-Za-z0-9_-]+", "_", snapshot.run.scene.name)[:MAX_NAME].strip("_") or "scene"
    return f"fdcal-{scene}-step-{snapshot.view.state.step}{kind.ending}"


SIZES = {"1280 x 800": (1280, 800), "1920 x 1080": (1920, 1080), "3840 x 2160": (3840, 2160)}


class ExportTab(Tab):
    """Owns the controls, and makes files in the order in which they were requested; a bounded number may wait."""

    part, where, order = "export", "View", 11

    def __init__(self, binding: Binding):
        self._binding, gui = binding, binding.gui
        self.worker = binding.threads.worker(self._make, keep=MAX_WAITING)
        with gui.add_folder("Save a file"):
            self.kind = binding.choice("File", "export_kind", {kind: kind for kind in KINDS})
            self.description = gui.add_html("")
            described = lambda choices: html.remark(KINDS[choices.export_kind].description)  # noqa: E731
            binding.follow(self.description, content=described)
            of_picture = lambda choices: choices.export_kind == PICTURE  # noqa: E731
            self.view = binding.choice("Camera view", "export_view", VIEWS, visible=of_picture)
            self.size = binding.choice("Size (pixels)", "export_size", SIZES, visible=of_picture)
            save = gui.add_button("Save", icon=viser.Icon.DOWNLOAD, hint="Save what is shown now")
            self.button = binding.on(save, self.save, of_client=True, command="save")

    def save(self, client: viser.ClientHandle, kind_name: Any = None) -> None:
        """Request a file of what is shown; the page says at once that it is in progress, or why it is refused.

        `kind_name`: a key of KINDS; by default the kind that is chosen. InputError if there is no such kind.
        """
        if len(self.worker.waiting) == MAX_WAITING:  # one more request would drop one that waits
            client.add_notification("Too many files are waiting", "Try again in a moment.", color="red")
            return
        name = kind_name if isinstance(kind_name, str) and kind_name else self._binding.choices.export_kind
        require_choice("file", name, KINDS)
        kind = KINDS[name]
        if kind.slow:
            client.add_notification("Rendering", "The download starts when the file is ready.", auto_close_seconds=4)
        self.worker.request(client, kind, replace(self._binding.state, choices=self._binding.choices))

    def _make(self, client: viser.ClientHandle, kind: Kind, state: PageState) -> None:
        """Make a file and send it to the page, unless the page was closed meanwhile; on the thread."""
        try:
            content = kind.make(state)
        except Exception as error:
            text = html.error_message(error)[:400]
            if not isinstance(error, (InputError, OSError)):
                log.exception("a file could not be made")
            client.add_notification("The file could not be made", text, color="red")
            return
        client.send_file_download(file_name(state, kind), content, save_immediately=True)
