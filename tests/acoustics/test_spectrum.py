"""Laws of the spectrum: peaks at the eigenfrequencies, pressures that solve Helmholtz, wavenumbers of the grid."""

import math
from dataclasses import replace

import numpy as np
import pytest
from fields import disc, waves
from running import refuses
from scipy.special import jv

from fdcal.acoustics import spectrum
from fdcal.acoustics.coherence import array_radius
from fdcal.acoustics.fdtd import simulate
from fdcal.acoustics.measure import cached_measurement, cached_recordings, measure
from fdcal.model.arrays import ball
from fdcal.model.scene import load_scene
from fdcal.model.settings import Faults

FS, T = 4000.0, 2.0
TIME = np.arange(round(FS * T)) / FS


@pytest.fixture(scope="module")
def recordings(scene):
    return cached_recordings(scene)


def picked_modes(recordings, fs, lowest, highest, prominence_db, resolution):
    """The peaks of the spectrum of recordings, as a measurement picks them, Hz."""
    first, step, power = spectrum.mean_power(recordings, fs, lowest, highest, resolution)
    return spectrum.pick_peaks(power, first, step, prominence_db, resolution)


def eigenfrequencies(scene):
    """Return the eigenfrequencies of the rigid rectangle on the grid, Hz, ascending, each once."""
    h, fs = scene.room.cell, scene.source.sample_rate
    nx, ny = (round(length / h) for length in scene.room.size)
    m, n = np.meshgrid(np.arange(nx), np.arange(ny))
    sine = np.hypot(np.sin(np.pi * m / nx / 2), np.sin(np.pi * n / ny / 2)) * scene.room.sound_speed / (fs * h)
    return np.unique(np.arcsin(sine.ravel()) * fs / np.pi)[1:]


def test_peaks_are_the_eigenfrequencies(scene, recordings):
    sensing, fs = scene.measurement, scene.source.sample_rate
    picked = picked_modes(recordings, fs, sensing.lowest, sensing.highest, 1.0, sensing.resolution)
    modes = eigenfrequencies(scene)
    modes = modes[modes < sensing.highest]
    nearest = np.abs(picked[:, None] - modes)
    assert np.all(np.diff(picked) > 0) and len(np.unique(nearest.argmin(axis=1))) == len(picked)
    apart = np.diff(modes, prepend=sensing.lowest, append=sensing.highest)
    alone = np.minimum(apart[1:], apart[:-1]) > 2 * sensing.resolution  # closer resonances shift each other's peak
    assert nearest.min(axis=0)[alone].max() < 0.1
    assert nearest.min(axis=1).max() < sensing.resolution


@pytest.mark.parametrize(
    ("frequencies", "loss", "off"), [([100.123, 130.456, 133.2], 0, 0.02), ([100.0, 140.0], 12, 0.3)]
)
def test_picking_refines_beyond_the_points_of_the_spectrum_with_and_without_a_window(frequencies, loss, off):
    ringing = sum(np.exp(-loss * TIME) * np.sin(2 * np.pi * f * TIME + f * (not loss)) for f in frequencies)[None]
    assert (spectrum.window_rate(ringing, FS) == 0) == bool(loss)
    np.testing.assert_allclose(picked_modes(ringing, FS, 50, 300, 1.0, 1.4), frequencies, atol=off)


@pytest.mark.parametrize("decay", [0.0, 1.0, 3.0, 5.0])
def test_the_decay_of_room_and_window_together_is_always_the_same(decay):
    noise = np.random.default_rng(0).normal(size=(4, len(TIME)))
    assert (spectrum.window_rate(noise * np.exp(-decay * TIME), FS) + decay) * T == pytest.approx(12, abs=2.0)


