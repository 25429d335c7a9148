"""A source drawn at random keeps its distances, everywhere in the room, or is not found."""

import numpy as np
import pytest

from fdcal.model.geometry import WALL_DISTANCE_M, random_source

MICROPHONES = np.array([[2.0, 2.0], [2.4, 2.0], [2.0, 2.4]])


@pytest.mark.parametrize("size", [(5.0, 4.0), (5.0, 4.0, 2.5)])
def test_places_keep_their_distances_and_reach_all_of_the_room(size):
    rng = np.random.default_rng(0)
    places = np.array([random_source(size, MICROPHONES, 0.7, rng, lambda place: place[0] > 0.5) for _ in range(800)])
    assert places.shape == (800, len(size))
    assert (places >= WALL_DISTANCE_M).all() and (places <= np.array(size) - WALL_DISTANCE_M).all()
    assert np.linalg.norm(places[:, None, :2] - MICROPHONES, axis=2).min() > 0.7
    assert places[:, 0].min() > 0.5, "what is not allowed is not drawn"
    quarters = (places[:, 0] > 2.5) * 2 + (places[:, 1] > 2.0)
    assert np.bincount(quarters).min() > 100


def test_one_seed_is_one_place_and_a_full_room_has_none():
    same = [random_source((5, 4), MICROPHONES, 0.7, np.random.default_rng(3), lambda place: True) for _ in range(2)]
    np.testing.assert_array_equal(*same)
    assert random_source((5, 4), MICROPHONES, 9.0, np.random.default_rng(3), lambda place: True) is None
