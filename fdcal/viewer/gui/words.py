"""Large words on the canvas, above what is drawn, with buttons below them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from html import escape
from itertools import zip_longest
from types import MappingProxyType

import viser

# The panel has neither frame nor tabs and lets the pointer through to the canvas, its buttons excepted.
STYLE = (
    "<style>[data-floating-window]:has(.fdcal-words) {left: 50% !important; top: 0 !important; width: auto !important;"
    " max-width: 92vw; height: auto !important; transform: translateX(-50%) !important; background: none !important;"
    " border: none !important; box-shadow: none !important; backdrop-filter: none !important; pointer-events: none}"
    "[data-floating-window]:has(.fdcal-words) * {background: none; box-shadow: none !important;"
    " border-color: transparent !important; overflow: visible !important}"
    "[data-floating-window]:has(.fdcal-words) [role=tablist] {display: none !important}"
    "[data-floating-window]:has(.fdcal-words:empty) {display: none !important}"
    "[data-floating-window]:has(.fdcal-words) button {pointer-events: auto; width: auto; min-width: 9em;"
    " margin: 0 auto; display: block; background: #1c7ed6}"
    ".fdcal-words {text-align: center; padding: 0.5em 0.3em 0.3em; color: var(--mantine-color-text);"
    " text-shadow: 0 0 4px var(--mantine-color-body), 0 0 4px var(--mantine-color-body),"
    " 0 0 9px var(--mantine-color-body), 0 0 9px var(--mantine-color-body)}"
    ".fdcal-words b {display: block; font-size: clamp(20px, 3vw, 36px); line-height: 1.25; font-weight: 650}"
    ".fdcal-words span {font-size: clamp(13px, 1.3vw, 17px)}</style>"
)
# All other panels are hidden, which would speak of a session that does not exist yet.
ALONE = (
    "<style>[data-dock-group]:not(:has(.fdcal-words)), [data-floating-window]:not(:has(.fdcal-words))"
    " {visibility: hidden}</style>"
)
MAX_BUTTONS = 2
Buttons = Mapping[str, Callable[[], object]]  # by label, what is called on viser's event loop when one is pressed
NO_BUTTONS: Buttons = MappingProxyType({})


class CanvasWords:
    """Owns the words and their buttons."""

    def __init__(self, gui: viser.GuiApi):
        panel = gui.add_panel()
        with panel.add_tab("Words"):
            self._text = gui.add_html(_html("", "", False))
            self._buttons = [gui.add_button("", visible=False) for _ in range(MAX_BUTTONS)]
        panel.float(x=400.0, y=8.0, width=480.0)
        panel.expand()
        self._acts: list[Callable[[], object]] = [lambda: None] * MAX_BUTTONS
        for number, button in enumerate(self._buttons):
            button.on_click(self._responder(number))

    def _responder(self, number: int):
        async def respond(event) -> None:
            if event.client is not None:
                self._acts[number]()

        return respond

    def show(self, words: str, detail: str = "", buttons: Buttons = NO_BUTTONS, alone: bool = False) -> None:
        """Show words, a smaller line below them, and buttons; nothing for "".

        `buttons`: MAX_BUTTONS at most; `alone`: whether all other panels are hidden.
        """
        self._text.content = _html(words, detail, alone)
        for number, (button, label) in enumerate(zip_longest(self._buttons, buttons)):
            button.visible = label is not None
            if label is not None:
                button.label, self._acts[number] = label, buttons[label]


def _html(words: str, detail: str, alone: bool) -> str:
    text = (f"<b>{escape(words)}</b>" if words else "") + (f"<span>{escape(detail)}</span>" if detail else "")
    return f"{STYLE}{ALONE if alone else ''}<div class='fdcal-words'>{text}</div>"
