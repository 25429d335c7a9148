"""The texts of a picture, which the page draws as HTML over the canvas.

viser draws a text in black on a white box, and the numbers of a ruler as large as the room makes them. `server/page.js`
draws them in the type of the page, outlined, and leaves out those that would cover one that comes before.
"""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from ...graphics.primitives import Colour, Label, Theme, by_rank, halo_of


def labels_html(labels: Iterable[Label], theme: Theme) -> str:
    """Return the texts as elements with place and lift in `data-at`, metres; what comes first covers the others."""
    return "".join(_element(label, theme) for label in by_rank(labels))


def _element(label: Label, theme: Theme) -> str:
    place = ",".join(f"{x:.4f}" for x in (*label.position, label.lift))
    style = f"color:{_css(label.colour)};--halo:{_css(halo_of(label.colour, theme))}"
    kind, axis = ("number", label.name.partition("/")[2][:1]) if label.name.startswith("frame/") else ("name", "")
    return (
        f"<span class='{kind}' data-at='{place}' data-anchor='{label.anchor}' data-axis='{axis}' style='{style}'>"
        f"{escape(label.text)}</span>"
    )


def _css(colour: Colour) -> str:
    return f"rgb{colour}".replace(" ", "")
