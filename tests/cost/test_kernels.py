"""Kernels of the likelihood and the waves that they are made of, in blocks on several cores."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured
from scipy.spatial.distance import pdist, squareform
from scipy.special import jv, spherical_jn

from fdcal.acoustics.dictionary import dictionary
from fdcal.cost import kernels
from fdcal.cost.kernels import directions_needed
from fdcal.cost.likelihood import FieldModel, field_covariance, isotropic_field, likelihood_terms, log_response, spectra

K = np.array([1.3, 3.1, 7.4])  # rad/m
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array


def array(D=2, seed=0, count=9):
    """Positions (N, D), metres, away from the origin."""
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, D)) + np.arange(2, 2 + D)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_diffuse_field_has_the_covariance_of_bessel_functions_of_order_zero(dimension):
    r = np.array([0.0, 1e-8, 0.01, 0.3, 2.0, 9.0])
    kappa, over = kernels.diffuse_kernel(r, K, dimension)
    z = np.multiply.outer(K, r)
    np.testing.assert_allclose(kappa, jv(0, z) if dimension == 2 else spherical_jn(0, z), atol=1e-14)
    np.testing.assert_array_equal(kappa, kernels.diffuse_correlation(z, dimension))
    np.testing.assert_allclose(over[:, 0], -(K**2) / dimension, rtol=1e-9, err_msg="kappa = 1 - z^2 / (2 D) at r = 0")
    x = array(dimension)
    matrices, _ = kernels.diffuse_matrices(x, K, dimension, True)
    z = np.multiply.outer(K, squareform(pdist(x)))
    np.testing.assert_allclose(matrices, kernels.diffuse_correlation(z, dimension), atol=1e-13)


@pytest.mark.parametrize("damping", [0.0, 0.05, 1.0])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_a_damped_isotropic_field_is_that_of_the_dictionary(dimension, D, damping):
    """It is compared with Eq. 4 at a high order, in the plane with plane waves, and in space with a closed form."""
    x, k = array(D, seed=6), K - 1j * damping
    about = 1.1 * x - 0.2
    field = FieldModel(k, np.ones(3), np.zeros(3), np.ones(len(x)), dimension, about)
    found, _ = field_covariance(x, field, slice(None), False)
    for m in range(len(K)):
        W = dictionary(x, complex(k[m]), 40, about.mean(axis=0), dimension)
        expected = W @ W.conj().T
        np.testing.assert_allclose(found[m], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_the_covariance_of_plane_waves_is_their_explicit_sum(dimension, D, damping):
    """This also holds for undamped waves, which are added in opposite pairs, and for a part of the modes."""
    x, k = array(D) - array(D).mean(axis=0), K - 1j * damping if damping else K
    powers = np.random.default_rng(3).uniform(0.1, 2.0, (len(K), kernels.directions_needed(x, K, dimension)))
    found, _ = kernels.plane_wave_covariance(x, k, powers, dimension, slice(None))
    W = kernels.plane_waves(x, k, powers, dimension)
    np.testing.assert_allclose(found, W.swapaxes(1, 2) @ W.conj(), atol=1e-10 * np.abs(found).max())
    some, _ = kernels.plane_wave_covariance(x, k, powers, dimension, slice(1, 3))
    np.testing.assert_allclose(some, found[1:], rtol=1e-12)


# The sums and slopes of plane waves over an array, and the number of waves that is needed.


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
@pytest.mark.parametrize("size", [0.3, 1.0, 2.5])
def test_the_directions_needed_resolve_a_diffuse_field_over_the_array(dimension, D, size):
    x = size * array(D, count=20)
    Q = kernels.directions_needed(x, K, dimension)
    W = kernels.plane_waves(x - x.mean(axis=0), K, np.ones((len(K), Q)), dimension)
    distance = np.linalg.norm(x[:, None] - x, axis=-1)
    for k, one in zip(K, W, strict=True):
        np.testing.assert_allclose(one.T @ one.conj(), kernels.diffuse_correlation(k * distance, dimension), atol=2e-4)
    assert Q <= kernels.directions_needed(1.5 * x, K, dimension) == kernels.directions_needed(x, 1.5 * K, dimension)


@pytest.mark.parametrize("damping", [0.0, 0.3])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_a_plane_wave_has_its_power_and_weight_and_falls_along_its_direction(dimension, D, damping):
    x, k = array(D) - array(D).mean(axis=0), K - 1j * damping if damping else K
    needed = kernels.directions_needed(np.zeros((1, dimension)), np.ones(1), dimension, 5)
    u, w = kernels.wave_directions(dimension, needed)
    powers = np.random.default_rng(1).uniform(0.1, 2, (len(K), len(w)))
    W = kernels.plane_waves(x, k, powers, dimension)
    phase = np.exp(-1j * np.multiply.outer(k, u[:D].T @ x.T))
    np.testing.assert_allclose(W, np.sqrt(w * powers)[..., None] * phase, rtol=1e-10)


@pytest.mark.parametrize(("kind", "N"), [(float, 5), (complex, 5), (complex, 12)])
def test_a_matrix_that_is_not_positive_definite_is_refused(kind, N):
    C = np.tile(np.eye(N, dtype=kind), (7, 1, 1))
    C[4] *= -1
    with pytest.raises(np.linalg.LinAlgError):
        kernels.hermitian_inverses(C)


# The likelihood of the pressures has these values, derivatives and invariances.


RISING = np.array([1.5, 2.5, 4.0])  # rad/m
M = len(RISING)
POWER, NOISE = np.array([1.0, 0.7, 1.6]), np.array([0.03, 0.05, 0.02])
KERNELS = ["diffuse", "damped", "directional", "damped directional"]
MANY = 48  # number of microphones
CASES = [(kernel, *array, 9) for kernel in KERNELS for array in ARRAYS] + [(kernel, 2, 2, MANY) for kernel in KERNELS]


def drawn(D, count=9, seed=0):
    """Positions (N, D) away from the origin, pressures (M, N), and channels (N, 4) of small gains and filters."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.4, 0.4, (count, D)) + np.arange(2, 2 + D)
    return x, rng.normal(size=(M, count)) + 1j * rng.normal(size=(M, count)), 0.1 * rng.normal(size=(count, 4))


