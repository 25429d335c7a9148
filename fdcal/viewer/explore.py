"""The face Explore: one bar on the canvas with scene, Play, modes and microphone, and sheets of scenes and lessons.

It is what a browser opens; "Expert" shows the panels in its place. Each browser chooses for itself (`server/page.js`),
so that a lecturer may use the panels while all others see the canvas.
"""

from __future__ import annotations

from functools import lru_cache
from html import escape
from typing import Any

import numpy as np
import viser

from ..assessment.words import state_error_words, state_word
from ..graphics.camera import VIEWS
from ..model.arrays import positions_of
from ..model.scene import MeasuredScene, load_scene, scene_names
from ..model.validation import InputError, StorageError, modes_text, require_choice
from ..session.session import SessionView
from ..session.sources import OpenRequest
from .html import error_message, whole
from .own_files import OwnFiles
from .session_view import Viewer
from .tabs.help import KEYS
from .tabs.lessons import LessonsTab

THUMB = 44  # pixels, of the drawing of a scene
MARGIN = 5  # pixels, at its edges
DOT = 8.5  # pixels, radius of a single microphone; of several it falls with the square root of their number
CURVE_POINTS, CURVE_HEIGHT = 120, 20  # at most, of the curve along a run, and in its own units
LECTURE = "Lecture mode: larger type, no panels (key H)"
INVITATION = "Drag the red ball away, and let it go."
ONE_LINE = 40  # characters of a status that leave room for the whole title of the scene
PLAY, PAUSE = "&#9654;", "&#10074;&#10074;"


def drawing(points: np.ndarray) -> str:
    """Return an array seen from above as SVG: `points` (N, 2), metres."""
    low, extent = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-9)
    span, radius = THUMB - 2 * MARGIN, max(DOT / np.sqrt(len(points)), 0.9)
    offset = (extent - np.ptp(points, axis=0)) / 2
    places = MARGIN + span * (points - low + offset) / extent
    dots = "".join(f"<circle cx='{x:.1f}' cy='{THUMB - y:.1f}' r='{radius:.2f}'/>" for x, y in places)
    return f"<svg viewBox='0 0 {THUMB} {THUMB}' aria-hidden='true'>{dots}</svg>"


def run_curve(view: SessionView) -> tuple[str, str]:
    """Return the path of the cost along the states of a run as SVG, from 0 to 100, and words that say where it lies.

    Both are "" before there are two costs.
    """
    at = np.unique(np.linspace(0, view.count - 1, min(view.count, CURVE_POINTS)).round().astype(int))
    cost = np.array([view.costs.of(view.history[i]) for i in at.tolist()])
    known = np.isfinite(cost)
    if known.sum() < 2:
        return "", ""
    x, cost = 100 * at[known] / (view.count - 1), cost[known]
    y = 1 + (CURVE_HEIGHT - 2) * (cost.max() - cost) / max(float(np.ptp(cost)), 1e-9)
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
    return path, f"cost along the run, {cost.max():z.1f} to {cost.min():z.1f} dB"


def summed_text(modes: tuple[int, ...]) -> str:
    """Return the modes of a map: "1 to 92", or "92" where a button beside it says "alone"."""
    if len(modes) == 1:
        return str(modes[0])
    return f"{modes[0]} to {modes[-1]}" if len(modes) == modes[-1] - modes[0] + 1 else modes_text(modes)


@lru_cache(maxsize=64)
def thumbnail(name: str) -> tuple[str, str]:
    """Return the title of a scene that comes with fdcal, and its drawing; of a measured array a ring stands for it.

    A file that was changed by hand and cannot be read has its name for a title, and no drawing.
    """
    try:
        scene = load_scene(name)
    except (InputError, StorageError):
        return name, ""
    angles = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    points = np.column_stack([np.cos(angles), np.sin(angles)])
    return scene.title, drawing(points if isinstance(scene, MeasuredScene) else positions_of(scene)[:, :2])


def shown_modes(viewer: Viewer) -> tuple[int, ...]:
    """Return the modes of the map, counted from 1; a map may not have all of those that the solver uses."""
    choices, wanted, state = viewer.binding.choices, viewer.wanted, viewer.view.state
    return choices.modes or (wanted and wanted.modes) or tuple(range(state.first, state.last + 1))


