"""Laws of the simulation: dispersion, energy, reciprocity, convergence, reflection; and what it refuses."""

import dataclasses
import math

import numpy as np
import pytest
from numba.core import config

from fdcal.acoustics import compiled
from fdcal.acoustics.fdtd import advance, make_grid, neighbour_sum, pulse, simulate
from fdcal.model.scene import Room, Source
from fdcal.model.validation import InputError

H, C = 0.05, 343.0
FS = 10000.0
L_SHAPE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.2, 1.0), (1.2, 1.6), (0.0, 1.6))
SOURCE = Source(position=(0.33, 0.42), low=60.0, high=900.0, sample_rate=FS, duration=0.08)


def mode(grid, m, n, wave):
    """Mode (m, n) of a rectangle, cos for rigid walls, sin for pressure-release ones, and its w dt on the grid."""
    ny, nx = grid.mask.shape
    kx, ky = math.pi * m / nx, math.pi * n / ny
    field = wave(ky * (np.arange(ny) + 0.5))[:, None] * wave(kx * (np.arange(nx) + 0.5))
    return field, 2 * math.asin(grid.courant * math.hypot(math.sin(kx / 2), math.sin(ky / 2)))


@pytest.mark.parametrize(("walls", "wave"), [("rigid", np.cos), ("pressure-release", np.sin)])
# The second room is high enough to be computed by two threads.
@pytest.mark.parametrize("size", [(2.0, 1.5), (1.45, 7.0)])
def test_mode_follows_the_discrete_dispersion_relation(walls, wave, size):
    grid = make_grid(Room(size=size, walls=walls, cell=H), FS)
    field, angle = mode(grid, 3, 2, wave)
    p_old, p = advance(grid, field * math.cos(-angle), field, 1000)
    assert np.abs(p - field * math.cos(1000 * angle)).max() < 1e-12
    assert np.abs(p_old - field * math.cos(999 * angle)).max() < 1e-12


def energy(grid, p_old, p):
    """Half of |p - p_old|^2 + lam^2 p . A p_old, with A p = K p - sum of the neighbours."""
    stiff = grid.stiffness * p_old - neighbour_sum(p_old * grid.mask)
    return 0.5 * (np.sum((p - p_old) ** 2 * grid.mask) + grid.courant**2 * np.sum(p * stiff * grid.mask))


@pytest.mark.parametrize("walls", ["rigid", "pressure-release"])
def test_energy_is_conserved(walls):
    grid = make_grid(Room(outline=L_SHAPE, walls=walls, cell=H), FS)
    fields = np.random.default_rng(1).normal(size=(2, *grid.mask.shape)) * grid.mask
    after = advance(grid, *fields, 1000)
    assert grid.mask.sum() * H * H == pytest.approx(2.0 * 1.0 + 1.2 * 0.6) and not np.any(after[1][~grid.mask])
    assert energy(grid, *after) == pytest.approx(energy(grid, *fields), rel=1e-12)


@pytest.mark.parametrize("walls", ["rigid", "absorbing"])
def test_exchanging_source_and_receiver_changes_nothing(walls):
    room = Room(outline=L_SHAPE, walls=walls, admittance=0.3 * (walls == "absorbing"), cell=H)
    there = (1.62, 0.71)
    one = simulate(room, SOURCE, [there])
    other = simulate(room, dataclasses.replace(SOURCE, position=there), [SOURCE.position])
    assert np.abs(one).max() > 0
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(one).max())