def assumed(kernel, x, dimension):
    """Return a field of that kernel whose channels have unequal noise, one of them strong noise."""
    rng = np.random.default_rng(5)
    tau = rng.uniform(0.5, 2.0, len(x))
    tau[3] = 1e3
    k = RISING if kernel in ("diffuse", "directional") else RISING - 0.05j
    field = FieldModel(k, POWER, NOISE, tau, dimension)
    field = field if kernel == "diffuse" else replace(field, about=x + 0.01)
    if "directional" not in kernel:
        return field
    return replace(field, directions=rng.uniform(0.1, 2.0, (M, directions_needed(x, RISING, dimension))))


def covariances(x, field):
    """C (M, N, N) and the slope of s RISING by every coordinate of its first microphone (D, M, N, N)."""
    powers, offsets, k = field.powers(x), field.offsets(x), field.wavenumbers
    if powers is not None:
        W = kernels.plane_waves(offsets, k, powers, field.dimension)
        u = kernels.wave_directions(field.dimension, powers.shape[1])[0][: x.shape[1], None, :, None]
        dW = -1j * np.asarray(k)[:, None, None] * u * W
        matrices, D = W.swapaxes(1, 2) @ W.conj(), dW.swapaxes(2, 3) @ W.conj()
    elif np.iscomplexobj(k):
        matrices, D = kernels.damped_matrices(offsets, k, True)
    else:
        matrices, S = kernels.diffuse_matrices(x, k, field.dimension, True)
        D = np.moveaxis(S[..., None] * (x[:, None] - x), -1, 0)
    s = field.power[:, None, None]
    return s * matrices + field.noise[:, None, None] * np.diag(field.channel_noise), s * D


