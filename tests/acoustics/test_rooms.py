"""Rooms in closed form: the field of a box, the modes of a rectangle."""

import dataclasses
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from fields import rigid_room

from fdcal.acoustics import room_modes
from fdcal.acoustics.box_field import modal_pressures, point_source_pressures
from fdcal.acoustics.measure import measure
from fdcal.acoustics.spectrum import SPECTRUM
from fdcal.model.scene import Room, Source, load_scene
from fdcal.model.settings import Sensing
from fdcal.model.validation import InputError
from fdcal.session.sources import check_scene
from fdcal.solvers.room import RoomData, diffuse_terms, exact

SIZE = (2.3, 1.9, 1.6)
SOURCE = np.array([2.1, 1.75, 1.45])
PLACES = np.random.default_rng(0).uniform([0.3, 0.3, 0.3], [1.3, 1.2, 1.1], (9, 3))
K = np.array([0.4 - 0.01j, 2.9 - 0.02j, 6.1 - 0.01j])
ROOMS = {
    "rigid": Room(size=SIZE),
    "pressure-release": Room(size=SIZE, walls="pressure-release"),
    "absorbing": Room(size=SIZE, walls="absorbing", admittance=0.08),
    "soft": Room(size=SIZE, walls="absorbing", admittance=0.4),
}


@pytest.fixture(params=ROOMS)
def room(request):
    return ROOMS[request.param]


@pytest.mark.parametrize("k", K)
def test_the_field_solves_helmholtz_to_second_order(room, k):
    """The one k of the field is the one asked for: the error of the finite differences falls with their square."""

    def fault(h):
        p, sums = point_source_pressures(room, SOURCE, PLACES, [k])[0], 0
        for d in h * np.concatenate([np.eye(3), -np.eye(3)]):
            sums = sums + point_source_pressures(room, SOURCE, PLACES + d, [k])[0]
        return np.abs((sums - 6 * p) / h**2 + k**2 * p)

    coarse, fine = fault(0.04), fault(0.02)
    assert coarse.max() > 1e-6
    assert np.linalg.norm(coarse) / np.linalg.norm(fine) == pytest.approx(4.0, rel=0.02)


def test_every_wall_has_its_condition(room):
    """Outwards dp/dn = -j k beta p, with beta = 0 for a rigid wall; p = 0 where there is no pressure."""
    inside = np.array([0.7, 0.8, 0.6])
    for axis in range(3):
        for wall, inward in ((0.0, 1.0), (SIZE[axis], -1.0)):
            h = 1e-3
            at = np.tile(inside, (4, 1))
            at[:, axis] = wall + inward * h * np.arange(4)
            p = point_source_pressures(room, SOURCE, at, K)
            outwards = -(p @ [-11 / 6, 3, -3 / 2, 1 / 3]) / h  # one-sided, of third order
            if room.walls == "pressure-release":
                np.testing.assert_allclose(p[:, 0], 0, atol=1e-12)
            else:
                np.testing.assert_allclose(outwards, -1j * K * room.admittance * p[:, 0], atol=1e-6 * np.abs(p).max())


def images(places, source, size, k, sign, reach):
    """Sum over the mirror images of the source, exp(-j k d) / (4 pi d), within `reach` metres; sign of a reflection."""
    total = np.zeros(len(places), complex)
    lines = []
    for length, x in zip(size, source, strict=True):
        cells = np.arange(-math.ceil(reach / length) - 1, math.ceil(reach / length) + 2)
        lines.append((np.where(cells % 2 == 0, cells * length + x, (cells + 1) * length - x), sign ** (cells % 2)))
    (x, a), (y, b), (z, c) = lines
    for one, sign_of_one in zip(x, a, strict=True):
        at = np.stack(np.broadcast_arrays(one, y[:, None], z[None, :]), axis=-1).reshape(-1, 3)
        signs = sign_of_one * (b[:, None] * c[None, :]).ravel()
        for n, place in enumerate(places):
            d = np.linalg.norm(at - place, axis=1)
            kept = d < reach
            total[n] += np.sum(signs[kept] * np.exp(-1j * k * d[kept]) / (4 * np.pi * d[kept]))
    return total


