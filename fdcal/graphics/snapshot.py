"""A picture drawn off-screen by pyvista, to a PNG file.

render     writes the file; a child process draws (fdcal.graphics.snapshot_process)
draw       draws; for that child, whose main thread is the only one to touch GL
pixels_of  where points of the picture appear in it
"""

from __future__ import annotations

import io
import os
import pickle
import sys
from pathlib import Path

import numpy as np

from ..model.validation import InputError, require_choice
from .annotations import annotate, margins, text_scale
from .camera import VIEWS, Camera, camera_for, project
from .primitives import Mesh, Picture
from .snapshot_process import check_size, render_png


def render(picture: Picture, path, size=(1280, 800), view: str = "top", force: bool = False) -> None:
    """Write the picture to a PNG file of `size` (width, height) pixels, seen from the "top", in "3d" or "close".

    Raises InputError (bad size or view, file exists without `force`) and StorageError (no GL library, cannot write).
    """
    from ..model.storage import write_atomically

    check_size(size)
    require_choice("view", view, VIEWS)
    path = Path(path)
    if path.exists() and not force:
        raise InputError(f"{path} exists; give --force to overwrite it or another name")
    png = render_png(picture, size, view)
    write_atomically(path, lambda temporary: Path(temporary).write_bytes(png), force=force)


def camera_of(picture: Picture, size, view: str) -> Camera:
    """Camera of a snapshot: `camera_for` with room for rulers, title and colour bar."""
    return camera_for(picture, size, view, margins(size, picture.floor is not None))


def pixels_of(picture: Picture, size, view: str, points) -> np.ndarray:
    """Pixels (column, row) of a snapshot at which the points (P, 3), metres, appear : (P, 2) float64."""
    return project(camera_of(picture, size, view), size, points)


def draw(picture: Picture, size, view: str) -> np.ndarray:
    """The image (H, W, 3) uint8; to be called on the main thread of a process with a GL library."""
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkEGLRenderWindow"
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(size), lighting="none")
    plotter.enable_anti_aliasing("msaa", multi_samples=8)
    plotter.set_background([channel / 255 for channel in picture.theme.background])
    camera = camera_of(picture, size, view)
    if picture.floor is not None:
        _add_floor(plotter, pyvista, picture.floor)
    for solid in picture.meshes:
        _add_solid(plotter, pyvista, solid)
    for lines in picture.lines:
        if len(lines.segments):
            mesh = pyvista.line_segments_from_points(lines.segments.reshape(-1, 3))
            width = max(lines.width * text_scale(size), 0.75)
            plotter.add_mesh(mesh, color=lines.colour, line_width=width, lighting=False)
    _aim(plotter, camera)
    pixels = plotter.screenshot(return_img=True)
    plotter.close()
    return annotate(np.ascontiguousarray(pixels[..., :3]), picture, camera)


def _add_floor(plotter, pyvista, floor) -> None:
    rows, columns = floor.rgb.shape[:2]
    step = floor.size[0] / columns, floor.size[1] / rows
    if floor.heights is not None:
        x, y = (o + s * (np.arange(n) + 0.5) for o, s, n in zip(floor.origin, step, (columns, rows), strict=True))
        surface = pyvista.StructuredGrid(*np.meshgrid(x, y), floor.height + floor.heights.astype(float))
        surface.point_data["rgb"] = floor.rgb.transpose(1, 0, 2).reshape(-1, 3)
        plotter.add_mesh(surface, scalars="rgb", rgb=True, lighting=False, opacity=floor.opacity)
        return
    corner = (*floor.origin, floor.height)
    grid = pyvista.ImageData(dimensions=(columns + 1, rows + 1, 1), spacing=(*step, 1), origin=corner)
    grid.cell_data["rgb"] = floor.rgb.reshape(-1, 3)
    plotter.add_mesh(grid, scalars="rgb", rgb=True, lighting=False, opacity=floor.opacity)


def _add_solid(plotter, pyvista, solid: Mesh) -> None:
    mesh = pyvista.PolyData.from_regular_faces(solid.vertices, solid.faces)
    plotter.add_mesh(mesh, color=solid.colour, opacity=solid.opacity, lighting=False)


def _aim(plotter, camera: Camera) -> None:
    eye = plotter.camera
    eye.position, eye.focal_point, eye.up = camera.position, camera.look_at, camera.up
    if camera.fov:
        eye.view_angle = float(np.degrees(camera.fov))
    else:
        eye.parallel_projection, eye.parallel_scale = True, camera.height / 2
    plotter.renderer.ResetCameraClippingRange()


def main() -> None:
    """Picture, size and view as a pickle on standard input, PNG on standard output."""
    from PIL import Image

    picture, size, view = pickle.load(sys.stdin.buffer)
    png = io.BytesIO()
    Image.fromarray(draw(picture, size, view)).save(png, format="png")
    sys.stdout.buffer.write(png.getvalue())


if __name__ == "__main__":
    main()
