"""The field of a rectangular room against closed forms, its derivatives, and its symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from fields import rigid_room

from fdcal.acoustics.box_field import point_source_pressures as box_field
from fdcal.acoustics.room_modes import (
    diffuse_model,
    nearest_symmetry,
    point_source_model,
    room_pressures,
    room_symmetries,
)
from fdcal.model.room import Room
from fdcal.solvers.room.fit import diffuse_terms, exact

RNG = np.random.default_rng(4)
SIZE, BOX = (6.0, 5.0), (4.1, 3.3, 2.6)
PLACES, SOURCE = RNG.uniform(0.3, 4.0, (6, 2)), np.array([5.4, 4.5])
HIGH, BOX_SOURCE = RNG.uniform(0.3, 2.3, (6, 3)), np.array([3.7, 2.9, 0.4])
K = (2 * np.pi * np.array([34.3, 66.7, 102.9]) - 3j) / 343.0


def differs(values, truth) -> float:
    """Largest relative difference after the amplitude of each frequency is removed."""
    ratio = values / truth
    return float(np.abs(ratio / ratio.mean(axis=1, keepdims=True) - 1).max())


def test_the_sum_is_the_closed_form_in_a_rigid_plane():
    room = point_source_model(SIZE, K, 0)
    assert differs(room_pressures(room.excitation(SOURCE), room.shapes(PLACES)), rigid_room(PLACES, SOURCE, K)) < 1e-4


@pytest.mark.parametrize("admittance", [0.0, 0.02, 0.1])
def test_the_sum_is_the_closed_form_in_a_box(admittance):
    walls = Room(size=BOX, walls="absorbing", admittance=admittance) if admittance else Room(size=BOX)
    room = point_source_model(BOX, K, admittance)
    truth = box_field(walls, BOX_SOURCE, HIGH, K)
    assert differs(room_pressures(room.excitation(BOX_SOURCE), room.shapes(HIGH)), truth) < 1e-5


def test_microphones_and_source_may_be_exchanged():
    room = point_source_model(BOX, K, 0.03)
    there = room_pressures(room.excitation(BOX_SOURCE), room.shapes(HIGH[:1]))
    back = room_pressures(room.excitation(HIGH[0]), room.shapes(BOX_SOURCE[None]))
    assert np.allclose(there, back, rtol=1e-9)


def noisy() -> tuple[np.ndarray, np.ndarray]:
    """Pressures that the unknowns of the next tests do not explain, and their noise."""
    p = RNG.standard_normal((2, 3, 6))
    return p[0] + 1j * p[1], np.array([0.1, 0.2, 0.3])


def slope(function, x, i: int, h: float = 1e-6) -> float:
    ahead, behind = x.copy(), x.copy()
    ahead[i] += h
    behind[i] -= h
    return (function(ahead) - function(behind)) / (2 * h)


@pytest.mark.parametrize(("size", "places"), [(SIZE, PLACES), (BOX, HIGH)], ids=["plane", "space"])
def test_the_diffuse_models_gradient_is_its_slope(size, places):
    p, noise = noisy()
    model, x = diffuse_model(size, K, 0.01), places.ravel()
    gradient = diffuse_terms(x, p, noise, model).gradient
    for i in (0, 3, 7):
        wanted = slope(lambda y: diffuse_terms(y, p, noise, model).cost, x, i)
        assert gradient[i] == pytest.approx(wanted, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(
    ("size", "places", "source"), [(SIZE, PLACES, SOURCE), (BOX, HIGH, BOX_SOURCE)], ids=["plane", "space"]
)
def test_the_exact_models_gradient_is_its_slope(size, places, source):
    p, noise = noisy()
    D = len(size)
    theta = np.concatenate([places.ravel(), source, [0.03, 0.01], np.full(D, 0.01)])

    def cost(y) -> float:
        return exact(y, p, noise, K, size, False).cost

    gradient = exact(theta, p, noise, K, size).terms.gradient
    for i in (1, 6 * D - 1, 6 * D, 7 * D, 7 * D + 1, len(theta) - 1):
        assert gradient[i] == pytest.approx(slope(cost, theta, i), rel=2e-3, abs=2e-3)


@pytest.mark.parametrize(
    ("size", "count"), [((6.0, 5.0), 4), ((5.0, 5.0), 8), ((4.0, 3.0, 2.5), 8), ((3.0, 3.0, 2.5), 16)]
)
def test_the_symmetries_of_a_room_leave_its_pressures_unchanged(size, count):
    found = room_symmetries(size)
    assert len(found) == count
    D, room = len(size), point_source_model(size, K, 0.02)
    places, source = RNG.uniform(0.2, 2.3, (4, D)), RNG.uniform(0.2, 2.3, D)
    here = room_pressures(room.excitation(source), room.shapes(places))
    assert np.array_equal(found[0].apply(places), places)
    distinct = {tuple(np.round(image.apply(places), 9).ravel()) for image in found}
    assert len(distinct) == len({str(image) for image in found}) == count
    for image in found:
        assert np.allclose(
            room_pressures(room.excitation(image.apply(source)), room.shapes(image.apply(places))), here, rtol=1e-9
        )
        assert nearest_symmetry(places, image.apply(places), size) == image


def test_at_an_exact_resonance_the_field_is_finite():
    k = np.array([np.pi / SIZE[0], 2 * np.pi / SIZE[1]])
    assert np.all(np.isfinite(point_source_model(SIZE, k, 0).response))