def test_transform_equals_its_defining_sum():
    signals = np.random.default_rng(0).normal(size=(3, 5000))
    f, s = np.array([0.0, 31.4, 777.7]), 5.0
    expected = np.exp(-np.outer(s + 2j * np.pi * f, np.arange(5000) / FS)) @ signals.T
    np.testing.assert_allclose(spectrum.laplace_transform(signals, FS, s, f), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize(("call", "words"), [
    (lambda _: spectrum.window_rate(np.zeros((2, 100)), FS), "silent"),
    (lambda _: spectrum.window_rate(np.full((2, 100), np.nan), FS), "finite"),
    (lambda _: picked_modes(np.exp(-500 * TIME)[None], FS, 50, 300, 1.0, 1.4), "resonance .* = 50 Hz and .* = 300 Hz"),
    (lambda _: picked_modes(np.sin(TIME)[None], FS, 50, 300, 1.0, 1.0), r"resolution = 1 Hz; use at least 2\.72 s"),
    (lambda scene: measure(replace(scene, source=replace(scene.source, duration=0.3))), r"0\.3 s is too short"),
    (lambda _: spectrum.wavenumber_discrete(np.array([3000.0]), 0.0, 343.0, 0.1, 20000.0), r"measurement\.highest"),
])  # fmt: skip
def test_signals_without_a_usable_spectrum_are_refused(scene, call, words):
    refuses(words, call, scene)


@pytest.mark.parametrize("s", [0.0, 3.0])
def test_plane_wave_of_the_grid_has_the_discrete_wavenumber(s):
    """On average over directions, a plane wave of |k| has the frequency in the scheme from which k was computed."""
    f, c, h, fs = np.array([20.0, 400.0, 2000.0]), 343.0, 0.02, 28590.0
    k = spectrum.wavenumber_discrete(f, s, c, h, fs)
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    sines = np.sin(k[:, None] * h / 2 * np.cos(angle)) ** 2 + np.sin(k[:, None] * h / 2 * np.sin(angle)) ** 2
    courant = c / (fs * h)
    w = 2 * fs * np.arcsin(courant * np.sqrt(sines.mean(axis=1)))
    np.testing.assert_allclose(w, 2 * np.pi * f - 1j * s, rtol=1e-12)
    spread = np.abs(2 * fs * np.arcsin(courant * np.sqrt(sines)) / w[:, None] - 1).max(axis=1)
    assert spread[1] < 3e-4  # below 400 Hz the direction has little influence
    errors = [
        np.abs(spectrum.wavenumber_discrete(f, s, c, h, 500 / h) - spectrum.wavenumber_continuous(f, s, c))[1]
        for h in (0.02, 0.01)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.04), "it converges to the continuous wavenumber"


def residual(positions, pressures, k, radius, offset):
    """Relative residual of the Fourier-Bessel fit (Eqs. 3 to 5) at the true positions."""
    order = math.ceil(k.real * radius) + offset
    x, y = (positions - positions.mean(axis=0)).T
    l = np.arange(-order, order + 1)  # noqa: E741
    W = jv(l, k * np.hypot(x, y)[:, None]) * np.exp(1j * l * np.arctan2(y, x)[:, None])
    return np.linalg.norm(pressures - W @ np.linalg.lstsq(W, pressures)[0]) / np.linalg.norm(pressures)


def test_the_residual_of_helmholtz_falls_with_the_order(scene):
    angle = 2 * np.pi * np.arange(48) / 48
    ears = np.array([0.7, 0.54]) + 0.2 * np.column_stack([np.cos(angle), np.sin(angle)])
    ears = np.unique((np.floor(ears / 0.04) + 0.5) * 0.04, axis=0)
    fs, room = scene.source.sample_rate, scene.room
    sound = simulate(room, scene.source, ears)
    f, s = eigenfrequencies(scene)[:5], spectrum.window_rate(sound, fs)
    k = spectrum.wavenumber_discrete(f, s, room.sound_speed, room.cell, fs)
    rows = list(zip(spectrum.laplace_transform(sound, fs, s, f), k, strict=True))
    errors = [np.mean([residual(ears, p, k, 0.25, offset) for p, k in rows]) for offset in range(4)]
    assert np.all(np.divide(errors[1:], errors[:-1]) < 0.2), errors
    assert errors[3] < 1e-4
    plain = spectrum.wavenumber_continuous(f, 0.0, room.sound_speed)
    untreated = zip(spectrum.laplace_transform(sound, fs, 0.0, f + 0.3), plain, strict=True)
    assert np.mean([residual(ears, p, k, 0.25, 3) for p, k in untreated]) > 5 * errors[3]


def test_noise_has_the_requested_power(scene, recordings):
    noisy = replace(scene, measurement=replace(scene.measurement, snr_db=20.0))
    clean, measured = measure(scene, recordings), measure(noisy, recordings)
    np.testing.assert_allclose(measured.noise_power, np.mean(np.abs(clean.pressures) ** 2, axis=1) / 100)
    error = np.abs(measured.pressures - clean.pressures) ** 2 / measured.noise_power[:, None]
    assert error.mean() == pytest.approx(1, abs=0.15) and not np.any(clean.noise_power)
    np.testing.assert_array_equal(measure(noisy, recordings).pressures, measured.pressures)


# The coherence of the pressures gives the extent of an array.


@pytest.mark.parametrize("radius", [0.07, 0.4, 1.5])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_radius_is_found_to_a_factor_of_one_and_a_half_whatever_the_gains(radius, dimension):
    rng = np.random.default_rng(3)
    positions = disc(40, radius, 1) if dimension == 2 else ball(40, radius, rng)
    k = np.linspace(0.2, 6, 50) / radius
    p = waves(positions, k, 300)
    found = array_radius(p, k, dimension)
    assert found is not None and radius / 1.5 < found < 1.5 * radius
    assert array_radius(p * np.exp(0.5 * rng.normal(size=40)), k, dimension) == pytest.approx(found, rel=0.05)


def test_no_radius_follows_from_incoherent_pressures_or_too_few_frequencies():
    positions, k = disc(40, 0.5, 1), np.linspace(40, 80, 30)
    assert array_radius(waves(positions, k, 300), k, 2) is None, "the array is incoherent throughout"
    k = np.linspace(0.4, 12, 3)
    assert array_radius(waves(positions, k, 300), k, 2) is None, "three frequencies are too few"


# The measurement of a scene contains the faults that the scene states, and no others.


def test_faults_change_only_their_own_channels():
    scene = load_scene("tiny")
    clean = cached_measurement(scene).pressures
    faulty = cached_measurement(replace(scene, faults=Faults((9,), (3,)))).pressures
    others = np.setdiff1d(np.arange(16), [3, 9])
    assert np.array_equal(faulty[:, others], clean[:, others])
    assert np.array_equal(faulty[:, 9], -clean[:, 9])
    assert 0 < np.mean(np.abs(faulty[:, 3]) ** 2) / np.mean(np.abs(clean[:, others]) ** 2) < 1e-5


def test_gains_scatter_as_stated_and_are_drawn_by_the_seed():
    faults = Faults(gain_db=1.0, phase_deg=5.0)
    gains = faults.gains(4000, 3)
    assert np.std(20 * np.log10(np.abs(gains))) == pytest.approx(1.0, rel=0.05)
    assert np.std(np.degrees(np.angle(gains))) == pytest.approx(5.0, rel=0.05)
    assert np.array_equal(gains, faults.gains(4000, 3)) and not np.array_equal(gains, faults.gains(4000, 4))
    assert np.array_equal(Faults().gains(5, 0), np.ones(5))
