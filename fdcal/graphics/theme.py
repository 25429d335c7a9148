"""Colours that depend on the background of a picture. Colours are RGB from 0 to 255."""

from __future__ import annotations

from dataclasses import dataclass

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours that depend on the background."""

    background: Colour
    foreground: Colour  # of texts, rulers and walls
    grid: Colour  # of the grid on the floor
    text: float = 1.0  # size of the texts, 1 for the usual one
    marks: float = 1.0  # size of the marks, likewise

    @property
    def quiet(self) -> Colour:
        """Of texts that give way to others of the same kind: between foreground and background, still legible."""
        red, green, blue = (round(0.62 * a + 0.38 * b) for a, b in zip(self.foreground, self.background, strict=True))
        return red, green, blue


LIGHT = Theme(background=(255, 255, 255), foreground=(40, 44, 52), grid=(222, 225, 230))
DARK = Theme(background=(26, 27, 30), foreground=(222, 225, 230), grid=(58, 61, 68))
# For a projector: large, and with as much contrast as there is.
LECTURE_LIGHT = Theme(background=(255, 255, 255), foreground=(0, 0, 0), grid=(168, 172, 180), text=1.5, marks=1.4)
LECTURE_DARK = Theme(background=(26, 27, 30), foreground=(255, 255, 255), grid=(112, 116, 124), text=1.5, marks=1.4)


def theme_of(dark: bool, lecture: bool = False) -> Theme:
    """Return the theme of a dark or light background, for a projector or not."""
    if lecture:
        return LECTURE_DARK if dark else LECTURE_LIGHT
    return DARK if dark else LIGHT


def fractions(colour: Colour) -> tuple[float, float, float]:
    """Return a colour as matplotlib and VTK take it: red, green and blue from 0 to 1."""
    red, green, blue = colour
    return red / 255, green / 255, blue / 255
