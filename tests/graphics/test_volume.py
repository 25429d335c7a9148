"""Isosurfaces and a layer of a cost in space: where they lie, their colours, and how a picture shows them."""

import numpy as np
import pytest
from fields import placed

from fdcal.cost.scale import Minima
from fdcal.graphics import snapshot
from fdcal.graphics.camera import camera_for, project
from fdcal.graphics.heatmap import to_rgb
from fdcal.graphics.picture import static_picture, with_volume
from fdcal.graphics.volume import SampledVolume, brightened, isosurface, layer_floor, levels_of, volume_of
from fdcal.model.settings import Search

SEARCH = Search(origin=(1.0, 2.0, 3.0), size=(0.8, 0.6, 0.4), step=0.02, radius=0.5)
CENTRE = np.array([1.3, 2.3, 3.2])
DOMAIN = np.array([[0.99, 1.99, 2.99], [1.81, 2.61, 3.41]])


def distance():
    axes = [o + SEARCH.step * np.arange(n) for o, n in zip(SEARCH.origin, SEARCH.shape, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    return np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2)


def cost():
    """A bowl: -40 dB at the centre, 5 dB more for every 10 cm."""
    return 10 ** (-4 + 5 * distance())


def test_an_isosurface_of_the_distance_is_a_sphere_whose_normals_point_outwards():
    vertices, faces, normals = isosurface(distance(), SEARCH, 0.15)
    reach = np.linalg.norm(vertices - CENTRE, axis=1)
    np.testing.assert_allclose(reach, 0.15, atol=0.05 * SEARCH.step)
    assert np.einsum("vd,vd->v", normals, (vertices - CENTRE) / reach[:, None]).min() > 0.98
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi * 0.15**2, rel=0.02)


def test_a_surface_that_leaves_the_domain_is_closed_at_its_edge():
    vertices, faces, _ = isosurface(distance(), SEARCH, 0.28)
    low, high = np.array(SEARCH.origin), np.array(SEARCH.origin) + SEARCH.size
    assert (vertices >= low - 1e-9).all() and (vertices <= high + 1e-9).all()
    assert np.isclose(vertices[:, 2], high[2]).sum() > 100, "it has a lid"
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all(), "without a hole"


def test_levels_are_few_round_decibels_that_leave_most_of_the_domain_open():
    decibels = 10 * np.log10(cost())
    levels = levels_of(decibels)
    assert 2 <= len(levels) <= 3 and list(levels) == sorted(levels)
    assert all(level == round(level, 1) for level in levels)
    assert np.mean(decibels < levels[-1]) < 0.07 and levels_of(np.full((3, 3, 3), -20.0)) == ()
    assert all(len(part) == 0 for part in isosurface(distance(), SEARCH, 9.0)), "a level that is not there"


def test_the_surfaces_are_those_of_the_levels_the_innermost_first_and_in_the_colours_of_the_scale():
    volume = volume_of(cost(), SEARCH, True)
    rows = np.rint(volume.surface.places[:, 1] * len(volume.levels) - 0.5).astype(int)
    for row, level in enumerate(volume.levels):
        reach = np.linalg.norm(volume.surface.vertices[rows == row] - CENTRE, axis=1)
        np.testing.assert_allclose(reach, (level + 40) / 50, atol=0.1 * SEARCH.step)
        share = (level - volume.bar.low) / (volume.bar.high - volume.bar.low)
        assert np.abs(volume.surface.texture[row, -1, :3].astype(int) - to_rgb(np.array(share))).max() <= 3
    assert np.all(np.diff(rows[volume.surface.faces[:, 0]]) >= 0)
    opacity = volume.surface.texture[:, 0, 3]
    assert np.all(np.diff(opacity.astype(int)) < 0) and 100 < opacity.max() < 200
    light, dark = (one.surface.texture.astype(int) for one in (volume, brightened(volume)))
    assert (dark[..., :3] > light[..., :3]).all() and (dark >= light).all(), "visible on a dark page"
    listed = ", ".join(f"{level:g}" for level in volume.levels[:-1])
    assert volume.text == f"isosurfaces at {listed} and {volume.levels[-1]:g} dB"


class Terms:
    """Terms of a cost that is 5 dB higher for every 10 cm in x, and in z."""

    domain = SEARCH

    def on(self, x, y, z):
        return 10 ** (-4 + 5 * (np.asarray(x) + np.zeros((len(z), len(y), 1)) + np.reshape(z, (-1, 1, 1)) - 4.0))


def test_the_layer_of_a_height_lies_on_the_floor_in_the_colours_of_the_scale():
    sampled, volume = SampledVolume(Terms(), SEARCH, cost(), None), volume_of(cost(), SEARCH, True)
    for z, shown in ((3.1, 3.1), (2.0, 3.0), (9.0, 3.4)):  # a height outside the domain shows the layer at its edge
        floor = layer_floor(volume, sampled, z, 0.5, True, 40)
        assert floor.bar.label.endswith(f"layer z = {shown:.2f} m") and floor.height == 0.5 and not floor.show_minima
        np.testing.assert_allclose([*floor.origin, *floor.size], [*DOMAIN[0, :2], *np.ptp(DOMAIN, axis=0)[:2]])
        x = floor.origin[0] + (np.arange(40) + 0.5) * floor.size[0] / 40
        share = (10 * (-4 + 5 * (x + shown - 4.0)) - volume.bar.low) / (volume.bar.high - volume.bar.low)
        assert np.abs(floor.rgb.astype(int) - to_rgb(np.clip(share, 0, 1)).astype(int)).max() <= 4


@pytest.fixture(scope="module")
def picture():
    positions = np.random.default_rng(0).uniform(DOMAIN[0] + 0.05, DOMAIN[1] - 0.05, (6, 3))
    return static_picture(None, placed(positions, SEARCH, [0]))


def image_of(painted, picture, view):
    size = (640, 480)
    pixels = painted(picture, size, view)
    camera = camera_for(picture, size, view, snapshot.margins(picture, size))
    return pixels, lambda place: project(camera, size, place)[0].round().astype(int)


def test_the_png_shows_surfaces_and_the_lowest_cost_in_their_places(picture, painted):
    low, middle = 0.3, float(CENTRE[2])
    volume = volume_of(cost(), SEARCH, True, minima=Minima(CENTRE[None], np.zeros((0, 3)), 1, None))
    surfaces = with_volume(picture, volume)
    (diamond,) = (part for part in surfaces.meshes if part.name == "lowest")
    np.testing.assert_allclose(diamond.vertices.mean(axis=0), CENTRE, atol=1e-4)
    bare, at = image_of(painted, with_volume(picture, None), "top")
    drawn, at = image_of(painted, surfaces, "top")
    column, row = at(CENTRE + [(volume.levels[-1] + 40) / 50 * 0.9, 0, 0])
    assert np.abs(drawn[row, column] - bare[row, column]).sum() > 20, "the outermost isosurface is not there"
    column, row = at([CENTRE[0] + low + 0.1, CENTRE[1] + 0.25, middle])
    np.testing.assert_allclose(drawn[row, column], 255, atol=2)
