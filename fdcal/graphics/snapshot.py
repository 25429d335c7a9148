"""A picture drawn off-screen by pyvista, to a PNG file or bytes, with title, labels, legend and colour bar.

The legend lists exactly the marks that are drawn. Page and PNG use the same entries in the same order.

A child process draws, so that a crash of the GL library does not end the caller, and VTK's memory is released. Only
the main thread of the child uses GL.
"""

import io
import os
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..model.libraries import ProcessError, call
from ..model.validation import StorageError
from .camera import Camera, camera_for, project
from .heatmap import relief_grid
from .marks import MARKS, Mark, symbol
from .picture import HEIGHT_TICKS
from .primitives import ColourBar, Label, Picture, by_rank, fractions

REMEDY = "pictures need a GL library; install one with: apt-get install -y libegl1 libgl1-mesa-dri"
VERSIONS = "install the versions of pyvista, vtk and pillow that fdcal needs: pip install -U fdcal"
MISMATCHED = re.compile(r"^(ImportError|ModuleNotFoundError|AttributeError|TypeError)\b")  # errors of libraries
TIMEOUT = 120.0  # s, longest time for one picture


def render_png(picture: Picture, size: Sequence[int] = (1280, 800), view: str = "top") -> bytes:
    """Return the bytes of the PNG, drawn by a child process; StorageError if no suitable GL library works."""
    try:
        return call(drawn_png, picture, tuple(size), view, seconds=TIMEOUT)
    except ProcessError as error:
        remedy = VERSIONS if MISMATCHED.match(str(error)) and "shared object" not in str(error) else REMEDY
        raise StorageError(f"the picture could not be drawn ({error}); {remedy}") from error


MIN_LINE_WIDTH = 0.75  # pixels
SUPERSAMPLED = 2.5  # factor for the width of lines in an image that is drawn larger and then reduced
PEELS = 12  # number of layers of translucent surfaces that are sorted by depth


def drawn_png(picture: Picture, size: tuple[int, int], view: str) -> bytes:
    """Return the bytes of the PNG, drawn on the main thread of this process; a wrong GL library may crash it."""
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    if picture.surfaces:  # with multisampling, VTK does not sort translucent surfaces
        plotter.enable_anti_aliasing("ssaa")
        plotter.enable_depth_peeling(PEELS, occlusion_ratio=0.0)
    else:
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
    plotter.set_background(fractions(picture.theme.background))
    hidden, camera = HEIGHT_TICKS if view == "top" else None, camera_for(picture, size, view, margins(picture, size))
    if (floor := picture.floor) is not None:
        if floor.heights is not None:
            ground: Any = pyvista.StructuredGrid(*np.moveaxis(relief_grid(floor, floor.heights), 2, 0))
            rgb = np.pad(floor.rgb, ((1, 1), (1, 1), (0, 0)), mode="edge")
            ground.point_data["rgb"] = rgb.transpose(1, 0, 2).reshape(-1, 3)
        else:
            rows, columns = floor.rgb.shape[:2]
            step, corner = (floor.size[0] / columns, floor.size[1] / rows, 1), (*floor.origin, floor.height)
            ground = pyvista.ImageData(dimensions=(columns + 1, rows + 1, 1), spacing=step, origin=corner)
            ground.cell_data["rgb"] = floor.rgb.reshape(-1, 3)
        plotter.add_mesh(ground, scalars="rgb", rgb=True, lighting=False)
    for mesh in picture.meshes:
        triangles = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces)
        plotter.add_mesh(triangles, color=mesh.colour, opacity=mesh.opacity, lighting=False)
    for lines in picture.lines:
        if len(lines.segments) and lines.name != hidden:
            polylines = pyvista.line_segments_from_points(lines.segments.reshape(-1, 3))
            width = max(lines.width * text_scale(size), MIN_LINE_WIDTH) * (SUPERSAMPLED if picture.surfaces else 1)
            plotter.add_mesh(polylines, color=lines.colour, line_width=width, lighting=False)
    for surface in picture.surfaces:
        triangles = pyvista.PolyData.from_regular_faces(surface.vertices, surface.faces)
        triangles.active_texture_coordinates = surface.places
        texture = pyvista.Texture(np.ascontiguousarray(surface.texture[::-1]))  # its first row is at the top
        plotter.add_mesh(triangles, texture=texture, lighting=False)
    eye = plotter.camera
    eye.position, eye.focal_point, eye.up = camera.position, camera.look_at, camera.up
    if camera.fov:
        eye.view_angle = float(np.degrees(camera.fov))
    else:
        eye.parallel_projection, eye.parallel_scale = True, camera.height / 2
    plotter.renderer.ResetCameraClippingRange()
    pixels = np.asarray(plotter.screenshot(return_img=True))
    plotter.close()
    png = io.BytesIO()
    Image.fromarray(annotate(np.ascontiguousarray(pixels[..., :3]), picture, camera)).save(png, format="png")
    return png.getvalue()


