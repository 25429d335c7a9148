"""The texts of the page as HTML: status lines, the verdict, remarks, error messages, and the regions on the canvas.

All texts from files and solvers are escaped.

`server/page.js` draws the regions in each browser. Their HTML is sent in invisible controls. An element with `data-do`
sends a command: `<button data-do="play">` sends "play", `<input type="range" data-do="modes">` with the value 12 sends
"modes=12". If a region changes in part, the other elements stay, so that a slider can be dragged meanwhile.
"""

import logging
import re
import secrets
from collections.abc import Callable, Coroutine, Iterable, Sequence
from html import escape
from typing import Any

import numpy as np
import viser

from ..assessment import words
from ..graphics.heatmap import to_rgb
from ..graphics.marks import EDGE, Mark, css, symbol_svg
from ..graphics.primitives import ColourBar
from ..model.measurement import Measurement
from ..model.validation import InputError, StorageError
from ..session.calibration_run import Assessment
from ..session.session import SessionView
from .server import REGIONS, content
from .server.process import log_location

CARD = "padding: 0.15em 0.75em; font-size: var(--text); line-height: 1.5;"
RED = "color-mix(in srgb, #d61828 65%, currentcolor)"  # colour of errors and warnings, also readable on a dark page
DIM = "<span style='opacity: 0.65'>"
MAX_ERROR_LENGTH = 400  # characters of an exception
NO_DOMAIN = (
    "the file has no search domain, and the positions could not be estimated to make one. Add search_origin,"
    " search_size, search_step and radius (metres) to the file of the measurement."
)

# Names of the page for the arguments in the remedy of an error (`InputError.worded`).
CONTROLS = {
    "array_radius": "the array radius of `fdcal import`",
    "kind": 'the list "Kind of a recording" below the scenes',
    "known": 'the slider "Known microphones" in the tab Scene',
    "modes": 'the slider "Last freq." in the settings',
    "rate": "the sampling rate to `fdcal import`",
    "radius": "its radius in the file that is shown",
    "search": "a search domain",
    "seed": 'the field "Seed" in the settings',
    "solver": 'the list "Method" in the settings',
    "start": 'the list "Start" in the settings',
}


def error_message(error: Exception | None) -> str:
    """Return an exception as a line of plain text, which is not escaped; "" for None.

    An exception other than InputError and OSError is a fault of the program, and the line names the log.
    """
    if error is None:
        return ""
    if isinstance(error, InputError):
        return error.worded(CONTROLS)
    if isinstance(error, OSError):
        return str(error)
    return f"{type(error).__name__}: {str(error)[:MAX_ERROR_LENGTH]}; details in {log_location()}"


def complaint(error: Exception | str) -> str:
    """Return an error below a control, from an exception or a text; "" for an empty text."""
    text = error_message(error) if isinstance(error, Exception) else error
    return f"<div style='{CARD} color: {RED}'>{escape(text)}</div>" if text else ""


def remark(text: str) -> str:
    """Return a sentence below a control."""
    return f"<div style='{CARD} opacity: 0.75'>{escape(text)}</div>"