@pytest.mark.parametrize(("walls", "sign"), [("rigid", 1.0), ("pressure-release", -1.0)])
@pytest.mark.parametrize("k", [0.9 - 0.5j, 5.2 - 0.5j])
def test_image_sources_agree(walls, sign, k):
    """Image by image the field of the same room, no eigenfunction in it; what lies beyond `reach` is below 1e-7."""
    expected = images(PLACES[:3], SOURCE, SIZE, k, sign, reach=45.0)
    found = point_source_pressures(ROOMS[walls], SOURCE, PLACES[:3], [k])[0]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_peaks_are_the_eigenfrequencies_of_the_room():
    room, c, highest = Room(size=SIZE), 343.0, 190.0
    sensing = Sensing(lowest=50.0, highest=highest, resolution=2.0, wavenumber="continuous")
    reported = []
    frequencies, wavenumbers, pressures, spectrum = modal_pressures(
        room, Source(position=tuple(SOURCE), duration=6.0), PLACES[:4], sensing, reported.append
    )
    n = np.stack(np.meshgrid(*[np.arange(9)] * 3), axis=-1).reshape(-1, 3)
    exact = np.unique(np.round(c / 2 * np.linalg.norm(n / SIZE, axis=1), 6))
    exact = exact[(exact > 50) & (exact < highest)]
    alone = exact[np.all(np.abs(exact[:, None] - exact) + 9 * np.eye(len(exact)) > 3, axis=1)]
    assert len(alone) > 8
    found = np.abs(alone[:, None] - frequencies).min(axis=1)
    assert found.max() < 0.05
    np.testing.assert_allclose(wavenumbers, (2 * np.pi * frequencies - 1j * SPECTRUM.decay / 6.0) / c)
    np.testing.assert_allclose(pressures, point_source_pressures(room, SOURCE, PLACES[:4], wavenumbers))
    peaks = np.array([spectrum[1][np.abs(spectrum[0] - f) < 1].max() for f in frequencies])
    assert np.all(peaks > np.median(spectrum[1])) and spectrum[0][0] == 50 and spectrum[0][-1] >= highest
    assert reported == sorted(reported) and reported[-1] == 1.0


def test_unresolved_lines_and_sums_that_do_not_converge_are_refused():
    with pytest.raises(InputError, match=r"source\.duration = 1 s is too short.*resolution = 2 Hz.*at least 3\.31 s"):
        modal_pressures(ROOMS["rigid"], Source(position=tuple(SOURCE), duration=1.0), PLACES, Sensing(resolution=2.0))
    with pytest.raises(InputError, match=r"too close to microphone 1 .*move it"):
        point_source_pressures(ROOMS["rigid"], SOURCE, [PLACES[0], SOURCE + 1e-3], K)
    with pytest.raises(InputError, match=r"room\.admittance is too high"):
        point_source_pressures(dataclasses.replace(ROOMS["absorbing"], admittance=30.0), SOURCE, PLACES, K)


@pytest.fixture
def ball():
    return load_scene("ball3d")


@pytest.mark.parametrize("call", [measure, check_scene])
def test_a_duration_of_days_is_refused_at_once(call, ball):
    scene = replace(ball, source=replace(ball.source, duration=1e6))
    began = time.process_time()
    with pytest.raises(InputError, match=r"source\.duration = 1e\+06 s .* use at most [\d.]+ s") as caught:
        call(scene)
    assert time.process_time() - began < 0.1
    longest = float(str(caught.value).split("use at most ")[1].split(" s")[0])
    check_scene(replace(ball, source=replace(ball.source, duration=0.99 * longest)))


# The field of a rectangular room against closed forms, its derivatives, and its symmetries.


RNG = np.random.default_rng(4)
RECTANGLE, BOX = (6.0, 5.0), (4.1, 3.3, 2.6)
IN_RECTANGLE, SOURCE_IN_RECTANGLE = RNG.uniform(0.3, 4.0, (6, 2)), np.array([5.4, 4.5])
HIGH, BOX_SOURCE = RNG.uniform(0.3, 2.3, (6, 3)), np.array([3.7, 2.9, 0.4])
WAVENUMBERS = (2 * np.pi * np.array([34.3, 66.7, 102.9]) - 3j) / 343.0


