"""Laws of the costs: through the expansion, the series and the kernel."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.special import jv, spherical_jn, spherical_yn, yv

from fdcal.acoustics.bessel import bessel, spherical_bessel_functions
from fdcal.acoustics.fourier_bessel import fourier_bessel, max_order
from fdcal.acoustics.spherical_harmonics import degrees, spherical_bessel
from fdcal.cost import circular_waves, low_rank_covariance
from fdcal.cost.dense_covariance import dense_terms
from fdcal.cost.likelihood import DiffuseField, newton_terms, total_cost
from fdcal.cost.low_rank_covariance import EXTRA_ORDERS, expansion_terms
from fdcal.cost.mode_sums import summed
from fdcal.cost.spherical_covariance import series_covariance

N, M = 9, 3
K = np.array([1.3, 3.1, 7.4])
POWER, NOISE = np.array([1.0, 0.7, 1.6]), np.array([0.03, 0.05, 0.02])
ASIDE = 1e-5  # the expansion's centre is a little beside the centre of mass, and so counts, of complex wavenumbers
CASES = [
    pytest.param(dimension, D, damped, log_det, near, id=f"{D} of {dimension}-{name}-{cost}{'-near' * near}")
    for (dimension, D), (damped, name), (log_det, cost), near in itertools.product(
        ((2, 2), (3, 3), (3, 2)),
        ((0.0, "real"), (0.2, "complex")),
        ((True, "likelihood"), (False, "projection")),
        (False, True),
    )
]


def drawn(D, seed=0):
    """Positions (N, D) away from the origin, pressures (M, N)."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.5, 0.5, (N, D)) + np.arange(2, 2 + D)
    return x, rng.normal(size=(M, N)) + 1j * rng.normal(size=(M, N))


def field(dimension, damped, log_det=True, near=False, about=None):
    k = K - 1j * damped if damped else K
    return DiffuseField(k, POWER, NOISE, dimension, log_det, near, about)


def dictionary(x, k, dimension, centre):
    order = int(max_order(np.array([k]), 1.0, EXTRA_ORDERS)[0])
    build = fourier_bessel if dimension == 2 else spherical_bessel
    return build(x, k, order, centre)


@pytest.mark.parametrize(("dimension", "D", "damped", "log_det", "near"), CASES)
def test_gradient_is_the_limit_of_differences(dimension, D, damped, log_det, near):
    x, p = drawn(D)
    model = field(dimension, damped, log_det, near, about=x)
    cost, gradient, _ = newton_terms(x, p, model)
    np.testing.assert_allclose(total_cost(x, p, model), cost, rtol=1e-10)
    h, expected = 1e-5, np.empty_like(x)
    for i, a in np.ndindex(x.shape):
        step = np.zeros_like(x)
        step[i, a] = h
        expected[i, a] = (total_cost(x + step, p, model) - total_cost(x - step, p, model)) / (2 * h)
    np.testing.assert_allclose(gradient, expected, rtol=2e-6, atol=2e-6 * np.abs(expected).max())


@pytest.mark.parametrize(("dimension", "D", "damped", "log_det"), [case.values[:4] for case in CASES[::2]])
def test_cost_gradient_and_curvature_are_those_of_the_explicit_covariance(dimension, D, damped, log_det):
    """C = s W W^H + v I of the dictionary; the Jacobian of sqrt(v) C^-1/2 p with the coefficients held (Kaufman)."""
    x, p = drawn(D, seed=1)
    model = field(dimension, damped, log_det)
    cost, _, curvature = newton_terms(x, p, model)
    expected, H, h = 0.0, np.zeros((N * D, N * D)), 1e-6
    for k, s, v, q in zip(model.wavenumbers, POWER, NOISE, p, strict=True):
        at = lambda y, k=k: dictionary(y, k, dimension, x.mean(axis=0))  # noqa: E731
        W = at(x)
        C = s * W @ W.conj().T + v * np.eye(N)
        scale = 1.0 if log_det else v
        expected += scale * np.vdot(q, np.linalg.solve(C, q)).real
        expected += log_det * (np.linalg.slogdet(C)[1] - N * np.log(v))
        mu = v / s
        whole = np.vstack([W, np.sqrt(mu) * np.eye(W.shape[1])])
        alpha = np.linalg.lstsq(whole, np.append(q, np.zeros(W.shape[1])), rcond=None)[0]
        Q = np.linalg.qr(whole)[0]
        J = np.zeros((len(whole), N * D), complex)
        for i, a in np.ndindex(x.shape):
            step = np.zeros_like(x)
            step[i, a] = h
            moved = np.zeros(len(whole), complex)
            moved[i] = (at(x + step) - at(x - step))[i] @ alpha / (2 * h)
            J[:, D * i + a] = -(moved - Q @ (Q.conj().T @ moved))
        H += 2 * scale / v * (J.conj().T @ J).real
    tolerance = ASIDE if damped else 1e-7
    assert cost == pytest.approx(expected, rel=tolerance)
    close = 100 * tolerance * np.abs(H).max()
    np.testing.assert_allclose(curvature.reshape(N * D, N * D), H, rtol=0, atol=close)