@pytest.mark.parametrize("parameters", [0, 4])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_the_terms_equal_an_explicit_covariance_and_finite_differences(kernel, dimension, D, count, parameters):
    x, p, channels = drawn(D, count)
    field, channels = assumed(kernel, x, dimension), channels[:, :parameters] if parameters else None
    found = likelihood_terms(x, p, field, channels)
    log_gain, by_parameter = log_response(channels, RISING)
    q = p * np.exp(-log_gain)
    C, slopes = covariances(x, field)
    P = np.linalg.inv(C)
    u = np.einsum("mij,mj->mi", P, q)
    costs = np.linalg.slogdet(C)[1] + np.sum(q.conj() * u, axis=1).real
    costs += np.sum(2 * np.broadcast_to(log_gain, q.shape).real, axis=1)
    J = [np.einsum("mij,mj->mi", slope, u) for slope in slopes] + [q * one for one in by_parameter]
    logs = [np.einsum("mij,mji->mi", slope, P).real for slope in slopes]
    logs += [np.broadcast_to(one, q.shape).real for one in by_parameter]
    gradients = np.stack([2 * (log - (u.conj() * one).real) for log, one in zip(logs, J, strict=True)], axis=-1)
    curvature = 2 * np.einsum("ami,mij,bmj->iajb", np.conj(J), P, J).real
    assert found.cost == pytest.approx(costs.sum(), rel=1e-9)
    expected = {"costs": costs, "gradient": gradients.sum(axis=0), "curvature": curvature}
    expected |= {"weighted": u, "precision": np.diagonal(P, axis1=1, axis2=2).real, "corrected": q}
    for name, value in expected.items():
        close = 1e-7 * np.abs(value).max()
        np.testing.assert_allclose(getattr(found, name), value, atol=close, err_msg=name)
    without = likelihood_terms(x, p, field, channels, derivatives=False)
    for name in ("costs", "weighted", "precision"):
        np.testing.assert_array_equal(getattr(without, name), getattr(found, name))
    gradient, _ = found.newton()
    direction, h = np.random.default_rng(1).normal(size=(count, D + parameters)), 1e-5

    def cost(way):
        move = way * h * direction
        moved = None if channels is None else channels + move[:, D:]
        return likelihood_terms(x + move[:, :D], p, field, moved, derivatives=False).cost

    assert (cost(1) - cost(-1)) / (2 * h) == pytest.approx(np.sum(gradient * direction), rel=1e-5)


TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2)) + [2.61, 2.31]


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_no_rigid_motion_no_mirror_and_no_order_of_the_microphones_changes_the_cost(kernel, dimension, D, count):
    """Directions rotate with the axes, so that the field is only moved; complex wavenumbers need their centre."""
    x, p, channels = drawn(D, count, seed=4)
    field = assumed(kernel, x, dimension)
    cost = likelihood_terms(x, p, field, channels).cost
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(D, D)))[0]
    Q[:, 0] *= -np.sign(np.linalg.det(Q))
    Q = np.eye(D) if "directional" in kernel else Q

    def moved(y):
        return None if y is None else y @ Q - 3.0

    away = likelihood_terms(moved(x), p, replace(field, about=moved(field.about)), channels).cost
    assert away == pytest.approx(cost, rel=1e-8 if kernel in ("diffuse", "directional") else 1e-3)
    order = np.random.default_rng(2).permutation(count)
    turned = replace(field, channel_noise=field.channel_noise[order])
    if turned.about is not None:
        turned = replace(turned, about=turned.about[order])
    assert likelihood_terms(x[order], p[:, order], turned, channels[order]).cost == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
