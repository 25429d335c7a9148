"""Title, labels and colour bar of a picture, written over an image of its scene."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from .camera import Camera, project
from .primitives import ColourBar, Label, Picture

ANCHORS = {"left": "l", "center": "m", "right": "r", "top": "a", "bottom": "d"}  # of a label to Pillow's


def text_scale(size) -> float:
    """Pixels of one point of text: an image 800 pixels high has a 16-pixel font."""
    return min(size[0] / 1000, size[1] / 800)


def margins(size, has_bar: bool) -> tuple[float, float, float, float]:
    """Pixels that rulers, colour bar and title take: left, bottom, right, top."""
    scale = text_scale(size)
    return 90 * scale, 62 * scale, (160 if has_bar else 40) * scale, 104 * scale


def annotate(pixels: np.ndarray, picture: Picture, camera: Camera) -> np.ndarray:
    """A copy of the image (H, W, 3) uint8 with all that is written."""
    image = Image.fromarray(pixels)
    size, scale = image.size, text_scale(image.size)
    draw = ImageDraw.Draw(image)
    font = _font(16 * scale)
    for label, (x, y) in zip(picture.labels, _places(picture, camera, size), strict=True):
        _write(draw, (x, y), label.text, font, label.colour, _anchor(label), _ground(label, picture), scale)
    _title(draw, picture, scale)
    if picture.floor is not None:
        _bar(draw, picture.floor.bar, picture, font, _bar_place(picture, camera, size))
    return np.asarray(image)


def _places(picture: Picture, camera: Camera, size) -> np.ndarray:
    points = np.array([label.position for label in picture.labels]).reshape(-1, 3)
    return project(camera, size, points)


def _anchor(label: Label) -> str:
    vertical, horizontal = label.anchor.split("-")
    return ANCHORS[horizontal] + ANCHORS[vertical]


def _ground(label: Label, picture: Picture):
    """Halo of a text: the background's colour, or white where the ink is black whatever the background."""
    return picture.theme.background if label.colour == picture.theme.foreground else (255, 255, 255)


def _write(draw, place, text: str, font, colour, anchor: str, ground, scale: float) -> None:
    width = max(round(2.5 * scale), 1)
    draw.text(tuple(place), text, fill=colour, font=font, anchor=anchor, stroke_width=width, stroke_fill=ground)


def _title(draw, picture: Picture, scale: float) -> None:
    """Title in the upper left corner, on a plate of the background's colour."""
    if not picture.title:
        return
    place, edge, points = (18 * scale, 13 * scale), 7 * scale, 19 * scale
    long = draw.multiline_textbbox(place, picture.title, font=_font(points))[2]
    font = _font(points * min(1.0, (draw.im.size[0] - 2 * place[0]) / (long - place[0])))
    left, top, right, bottom = draw.multiline_textbbox(place, picture.title, font=font)
    draw.rectangle([left - edge, top - edge, right + edge, bottom + edge], fill=picture.theme.background)
    draw.multiline_text(place, picture.title, font=font, fill=picture.theme.foreground)


def _bar_place(picture: Picture, camera: Camera, size) -> tuple[float, float, float]:
    """Left, top and bottom edge of the colour bar, pixels: beside the map from the top, at the image's edge in 3-D."""
    scale = text_scale(size)
    edge = size[0] - 126 * scale
    if camera.fov:
        return edge, 0.24 * size[1], 0.86 * size[1]
    corners = [(*picture.focus[:2], picture.z_range[0]), (*picture.focus[2:], picture.z_range[0])]
    (_, bottom), (right, top) = project(camera, size, corners)
    return min(right + 46 * scale, edge), top + 46 * scale, bottom


def _bar(draw, bar: ColourBar, picture: Picture, font, place) -> None:
    """Colour bar with ticks, its label above it."""
    scale, theme = font.size / 16, picture.theme
    left, top, bottom = place
    right, rows, stroke = left + 22 * scale, np.arange(round(top), round(bottom)), max(round(scale), 1)
    colours = matplotlib.colormaps[bar.colour_map]((bottom - rows) / (bottom - top), bytes=True)[:, :3]
    for row, colour in zip(rows, colours, strict=True):
        draw.line([(left, row), (right, row)], fill=tuple(map(int, colour)))
    draw.rectangle([left, top, right, bottom], outline=theme.foreground, width=stroke)
    for share, text in bar.ticks:
        row = bottom + share * (top - bottom)
        draw.line([(right, row), (right + 6 * scale, row)], fill=theme.foreground, width=stroke)
        _write(draw, (right + 10 * scale, row), text, font, theme.foreground, "lm", theme.background, scale)
    small = _font(14 * scale)
    draw.multiline_text(
        (left - scale, top - 42 * scale), bar.label.replace(" (", "\n("), fill=theme.foreground, font=small
    )


def _font(points: float) -> ImageFont.FreeTypeFont:
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(folder / "DejaVuSans.ttf", max(points, 6))
