"""The field of a box-shaped room in closed form."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from fdcal.acoustics.box_field import modal_pressures, point_source_pressures
from fdcal.acoustics.measure import measure
from fdcal.acoustics.spectrum import SPECTRUM
from fdcal.model.scene import Room, Source, load_scene
from fdcal.model.settings import Sensing
from fdcal.model.validation import InputError
from fdcal.session.sources import check_scene

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
    """The field has the requested k: the error of the finite differences falls with the square of their step."""

    def residual(h):
        p, sums = point_source_pressures(room, SOURCE, PLACES, [k])[0], 0
        for d in h * np.concatenate([np.eye(3), -np.eye(3)]):
            sums = sums + point_source_pressures(room, SOURCE, PLACES + d, [k])[0]
        return np.abs((sums - 6 * p) / h**2 + k**2 * p)

    coarse, fine = residual(0.04), residual(0.02)
    assert coarse.max() > 1e-6
    assert np.linalg.norm(coarse) / np.linalg.norm(fine) == pytest.approx(4.0, rel=0.02)


def test_every_wall_satisfies_its_boundary_condition(room):
    """The outward dp/dn is -j k beta p, with beta = 0 for a rigid wall; p = 0 at a pressure-release wall."""
    inside = np.array([0.7, 0.8, 0.6])
    for axis in range(3):
        for wall, inward in ((0.0, 1.0), (SIZE[axis], -1.0)):
            h = 1e-3
            at = np.tile(inside, (4, 1))
            at[:, axis] = wall + inward * h * np.arange(4)
            p = point_source_pressures(room, SOURCE, at, K)
            outwards = -(p @ [-11 / 6, 3, -3 / 2, 1 / 3]) / h  # one-sided difference of third order
            if room.walls == "pressure-release":
                np.testing.assert_allclose(p[:, 0], 0, atol=1e-12)
            else:
                np.testing.assert_allclose(outwards, -1j * K * room.admittance * p[:, 0], atol=1e-6 * np.abs(p).max())


def images(places, source, size, k, sign, reach):
    """Sum over the mirror images of the source, exp(-j k d) / (4 pi d), within `reach` metres; sign of a reflection."""
    total, lines = np.zeros(len(places), complex), []
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
def test_the_field_equals_the_sum_over_image_sources(walls, sign, k):
    """The sum over image sources uses no eigenfunction; images beyond `reach` contribute less than 1e-7."""
    expected = images(PLACES[:3], SOURCE, SIZE, k, sign, reach=45.0)
    np.testing.assert_allclose(point_source_pressures(ROOMS[walls], SOURCE, PLACES[:3], [k])[0], expected, rtol=1e-6)


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
    assert len(alone) > 8 and np.abs(alone[:, None] - frequencies).min(axis=1).max() < 0.05
    np.testing.assert_allclose(wavenumbers, (2 * np.pi * frequencies - 1j * SPECTRUM.decay / 6.0) / c)
    np.testing.assert_allclose(pressures, point_source_pressures(room, SOURCE, PLACES[:4], wavenumbers))
    peaks = np.array([spectrum[1][np.abs(spectrum[0] - f) < 1].max() for f in frequencies])
    assert np.all(peaks > np.median(spectrum[1])) and spectrum[0][0] == 50 and spectrum[0][-1] >= highest
    assert reported == sorted(reported) and reported[-1] == 1.0


def test_unresolved_lines_and_sums_that_do_not_converge_are_refused():
    with pytest.raises(InputError, match=r"source\.duration = 1 s is too short.*resolution = 2 Hz.*at least 3\.31 s"):
        modal_pressures(ROOMS["rigid"], Source(position=tuple(SOURCE), duration=1.0), PLACES, Sensing(resolution=2.0))
    with pytest.raises(InputError, match=r"too close to microphone 1, or room.size too large.*move it"):
        point_source_pressures(ROOMS["rigid"], SOURCE, [PLACES[0], SOURCE + 1e-3], K)
    with pytest.raises(InputError, match=r"room\.admittance is too high"):
        point_source_pressures(replace(ROOMS["absorbing"], admittance=30.0), SOURCE, PLACES, K)


@pytest.fixture
def ball():
    return load_scene("ball3d")


@pytest.mark.parametrize("call", [measure, check_scene])
def test_a_duration_of_days_is_refused_at_once(call, ball):
    scene, began = replace(ball, source=replace(ball.source, duration=1e6)), time.process_time()
    with pytest.raises(InputError, match=r"source\.duration = 1e\+06 s .* use at most [\d.]+ s") as caught:
        call(scene)
    assert time.process_time() - began < 0.1
    longest = float(str(caught.value).split("use at most ")[1].split(" s")[0])
    check_scene(replace(ball, source=replace(ball.source, duration=0.99 * longest)))
