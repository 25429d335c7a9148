"""The legend names exactly the marks that a picture draws, alike on the page and in the PNG."""

import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest
from fields import placed
from PIL import Image

from fdcal.cost.scale import Minima
from fdcal.graphics import picture as overlays
from fdcal.graphics.camera import camera_for
from fdcal.graphics.heatmap import cost_floor
from fdcal.graphics.marks import EDGE, MARKS, symbol, symbol_svg
from fdcal.graphics.picture import compose, static_picture, with_estimate, with_floor
from fdcal.graphics.primitives import Curve
from fdcal.graphics.snapshot import annotate, legend_of, margins
from fdcal.graphics.volume import volume_of
from fdcal.model.settings import Search
from fdcal.viewer.html import canvas_legend

SIZE = (1280, 800)
PLANE = [name for name, mark in MARKS.items() if mark.text and name != "isosurfaces"]  # a plane array has these marks
# These marks have labels in the scene, or are parts of another mark.
SCENERY = ("room/", "frame", "source", "microphones/stems", "selected/", "ball/")


@pytest.fixture(scope="module")
def measurement(scene):
    return placed(np.random.default_rng(5).uniform([0.5, 0.35], [0.9, 0.75], (8, 2)), scene.search, [0, 1])


@pytest.fixture(scope="module")
def estimate(measurement):
    moved = measurement.positions + np.array([0.04, 0.0])
    moved[measurement.known] = measurement.known_positions
    return moved


@pytest.fixture(scope="module")
def floor(scene):
    ny, nx = scene.search.shape[::-1]
    minima = Minima(np.array([scene.search.origin]), np.array([[0.7, 0.6]]), 1, None)
    return cost_floor(np.add.outer(np.arange(ny), np.arange(nx)) + 1.0, scene.search, minima=minima)


@pytest.fixture(scope="module")
def full(scene, measurement, estimate, floor):
    """A picture with every mark."""
    line = np.array([[[0.5, 0.4], [0.9, 0.5]]], np.float32)
    floor = replace(floor, curves=tuple(Curve(f"same in mode {mode}", line) for mode in (1, 2, 3)))
    picture = with_estimate(static_picture(scene, measurement), measurement, estimate, 5, floor, None, [4])
    picture = with_floor(picture, floor)
    picture = overlays.with_ball(picture, estimate[5], floor)
    picture = overlays.with_trails(picture, np.stack([estimate, estimate + 0.05]))
    picture = overlays.with_ellipses(picture, estimate, np.tile(0.02 * np.eye(2), (8, 1, 1)))
    return overlays.with_faulty_channels(picture, estimate, [4])


def names_of(picture):
    return [entry.name for entry in legend_of(picture)]


def test_every_mark_has_an_entry_and_every_part_of_a_picture_is_scenery_or_in_the_legend(full):
    assert names_of(full) == PLANE
    parts = {part.name.removesuffix("_halo") for part in (*full.meshes, *full.lines)}
    assert {name for name in parts if not name.startswith(SCENERY)} == set(names_of(full))
    (place,) = (solid.vertices.mean(axis=0) for solid in full.meshes if solid.name == "minima")
    np.testing.assert_allclose(place[:2], [0.7, 0.6], atol=1e-6)


def test_a_known_microphone_has_the_circle_of_its_true_position_in_the_legend(full, scene, measurement, estimate):
    entries = {entry.name: entry for entry in legend_of(full)}
    known, circle = entries["microphones/known"], entries["microphones/true"]
    assert [name for name, entry in entries.items() if entry.below is not None] == ["microphones/known"]
    assert known.below == circle and np.abs(known.paths[0]).max() < np.abs(circle.paths[0]).max()
    bare = replace(measurement, positions=None)
    alone = {one.name: one for one in legend_of(compose(scene, bare, estimate))}
    assert alone["microphones/known"] == MARKS["microphones/known"] and "microphones/true" not in alone


def test_a_mark_that_is_not_drawn_has_no_entry(full):
    for name in PLANE:
        meshes, lines = (tuple(part for part in kind if part.name != name) for kind in (full.meshes, full.lines))
        without = replace(full, meshes=meshes, lines=lines)
        assert names_of(without) == [other for other in names_of(full) if other != name]


def test_isosurfaces_are_named_with_their_levels(scene, measurement, estimate):
    decibels = 10 * np.linalg.norm(np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, 17)])), axis=0) - 20
    cost, search = 10 ** (decibels / 10), Search((0.0, 0.0, 0.0), (1.6, 1.6, 1.6), 0.1, 0.8)
    volume = volume_of(cost, search, True)
    picture = overlays.with_volume(compose(scene, measurement, estimate), volume)
    assert volume.text in [entry.text for entry in legend_of(picture)]


@pytest.mark.parametrize("half_axis", [1e-5, 3e-4, 0.02])
def test_the_legend_says_by_how_much_ellipses_are_enlarged(scene, measurement, estimate, half_axis):
    axes = np.tile(half_axis * np.eye(2), (8, 1, 1))
    scale = overlays.ellipse_scale(axes, 0.5)
    picture = overlays.with_ellipses(compose(scene, measurement, estimate), estimate, axes, scale=scale)
    said = re.search(r"drawn ([\d]+) times larger", legend_of(picture)[-1].text)
    assert (said is None) == (scale == 1) and (scale == 1 or float(said[1]) == scale)
    rim = next(part for part in picture.lines if part.name == "ellipses").segments[:, 0, :2]
    reach = np.linalg.norm(rim.reshape(-1, 8, 2)[:, 0] - estimate[0], axis=1)
    np.testing.assert_allclose(reach, scale * half_axis, rtol=1e-4)
    unscaled = overlays.with_ellipses(compose(scene, measurement, estimate), estimate, axes)
    assert ("too small to be seen" in legend_of(unscaled)[-1].text) == (half_axis < 0.01)


def test_page_and_png_show_the_same_entries(full):
    html = canvas_legend(full.floor.bar, legend_of(full))
    texts = [unescape(text.strip()) for text in re.findall(r"</svg>(.*?)</span>", html)]
    assert texts == [entry.text for entry in legend_of(full)]
    for fraction, tick in full.floor.bar.ticks:
        assert f"left: {100 * fraction:.2f}%" in html and f"</div>{tick}</div>" in html


def test_each_entry_of_the_png_stands_in_its_colour_below_the_map(full):
    camera = camera_for(full, SIZE, "top", margins(full, SIZE))
    image = annotate(np.full((SIZE[1], SIZE[0], 3), 255, np.uint8), full, camera).astype(int)
    height = margins(full, SIZE)[1] - margins(replace(full, meshes=(), lines=()), SIZE)[1]
    assert height > 20
    rows = image[-round(height) - 5 :]
    for entry in legend_of(full):
        assert np.abs(rows - entry.colour).max(axis=2).min() < 40, f"no {entry.text} in the legend"


@pytest.mark.parametrize("name", [name for name, mark in MARKS.items() if mark.text])
def test_a_symbol_fills_its_square(name):
    alpha = np.asarray(symbol(MARKS[name], 40))[..., 3]
    assert isinstance(symbol(MARKS[name], 40), Image.Image) and 40 < (alpha > 128).sum() < 1200
    assert alpha[[0, -1]].max() < 30, "nothing is cut off"
    width = float(re.findall(r"stroke-width='([\d.]+)'", symbol_svg(MARKS[name]))[-1])
    assert width == pytest.approx(MARKS[name].line * EDGE / 2, rel=0.01), "as in the PNG, over half of the square"