def legend_of(picture: Picture) -> tuple[Mark, ...]:
    """Return the marks of a legend: those that can be seen, in the order of MARKS."""
    seen = {part.name for part in picture.lines if len(part.segments)}
    seen |= {part.name for part in picture.meshes if len(part.faces)}
    seen |= {"isosurfaces"} if picture.surfaces else set()
    captions, circle = dict(picture.captions), MARKS["microphones/true"]
    # the square of a known microphone is inside its circle
    changes = {"microphones/known": {"size": 0.29, "below": circle}} if circle.name in seen else {}
    return tuple(
        replace(mark, text=captions.get(name, mark.text), **changes.get(name, {}))
        for name, mark in MARKS.items()
        if name in seen and mark.text
    )


SYMBOL, GAP, ROW = 18, 22, 27  # edge of a symbol, space between entries and height of a row, at a 16-pixel font


ANCHORS = {  # anchor of Pillow for each anchor of a label
    f"{one}-{other}": across + up
    for one, up in (("top", "a"), ("center", "m"), ("bottom", "d"))
    for other, across in (("left", "l"), ("center", "m"), ("right", "r"))
}
SMALLEST_FONT = 6  # pixels
LEGEND_EDGE = 20  # pixels left and right of the legend, at a 16-pixel font


def text_scale(size: tuple[int, int]) -> float:
    """Return the scale of texts and lines: 1 in an image of 1000 x 800 pixels, whose font has 16 pixels."""
    return min(size[0] / 1000, size[1] / 800)


def font(pixels: float) -> ImageFont.FreeTypeFont:
    """Return the font of all texts, with a size in pixels."""
    folder = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    return ImageFont.truetype(str(folder / "DejaVuSans.ttf"), max(pixels, SMALLEST_FONT))


