"""Shapes of markers, walls and grids: their areas and lengths, and where they lie."""

import numpy as np
import pytest
import trimesh

from fdcal.graphics import glyphs
from fdcal.graphics.primitives import Mesh
from fdcal.model.scene_file import load_scene


def area(solid) -> float:
    corner = solid.vertices[solid.faces].astype(float)
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum() / 2


def test_areas_of_markers():
    """A ring of many corners, a bar and a square have the areas of the textbook."""
    centres = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0]])
    for triangles, expected in (
        (glyphs.annuli(centres, 2.0, 0.2, corners=400), 2 * np.pi * (2.1**2 - 1.9**2)),
        (glyphs.squares(centres, 0.3), 2 * 0.09),
        (glyphs.strokes(centres[None], 0.1, extension=0.5), 0.1 * (np.sqrt(10) + 1.0)),
    ):
        solid = Mesh("x", *triangles, (0, 0, 0))
        assert area(solid) == pytest.approx(expected, rel=1e-3)


def test_a_bar_of_no_length_is_drawn_without_a_fault():
    vertices, faces = glyphs.strokes(np.zeros((1, 2, 3)), 0.1)
    assert np.isfinite(vertices).all() and len(faces) == 2


@pytest.mark.parametrize("name", ["tiny", "lshape", "array1_circle"])
def test_walls_are_a_closed_band_of_the_right_area(name):
    scene = load_scene(name)
    vertices = scene.room.vertices
    mesh = trimesh.Trimesh(*glyphs.walls(vertices, 0.5), process=False)
    perimeter = np.linalg.norm(vertices - np.roll(vertices, -1, axis=0), axis=1).sum()
    assert mesh.area == pytest.approx(0.5 * perimeter)
    assert len(mesh.faces) == 2 * len(vertices)


def test_the_floor_grid_stays_inside_the_outline():
    corner = [(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)]
    grid = glyphs.floor_grid(corner, 0.5, 0.0)
    middles = grid.mean(axis=1)
    assert not ((middles[:, 0] > 2) & (middles[:, 1] > 2)).any()
    lengths = np.linalg.norm(grid[:, 1] - grid[:, 0], axis=1)
    assert lengths.sum() == pytest.approx(2 * (3 * 4 + 4 * 2))  # 0.5, 1, 1.5 are long, 2 to 3.5 short, both ways


def test_positions_in_space_keep_their_height():
    lifted = glyphs.lift([[1.0, 2.0, 0.7]], 0.1)
    np.testing.assert_allclose(lifted, [[1.0, 2.0, 0.8]])


def test_bars_in_space_keep_their_width_and_length():
    ends = np.array([[[0, 0, 0], [1, 2, 2]], [[0, 0, 0], [0, 0, 1]], [[0, 0, 0], [1, 0, 0]]], float)
    vertices, _ = glyphs.strokes(ends, 0.1, extension=0.5)
    corners = vertices.reshape(3, 4, 3)
    np.testing.assert_allclose(np.linalg.norm(corners[:, 0] - corners[:, 3], axis=1), 0.1)
    np.testing.assert_allclose(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1), [4, 2, 2])
