"""The layout Explore: a bar on the canvas with scene, method, Play, frequencies and microphone, and three sheets.

The sheets list the scenes, the lessons, and what a user can share. A browser opens with this layout; "Expert" shows
the panels instead. Each browser chooses its layout (`server/page.js`), so that a lecturer can use the panels while all
others see only the canvas. The commands of the bar are declared with the controls of the panels (`Binding.commands`).

Below the list of scenes a form takes files of the user (`OwnFiles`). They arrive in parts, in viser's messages for
uploads, and are kept in a private temporary folder until the server ends. The page accepts files only if no other
machine can reach it.
"""

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import viser
from viser import _messages

from .. import solvers
from ..assessment.words import NOT_STARTED, band_label, plane_words, state_error_words, state_word
from ..graphics.replay import filled
from ..model.arrays import positions_of
from ..model.gauge import fixes_gauge
from ..model.scene import MeasuredScene, load_scene, scene_names
from ..model.settings import SolverSettings
from ..model.validation import InputError, StorageError, evenly_spaced, modes_text, require_choice
from ..recordings.recording import ImportOptions, number_in
from ..session import session_file, sources
from ..session.session import SessionView
from ..session.worker import LatestWorker
from . import html
from .server import content
from .session_view import PageParts, Viewer
from .state import PICTURE, VIEWS, Binding
from .tabs.lessons import LessonsTab
from .tabs.view import KINDS

MAX_BYTES = 500_000_000  # largest size of all files that a page accepts
MAX_FILES, MAX_NAME = 1000, 100  # largest number of files of one request, and of characters of a name
TOO_LARGE = f"the page accepts at most {MAX_BYTES // 1_000_000} MB and {MAX_FILES} files: use fdcal view FILE"
RECORDING, LIST = "recording", "positions"  # purpose of a file: name of its field in the form
SOURCES = "auto", "impulse", "stationary"
FORM = Path(__file__).with_name("own_files.html")


@dataclass
class Delivered:
    """The files of one upload, with their purposes; `uploaded` shows the browser how many bytes have arrived."""

    folder: Path
    uploaded: viser.GuiHtmlHandle
    upload: str  # identifier that the browser gives to all files of one upload
    files: list[tuple[str, Path]] = field(default_factory=list)
    open: BinaryIO | None = None
    count: int = 0  # bytes that have arrived
    refused: bool = False  # whether the rest of the upload is ignored


