"""The shadow of a map in relief."""

import numpy as np

from fdcal.graphics.heatmap import TOWARDS_LIGHT, cost_floor, relief_shadow, shadow_of
from fdcal.graphics.picture import compose
from fdcal.model.scene import load_scene
from fdcal.model.settings import Search
from fdcal.session.sources import scene_input

SEARCH = Search((1.0, 2.0), (1.2, 0.8), 0.02, 1.0)


def centre(shadow):
    """The middle of a shadow, metres, weighted by its opacity."""
    weights = shadow.rgb[..., 3].astype(float)
    rows, columns = np.indices(weights.shape)
    pixel = shadow.size[0] / weights.shape[1]
    middle = [(weights * (index + 0.5)).sum() / weights.sum() for index in (columns, rows)]
    return np.array(shadow.origin) + pixel * np.array(middle)


def test_a_shadow_falls_away_from_the_light_the_further_the_higher_its_object_is():
    patch = np.stack(np.meshgrid(np.linspace(1.5, 1.7, 40), np.linspace(2.3, 2.5, 40)), axis=-1).reshape(-1, 2)
    fallen = []
    for height in (0.0, 0.1, 0.2):
        points = np.column_stack([patch, np.full(len(patch), 0.5 + height)])
        fallen.append(centre(shadow_of(points, SEARCH.origin, SEARCH.size, 0.5)))
    np.testing.assert_allclose(fallen[0], patch.mean(axis=0), atol=0.02)
    steps = np.diff(fallen, axis=0)
    np.testing.assert_allclose(steps[0], steps[1], atol=0.02)
    assert (np.linalg.norm(steps, axis=1) > 0.04).all()
    assert (steps @ TOWARDS_LIGHT[:2] < -0.95 * np.linalg.norm(steps, axis=1) * np.linalg.norm(TOWARDS_LIGHT[:2])).all()


def test_reliefs_of_one_box_have_shadows_of_one_extent_whose_edges_show_nothing():
    rng, shadows = np.random.default_rng(0), []
    for height in (0.1, 1.0):
        cost = rng.random(SEARCH.shape[::-1])
        shadows.append(relief_shadow(cost_floor(cost, SEARCH, relief=True, relief_height=height, height=0.3)))
    for shadow in shadows:
        assert (shadow.origin, shadow.size, shadow.position) == (
            shadows[0].origin,
            shadows[0].size,
            shadows[0].position,
        )
        opacity = shadow.rgb[..., 3]
        edges = np.concatenate([opacity[0], opacity[-1], opacity[:, 0], opacity[:, -1]])
        assert opacity.max() > 60 and edges.max() < 8, "no edge of the image can be seen"
        assert shadow.position < 0.3


def test_only_a_map_in_relief_has_a_shadow():
    measurement = scene_input(load_scene("tiny")).measurement
    cost = np.random.default_rng(1).random(measurement.search.shape[::-1])
    for relief in (False, True):
        floor = cost_floor(cost, measurement.search, relief=relief)
        names = [plate.name for plate in compose(None, measurement, None, floor=floor).plates]
        assert names == ["shadow"] * relief