class Explore:
    """Fills the regions `bar` and `sheet`, and carries out what is pressed there.

    `page`: whose session is shown; `lessons`: that the sheet offers; `own_files`: what takes files, or None.
    """

    def __init__(self, page: Any, lessons: LessonsTab, own_files: OwnFiles | None):
        self._page, self._lessons, self._own_files, overlay = page, lessons, own_files, page.panels.overlay
        self._names = scene_names()  # the bar is written with every turn of the main loop
        self._own: tuple[OpenRequest, str] | None = None  # the file that was shown last, and the drawing of its array
        overlay.on("scene", self._open)
        overlay.on("opened", lambda client, _: self._open(client, ""))
        overlay.on("look", self._look)
        if own_files is not None:
            overlay.on("own", own_files.open)
        commands = {
            "play": lambda viewer, _: self._play(viewer),
            "state": lambda viewer, value: viewer.binding.session.seek(whole(value, 0, viewer.view.count - 1)),
            "microphone": lambda viewer, value: viewer.tabs.map.pick(
                whole(value, 0, viewer.binding.measurement.count - 1)
            ),
            "modes": lambda viewer, value: viewer.tabs.sweep.sum_up_to(
                whole(value, 1, viewer.binding.modes), viewer.tabs.sweep.alone
            ),
            "alone": lambda viewer, _: viewer.tabs.sweep.sum_up_to(
                shown_modes(viewer)[-1], not viewer.tabs.sweep.alone
            ),
        }
        commands |= {key.command: lambda viewer, _, act=key.act: act(viewer.tabs) for key in KEYS if key.command}
        for name, act in commands.items():

            def carry_out(client: viser.ClientHandle, value: str, act=act) -> None:
                if page.viewer is not None:
                    page.viewer.binding.session.yield_to_ui()
                    act(page.viewer, value)

            overlay.on(name, carry_out)

    def _open(self, client: viser.ClientHandle, name: str) -> None:
        """Open a scene that comes with fdcal or, for "", the file again that was shown last; a lesson ends."""
        if name or self._own is None:
            require_choice("scene", name, self._names)
            request = OpenRequest(load_scene(name), fewer_modes=True)
        else:
            request = self._own[0]
        self._lessons.leave()
        self._page.open(request)

    def _look(self, client: viser.ClientHandle, view: str) -> None:
        """Place the camera of the browser that asks."""
        require_choice("view", view, VIEWS)
        if self._page.viewer is not None:
            self._page.viewer.tabs.look(client, view)

    @staticmethod
    def _play(viewer: Viewer) -> None:
        """Run the solver or pause it; from its start where it has finished. The map is that of the modes it uses."""
        session = viewer.binding.session
        if not session.view.running:
            viewer.tabs.follow_solver()
        if session.view.state.finished and not session.view.running:
            session.reset(viewer.binding.choices.seed)
            session.play()
        else:
            viewer.tabs.run_bar.toggle()

    def show(self) -> None:
        """Bring bar and sheet up to date; called by the main loop."""
        viewer, overlay, current = self._page.viewer, self._page.panels.overlay, self._page.switcher.current
        error = error_message(self._page.switcher.error)
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
        binding, state = viewer.binding, viewer.view.state
        running = viewer.view.running
        modes = shown_modes(viewer)
        label = f"{PAUSE} Pause" if running else f"{PLAY} Play again" if state.finished else f"{PLAY} Play"
        sweeps, alone = viewer.tabs.sweep.playing, str(viewer.tabs.sweep.alone).lower()
        row = binding.row.capitalize()
        shown = title or viewer.run.scene.title
        head, colon, rest = shown.partition(":")
        end = "<button data-do='lecture'>End lecture mode</button>" if binding.choices.lecture else ""
        status = escape(waiting) or self._status(viewer)
        count, done = viewer.view.count, state.finished and not running
        curve, costs = run_curve(viewer.view)
        again = "<button data-do='restart'>Start again</button>" if count > 1 else ""
        return (
            f"<div class='run'><svg viewBox='0 0 100 {CURVE_HEIGHT}' preserveAspectRatio='none' aria-hidden='true'>"
            f"<path d='{curve}'/></svg>{costs and f'<small>{costs}</small>'}"
            f"<input type='range' data-do='state' aria-label='State of the run' min='0' max='{max(count - 1, 1)}'"
            f" value='{viewer.view.index}'{'' if count > 1 else ' disabled'}></div>"
            "<button class='view' data-do='look=top'>Top</button><button class='view' data-do='look=close'>3-D</button>"
            f"<button class='scene' data-local='sheet:scenes' aria-label='Choose a scene'"
            f" title='{escape(shown)}'>{self._drawn(viewer)}<span><b>{escape(head)}<i>{escape(colon + rest)}</i></b>"
            f"<small class='{'long' if len(status) > ONE_LINE else ''}'>{status}</small></span></button>"
            f"<button class='first' data-do='play'>{label}</button>"
            f"<button data-do='onestep'{' disabled' if done else ''}>Step</button>{again}"
            f"<label>{row}s <input type='range' data-do='modes' min='1' max='{binding.modes}' value='{modes[-1]}'>"
            f"<output>{escape(summed_text(modes))}</output><button data-do='alone' aria-pressed='{alone}'"
            f" title='This {binding.row} alone, or the sum from {binding.row} 1 to it'>alone</button></label>"
            f"<button data-do='sweep' title='Add {binding.row}s one by one'>{'Stop' if sweeps else 'Add up'}</button>"
            f"<label>Microphone <input type='range' data-do='microphone' min='0' max='{binding.measurement.count - 1}'"
            f" value='{viewer.snapshot.microphone}'><output>{viewer.snapshot.microphone}</output></label>"
            f"<button data-local='sheet:lessons'>Lessons</button>{end}"
            "<button data-local='face:expert'>Expert</button>"
        )

    def _drawn(self, viewer: Viewer) -> str:
        name = viewer.run.scene.name
        if name in self._names:
            return thumbnail(name)[1]
        return drawing(np.asarray(viewer.view.history[0].positions)[:, :2])

    @staticmethod
    def _status(viewer: Viewer) -> str:
        """Return what the solver does, and the error that is left."""
        view, measurement, sought = viewer.view, viewer.run.measurement, viewer.snapshot.counted
        errors = measurement.errors(view.state.positions, sought)
        faulty = len(viewer.run.sought) - len(sought)
        error = state_error_words(measurement, None if errors is None else errors[sought], faulty)
        verdict = [] if viewer.found is None else [viewer.found.verdict]
        return escape(", ".join(filter(None, (state_word(view.state, view.running, view.error, *verdict), error))))

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
        return f"<div class='scenes'>{scenes}</div><div class='lessons'>{lessons}</div>"