def status(
    view: SessionView,
    measurement: Measurement,
    fault: str = "",
    sought: np.ndarray | slice = slice(None),
    found: Assessment | None = None,
    left_out: Sequence[str] = (),
) -> str:
    """Return the lines at the top of the main panel.

    `fault` is an exception of the page itself, as a text; `sought` are the numbers of the microphones whose errors are
    averaged, by default all; `found` is the assessment of the state, or None; `left_out` are the names of microphones
    that are not averaged because their channels are faulty.
    """
    state, errors = view.state, measurement.errors(view.state.best_positions, sought)
    found_errors = None if errors is None else errors[sought]
    error, figures, compared = words.error_parts(found_errors, measurement.blind, measurement.nominal)
    error, (mean, comma, largest) = error.capitalize(), figures.partition(", ")
    if error and left_out:  # only a sign, because a longer name would wrap and move the buttons
        why = f"{error} without microphone {', '.join(left_out)}: faulty channel"
        error = f"<span title='{escape(why)}'>{error}*</span>"
    kept = state.best_positions is not state.positions  # True while the run tries another start
    used = tuple(range(state.first, state.last + 1))
    verdict = [] if found is None else [found.verdict]
    rows = {
        "Progress": f"step {state.step}, " + ("the best start so far is kept" if kept else f"sweep {state.sweep}"),
        "In use": f"{words.count_label(measurement, used)}, {words.band_label(measurement, used)}",
        error: f"<b>{mean}</b>"
        + (f"{comma}<span style='white-space: nowrap'>{largest}</span>" if largest else "")
        + (f"<br>{DIM}{compared}</span>" if compared else ""),
        "Cost": words.cost_words(view.cost, state.channels is not None).replace(" (", f" {DIM}(") + "</span>",
        "Array": words.plane_words(measurement),
    }
    cells = "".join(f"<tr><td>{name}</td><td>{text}</td></tr>" for name, text in rows.items() if name and text)
    faults = [view.error[:MAX_ERROR_LENGTH]] if view.error else []
    faults += [f"The page could not be updated: {fault[:MAX_ERROR_LENGTH]}"] if fault else []
    lines = "".join(
        f"<div style='color: {RED}; overflow-wrap: anywhere'>{escape(f'{text}; details in {log_location()}')}</div>"
        for text in faults
    )
    word = words.state_word(state, view.running, view.error, *verdict).partition(";")[0]
    if word == "Ended" and found is not None:
        lines += f"<div style='opacity: 0.65'>{words.STEP_LEFT.capitalize()}.</div>"
    head = f"<div style='font-size: var(--head); font-weight: 600'>{word}</div>"
    return f"<div class='fdcal-status'>{head}{lines}<table>{cells}</table></div>"


# Colours of the verdict on a light and on a dark page: good; good except for faulty channels; not good.
GOOD, FAULTY, DOUBTFUL = (
    "light-dark(#1a7f37, #4cc26b)", "light-dark(#0b6aa8, #58b4f0)", "light-dark(#c2410c, #fb923c)"
)  # fmt: skip
GREY, PENDING = "#808894", "Assessing the result ..."


def verdict_html(found: Assessment | None, pending: bool = False) -> str:
    """Return the verdict with its text and the leave-one-out error; "" if there is none and none is `pending`.

    The height is always the same, so that buttons do not move: a long text is scrolled.
    """
    if found is None and not pending:
        return ""
    colour, text = GREY, PENDING
    if found is not None:
        colour = DOUBTFUL if found.verdict != "good" else FAULTY if found.channels.faults else GOOD
        text = f"<b>{escape(found.verdict.replace('_', ' '))}</b>: {escape(found.verdict_text)}"
        figures = words.prediction_words(found.evidence.leave_one_out_db)
        text = f"<div style='color: {colour}'>{text}</div><div style='opacity: 0.85'>{figures}</div>"
    return f"<div class='fdcal-verdict' style='border-color: {colour}'>{text}</div>"


def drawings_html(marks: dict[str, str]) -> str:
    """Return SVG drawings, each beside its name and in the size of the text; `marks`: contents by their names."""
    spans = (f"<span><svg viewBox='0 0 {EDGE} {EDGE}'>{mark}</svg> {name}</span>" for name, mark in marks.items())
    return f"<div class='fdcal-marks' style='{CARD}'>{''.join(spans)}</div>"


# Words of the layout Expert, and those that replace them in the layout Explore.
EXPLORE = {
    "cost, Eq. 7": "misfit", "Eq. 7, for comparison": "misfit, for comparison",
    "negative log-likelihood above its lowest": "misfit", "negative log-likelihood": "misfit",
}  # fmt: skip


