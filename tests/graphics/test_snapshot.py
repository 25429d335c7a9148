"""The PNG shows the picture at the projected pixels: each microphone's colour at its pixel."""

import sys

import matplotlib
import numpy as np
import pytest
from fields import placed
from PIL import Image

from fdcal.graphics import snapshot
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.heatmap import cost_floor
from fdcal.graphics.marks import ESTIMATE, Layer, layer_height
from fdcal.graphics.picture import compose
from fdcal.graphics.primitives import COLOUR_MAP
from fdcal.model.scene import load_scene
from fdcal.model.validation import StorageError

SIZE = (1300, 1030)  # the legend covers the lowest 27 pixels
VIEWS = ("top", "close")


@pytest.fixture(scope="module")
def measurement(scene):
    """Twelve microphones on a coarse grid, so that no marker hides another."""
    x, y = np.meshgrid(np.linspace(0.52, 0.86, 4), np.linspace(0.38, 0.7, 3))
    return placed(np.stack([x.ravel(), y.ravel()], axis=1), scene.search, [0, 3, 9])


@pytest.fixture(scope="module")
def estimate(measurement):
    moved = measurement.positions + np.array([0.045, 0.02])
    moved[measurement.known] = measurement.known_positions
    return moved


@pytest.fixture(scope="module")
def floor(scene):
    """A map whose low corner is the lowest and whose high corner is the highest value."""
    ny, nx = scene.search.shape[::-1]
    return cost_floor(np.add.outer(np.arange(ny), np.arange(nx)).astype(float), scene.search)


@pytest.fixture(scope="module")
def drawn(painted, scene, measurement, estimate, floor):
    """Function (view, dark) -> picture and its image, drawn once each."""
    images = {}

    def draw(view, dark=False):
        if (view, dark) not in images:
            selected = 5 if dark else None  # the name of a selected microphone may cover a neighbour
            picture = compose(scene, measurement, estimate, selected, floor, "Tiny", dark)
            images[view, dark] = picture, painted(picture, SIZE, view)
        return images[view, dark]

    return draw


def pixels_of(picture, size, view, points):
    """Pixels (P, 2) of a snapshot at which the points (P, 3), metres, appear."""
    return project(camera_for(picture, size, view, snapshot.margins(picture, size)), size, points)


def nearest(image, pixel, colour, reach=1) -> float:
    """Distance of the closest colour to `colour` within `reach` pixels of (column, row), in 0 to 255 levels."""
    column, row = np.round(pixel - 0.5).astype(int)
    patch = image[row - reach : row + reach + 1, column - reach : column + reach + 1].reshape(-1, 3)
    return float(np.abs(patch - colour).max(axis=1).min())


@pytest.mark.parametrize("view", VIEWS)
def test_each_cross_is_red_at_its_estimate(drawn, measurement, estimate, view):
    picture, image = drawn(view)
    free = [n for n in range(12) if n not in measurement.known]
    places = np.column_stack([estimate[free], np.full(len(free), layer_height(Layer.ESTIMATE, picture.marker_radius))])
    for n, pixel in zip(free, pixels_of(picture, SIZE, view, places), strict=True):
        assert nearest(image, pixel, ESTIMATE) < 40, f"no red at microphone {n}"


@pytest.mark.parametrize("view", VIEWS)
def test_the_map_lies_the_right_way_round(drawn, floor, view):
    picture, image = drawn(view)
    inset = 0.25 * floor.size[0] / floor.rgb.shape[1]
    x0, y0 = floor.origin[0] + inset, floor.origin[1] + inset
    x1, y1 = floor.origin[0] + floor.size[0] - inset, floor.origin[1] + floor.size[1] - inset
    low, high, middle = matplotlib.colormaps[COLOUR_MAP]([0.0, 1.0, 0.5], bytes=True)[:, :3]
    corners = pixels_of(picture, SIZE, view, [(x0, y0, 0), (x1, y1, 0), (x0, y1, 0), (x1, y0, 0)])
    for pixel, colour in zip(corners, (low, high, middle, middle), strict=True):
        assert nearest(image, pixel, colour, reach=3) < 12


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("size", [SIZE, (400, 700), (300, 300)])
@pytest.mark.parametrize("name", ["tiny", "ball3d"])
def test_the_whole_search_domain_is_in_the_image(name, view, size):
    scene = load_scene(name)
    low, dimension = np.array(scene.search.origin), len(scene.search.origin)
    corners = low + scene.search.size * np.array(list(np.ndindex((2,) * dimension)))
    heights = np.zeros((len(corners), 3 - dimension))
    picture = compose(scene, placed(corners, scene.search))
    pixels = pixels_of(picture, size, view, np.column_stack([corners, heights]))
    assert (pixels >= 0).all() and (pixels <= size).all()
    assert np.ptp(pixels, axis=0).max() > 0.35 * min(size), "it fills a good part of the image"


@pytest.mark.parametrize("dark", [False, True])
def test_background_and_title(drawn, dark):
    picture, image = drawn("top", dark)
    assert nearest(image, np.array([SIZE[0] - 8.0, SIZE[1] - 8.0]), picture.theme.background, reach=2) == 0
    title = image[5:45, 10:120]
    assert np.abs(title - picture.theme.foreground).max(axis=-1).min() < 20, "the title is not written"


def test_colour_bar_shows_the_whole_map(drawn):
    _, image = drawn("3d")
    strip = {tuple(pixel) for pixel in image[:, int(SIZE[0] * 0.87) : -20].reshape(-1, 3)}
    ends = matplotlib.colormaps[COLOUR_MAP]([0.01, 0.99], bytes=True)[:, :3].astype(int)
    for end in ends:
        assert min(np.abs(np.array(pixel) - end).max() for pixel in strip) <= 3


def test_the_same_picture_gives_the_same_bytes(drawn, scene, measurement, estimate, floor, tmp_path):
    _, image = drawn("top")
    path = tmp_path / "picture.png"
    path.write_bytes(snapshot.render_png(compose(scene, measurement, estimate, None, floor, "Tiny"), SIZE, "top"))
    np.testing.assert_array_equal(Image.open(path).convert("RGB"), image)


def test_a_crash_of_the_gl_library_is_reported_in_one_line(scene, measurement, monkeypatch, tmp_path):
    """If the child process dies, as with VTK without a GL library, there is an error and no file."""
    dying = tmp_path / "python"
    dying.write_text("#!/bin/sh\nkill -SEGV $$\n")
    dying.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(dying))
    with pytest.raises(StorageError, match="apt-get install") as caught:
        snapshot.render_png(compose(scene, measurement), SIZE)
    assert "\n" not in str(caught.value) and not (tmp_path / "picture.png").exists()
