"""Positions from short windows: invariances of the term, and the smaller error of an array in a room."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2
from solving import rms_of_shape

import fdcal
from fdcal.cost.short_windows import ShortLikelihood, anisotropic_kernel, first_field
from fdcal.model.gauge import rigid_motions
from fdcal.model.problem import ShortWindows
from fdcal.model.settings import SolverSettings
from fdcal.recordings.importer import ImportOptions, measurement_of_takes
from fdcal.recordings.recording import recording_of
from fdcal.recordings.short_windows import found_flat
from fdcal.solvers import robust
from fdcal.solvers.robust import windows
from fdcal.solvers.robust.arrivals import arrivals_of
from fdcal.solvers.robust.objective import in_unit_power
from fdcal.solvers.robust.schedule import with_windows
from fdcal.solvers.robust.state import FINAL
from fdcal.solvers.robust.windows import WindowTerm, fitted, likelihood_of, precision_of, usable, with_rival

RATE, SOUND = 8000, 343.2


@pytest.fixture(scope="module")
def term() -> WindowTerm:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((6, 3))
    x -= x.mean(axis=0)
    motions = np.linalg.qr(rigid_motions(x))[0]
    fixed, root = np.eye(18) - motions @ motions.T, rng.standard_normal((18, 18))
    return WindowTerm(x, 1e4 * fixed @ root @ root.T @ fixed)


def test_rounding_errors_of_rigid_motions_are_no_precision(term):
    """Such errors made one of eight arrays fail, because a pseudo-inverse treated them as variances of either sign."""
    rng, motions = np.random.default_rng(4), np.linalg.qr(rigid_motions(term.positions))[0]
    fixed = np.eye(18) - motions @ motions.T
    covariance = fixed @ np.diag(np.geomspace(1e-8, 1e-4, 18)) @ fixed
    rounding = motions @ rng.standard_normal((6, 6)) @ motions.T
    precision = precision_of(covariance + 1e-12 * (rounding + rounding.T), term.positions)
    values = np.linalg.eigvalsh(precision)
    assert values[0] > -1e-6 * values[-1] and np.abs(precision @ motions).max() < 1e-3 * values[-1]
    assert np.allclose(covariance @ precision @ covariance, covariance, atol=1e-10)


def turned(x: np.ndarray, mirror: int = 1) -> np.ndarray:
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    turn[:, 0] *= mirror * np.sign(np.linalg.det(turn))
    return x @ turn + [1.0, -2.0, 0.5]


@pytest.mark.parametrize("mirror", [1, -1])
def test_the_term_does_not_depend_on_where_the_array_is(term, mirror):
    moved = term.positions + 1e-3 * np.random.default_rng(2).standard_normal((6, 3))
    here, there = term.terms(moved), term.terms(turned(moved, mirror))
    assert here[0] > 1e-3 and here[0] == pytest.approx(there[0], rel=1e-9)
    assert np.allclose(np.linalg.eigvalsh(here[2]), np.linalg.eigvalsh(there[2]), atol=1e-6)
    assert term.terms(turned(term.positions, mirror))[0] == pytest.approx(0, abs=1e-12)


def test_the_gradient_of_the_term_is_that_of_its_cost(term):
    x = turned(term.positions) + 1e-4 * np.random.default_rng(3).standard_normal((6, 3))
    gradient, h = term.terms(x)[1], 1e-7
    numerical = [(term.terms(x + e)[0] - term.terms(x - e)[0]) / (2 * h) for e in h * np.eye(18).reshape(18, 6, 3)]
    assert np.allclose(gradient, numerical, atol=1e-2 * np.abs(gradient).max())


def test_estimates_that_differ_by_more_than_both_claim_are_less_certain(term):
    values, vectors = np.linalg.eigh(free := np.linalg.pinv(term.precision, rcond=1e-9, hermitian=True))
    z = np.sqrt(2 * np.maximum(values, 0)) * np.random.default_rng(4).standard_normal(18)
    away = vectors @ z  # as if two covariances were equal
    same, near, far = (term.disagreement(term.positions + c * away.reshape(6, 3), free) for c in (0, 1, 5))
    assert same == 1 and near < 2.5 and 10 < far < 50


def test_a_large_difference_that_the_estimates_claim_is_no_disagreement():
    """Small variances along rotations, which two arrays of different shape define differently, are not counted."""
    x = (rng := np.random.default_rng(5)).standard_normal((12, 3))
    x -= x.mean(axis=0)
    maps = 0.2 * np.array([np.kron(np.eye(12), one + one.T) @ x.ravel() for one in np.eye(9).reshape(9, 3, 3)])
    bent = x + (rng.standard_normal(9) @ maps).reshape(12, 3) + 1e-3 * rng.standard_normal((12, 3))
    own, fixed = (np.eye(36) - q @ q.T for q in (np.linalg.qr(rigid_motions(array))[0] for array in (x, bent)))
    claimed = fixed @ (maps.T @ maps + 1e-8 * np.eye(36)) @ fixed
    assert WindowTerm(x, 1e6 * own).disagreement(bent, claimed) == 1


def room(x: np.ndarray, seconds: float, seed: int = 0) -> np.ndarray:
    """Return noise (N, T) from eighty directions, mainly horizontal, as in a room with absorbing floor and ceiling."""
    rng, samples = np.random.default_rng(seed), int(seconds * RATE)
    f = np.fft.rfftfreq(samples, 1 / RATE)
    total, used = np.zeros((len(x), len(f)), complex), f < 3000
    for _ in range(80):
        u = rng.standard_normal(3) * [1, 1, 0.5]
        wave = (rng.standard_normal(len(f)) + 1j * rng.standard_normal(len(f)))[used]
        total[:, used] += wave * np.exp(2j * np.pi * f[used] * (x @ u / np.linalg.norm(u))[:, None] / SOUND)
    y = np.fft.irfft(total, samples)
    return y / y.std() + 0.01 * rng.standard_normal(y.shape)


@pytest.fixture(scope="module")
def small_array():
    """A measurement of eight microphones within 0.15 m in such a room, and their positions (8, 3), metres."""
    x = (rng := np.random.default_rng(7)).standard_normal((8, 3))
    x *= 0.15 * rng.random((8, 1)) ** (1 / 3) / np.linalg.norm(x, axis=1, keepdims=True)
    recording = recording_of("room", "stationary", RATE, room(x, 3.0))
    return measurement_of_takes([recording], ImportOptions(kind="stationary"))[0], x


def test_short_windows_determine_an_array_that_few_long_rows_of_a_room_leave_uncertain(small_array):
    measurement, x = small_array
    beside = fdcal.calibrate(measurement)
    error, claimed = rms_of_shape(beside.positions, x), float(np.sqrt(np.mean(beside.uncertainty**2)))
    assert error < min(0.006, 2.5 * claimed) and beside.converged, "without windows the error is larger"


def test_windows_do_not_count_for_few_microphones_or_an_array_that_sound_crosses_slowly(small_array):
    measurement, x = small_array
    problem, every = measurement.problem(), np.ones(8, bool)
    assert usable(problem, 7 * x, every) and not usable(problem, 9 * x, every)  # 1.8 and 2.3 m
    without, plate = replace(problem, windows=None), replace(problem, dimension=2)
    assert not (usable(problem, x, np.arange(8) < 4) or usable(without, x, every) or usable(plate, x, every))


@pytest.fixture(scope="module")
def fewer(small_array):
    """The problem of `small_array`, with an eighth of the windows."""
    return replace(in_unit_power(small_array[0].problem()), windows=every_eighth(small_array[0].windows))


def every_eighth(windows: ShortWindows) -> ShortWindows:
    return replace(windows, **{name: getattr(windows, name)[::8] for name in ("frequencies", "takes", "pressures")})


def at_the_end(problem, x, **changes):
    """Return the state of the last stage at `x`, with windows, or None if they are not used."""
    state = robust.init(problem, SolverSettings(modes=len(problem.frequencies)), 0, x)
    model, progress = replace(state.model, **changes), replace(state.progress, stage=FINAL)
    return with_windows(problem, replace(state, model=model, progress=progress))


def test_given_positions_do_not_raise_the_weight_of_the_rows(fewer, small_array):
    """Four right positions of 32 microphones in a living room were once called wrong in 3 of 6 calibrations."""
    given = replace(fewer, known=np.arange(4), known_positions=small_array[1][:4], frame=None)
    alone, beside = (at_the_end(problem, small_array[1]).model.tempering for problem in (fewer, given))
    assert alone > 1.2 and beside == pytest.approx(alone, rel=0.1)


def test_the_weight_of_the_rows_is_that_at_the_array_of_the_windows(fewer, small_array):
    """A ball of 32 in a dry room was once 6 instead of 2 mm off: at its array the noise is 100 times lower."""
    away = 0.04 * np.random.default_rng(0).standard_normal((8, 3))
    here, there = (at_the_end(fewer, small_array[1] + move).model for move in (0.0, away))
    assert here.tempering / here.window_ratio == pytest.approx(there.tempering / there.window_ratio, rel=1e-3)


def test_windows_are_used_if_all_channels_share_a_delay_and_leave_out_a_late_channel(fewer, small_array):
    every = np.tile([0.05, 0.0], (8, 1))  # metres, more than a window's

    def at_delays(delay_sigma: float, filters: np.ndarray):
        return at_the_end(fewer, small_array[1], filters=filters, delay_sigma=delay_sigma)

    shared = at_delays(0.01, every).model
    assert shared.window_positions is not None and shared.delay_sigma < 1e-3, "no channel is late, which the rows show"
    assert at_delays(0.0, every) is None
    one = at_delays(0.0, every * (np.arange(8) == 3)[:, None])
    counted = np.diag(one.model.window_precision).reshape(8, 3) > 0
    assert np.array_equal(np.flatnonzero(~counted.any(axis=1)), [3])


def test_rows_with_a_microphone_elsewhere_that_contradict_the_windows_are_a_rival(fewer, small_array, monkeypatch):
    """A ball of 0.8 m was called good 0.2 m off, with one sigma of 31 mm, although its two estimates differed."""
    for apart, is_rival in ((0.05, False), (0.3, True)):
        moved = small_array[1] + apart * np.eye(8, 3)
        term = WindowTerm(moved, precision_of(1e-6 * np.eye(24), moved))
        monkeypatch.setattr(windows, "window_term", lambda *_, term=term: term)
        assert (at_the_end(fewer, small_array[1]).model.window_rival is not None) == is_rival


def test_arrivals_of_six_takes_are_not_outweighed():
    """If times determine the array, it ends within three of their sigmas from their optimum; 13 unknowns are free."""
    rng = np.random.default_rng(0)
    x = np.pad(0.15 * np.sqrt(rng.random((8, 1))) * rng.standard_normal((8, 2)), ((0, 0), (0, 1)))
    recordings = [recording_of("room", "stationary", RATE, room(x, 2.0, take)) for take in range(6)]
    measurement = measurement_of_takes(recordings, ImportOptions(kind="stationary", array_dimension=2, max_rows=60))[0]
    sources = rng.standard_normal((6, 3)) * [2, 2, 0.5]
    paths = np.linalg.norm(x - sources[:, None], axis=2) + 3e-4 * rng.standard_normal((6, 8))
    sigma = np.full(6, 3e-4 / measurement.sound_speed)
    times, windows = paths / measurement.sound_speed, every_eighth(measurement.windows)
    measurement = replace(measurement, arrivals=times, arrival_sigma=sigma, windows=windows)
    end = np.asarray(fdcal.calibrate(measurement).positions)
    arrivals = arrivals_of(measurement.problem(known="none"), None)

    def cost(y):
        terms = arrivals.terms(y.reshape(8, 2))
        return terms.cost, terms.gradient.sum(axis=0)[:-1]

    assert cost(end)[0] < minimize(cost, end.ravel(), jac=True).fun + chi2.isf(0.0027, 13) / 2


@pytest.mark.parametrize(("count", "height", "dead"), [
    (8, 0.0, False), (8, 0.06, False), (8, 0.0, True), (40, 0.0, False), (40, 0.06, False),
])  # fmt: skip
def test_an_array_is_flat_where_its_windows_show_no_heights(count, height, dead):
    """Long rows and windows are drawn from the model: microphones on a tilted plane, or up to 60 mm above it."""
    rng, k = np.random.default_rng(5), np.append(np.linspace(1.2, 12, 40), np.linspace(4, 60, 40))
    x = rng.uniform(-0.15, 0.15, (count, 3)) * [1, 1, 0]
    x[:, 2] = height * np.resize([1, -1, 1, -1, -1, 1, -1, 1], count)
    K = anisotropic_kernel(turned(x), k, np.array([0, 0, 0, 0, -0.4, 0.1, 0.1]), 0.0, False)[0]
    z = rng.standard_normal((len(k), 60, count, 2)).view(complex)[..., 0]
    p = z @ np.linalg.cholesky(K + np.repeat([2e-4, 0.02], 40)[:, None, None] * np.eye(count)).swapaxes(1, 2)
    if dead:
        p[..., 3] = rng.standard_normal((*p.shape[:2], 2)).view(complex)[..., 0]
    low, high = (k * SOUND / (2 * np.pi)).reshape(2, 40)
    measurement = fdcal.Measurement.from_arrays(low, p[:40, 0], sound_speed=SOUND)
    measurement = replace(measurement, windows=ShortWindows(high, np.zeros(40, np.int64), p[40:], 0.03))
    assert found_flat(measurement) == (height == 0)


def test_more_microphones_do_not_make_the_size_and_shear_of_a_plane_array_more_certain(monkeypatch):
    x = np.random.default_rng(5).uniform(-0.15, 0.15, (8, 2))
    recording = recording_of("room", "stationary", RATE, room(np.pad(x, ((0, 0), (0, 1))), 2.0))
    measurement = measurement_of_takes([recording], ImportOptions(kind="stationary", array_dimension=2, max_rows=40))[0]
    measurement = replace(measurement, windows=every_eighth(measurement.windows))
    before = fdcal.calibrate(measurement)
    monkeypatch.setattr(windows, "STRETCH_COUNT", 2)  # as if eight were four times as many as the claim is right for
    wide, after = windows.enlarging(np.pad(x, ((0, 0), (0, 1)))), fdcal.calibrate(measurement)
    y = np.pad((x - x.mean(axis=0)) * [1, -1], ((0, 0), (0, 1)))
    np.testing.assert_allclose([wide @ y.ravel(), wide @ np.ones(24)], [2 * y.ravel(), np.ones(24)], atol=1e-9)
    ratio = np.sqrt(np.mean(after.uncertainty**2) / np.mean(before.uncertainty**2))
    assert np.array_equal(after.positions, before.positions) and 1.3 < ratio < 2


@pytest.mark.parametrize("apart", [2.4, 0.3])
def test_a_microphone_that_may_stand_elsewhere_is_found(apart):
    """Three waves along y = 0 show only how far two microphones are from the plane of the others, not on which side.

    The coherence of the two shows whether they are on the same side, if they are near each other.
    """
    rng, k = np.random.default_rng(0), np.linspace(4, 40, 20)
    x = np.vstack([rng.uniform(-0.15, 0.15, (8, 3)) * [1, 0, 1], [[-apart / 2, 0.4, 0], [apart / 2, 0.4, 0.1]]])
    waves = np.array([[0.8, 0, 0.6], [0.6, 0, -0.8], [-0.28, 0, 0.96]])
    field = replace(first_field(x, 1), directions=waves[None], powers=np.full((1, 3, 2), 1.5))
    field = replace(field, curvature=np.full((1, 3), 0.5))
    across = np.sum(field.positions**2, axis=1)[:, None] - (field.positions @ waves.T) ** 2
    h = np.exp(0.75 + 1j * k[:, None, None] * (field.positions @ waves.T - across / 4))
    K = anisotropic_kernel(x, k, field.spectrum, 0.0, False)[0] + h @ h.conj().swapaxes(1, 2)
    z = rng.standard_normal((len(k), 40, 10, 2)).view(complex)[..., 0]
    p = z @ np.linalg.cholesky(K + 0.05 * np.eye(10)).swapaxes(1, 2)
    likelihood = ShortLikelihood(k, np.zeros(len(k), np.int64), p, 0.0)
    assert (with_rival(likelihood, field, np.arange(3), np.full(10, True))[1] is None) == (apart < 1)


def test_the_covariance_of_windows_is_that_of_white_sound_in_a_hann_window():
    """It holds for one wave at two microphones 1.2 m apart, and on average over waves from all directions."""
    window, late = np.hanning(480), np.arange(60)
    correlation = [window[n:] @ window[: 480 - n] / (window @ window) for n in late]
    windows = ShortWindows(np.full(1, 1e3), np.zeros(1, np.int64), np.ones((1, 1, 2), complex), 0.03)
    likelihood, cosine = likelihood_of(windows, SOUND, np.zeros(2)), np.linspace(-1, 1, 2001)
    k, x = likelihood.wavenumbers, np.array([[-0.6, 0, 0], [0.6, 0, 0]])
    exact = np.exp(1j * k * 1.2 * cosine) * np.interp(1.2 * np.abs(cosine) / SOUND * 16000, late, correlation)
    wave = replace(first_field(x, 1), directions=np.array([[[-1.0, 0, 0]]]), powers=np.zeros((1, 1, 2)))
    h = likelihood.waves(replace(wave, curvature=np.zeros((1, 1))), np.full((1, 2), 0.5))[0][0]
    assert anisotropic_kernel(x, k, np.zeros(7), likelihood.bandwidth, False)[0][0, 0, 1] == pytest.approx(
        exact.mean().real, abs=2e-3
    )
    assert h[:, 0] @ h[:, 1].conj() == pytest.approx(exact[-1], abs=0.01)


def test_the_reflections_of_each_of_two_takes_are_found():
    rng, k, takes = np.random.default_rng(0), np.linspace(4, 60, 40), np.tile([0, 1], 20)
    field, v = first_field(rng.uniform(-0.15, 0.15, (8, 3)), 2), rng.standard_normal((2, 3, 3))
    v /= np.linalg.norm(v, axis=2, keepdims=True)
    h = np.exp(1j * k[:, None, None] * (v[takes] @ field.positions.T))
    K = anisotropic_kernel(field.positions, k, field.spectrum, 0.0, False)[0] + 2 * h.swapaxes(1, 2) @ h.conj()
    z = rng.standard_normal((len(k), 60, 8, 2)).view(complex)[..., 0]
    likelihood = ShortLikelihood(k, takes, z @ np.linalg.cholesky(K + 0.02 * np.eye(8)).swapaxes(1, 2), 0.0)
    found = fitted(likelihood, [(field.positions, (60.0,))])[1]
    delays = found.directions @ (found.positions - found.positions.mean(axis=0)).T
    apart = np.abs(delays[:, :, None] - (v @ field.positions.T)[:, None]).max(axis=3)
    assert apart.min(axis=1).max() < 0.02, "metres, whatever way the array found is turned"


def test_heights_that_their_covariance_explains_are_evidence_of_a_flat_array():
    rng, spread = np.random.default_rng(5), 0.004  # metres
    flat = np.pad(rng.standard_normal((40, 2)), ((0, 0), (0, 1)))
    noise, covariance = rng.standard_normal((40, 1)) * [0, 0, spread], spread**2 * np.eye(120)
    within, beyond = (windows.flat_evidence(turned(flat + scale * noise), covariance) for scale in (1, 12))
    assert within > 50 and beyond < -50


def test_many_microphones_in_space_use_windows_only_if_they_are_flat(small_array):
    problem, every = small_array[0].problem(), np.ones(40, bool)
    x = np.random.default_rng(6).uniform(-0.1, 0.1, (40, 3))
    assert usable(problem, x, every, True) and usable(problem, x[:, :2], every) and not usable(problem, x, every)


def test_the_term_of_a_flat_array_in_space_holds_its_heights_near_its_plane():
    rng = np.random.default_rng(7)
    flat = np.column_stack([rng.uniform(-0.15, 0.15, (8, 2)), np.zeros(8)])
    recording = recording_of("room", "stationary", RATE, room(flat, 2.0))
    problem = measurement_of_takes([recording], ImportOptions(kind="stationary", array_dimension=3))[0].problem()
    normal = turned(np.eye(3))[2] - turned(np.zeros(3))
    guess = turned(flat) + np.outer(np.linspace(-0.0025, 0.0025, 8), normal)  # metres
    term = windows.window_term(problem, guess, np.zeros(8), np.ones(8, bool), flat=True)
    assert np.linalg.svd(term.positions - term.positions.mean(axis=0))[1][2] < 1e-9
    assert rms_of_shape(term.positions, flat) < 0.006
    bent = term.positions + np.outer(across := rng.standard_normal(8) * 1e-3, normal)
    rest = np.linalg.lstsq(np.column_stack([np.ones(8), flat[:, :2]]), across, rcond=None)[1]
    assert term.terms(bent)[0] == pytest.approx(rest[0] / (2 * windows.FLAT_SIGMA**2), rel=0.1)