@pytest.mark.parametrize("log_det", [True, False])
@pytest.mark.parametrize("D", [2, 3])
def test_both_ways_are_one(D, log_det):
    x, p = drawn(D, seed=2)
    through_expansion = expansion_terms(x, p, K, POWER, NOISE, 3, log_det)
    through_kernel = dense_terms(x, p, K, POWER, NOISE, log_det)
    assert through_expansion.costs == pytest.approx(through_kernel.costs, rel=1e-7)
    for one, other in zip(summed(through_expansion, x.shape), summed(through_kernel, x.shape), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-8 * np.abs(other).max())


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("damped", [0.0, 0.2])
def test_combining_very_many_waves_changes_nothing(damped, near, monkeypatch):
    """An array of many wavelengths has far more waves than microphones."""
    x, p = drawn(2, seed=3)
    k = 8 * K - 1j * damped if damped else 8 * K
    found = []
    for many in (1, 1000):
        monkeypatch.setattr(circular_waves, "MANY", many)
        terms = expansion_terms(x, p, k, POWER, NOISE, 2, True, near)
        spectra = low_rank_covariance.expansion_spectra(x, p, k, 2, near)
        found.append([terms.costs, *summed(terms, x.shape), *spectra])
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-9 * np.abs(other).max())


def test_no_matrix_grows_with_the_wavelengths_in_the_array(monkeypatch):
    sizes, cholesky, eigh = [], np.linalg.cholesky, np.linalg.eigh
    monkeypatch.setattr(np.linalg, "cholesky", lambda A: sizes.append(A.shape[-1]) or cholesky(A))
    monkeypatch.setattr(np.linalg, "eigh", lambda A: sizes.append(A.shape[-1]) or eigh(A))
    x, p = drawn(2)
    expansion_terms(x, p, 100 * K, POWER, NOISE, 2, True)
    low_rank_covariance.expansion_spectra(x, p, 100 * K, 2)
    assert sizes and max(sizes) <= 3 * N


def with_penalty(W, p, weight) -> float:
    """Least |W alpha - p|^2 + weight |alpha|^2."""
    A, b = np.concatenate([W, np.sqrt(weight) * np.eye(W.shape[1])]), np.concatenate([p, np.zeros(W.shape[1])])
    return float(np.sum(np.abs(A @ np.linalg.lstsq(A, b, rcond=None)[0] - b) ** 2))


def test_the_projection_is_the_paper_s_cost_with_a_tikhonov_weight():
    x, p = drawn(2, seed=3)
    for damped in (0.0, 0.2):
        k = K - 1j * damped
        orders, centre = max_order(K, 1.0, EXTRA_ORDERS), x.mean(axis=0)
        weights = NOISE / POWER
        expected = sum(
            with_penalty(fourier_bessel(x, k[m], int(orders[m]), centre), p[m], weights[m]) for m in range(M)
        )
        assert total_cost(x, p, field(2, damped, log_det=False)) == pytest.approx(
            expected, rel=ASIDE if damped else 1e-8
        )


@pytest.mark.parametrize("log_det", [True, False])
@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 3), (3, 2)])
@pytest.mark.parametrize("damped", [0.0, 0.05])
def test_no_rigid_motion_and_no_mirror_changes_the_cost(dimension, D, damped, log_det):
    """Of complex wavenumbers only those about the centre of mass, as the expansion is."""
    x, p = drawn(D, seed=4)
    model = field(dimension, damped, log_det)
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(D, D)))[0]
    Q[:, 0] *= -np.sign(np.linalg.det(Q))
    assert total_cost(x @ Q - 3.0, p, model) == pytest.approx(total_cost(x, p, model), rel=ASIDE if damped else 1e-8)