def differs(values, truth) -> float:
    """Largest relative difference after the amplitude of each frequency is removed."""
    ratio = values / truth
    return float(np.abs(ratio / ratio.mean(axis=1, keepdims=True) - 1).max())


@pytest.mark.parametrize("admittance", [0.0, 0.02, 0.1])
def test_the_sum_is_the_closed_form_in_a_box(admittance):
    walls = Room(size=BOX, walls="absorbing", admittance=admittance) if admittance else Room(size=BOX)
    room = room_modes.point_source_model(BOX, WAVENUMBERS, admittance)
    truth = point_source_pressures(walls, BOX_SOURCE, HIGH, WAVENUMBERS)
    assert differs(room_modes.room_pressures(room.excitation(BOX_SOURCE), room.shapes(HIGH)), truth) < 1e-5
    if not admittance:
        room, source = room_modes.point_source_model(RECTANGLE, WAVENUMBERS, 0), SOURCE_IN_RECTANGLE
        truth = rigid_room(IN_RECTANGLE, source, WAVENUMBERS)
        assert differs(room_modes.room_pressures(room.excitation(source), room.shapes(IN_RECTANGLE)), truth) < 1e-4


def slope(function, x, i: int, h: float = 1e-6) -> float:
    ahead, behind = x.copy(), x.copy()
    ahead[i] += h
    behind[i] -= h
    return (function(ahead) - function(behind)) / (2 * h)


@pytest.mark.parametrize(
    ("size", "places", "source"),
    [(RECTANGLE, IN_RECTANGLE, SOURCE_IN_RECTANGLE), (BOX, HIGH, BOX_SOURCE)],
    ids=["plane", "space"],
)
def test_the_gradients_of_the_exact_and_the_diffuse_model_are_their_slopes(size, places, source):
    draws, noise, D = RNG.standard_normal((2, 3, 6)), np.array([0.1, 0.2, 0.3]), len(size)
    p = draws[0] + 1j * draws[1]  # which the unknowns do not explain
    theta = np.concatenate([places.ravel(), source, [0.03, 0.01], np.full(D, 0.01)])

    data = RoomData(p, noise, WAVENUMBERS, size)
    gradient = exact(theta, data).terms.gradient
    for i in (1, 6 * D - 1, 6 * D, 7 * D, 7 * D + 1, len(theta) - 1):
        assert gradient[i] == pytest.approx(slope(lambda y: exact(y, data, False).cost, theta, i), rel=2e-3, abs=2e-3)
    model, x = room_modes.diffuse_model(size, WAVENUMBERS, 0.01), places.ravel()
    gradient = diffuse_terms(x, p, noise, model).gradient
    for i in (0, 3, 7):
        wanted = slope(lambda y: diffuse_terms(y, p, noise, model).cost, x, i)
        assert gradient[i] == pytest.approx(wanted, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize(
    ("size", "count"), [((6.0, 5.0), 4), ((5.0, 5.0), 8), ((4.0, 3.0, 2.5), 8), ((3.0, 3.0, 2.5), 16)]
)
def test_the_symmetries_of_a_room_leave_its_pressures_unchanged(size, count):
    found = room_modes.room_symmetries(size)
    assert len(found) == count
    D, room = len(size), room_modes.point_source_model(size, WAVENUMBERS, 0.02)
    places, source = RNG.uniform(0.2, 2.3, (4, D)), RNG.uniform(0.2, 2.3, D)
    here = room_modes.room_pressures(room.excitation(source), room.shapes(places))
    assert np.array_equal(found[0].apply(places), places)
    distinct = {tuple(np.round(image.apply(places), 9).ravel()) for image in found}
    assert len(distinct) == len({str(image) for image in found}) == count
    for image in found:
        assert np.allclose(
            room_modes.room_pressures(room.excitation(image.apply(source)), room.shapes(image.apply(places))),
            here,
            rtol=1e-9,
        )
        assert room_modes.nearest_symmetry(places, image.apply(places), size) == image
