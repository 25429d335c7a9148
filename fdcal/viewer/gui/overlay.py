"""Regions on the canvas, filled with HTML, and the commands of what is pressed there.

`server/page.js` draws them in each browser. The HTML travels in controls that nobody sees. An element with `data-do`
sends its value as a command: `<button data-do="play">` sends "play", `<input type="range" data-do="modes">` "modes=12".
A region that only changes in part keeps the elements that stay, so that a slider can be dragged meanwhile.
"""

import logging
import re
import secrets
from collections.abc import Callable, Mapping
from html import escape
from types import MappingProxyType

import viser

from ...model.validation import InputError, StorageError
from ..server import REGIONS, content
from .html import error_message

CHANNEL = "fdcal command"  # label of the control of the commands, as in page.js
ERROR_TIME = 8.0  # s that a refused command is shown

Act = Callable[[viser.ClientHandle, str], object]

log = logging.getLogger(__name__)


class Overlay:
    """Owns the hidden controls, and knows what each command does."""

    def __init__(self, gui: viser.GuiApi):
        self._regions = {name: gui.add_html(content(name), visible=False) for name in REGIONS}
        self._acts: dict[str, Act] = {}
        self._start = secrets.token_hex(8)  # of this server: a browser tells by it whether its address is still of use
        self.channel = gui.add_text(CHANNEL, "", visible=False)

        @self.channel.on_update
        async def _(event) -> None:
            if event.client is not None:
                self.receive(event.client, event.target.value)

    def greet(self, client: viser.ClientHandle) -> None:
        """Tell a browser that its commands are heard: viser drops what it sends before it has sent its camera."""
        client.gui.add_html(content("greeting", self._start), visible=False)

    def show(self, region: str, html: str) -> None:
        """Fill a region; any thread. All texts in `html` are escaped already."""
        if self._regions[region].content != (wanted := content(region, html)):
            self._regions[region].content = wanted

    def on(self, name: str, act: Act) -> None:
        """Call `act(client, value)` for a command, in place of what it did before; on viser's event loop."""
        self._acts[name] = act

    def receive(self, client: viser.ClientHandle, text: str) -> None:
        """Carry out what a browser has sent: a stamp, a name and a value; an unknown command does nothing."""
        name, _, value = text.partition(" ")[2].partition("=")
        if name in self._acts:
            self.guarded(client, lambda: self._acts[name](client, value))

    def guarded(self, client: viser.ClientHandle, act: Callable[[], object]) -> None:
        """Call `act`; an error that it raises is shown to one browser in one line."""
        try:
            act()
        except (InputError, StorageError) as error:
            text = error_message(error)[:400]
            client.add_notification("Not possible", text, color="red", auto_close_seconds=ERROR_TIME)
        except Exception:
            log.exception("a command could not be carried out")


def whole(value: str, low: int, high: int) -> int:
    """Return a whole number of a command, bounded. Raises InputError: it is none."""
    if not re.fullmatch(r"-?[0-9]{1,9}", value):
        raise InputError(f'"{value[:40]}" is no whole number', f"use {low} to {high}", value=value)
    return min(max(int(value), low), high)


Buttons = Mapping[str, Callable[[], object]]  # by label, what is called on viser's event loop when one is pressed
NO_BUTTONS: Buttons = MappingProxyType({})


class CanvasWords:
    """Owns the region of the words."""

    def __init__(self, overlay: Overlay):
        self._overlay, self._buttons = overlay, NO_BUTTONS
        overlay.on("words", lambda client, label: self.press(label))
        overlay.on("dismiss", lambda client, value: self.show(""))

    def press(self, label: str) -> None:
        """Do what a button does; nothing for a button that has been removed."""
        self._buttons.get(label, lambda: None)()

    def show(self, words: str, detail: str = "", buttons: Buttons = NO_BUTTONS) -> None:
        """Show words, a smaller line below them, and buttons, which with that line invite; nothing for ""."""
        self._buttons = buttons
        text = f"<div>{escape(words)}</div>" if words else ""
        text += f"<p>{escape(detail)}</p>" if detail else ""
        labels = [escape(label, quote=True) for label in buttons]
        kind = 'class="first"' if detail else ""
        text += "".join(f'<button {kind} data-do="words={label}">{label}</button>' for label in labels)
        self._overlay.show("words", text)
