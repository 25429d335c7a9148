"""An ellipse holds the share of a Gaussian that it says, in one, two and three dimensions, wherever it is drawn."""

from types import SimpleNamespace

import numpy as np
import pytest

from fdcal.assessment.uncertainty import confidence_factor, ellipse_axes
from fdcal.graphics.calibration_figure import enlarged_ellipses
from fdcal.model.arrays import positions_of
from fdcal.model.scene_file import load_scene
from fdcal.session.planning.bounds import request_information
from fdcal.viewer.background.verdict import uncertainty_of
from fdcal.viewer.gui.choices import PlanChoices
from fdcal.viewer.tabs.plan import plan_request, planned_array, position_bound

DRAWS, SIGMAS = 20_000, 4.0  # draws of each Gaussian; sampling errors that a share may be off


def covariances(dimension: int, count: int = 3) -> np.ndarray:
    """Return covariances of positions (count, D, D), metres^2, long and turned."""
    maps = np.random.default_rng(dimension).normal(size=(count, dimension, dimension)) * 0.003
    return maps @ maps.swapaxes(1, 2)


def share_inside(axes: np.ndarray, covariance: np.ndarray) -> float:
    """Return the share of draws of a Gaussian that fall inside an ellipse with half axes in rows."""
    draws = np.random.default_rng(7).multivariate_normal(np.zeros(len(axes)), covariance, DRAWS)
    return float(np.mean(np.sum(np.linalg.solve(axes.T, draws.T) ** 2, axis=0) < 1))


def assert_holds(axes: np.ndarray, covariance: np.ndarray, probability: float) -> None:
    sampling = np.sqrt(probability * (1 - probability) / DRAWS)
    assert share_inside(axes, covariance) == pytest.approx(probability, abs=SIGMAS * sampling)


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_an_ellipse_holds_the_share_that_its_factor_is_for(dimension, probability):
    blocks = covariances(dimension)
    for axes, block in zip(ellipse_axes(blocks, confidence_factor(probability, dimension)), blocks, strict=True):
        assert_holds(axes, block, probability)


def test_the_factor_in_the_plane_has_a_closed_form():
    assert confidence_factor(0.95, 2) == pytest.approx(np.sqrt(-2 * np.log(0.05)), rel=1e-12)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_ellipses_of_the_page_hold_95_percent(dimension):
    blocks = covariances(dimension)
    found = SimpleNamespace(
        room=None, covariance=blocks, uncertainty=np.ones(len(blocks)), verdict="good", verdict_text="", channels=None
    )
    for axes, block in zip(uncertainty_of(found).axes, blocks, strict=True):
        assert_holds(axes, block, 0.95)


@pytest.mark.parametrize("name", ["tiny", "ball3d"])
def test_the_ellipses_of_a_plan_hold_95_percent(name):
    scene = load_scene(name)
    places = positions_of(scene)
    measurement = SimpleNamespace(
        positions=places, names=tuple(map(str, range(len(places)))), sound_speed=scene.room.sound_speed
    )
    run = SimpleNamespace(measurement=measurement, scene=scene, known_scene=scene)
    choices = PlanChoices(known=(0, 1, 2, 3), frequencies=12)
    request = plan_request(run, choices)
    bound = position_bound(request_information(request), request.prior)
    drawn = planned_array(run, choices)
    for n in np.flatnonzero(bound.free)[:3]:
        assert_holds(drawn.axes[n], bound.covariance[n], 0.95)


def test_the_ellipses_of_a_figure_hold_95_percent():
    drawn = []
    panel = SimpleNamespace(plot=lambda x, y, *_, **__: drawn.append(np.stack([x, y], axis=1)))
    (block,) = covariances(2, 1)
    enlarged_ellipses(panel, np.zeros((1, 2)), block[None], np.array([[0.0, 0.0], [0.01, 0.01]]))
    ((*_, outline),) = [drawn]
    axes = outline[[0, len(outline) // 4]]  # two conjugate half axes: a quarter of the outline apart
    assert_holds(axes, block, 0.95)