def test_second_order_convergence():
    errors = []
    for h in (0.1, 0.05, 0.025):
        grid = make_grid(Room(size=(2.0, 1.5), cell=h), 0.6 * 1000 / h)
        field, _ = mode(grid, 2, 1, np.cos)
        w = C * math.pi * math.hypot(2 / 2.0, 1 / 1.5)
        dt, steps = h / 600, round(6 / h)
        _, p = advance(grid, field * math.cos(w * dt), field, steps)
        errors.append(np.abs(p - field * math.cos(w * dt * steps)).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all(np.abs(orders - 2) < 0.1), orders


@pytest.mark.parametrize("beta", [0.0, 0.3, 1.0, 4.0])
def test_absorbing_end_of_a_tube_reflects_as_its_admittance_says(beta):
    length = 2000
    grid = make_grid(Room(size=(length * 0.01, 0.01), cell=0.01), 1.5 * C / 0.01)
    loss = np.zeros_like(grid.loss)
    loss[0, -1] = 0.5 * grid.courant * beta  # only the far end absorbs
    grid, x = dataclasses.replace(grid, loss=loss), np.arange(length) + 0.5
    wave = lambda steps: np.exp(-(((x - 1000 - steps * grid.courant) / 100) ** 2))[None]  # noqa: E731
    _, p = advance(grid, wave(-1), wave(0), round(1500 / grid.courant))
    # The pressure is taken half a cell in front of the wall.
    assert p[0, np.abs(p[0]).argmax()] == pytest.approx((1 - beta) / (1 + beta), abs=4e-3)


def test_one_thread_or_several_give_the_same(monkeypatch):
    from fdcal.acoustics import fdtd_kernels

    room = Room(size=(1.0, 8.0), cell=H, walls="absorbing", admittance=0.1)
    ears = [(0.5, y) for y in (0.2, 3.9, 4.1, 7.7)]
    together = simulate(room, SOURCE, ears)
    for threads in (1, 3):
        monkeypatch.setattr(fdtd_kernels, "MAX_THREADS", threads)
        monkeypatch.setattr(fdtd_kernels.os, "cpu_count", lambda: 4)
        np.testing.assert_allclose(simulate(room, SOURCE, ears), together, rtol=0, atol=1e-15)


def test_recordings_are_those_of_the_scheme_step_by_step():
    room = Room(outline=L_SHAPE, cell=H, walls="absorbing", admittance=0.2)
    grid, ears = make_grid(room, FS), np.array([(0.33, 0.42), (1.77, 0.21)])
    recordings = simulate(room, SOURCE, ears)
    p_old = p = np.zeros(grid.mask.shape)
    rows, columns = (ears[:, ::-1] / H).astype(int).T
    for step, push in enumerate(pulse(SOURCE)[:60]):
        np.testing.assert_allclose(recordings[:, step], p[rows, columns], rtol=0, atol=1e-16)
        p_old, p = (field.copy() for field in advance(grid, p_old, p, 1))
        p[rows[0], columns[0]] += push
    assert not np.any(recordings[:, 0])


def test_pulse_has_a_flat_spectrum_begins_at_zero_and_has_no_mean():
    samples = pulse(Source(position=(0, 0)))
    assert abs(math.fsum(samples)) < 1e-17 and abs(samples[0]) < 1e-3 * np.abs(samples).max()
    gain, frequency = np.abs(np.fft.rfft(samples, 1 << 16)), np.fft.rfftfreq(1 << 16, 1 / 28590)
    assert np.all(np.abs(gain[(frequency >= 20) & (frequency <= 3000)] - 1) < 0.01)
    assert np.all(gain[frequency > 3030] < 0.01)


def test_progress_rises_to_one_and_may_stop_the_run():
    seen = []
    simulate(Room(size=(1.0, 0.8), cell=H), SOURCE, [(0.5, 0.5)], seen.append)
    assert seen == sorted(seen) and seen[-1] == 1 and 10 <= len(seen) <= 51
    with pytest.raises(ZeroDivisionError):
        simulate(Room(size=(1.0, 0.8), cell=H), SOURCE, [(0.5, 0.5)], lambda done: 1 / 0)


def test_a_sampling_rate_that_is_too_low_is_refused_with_a_sufficient_one():
    with pytest.raises(InputError, match=r"sample_rate = 20000 Hz breaks the CFL .* 0.02 m; use at least 24254 Hz"):
        make_grid(Room(size=(6.0, 5.0)), 20000)
    make_grid(Room(size=(6.0, 5.0)), 24254)


@pytest.mark.parametrize(("room", "source", "receiver", "words"), [
    ({"size": (2.01, 1.5)}, {}, (0.5, 0.5), "room.size has a wall at 2.01 m.* use 2 or 2.05 m"),
    ({"outline": ((0.0, 0.0), (1.03, 0.0), (1.03, 1.0))}, {}, (0.5, 0.5), "room.outline has a wall at 1.03 m"),
    ({"outline": ((-1.0, 0.0), (1.0, 0.0), (1.0, 1.0))}, {}, (0.5, 0.5), "below 0"),
    ({"outline": ((0.0, 0.0), (1.0, 0.1), (2.0, 0.0), (1.0, 0.12))}, {}, (0.5, 0.5), "pieces|no cell"),
    ({"size": (2000.0, 2000.0)}, {}, (0.5, 0.5), "use a larger one"),
    ({"outline": ((1e6, 0.0), (1e6 + 1, 0.0), (1e6 + 1, 1.0))}, {}, (0.5, 0.5), "use a larger one"),
    ({}, {}, (1.5, 1.3), r"microphone 0 = \[1.5, 1.3\] m is outside"),
    ({}, {"position": (3.0, 0.5)}, (0.5, 0.5), "source.position"),
    ({}, {"duration": 0.02}, (0.5, 0.5), "source.duration = 0.02 s is shorter than .*; use at least 0.05"),
    ({}, {"low": 1e-6, "duration": 1e9}, (0.5, 0.5), "over 4 GB"),
    ({}, {"low": 1e-6}, (0.5, 0.5), "source.duration = 0.08 s is shorter than .*higher source.low"),
])  # fmt: skip
def test_what_simulate_refuses(room, source, receiver, words):
    with pytest.raises(InputError, match=words):
        simulate(Room(**(room or {"outline": L_SHAPE}), cell=H), dataclasses.replace(SOURCE, **source), [receiver])


@pytest.mark.parametrize(("variable", "writable"), [("FDCAL_CACHE", True), ("FDCAL_CACHE", False), ("NONE", False)])
def test_machine_code_is_stored_in_the_cache_only_if_the_source_is_read_only(monkeypatch, tmp_path, variable, writable):
    monkeypatch.setattr(config, "CACHE_DIR", "")
    monkeypatch.setattr(compiled.os, "access", lambda *_: writable)
    monkeypatch.delenv("FDCAL_CACHE")
    monkeypatch.setenv(variable, str(tmp_path))
    compiled.compiled(lambda: 0)
    assert config.CACHE_DIR == (str(tmp_path / "compiled") if variable == "FDCAL_CACHE" and not writable else "")
