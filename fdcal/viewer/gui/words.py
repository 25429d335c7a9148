"""Large words at the top of the canvas, with buttons below them."""

from collections.abc import Callable, Mapping
from html import escape
from types import MappingProxyType

from .overlay import Overlay

# All panels and all other regions are hidden, which would speak of a session that does not exist yet.
ALONE = (
    "<style>[data-dock-group], [data-floating-window], #fdcal > :not([data-region=words]) {visibility: hidden}</style>"
)
Buttons = Mapping[str, Callable[[], object]]  # by label, what is called on viser's event loop when one is pressed
NO_BUTTONS: Buttons = MappingProxyType({})


class CanvasWords:
    """Owns the region of the words."""

    def __init__(self, overlay: Overlay):
        self._overlay, self._buttons, self._alone = overlay, NO_BUTTONS, False
        overlay.on("words", lambda client, label: self.press(label))
        overlay.on("dismiss", lambda client, value: self.dismiss())

    def press(self, label: str) -> None:
        """Do what a button does; nothing for a button that has been removed."""
        self._buttons.get(label, lambda: None)()

    def dismiss(self) -> None:
        """Press the first button of words that stand alone, and take others away."""
        if self._alone:
            self.press(next(iter(self._buttons), ""))
        else:
            self.show("")

    def show(
        self, words: str, detail: str = "", buttons: Buttons = NO_BUTTONS, alone: bool = False, quiet: bool = False
    ) -> None:
        """Show words, a smaller line below them, and buttons; nothing for "".

        `alone`: whether all else than the scene is hidden; any key then presses the first button, and not Escape alone;
        `quiet`: whether the buttons are no invitation, as without a line below the words.
        """
        self._buttons, self._alone = buttons, alone
        text = f"<div>{escape(words)}</div>" if words else ""
        text += f"<p>{escape(detail)}</p>" if detail else ""
        labels = [escape(label, quote=True) for label in buttons]
        kind = 'class="first"' if detail and not quiet else ""
        kind += " data-any" if alone else ""
        text += "".join(f'<button {kind} data-do="words={label}">{label}</button>' for label in labels)
        self._overlay.show("words", (ALONE if alone else "") + text)