@pytest.mark.parametrize("kernel", ["damped", "damped directional"])
def test_the_centre_of_a_damped_field_follows_from_the_positions_given_for_it(kernel, dimension, D):
    x, p, _ = drawn(D, seed=5)
    field, about = assumed(kernel, x, dimension), 1.5 * x - 0.2
    shared = likelihood_terms(x, p, replace(field, about=about)).cost
    assert shared != pytest.approx(likelihood_terms(x, p, field).cost, rel=1e-6)
    assert likelihood_terms(x + 0.3, p, replace(field, about=about + 0.3)).cost == pytest.approx(shared, rel=1e-9)
    assert likelihood_terms(x + 0.3, p, replace(field, about=about)).cost != pytest.approx(shared, rel=1e-6)
    own = likelihood_terms(x, p, replace(field, about=None)).cost
    assert own == pytest.approx(likelihood_terms(x, p, replace(field, about=x)).cost, rel=1e-12)


# Channels have gains and corner frequencies.


def test_a_delay_and_a_high_pass_have_their_transfer_functions():
    d, corner = 0.34, 0.8  # metres and rad/m
    filtered = np.exp(log_response(np.array([[0, 0, d, 0], [0, 0, 0, corner], [0, 0, 0, -corner]]), RISING)[0])
    high_pass = 1j * RISING / (corner + 1j * RISING)
    expected = np.column_stack([np.exp(-1j * RISING * d), high_pass, 1 / high_pass])
    np.testing.assert_allclose(filtered, expected, rtol=1e-12)


# Power, noise, spectra and blocks follow from the likelihood.


PROBLEM = measured(TRUTH, [0, 1, 2], highest=200.0, snr_db=30).problem()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_power_of_field_and_noise_add_up_to_that_of_the_pressures(dimension, share):
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = isotropic_field(PROBLEM.pressures, PROBLEM.wavenumbers, share * power, dimension)
    np.testing.assert_allclose(field.power + field.noise, power, rtol=1e-12)
    assert np.isrealobj(field.wavenumbers) and field.dimension == dimension
    np.testing.assert_array_equal(field.channel_noise, np.ones(len(TRUTH)))
    loud = isotropic_field(PROBLEM.pressures, PROBLEM.wavenumbers, 2 * power, dimension).power
    assert np.all((loud > 0) & (loud < 0.01 * power)), "pressures of pure noise still have a field"


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_the_spectra_give_the_likelihood(kernel, dimension, D, count):
    x, p, _ = drawn(D, count)
    field = assumed(kernel, x, dimension)
    values, along = spectra(x, p, field)
    assert values.shape == along.shape == p.shape and values.min() >= 0
    spectrum = POWER[:, None] * values + NOISE[:, None]
    costs = np.sum(np.log(spectrum) + along / spectrum, axis=1) + np.sum(np.log(field.channel_noise))
    np.testing.assert_allclose(costs, likelihood_terms(x, p, field).costs, rtol=1e-8)
    matrices = field_covariance(x, field, slice(None), False)[0]
    whole = np.linalg.eigvalsh(matrices / np.sqrt(np.multiply.outer(field.channel_noise, field.channel_noise)))
    np.testing.assert_allclose(np.sort(values, axis=1), whole, atol=1e-7 * whole.max())


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_threads_give_the_same_bits_as_one_core_and_blocks_the_same_numbers(kernel, dimension, D, count, monkeypatch):
    x, p, channels = drawn(D, count)
    field, found = assumed(kernel, x, dimension), []
    for largest, least in ((1.3e5, np.inf), (200, np.inf), (200, 0.0)):
        monkeypatch.setattr(kernels, "BLOCK", largest)
        monkeypatch.setattr(kernels, "WORTH_THREADS", least)
        terms, (values, along) = likelihood_terms(x, p, field, channels), spectra(x, p, field)
        spectrum = np.sort(values, axis=1), along.sum(axis=1)  # zero eigenvalues may be in another order
        found.append([terms.costs, terms.gradient, terms.curvature, terms.weighted, terms.precision, *spectrum])
    for whole, one_core, threads in zip(*found, strict=True):
        np.testing.assert_array_equal(threads, one_core)
        np.testing.assert_allclose(one_core, whole, rtol=1e-7, atol=1e-9 * np.abs(whole).max())
