"""A picture drawn off-screen by pyvista, to a PNG file or bytes.

A child process draws, so that a crash of the GL library does not end the caller and VTK does not use its memory. Only
the main thread of the child uses GL.
"""

import io
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..model.libraries import ProcessError, call
from ..model.validation import InputError, StorageError, require_choice
from .annotations import annotate, margins, text_scale
from .camera import VIEWS, Camera, camera_for
from .heatmap import relief_grid
from .picture import HEIGHT_TICKS
from .primitives import Floor, Picture, fractions

MIN_EDGE, MAX_EDGE = 64, 8192  # pixels
REMEDY = "pictures need a GL library; install one with: apt-get install -y libegl1 libgl1-mesa-dri"
VERSIONS = "install the versions of pyvista, vtk and pillow that fdcal needs: pip install -U fdcal"
MISFIT = re.compile(r"^(ImportError|ModuleNotFoundError|AttributeError|TypeError)\b")  # of libraries that do not fit
TIMEOUT = 120.0  # s


def render_png(picture: Picture, size: Sequence[int] = (1280, 800), view: str = "top") -> bytes:
    """Return the bytes of the PNG, drawn by a child process; StorageError without a GL library of a fitting version."""
    if len(size) != 2 or not all(MIN_EDGE <= length <= MAX_EDGE for length in size):
        text = "x".join(str(length) for length in size)
        problem = f"size = {text} pixels is not usable"
        remedy = f"give <size> as two lengths from {MIN_EDGE} to {MAX_EDGE}, as in 1280x800"
        raise InputError(problem, remedy, key="size")
    require_choice("view", view, VIEWS)
    try:
        return call(drawn_png, picture, tuple(size), view, seconds=TIMEOUT)
    except ProcessError as error:
        remedy = VERSIONS if MISFIT.match(str(error)) and "shared object" not in str(error) else REMEDY
        raise StorageError(f"the picture could not be drawn ({error}); {remedy}") from error


MIN_LINE_WIDTH = 0.75  # pixels
SUPERSAMPLED = 2.5  # width of a line, where the image is drawn larger and then reduced
PEELS = 12  # layers of translucent surfaces that are sorted
RECTANGLE, UNIT_SQUARE = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def render(
    picture: Picture, path: str | Path, size: tuple[int, int] = (1280, 800), view: str = "top", force: bool = False
) -> None:
    """Write the picture to a PNG file; `force`: whether to overwrite an existing one."""
    from ..model.storage import write_atomically

    png = render_png(picture, size, view)
    write_atomically(path, lambda temporary: temporary.write_bytes(png), force=force)


def camera_of(picture: Picture, size: tuple[int, int], view: str) -> Camera:
    """Return the camera of a snapshot: `camera_for` with margins for rulers, legend, title and colour bar."""
    return camera_for(picture, size, view, margins(picture, size))


def drawn_png(picture: Picture, size: tuple[int, int], view: str) -> bytes:
    """Return the bytes of the PNG, drawn on the main thread of this process, which a wrong GL library may crash."""
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    import pyvista
    from PIL import Image

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    if picture.surfaces:  # VTK sorts no translucent surfaces with the other kind of anti-aliasing
        plotter.enable_anti_aliasing("ssaa")
        plotter.enable_depth_peeling(PEELS, occlusion_ratio=0.0)
    else:
        plotter.enable_anti_aliasing("msaa", multi_samples=8)
    plotter.set_background(fractions(picture.theme.background))
    hidden, camera = HEIGHT_TICKS if view == "top" else None, camera_of(picture, size, view)
    if picture.floor is not None:
        _add_floor(plotter, pyvista, picture.floor)
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


def _add_floor(plotter: Any, pyvista: Any, floor: Floor) -> None:
    if floor.heights is not None:
        surface = pyvista.StructuredGrid(*np.moveaxis(relief_grid(floor, floor.heights), 2, 0))
        rgb = np.pad(floor.rgb, ((1, 1), (1, 1), (0, 0)), mode="edge")
        surface.point_data["rgb"] = rgb.transpose(1, 0, 2).reshape(-1, 3)
    else:
        rows, columns = floor.rgb.shape[:2]
        step, corner = (floor.size[0] / columns, floor.size[1] / rows, 1), (*floor.origin, floor.height)
        surface = pyvista.ImageData(dimensions=(columns + 1, rows + 1, 1), spacing=step, origin=corner)
        surface.cell_data["rgb"] = floor.rgb.reshape(-1, 3)
    plotter.add_mesh(surface, scalars="rgb", rgb=True, lighting=False)