def canvas_legend(bar: ColourBar | None, entries: Iterable[Mark], hint: str = "") -> str:
    """Return the legend on the canvas: how to read the map (`hint`), its colour bar, if any, and the marks."""
    explore = re.compile("|".join(map(re.escape, EXPLORE)))

    def for_both_layouts(text: str) -> str:
        """Return a text in the words of Expert and, if they differ, in those of Explore."""
        usual, plain = (
            re.sub("z = .* m|[0-9.]+( to [0-9]+)? Hz", lambda found: found[0].replace(" ", "&nbsp;"), escape(one))
            for one in (text, explore.sub(lambda found: EXPLORE[found[0]], text))
        )
        return usual if usual == plain else f"<span class='expert'>{usual}</span><span class='explore'>{plain}</span>"

    scale, advice = "", f"<p>{for_both_layouts(hint)}</p>" if hint else ""
    if bar is not None:
        gradient = ", ".join(css(colour) for colour in to_rgb(np.linspace(0, 1, 17), bar.colour_map))
        ticks = "".join(f"<div style='left: {100 * at:.2f}%'><div></div>{text}</div>" for at, text in bar.ticks)
        colours = f"<div class='colours' style='background: linear-gradient(to right, {gradient})'></div>"
        scale = f"<div>{colours}<div class='ticks'>{ticks}</div></div><div>{for_both_layouts(bar.label)}</div>"
        scale = f"<div class='fdcal-scale'>{scale}</div>"
    marks = drawings_html({escape(mark.text): symbol_svg(mark) for mark in entries})
    return f"<div class='fdcal-legend'>{advice}{scale}{marks}</div>"


CHANNEL = "fdcal command"  # label of the control of the commands, as in page.js
ERROR_TIME = 8.0  # s that a refused command is shown

Act = Callable[[viser.ClientHandle, str], object]

log = logging.getLogger(__name__)


def of_browsers(act: Callable[[Any], object]) -> Callable[[Any], Coroutine[Any, Any, None]]:
    """Return a callback for viser that calls `act(event)` for events of browsers, but not of this program."""

    async def respond(event) -> None:
        if event.client is not None:
            act(event)

    return respond


class Overlay:
    """Owns the hidden controls, and maps each command to its effect.

    `wake`: makes the main loop update the page at once; `acts`: what is called with client and value for each command,
    on viser's event loop.
    """

    def __init__(self, gui: viser.GuiApi, wake: Callable[[], None] = lambda: None):
        self._wake = wake
        self._regions = {name: gui.add_html(content(name), visible=False) for name in REGIONS}
        self.acts: dict[str, Act] = {}
        self.otherwise: Callable[[viser.ClientHandle, str, str], object] = lambda client, name, value: None
        self.start = secrets.token_hex(8)  # name of this start; a browser drops an address from another start
        self.channel = gui.add_text(CHANNEL, "", visible=False)
        self.channel.on_update(of_browsers(lambda event: self.receive(event.client, event.target.value)))

    def show(self, region: str, html: str) -> None:
        """Fill a region; any thread. All texts in `html` are escaped already."""
        self._regions[region].content = content(region, html)  # viser sends it only if it differs

    def receive(self, client: viser.ClientHandle, text: str) -> None:
        """Carry out what a browser has sent: a stamp, a name and a value; `otherwise` gets unknown commands."""
        name, _, value = text.partition(" ")[2].partition("=")
        act = self.acts.get(name, lambda client, value: self.otherwise(client, name, value))
        self.guarded(client, lambda: act(client, value))

    def guarded(self, client: viser.ClientHandle, act: Callable[[], object]) -> None:
        """Call `act`; show an InputError or StorageError to one browser in one line, and log any other exception."""
        try:
            act()
        except (InputError, StorageError) as error:
            text = error_message(error)[:400]
            client.add_notification("Not possible", text, color="red", auto_close_seconds=ERROR_TIME)
        except Exception:
            log.exception("a command could not be carried out")
        self._wake()


def whole(value: str, low: int, high: int) -> int:
    """Return the whole number in a command, limited to the bounds; InputError if the text is no whole number."""
    if not re.fullmatch(r"-?[0-9]{1,9}", value):
        raise InputError(f'"{value[:40]}" is not a whole number', f"use {low} to {high}")
    return min(max(int(value), low), high)