def test_positions_that_are_no_numbers_are_refused():
    x, p = drawn(2)
    x[3, 1] = np.nan
    with pytest.raises(np.linalg.LinAlgError):
        total_cost(x, p, field(2, 0.0))


ARGUMENTS = [0.0, 1e-9, 0.03, 0.1999, 0.2001, 1.0, 4.7, 23.0, 60.0]


@pytest.mark.parametrize("damped", [0.0, 0.5])
@pytest.mark.parametrize("top", [1, 6, 40, 150])
def test_bessel_functions_of_all_orders_are_scipy_s(damped, top):
    z = np.array([z for z in ARGUMENTS if z <= top + 25])  # the orders in use always reach beyond the argument
    z = z - 1j * damped if damped else z
    J = bessel(z, top)
    assert J.dtype == z.dtype
    np.testing.assert_allclose(J, jv(np.arange(top + 1)[:, None], z), rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("top", [0, 1, 6, 40, 150])
def test_spherical_bessel_functions_are_scipy_s(top):
    z = np.array([complex(z, -loss) for z in ARGUMENTS[1:] if z <= top + 25 for loss in (0.0, 0.3)])
    j = spherical_bessel_functions(z.reshape(2, -1), top)
    expected = spherical_jn(np.arange(top + 1)[:, None, None], z.reshape(2, -1))
    np.testing.assert_allclose(j, expected, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("near", [False, True])
@pytest.mark.parametrize("damped", [0.0, 0.05, 1.0])
@pytest.mark.parametrize("D", [2, 3])
def test_the_covariance_in_space_is_that_of_the_spherical_dictionary(D, damped, near):
    x, _ = drawn(D, seed=6)
    k = K - 1j * damped
    centre, orders, gains = low_rank_covariance.expansion_centre(x, k, 3, near)
    covariance, slope = series_covariance(x, centre, k, orders, gains, True)
    for m, top in enumerate(orders if near else [40] * M):  # without gains it is the sum over all orders
        factor = gains[m, degrees(int(top), D == 2)[0]] if near else 1.0
        W = factor * spherical_bessel(x, complex(k[m]), int(top), centre)
        expected = W @ W.conj().T
        np.testing.assert_allclose(covariance[m], expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    h = 1e-5
    for i, a in np.ndindex(N, D):
        step = np.zeros_like(x)
        step[i, a] = h
        above, below = (series_covariance(x + way * step, centre, k, orders, gains, False)[0] for way in (1, -1))
        found = slope[a, :, i].copy()
        found[:, i] = 2 * found[:, i].real  # both microphones of that element move
        np.testing.assert_allclose(found, (above - below)[:, i] / (2 * h), rtol=0, atol=1e-8 * np.abs(slope).max())


@pytest.mark.parametrize(("dimension", "D"), [(2, 2), (3, 3), (3, 2)])
def test_the_reference_positions_set_the_centre_of_a_near_field_expansion(dimension, D):
    """With a near source the cost depends on the centre and the extent, which are those of the reference alone."""
    x, p = drawn(D, seed=5)
    reference = 1.5 * x - 0.2
    own, shared = field(dimension, 0.2, True, True), field(dimension, 0.2, True, True, reference)
    assert total_cost(x, p, shared) != pytest.approx(total_cost(x, p, own), rel=1e-6)
    moved = x + 0.3
    away = field(dimension, 0.2, True, True, reference + 0.3)
    assert total_cost(moved, p, away) == pytest.approx(total_cost(x, p, shared), rel=1e-9)
    assert total_cost(moved, p, shared) != pytest.approx(total_cost(x, p, shared), rel=1e-6)


def test_gains_follow_wavenumbers_size_and_dimension():
    """Each in turn, since trials of a step share them."""
    x = drawn(2)[0]
    reach = float(np.linalg.norm(x - x.mean(axis=0), axis=1).max())
    for k, scale, dimension in ((K, 1.0, 2), (1.1 * K, 1.0, 2), (K, 1.3, 2), (K, 1.3, 3), (K, 1.0, 2)):
        _, orders, gains = low_rank_covariance.expansion_centre(scale * x, k, dimension, True)
        l, z = np.arange(orders.max() + 1), (k * low_rank_covariance.SOURCE_DISTANCE * scale * reach)[:, None]  # noqa: E741
        sizes = np.hypot(jv(l, z), yv(l, z)) if dimension == 2 else np.hypot(spherical_jn(l, z), spherical_yn(l, z))
        np.testing.assert_allclose(gains, np.clip(sizes, 1.0, 1e100), rtol=1e-10)