class OwnFiles:
    """Owns the folder and the thread that reads its files; `show` shows a session, `wake` updates the page."""

    def __init__(
        self, server: viser.ViserServer, show: Callable[[sources.OpenRequest], None], wake: Callable[[], None]
    ):
        self._server, self._show, self._delivered, self._bytes = server, show, dict[int, Delivered](), 0
        self._wake, self._folder = wake, tempfile.TemporaryDirectory(prefix="fdcal-", ignore_cleanup_errors=True)
        self.worker, self._complaint = LatestWorker(self._open, "fdcal-open", notify=wake), ""
        self._closed = False
        server._websock_server.register_handler(_messages.FileTransferStartUpload, self._begin)
        server._websock_server.register_handler(_messages.FileTransferPart, self._take)

    def close(self) -> None:
        """End the thread, and delete the files."""
        self.worker.close(0.5)
        self._closed = True
        for client in list(self._delivered):
            self.forget(client)
        for _ in range(3):  # a file may be added to the folder while it is deleted
            self._folder.cleanup()

    def forget(self, client: int) -> None:
        """Forget the files of a browser that were not opened."""
        if (delivered := self._delivered.pop(client, None)) is not None and delivered.open is not None:
            delivered.open.close()

    def _begin(self, client: int, message: Any) -> None:
        """Begin the next file with its name and size, on viser's event loop."""
        handle, delivered = self._server.get_clients().get(client), self._delivered.get(client)
        if self._closed or handle is None or message.source_component_uuid not in (RECORDING, LIST):
            return
        if delivered is None or delivered.upload != message.transfer_uuid:
            self.forget(client)
            uploaded = handle.gui.add_html(content("upload"), visible=False)
            folder = Path(tempfile.mkdtemp(dir=self._folder.name))
            delivered = self._delivered[client] = Delivered(folder, uploaded, message.transfer_uuid)
        if self._bytes + message.size_bytes > MAX_BYTES or len(delivered.files) == MAX_FILES:
            self._refuse(delivered)
        if delivered.refused:
            return
        if delivered.open is not None:
            delivered.open.close()
        name = re.sub(r"[^\w .()+-]", "_", re.split(r"[/\\]", message.filename)[-1])[-MAX_NAME:].lstrip(". ") or "file"
        place = delivered.folder / str(len(delivered.files))  # a folder for each file, because names may be equal
        place.mkdir()
        delivered.files.append((message.source_component_uuid, place / name))
        delivered.open = (place / name).open("wb")

    def _take(self, client: int, message: Any) -> None:
        """Write a part of the last file that was begun, on viser's event loop."""
        delivered, size = self._delivered.get(client), len(message.content)
        if delivered is None or delivered.open is None or delivered.refused:
            return
        if self._bytes + size > MAX_BYTES:  # a browser may send more than it has announced
            self._refuse(delivered)
            return
        delivered.open.write(message.content)
        delivered.count += size
        self._bytes += size
        delivered.uploaded.content = content("upload", str(delivered.count))

    def _refuse(self, delivered: Delivered) -> None:
        delivered.refused, self._complaint, delivered.uploaded.content = True, TOO_LARGE, content("upload", "refused")
        self._wake()

    def open(self, client: viser.ClientHandle, value: str) -> None:
        """Open the files of a browser; `value`: kind and temperature, degrees Celsius, such as "auto 20"."""
        delivered = self._delivered.get(client.client_id)
        self.forget(client.client_id)
        if delivered is None or delivered.refused:
            return
        kind, _, celsius = value.partition(" ")
        require_choice("kind", kind, SOURCES)
        self._complaint = ""
        self.worker.request(delivered.files, kind, number_in(celsius))

    def html(self) -> str:
        """Return the form, with the report on the file that was opened last, or why it could not be opened."""
        latest = self.worker.latest
        report = f"<pre>{escape(latest.result or '')}</pre>" if latest is not None else ""
        report += html.complaint(self._complaint or (html.error_message(latest.error) if latest is not None else ""))
        report = "<p>Reading ...</p>" if self.worker.busy else report
        report = re.sub(rf"{re.escape(self._folder.name)}/\w+/\w+/", "", report)  # file names as the user knows them
        parts = {"LIMIT": str(MAX_BYTES), "MEGABYTES": str(MAX_BYTES // 1_000_000), "REPORT": report}
        return filled(FORM.read_text(encoding="utf-8"), parts)

    def _open(self, files: list[tuple[str, Path]], kind: Any, temperature: float) -> str:
        """Show files as a session, and return the report of their import; on the thread."""
        from ..recordings.importer import import_recording, import_summary

        paths, lists = ([path for role, path in files if role == wanted] for wanted in (RECORDING, LIST))
        if not paths:
            raise InputError("no recording was chosen", "choose a file")
        first, report = paths[0], ""
        if first.suffix.lower() == ".zip":
            if len(files) > 1:
                raise InputError(f"{first.name} is a session, and other files were given, too", "choose it alone")
            self._show(session_file.read(str(first)))
            return f"{first.name} is shown."
        if first.suffix.lower() == ".npz" and not sources.is_recording(str(first)):
            inputs, report = sources.load_input([str(path) for path in paths]), f"{first.name} is shown."
        else:
            options = ImportOptions(leave_out="bad", kind=kind, temperature=temperature)
            measurement, found = import_recording(paths, options)
            inputs = replace(sources.measurement_input(measurement, first.stem), excluded=tuple(found.left_out))
            report = import_summary(measurement, found, html.CONTROLS)
        if lists:
            inputs = sources.compared_with_file(inputs, str(lists[0]))
        self._show(sources.measurement_request(inputs))
        return report


THUMB = 44  # pixels, of the drawing of a scene
MARGIN = 5  # pixels, at the edges of the drawing
DOT = 8.5  # product of a microphone's radius, pixels, and the square root of the number of microphones
CURVE_POINTS, CURVE_HEIGHT = 120, 20  # largest number of points, and height, of the curve along a run
LECTURE = "Lecture mode: larger type, no panels (key H)"
SHARED = ("Replay (HTML)", PICTURE)  # kinds of file in the sheet Share
LINK = "Copy the address of this page: it opens the same view for anyone who has the same scene or file."
INVITATION = "Drag the red ball away, and let it go."
PLAY, PAUSE = "&#9654; Play", "&#10074;&#10074; Pause"
ONE, ALL = "One at a time (the paper)", "All together"  # methods
NEW_RUN, NEEDED = "Begins a new run with this method", "needs more known microphones"


def drawing(points: np.ndarray) -> str:
    """Return an array seen from above as SVG: `points` (N, 2), metres."""
    low, extent = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-9)
    span, radius = THUMB - 2 * MARGIN, max(DOT / np.sqrt(len(points)), 0.9)
    places = MARGIN + span * (points - low + (extent - np.ptp(points, axis=0)) / 2) / extent
    dots = "".join(f"<circle cx='{x:.1f}' cy='{THUMB - y:.1f}' r='{radius:.2f}'/>" for x, y in places)
    return f"<svg viewBox='0 0 {THUMB} {THUMB}' aria-hidden='true'>{dots}</svg>"


def run_curve(view: SessionView) -> tuple[str, str]:
    """Return the curve of the cost along the states of a run as a path of SVG, from 0 to 100, and its range in words.

    Both are "" before two costs are known.
    """
    at = evenly_spaced(view.count, CURVE_POINTS)
    cost = np.array([view.costs.of(view.history[i]) for i in at.tolist()])
    known = np.isfinite(cost)
    if known.sum() < 2:
        return "", ""
    x, cost = 100 * at[known] / (view.count - 1), cost[known]
    y = 1 + (CURVE_HEIGHT - 2) * (cost.max() - cost) / max(float(np.ptp(cost)), 1e-9)
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return path, f"misfit along the run, {cost.max():z.1f} to {cost.min():z.1f} dB"


@lru_cache(maxsize=64)
def thumbnail(name: str) -> tuple[str, str]:
    """Return title and drawing of a scene that comes with fdcal; the drawing of a measured array is a ring.

    If the file cannot be read, the title is its name and the drawing is empty.
    """
    try:
        scene = load_scene(name)
    except (InputError, StorageError):
        return name, ""
    angles = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    return scene.title, drawing(points if isinstance(scene, MeasuredScene) else positions_of(scene)[:, :2])


def _slider(binding: Binding, command: str, label: str) -> str:
    """Return a slider with the range and the value of the corresponding slider in the panels."""
    handle = binding.commands[command][0]
    disabled = " disabled" if handle.disabled else ""
    return (
        f"<input type='range' data-do='{command}' aria-label='{label}' min='{handle.min}' max='{handle.max}'"
        f" value='{handle.value}'{disabled}>"
    )


class Explore:
    """Fills the regions `bar`, `sheet`, `invitation` and `lecture`.

    `page` shows the session; the sheet lists the `lessons`; `own_files` receives uploaded files, or is None.
    """

    def __init__(self, page: PageParts, lessons: LessonsTab, own_files: OwnFiles | None):
        self._page, self._lessons, self._own_files, overlay = page, lessons, own_files, page.panels.overlay
        self._names = scene_names()  # read once, because the bar is written in every iteration of the main loop
        self._own: tuple[sources.OpenRequest, str] | None = None  # the last file shown, and its drawing
        overlay.acts["scene"] = self._open
        overlay.acts["opened"] = lambda client, _: self._open(client, "")
        if own_files is not None:
            overlay.acts["own"] = own_files.open

    def _open(self, client: viser.ClientHandle, name: str) -> None:
        """Open a scene that comes with fdcal or, for "", the last file that was shown; end a lesson."""
        if name or self._own is None:
            require_choice("scene", name, self._names)
            request = sources.scene_request(load_scene(name))
        else:
            request = self._own[0]
        self._lessons.leave()
        self._page.open(request)

    def show(self) -> None:
        """Update bar and sheet; called by the main loop."""
        viewer, overlay, current = self._page.viewer, self._page.panels.overlay, self._page.switcher.current
        error = html.error_message(self._page.switcher.error)
        title, waiting = ("", error) if current is None else (current.request.scene.title, current.text)
        if viewer is None:
            words = f"<b>{escape(title)}</b><small>{escape(waiting)}</small>"
            overlay.show("bar", f"<span class='scene'><span>{words}</span></span>" if waiting else "")
            return
        request = viewer.run.opening
        comes_with_fdcal = request.scene.name in self._names or self._lessons.progress.lesson is not None
        if not comes_with_fdcal and (self._own is None or self._own[0] is not request):
            self._own = request, self._drawn(viewer)  # so that it can be opened again
        bar = self._bar(viewer, title, waiting)
        overlay.show("bar", bar if current is None else f"{bar}<span class='preparing'>{escape(waiting)}</span>")
        overlay.show("sheet", self._sheet(viewer))
        overlay.show("invitation", INVITATION if viewer.drop.inviting and self._lessons.progress.lesson is None else "")
        overlay.show("lecture", "on" if viewer.binding.choices.lecture else "")

    def _bar(self, viewer: Viewer, title: str, waiting: str) -> str:
        binding, view, state, measurement = viewer.binding, viewer.view, viewer.view.state, viewer.run.measurement
        running, done = view.running, state.finished and not view.running
        shown = title or viewer.run.scene.title
        head, colon, rest = shown.partition(":")
        status = escape(waiting) or self._status(viewer)
        curve, costs = run_curve(view)
        step = "Step"  # the label of the button describes the next step
        if not running and not state.finished:
            n = state.next_microphone(viewer.run.problem)
            step = "Move all microphones by one step"
            if n >= 0:
                step = f"Move microphone {escape(measurement.names[n])} to its lowest point"
        # the map may lack frequencies that the solver uses
        modes = binding.choices.modes or (viewer.wanted and viewer.wanted.modes)
        modes = modes or tuple(range(state.first, state.last + 1))
        in_a_row = 1 < len(modes) == modes[-1] - modes[0] + 1
        summed, hertz = f"{modes[0]} to {modes[-1]}" if in_a_row else modes_text(modes), band_label(measurement, modes)
        summed = f"no. {summed}, {measurement.frequencies[modes[0] - 1]:.0f} Hz" if len(modes) == 1 else summed
        sweep, lecture = viewer.tabs.sweep, binding.choices.lecture
        add = "Add frequencies one by one" if sweep.playing is None else "Stop"
        own, together, methods = viewer.run.scene.solver.name, viewer.run.solver.TRAITS.moves_all, ""
        at_once = own if together else SolverSettings().name
        for text, name, pressed in ((ONE, solvers.PAPER, not together), (ALL, at_once, together)):
            how = f"aria-pressed='{str(pressed).lower()}'" + ("" if pressed else f" title='{NEW_RUN}'")
            if name not in viewer.tabs.solver.name.options:
                why = "not for this array" if fixes_gauge(viewer.run.problem.known_positions) else NEEDED
                text, how = f"{text.partition(' (')[0]}<i> ({why})</i>", f"aria-pressed='false' disabled title='{why}'"
            methods += f"<button data-do='method={name}' {how}>{text}</button>"
        again = "<button data-do='step=Restart'>Restart</button>" if view.count > 1 else ""
        end = "<button data-do='lecture'>End lecture mode</button>" if lecture else ""
        views = "".join(f"<button class='view' data-do='look={name}'>{name}</button>" for name in VIEWS)
        return (
            f"<button class='scene' data-local='sheet:scenes' aria-label='Choose a scene'"
            f" title='{escape(shown)}'>{self._drawn(viewer)}<span><b>{escape(head)}<i>{escape(colon + rest)}</i></b>"
            f"<small>{status}</small></span><i aria-hidden='true'>&#9662;</i></button>"
            f"<span class='switch' role='group' aria-label='Method'>{methods}</span>"
            f"<button class='first' data-do='play'>{PAUSE if running else PLAY}</button>"
            f"<button data-do='step=Step'{' disabled' if done else ''}>{step}</button>"
            "<button data-local='sheet:lessons'>Lessons</button><button data-local='sheet:share'>Share</button>"
            f"{end}<button data-local='layout:expert'>Expert</button><hr>"
            f"{again}<div class='run' title='{costs}'><svg viewBox='0 0 100 {CURVE_HEIGHT}' preserveAspectRatio='none'"
            f" aria-hidden='true'><path d='{curve}'/></svg>{costs and f'<small>{costs}</small>'}"
            f"{_slider(binding, 'state', 'State of the run')}</div>"
            f"<label title='{hertz}'>Frequencies {_slider(binding, 'modes', 'Frequencies')}<output>{summed}</output>"
            f"</label><button data-do='alone' aria-pressed='{str(sweep.alone).lower()}'>this frequency only</button>"
            f"<button data-do='sweep'>{add}</button>"
            f"<label>Microphone {_slider(binding, 'microphone', 'Microphone')}"
            f"<output>{viewer.snapshot.microphone}</output></label>{views}"
        )

    def _drawn(self, viewer: Viewer) -> str:
        name = viewer.run.scene.name
        if name in self._names:
            return thumbnail(name)[1]
        return drawing(np.asarray(viewer.view.history[0].positions)[:, :2])

    @staticmethod
    def _status(viewer: Viewer) -> str:
        """Return what the solver does, and the error of the best positions so far."""
        view, measurement, sought = viewer.view, viewer.run.measurement, viewer.snapshot.counted
        errors = measurement.errors(view.state.best_positions, sought)
        faulty = len(viewer.run.sought) - len(sought)
        error = state_error_words(measurement, None if errors is None else errors[sought], faulty)
        word = state_word(view.state, view.running, view.error, *([viewer.found.verdict] if viewer.found else ()))
        word = ("Moved by hand" if view.index else "Start of a new run") if word == NOT_STARTED else word
        said = (": " if ";" in word else ", ").join(filter(None, (word, error)))
        return escape("; ".join(filter(None, (said, plane_words(measurement)))))

    def _sheet(self, viewer: Viewer) -> str:
        shown = viewer.run.scene.name
        scenes = "".join(
            f"<button data-do='scene={escape(name)}' aria-pressed='{str(name == shown).lower()}'>"
            f"{thumbnail(name)[1]}<span>{escape(thumbnail(name)[0])}</span></button>"
            for name in self._names
        )
        if self._own is not None:
            (request, dots), pressed = self._own, str(self._own[0].scene.name == shown).lower()
            title = escape(request.scene.title)
            scenes += f"<button data-do='opened' aria-pressed='{pressed}'>{dots}<span>{title}</span></button>"
        scenes += "" if self._own_files is None else self._own_files.html()
        lessons = self._lessons.list_html()
        if not viewer.binding.choices.lecture:
            lessons += f"<button data-do='lecture'>{LECTURE}</button>"
        share = "".join(
            f"<button data-do='save={kind}'><b>{escape(kind)}</b><br><small>{KINDS[kind].description}</small></button>"
            for kind in SHARED
        )
        share += f"<div class='dim'>{LINK}</div>"
        return f"<div class='scenes'>{scenes}</div><div class='lessons'>{lessons}</div><div class='share'>{share}</div>"
