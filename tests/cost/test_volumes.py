"""Eq. 7 of one microphone over a domain of three dimensions."""

import numpy as np
import pytest

from fdcal.acoustics.measurement_cache import cached_measurement
from fdcal.cost.channel_correction import ChannelCorrection
from fdcal.cost.maps import cost_volume, eq7_maps
from fdcal.cost.reference_cost import ReferenceCost
from fdcal.model.scene_file import load_scene
from fdcal.model.validation import InputError

MICROPHONE = 10


def case(name="ball3d"):
    measurement = cached_measurement(load_scene(name))
    away = 0.02 * np.random.default_rng(1).normal(size=measurement.positions.shape)
    return measurement.problem(), measurement.positions + away


def test_the_volume_is_the_number_of_the_status_with_the_microphone_at_each_point():
    problem, x = case()
    reference_cost = ReferenceCost(problem)
    volume = cost_volume(problem, x, MICROPHONE, range(1, reference_cost.count + 1), reference_cost.order_offset)
    # the centre of the expansion stays: Eq. 7 about another one differs by its truncation alone
    assert 10 * np.log10(volume.on(*x[MICROPHONE])[0, 0, 0]) == pytest.approx(reference_cost(x), abs=1e-5)


def test_a_layer_of_the_volume_is_the_map_of_that_height():
    problem, x = case()
    search, modes = problem.search, (1, 20, 60)
    layer = eq7_maps(problem, x, MICROPHONE, modes, 2).sum(axis=0)
    px, py = (o + search.step * np.arange(n) for o, n in zip(search.origin[:2], search.shape[:2], strict=True))
    volume = cost_volume(problem, x, MICROPHONE, modes, 2)
    np.testing.assert_allclose(volume.on(px, py, x[MICROPHONE, 2])[0], layer, rtol=1e-6)


def test_gains_of_the_channels_are_taken_into_account():
    problem, x = case()
    count = len(x)
    gains = np.exp(0.1 * np.random.default_rng(2).normal(size=count))
    channels = ChannelCorrection(gains=gains.astype(complex), noise=np.ones(count))
    place = [1.7], [1.5], [1.2]
    with_gains = cost_volume(problem, x, MICROPHONE, (3, 4), 2, channels).on(*place)
    assert with_gains != pytest.approx(cost_volume(problem, x, MICROPHONE, (3, 4), 2).on(*place), rel=1e-3)


def test_a_coarse_expansion_agrees_to_its_tolerance_and_is_smaller():
    problem, x = case()
    fine, coarse = (cost_volume(problem, x, MICROPHONE, (5, 80), 2, negligible=e) for e in (1e-8, 1e-3))
    axes = [np.linspace(o, o + length, 9) for o, length in zip(problem.search.origin, problem.search.size, strict=True)]
    np.testing.assert_allclose(coarse.on(*axes), fine.on(*axes), rtol=0.05)
    assert coarse.modes[-1].terms.size < fine.modes[-1].terms.size


def test_a_volume_that_nobody_wants_any_longer_ends_at_once():
    problem, x = case()
    assert cost_volume(problem, x, MICROPHONE, (1, 2, 3), 2, cancelled=lambda: True) is None
    assert cost_volume(problem, x, MICROPHONE, (1, 2), 2).on([1.5], [1.5], [1.2], lambda: True) is None


def test_an_array_in_a_plane_has_no_volume():
    problem, x = case("plane3d")
    with pytest.raises(InputError, match="in a plane"):
        cost_volume(problem, x, MICROPHONE, (1, 2), 2)