def margins(picture: Picture, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return the margins for rulers, legend, colour bar and title, pixels: left, bottom, right, top."""
    scale, right = text_scale(size), 40 if picture.bar is None else 160
    return 90 * scale, (62 + ROW * len(_legend_rows(picture, size))) * scale, right * scale, 104 * scale


def _legend_rows(picture: Picture, size: tuple[int, int]) -> list[list[tuple[Mark, float]]]:
    """Return the rows of a legend that fits into an image: entries, each with the distance to the next one, pixels."""
    scale = text_scale(size)
    letters, rows, used = font(16 * scale), list[list[tuple[Mark, float]]](), 0.0
    for entry in legend_of(picture):
        length = (SYMBOL * 1.35 + GAP) * letters.size / 16 + letters.getlength(entry.text)
        if not rows or used + length > size[0] - 2 * LEGEND_EDGE * scale:
            rows.append([])
            used = 0.0
        rows[-1].append((entry, length))
        used += length
    return rows


def annotate(pixels: np.ndarray, picture: Picture, camera: Camera) -> np.ndarray:
    """Return a copy of an image (H, W, 3), made with `camera`, with all texts, the legend and the colour bar."""
    image = Image.fromarray(pixels)
    size, scale = image.size, text_scale(image.size)
    draw = ImageDraw.Draw(image)
    letters = font(16 * scale)
    outlined: dict[str, Any] = {"font": letters, "fill": picture.theme.foreground}
    outlined |= {"stroke_width": max(round(2.5 * scale), 1), "stroke_fill": picture.theme.background}
    for label, place in uncovered(draw, picture, camera, letters):
        draw.text(place, label.text, anchor=ANCHORS[label.anchor], **outlined)
    if picture.title:  # drawn in the upper left corner, on a rectangle of the background's colour
        place, edge, height = (18 * scale, 13 * scale), 7 * scale, 19 * scale
        end = draw.multiline_textbbox(place, picture.title, font=font(height))[2]
        large = font(height * min(1.0, (size[0] - 2 * place[0]) / (end - place[0])))
        left, top, right, bottom = draw.multiline_textbbox(place, picture.title, font=large)
        draw.rectangle([left - edge, top - edge, right + edge, bottom + edge], fill=picture.theme.background)
        draw.multiline_text(place, picture.title, font=large, fill=picture.theme.foreground)
    rows, edge = _legend_rows(picture, size), round(SYMBOL * scale)
    first = size[1] - len(rows) * ROW * scale - LEGEND_EDGE / 4 * scale
    for i, row in enumerate(rows):
        x, middle = LEGEND_EDGE * scale, first + (i + 0.5) * ROW * scale
        for entry, length in row:
            stamp = symbol(entry, edge)
            image.paste(stamp, (round(x), round(middle - edge / 2)), stamp)
            draw.text((x + 1.35 * edge, middle), entry.text, fill=picture.theme.foreground, font=letters, anchor="lm")
            x += length
    if picture.bar is not None:
        _draw_bar(draw, picture, picture.bar, camera, outlined)
    return np.asarray(image)


def uncovered(draw, picture: Picture, camera: Camera, letters) -> list[tuple[Label, tuple[float, float]]]:
    """Return the texts of a scene and their pixels, without those that overlap one of higher priority."""
    labels, taken, seen = by_rank(picture.labels), [], []
    points = np.array([label.position for label in labels]).reshape(-1, 3)
    places = project(camera, draw.im.size, points, [label.lift for label in labels]).tolist()
    heights = [y for label, (_, y) in zip(labels, places, strict=True) if label.name.startswith("frame/z")]
    upright = bool(heights) and max(heights) - min(heights) > 4 * letters.size
    for label, (x, y) in zip(labels, places, strict=True):
        if label.name.startswith("frame/z" if not upright else "frame/range"):
            continue
        a, b, c, d = draw.textbbox((x, y), label.text, font=letters, anchor=ANCHORS[label.anchor])
        if all(a > right or c < left or b > bottom or d < top for left, top, right, bottom in taken):
            taken.append((a, b, c, d))
            seen.append((label, (x, y)))
    return seen


def _draw_bar(draw, picture: Picture, bar: ColourBar, camera: Camera, outlined: dict[str, Any]) -> None:
    """Draw the colour bar with its ticks and its label: beside the map or, in 3-D, at the edge of the image.

    `outlined`: font and colours of its numbers, as Pillow takes them.
    """
    scale, size, theme = outlined["font"].size / 16, draw.im.size, picture.theme
    left, top, bottom = size[0] - 126 * scale, 0.24 * size[1], 0.86 * size[1]
    if not camera.fov:
        corners = [(*picture.focus[:2], picture.z_range[0]), (*picture.focus[2:], picture.z_range[0])]
        (_, bottom), (edge, highest) = project(camera, size, corners)
        left, top = min(edge + 46 * scale, left), highest + 46 * scale
    right, rows, stroke = left + 22 * scale, np.arange(round(top), round(bottom)), max(round(scale), 1)
    colours = matplotlib.colormaps[bar.colour_map]((bottom - rows) / (bottom - top), bytes=True)[:, :3]
    for row, colour in zip(rows, colours, strict=True):
        draw.line([(left, row), (right, row)], fill=tuple(map(int, colour)))
    draw.rectangle([left, top, right, bottom], outline=theme.foreground, width=stroke)
    for fraction, text in bar.ticks:
        row = bottom + fraction * (top - bottom)
        draw.line([(right, row), (right + 6 * scale, row)], fill=theme.foreground, width=stroke)
        draw.text((right + 10 * scale, row), text, anchor="lm", **outlined)
    label = bar.label.replace(" (", "\n(").replace("), ", "),\n").replace(" the layer z", "\nthe layer\nz")
    draw.multiline_text((left - scale, top - 8 * scale), label, theme.foreground, font(14 * scale), anchor="ld")
