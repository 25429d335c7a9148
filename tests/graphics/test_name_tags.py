"""The name of a microphone stands beside it, inside the picture, and hides as few other marks as it can."""

import numpy as np
import pytest

from fdcal.graphics.picture import HEIGHT, LETTER, name_place

FOCUS, RADIUS, TEXT = (0.0, 0.0, 1.0, 1.0), 0.0125, "microphone 12"


def box_of(place, anchor):
    """What the text covers, by the meaning of its anchor."""
    vertical, horizontal = anchor.split("-")
    width, height = LETTER * len(TEXT) * RADIUS, HEIGHT * RADIUS
    x = place[0] - width * {"left": 0, "center": 0.5, "right": 1}[horizontal]
    y = place[1] - height * {"bottom": 0, "center": 0.5, "top": 1}[vertical]
    return x, y, x + width, y + height


def covered(box, marks):
    x, y = np.reshape(marks, (-1, 2)).T
    return int(((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])).sum())


@pytest.mark.parametrize("place", [(x, y) for x in (0.02, 0.5, 0.98) for y in (0.02, 0.5, 0.98)])
def test_a_name_stays_inside_the_picture_and_off_its_microphone(place):
    box = box_of(*name_place(TEXT, place, [], FOCUS, RADIUS))
    assert box[0] >= 0 and box[1] >= 0 and box[2] <= 1 and box[3] <= 1
    assert not covered((box[0] - RADIUS, box[1] - RADIUS, box[2] + RADIUS, box[3] + RADIUS), [place])


@pytest.mark.parametrize("seed", range(20))
def test_a_name_covers_no_mark_where_one_side_is_free(seed):
    marks = np.random.default_rng(seed).uniform(0, 1, (25, 2))
    place = (0.5, 0.5)
    chosen = covered(box_of(*name_place(TEXT, place, marks, FOCUS, RADIUS)), marks)
    assert chosen <= covered(box_of((0.5 + 2.6 * RADIUS, 0.5), "center-left"), marks)
    ring = [(0.5 + 0.1 * np.cos(a), 0.5 + 0.1 * np.sin(a)) for a in np.linspace(-2.2, 2.2, 30)]  # open on the left
    assert not covered(box_of(*name_place(TEXT, place, ring, FOCUS, RADIUS)), ring)


def test_without_other_marks_it_stands_on_the_right():
    assert name_place(TEXT, (0.4, 0.5), [], FOCUS, RADIUS)[1] == "center-left"
