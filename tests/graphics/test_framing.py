"""A picture without a search domain shows all microphones."""

import dataclasses

import numpy as np
import pytest

from fdcal.graphics.picture import compose
from fdcal.graphics.surroundings import with_display_domain
from fdcal.model.measurement import Measurement


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("known", [0, 4])
def test_the_frame_holds_every_microphone_and_the_known_ones(dimension, known):
    rng = np.random.default_rng(dimension)
    places = rng.uniform(-3, 2, (12, dimension))
    measured = Measurement(
        frequencies=np.linspace(100, 300, 4),
        pressures=np.exp(1j * rng.uniform(0, 6, (4, 12))),
        sound_speed=343.0,
        known=np.arange(known),
        known_positions=places[:known],
        dimension=dimension,
        array_dimension=dimension,
    )
    drawn = with_display_domain(measured, places + 0.2)
    x0, y0, x1, y1 = compose(None, drawn, places + 0.2).focus
    for points in (places + 0.2, places[:known]):
        assert ((points[:, :2] > [x0, y0]) & (points[:, :2] < [x1, y1])).all()
    assert measured.search is None and with_display_domain(drawn, places) is drawn
    assert dataclasses.replace(drawn, search=None).count == measured.count


def test_microphones_with_equal_estimates_have_a_frame_too():
    measured = Measurement(frequencies=np.array([100.0]), pressures=np.ones((1, 5), complex), sound_speed=343.0)
    x0, y0, x1, y1 = compose(None, with_display_domain(measured, np.zeros((5, 2)))).focus
    assert x1 - x0 > 0.1 and y1 - y0 > 0.1
