"""The likelihood of the pressures: its value, derivatives, invariances, and what it says of a recording."""

from dataclasses import replace

import numpy as np
import pytest
from fields import measured

from fdcal.acoustics.dictionary import fourier_bessel, max_order, spherical_bessel
from fdcal.cost import batches
from fdcal.cost.kernels import EXTRA_ORDERS, diffuse_matrices, directions_needed
from fdcal.cost.likelihood import (
    Conditional,
    FieldModel,
    few_waves,
    field_covariance,
    isotropic_field,
    likelihood_terms,
    log_response,
    spectra,
)
from fdcal.model.gauge import rigid_motions

K = np.array([1.5, 2.5, 4.0])  # rad/m
M = len(K)
POWER, NOISE = np.array([1.0, 0.7, 1.6]), np.array([0.03, 0.05, 0.02])
ARRAYS = [(2, 2), (3, 3), (3, 2)]  # dimensions of the field and of the array
KERNELS = ["diffuse", "series", "near", "directional", "damped directional"]
MANY = 48  # microphones: more than the waves of every kernel in the plane
CASES = [(kernel, *array, 9) for kernel in KERNELS for array in ARRAYS] + [(kernel, 2, 2, MANY) for kernel in KERNELS]
ASIDE = 1e-5  # the expansion's centre is a little beside the centre of mass, and so counts, of complex wavenumbers


def drawn(D, count=9, seed=0):
    """Positions (N, D) away from the origin, pressures (M, N), and channels (N, 4) of small gains and filters."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.4, 0.4, (count, D)) + np.arange(2, 2 + D)
    return x, rng.normal(size=(M, count)) + 1j * rng.normal(size=(M, count)), 0.1 * rng.normal(size=(count, 4))


def assumed(kernel, x, dimension):
    """A field of that kernel, whose channels have unequal noise, one of them much."""
    rng = np.random.default_rng(5)
    tau = rng.uniform(0.5, 2.0, len(x))
    tau[3] = 1e3
    k = K if kernel in ("diffuse", "directional") else K - 0.05j
    field = FieldModel(k, POWER, NOISE, tau, dimension, kernel == "near")
    field = field if kernel == "diffuse" else replace(field, about=x + 0.01)
    if "directional" not in kernel:
        return field
    return replace(field, directions=rng.uniform(0.1, 2.0, (M, directions_needed(x, K, dimension))))


def with_conditional(field, channels, weight=0.1):
    """`field` with a conditional likelihood, whose noise is that behind other gains than those of `channels`."""
    reference = np.broadcast_to(log_response(channels, K)[0], (M, len(field.channel_noise))) + 0.05
    return replace(field, conditional=Conditional(50.0, weight, np.iscomplexobj(field.wavenumbers), reference))


def covariances(x, field):
    """C (M, N, N) and the slope of s K by every coordinate of its first microphone (D, M, N, N)."""
    matrices, D = field_covariance(x, field, slice(None), True)
    D = np.moveaxis(D[..., None] * (x[:, None] - x), -1, 0) if D.ndim == 3 else D
    s = field.power[:, None, None]
    return s * matrices + field.noise[:, None, None] * np.diag(field.channel_noise), s * D


@pytest.mark.parametrize("parameters", [0, 2, 4])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_the_terms_are_those_of_the_explicit_covariance(kernel, dimension, D, count, parameters):
    """Whether the covariance itself is factorised or, of many microphones in the plane, its waves."""
    x, p, channels = drawn(D, count)
    field, channels = assumed(kernel, x, dimension), channels[:, :parameters] if parameters else None
    assert (few_waves(x, field) is not None) == (count == MANY)
    found = likelihood_terms(x, p, field, channels)
    log_gain, by_parameter = log_response(channels, K)
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
    expected = {"costs": costs, "gradient": gradients.sum(axis=0), "slopes": gradients, "curvature": curvature}
    expected |= {"weighted": u, "precision": np.diagonal(P, axis1=1, axis2=2).real, "corrected": q}
    for name, value in expected.items():
        close = 1e-7 * np.abs(value).max()
        np.testing.assert_allclose(getattr(found, name), value, atol=close, err_msg=name)
    without = likelihood_terms(x, p, field, channels, derivatives=False)
    for name in ("costs", "weighted", "precision"):
        np.testing.assert_array_equal(getattr(without, name), getattr(found, name))


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize("parameters", [0, 2, 4])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_the_gradient_is_the_limit_of_differences(kernel, dimension, D, count, parameters, conditioned):
    x, p, channels = drawn(D, count)
    field, channels = assumed(kernel, x, dimension), channels[:, :parameters] if parameters else None
    field = with_conditional(field, channels) if conditioned else field
    gradient, _ = likelihood_terms(x, p, field, channels).newton()
    assert gradient.shape == (count, D + parameters)
    direction, h = np.random.default_rng(1).normal(size=gradient.shape), 1e-5

    def cost(way):
        move = way * h * direction
        moved = None if channels is None else channels + move[:, D:]
        return likelihood_terms(x + move[:, :D], p, field, moved, derivatives=False).cost

    slope = (cost(1) - cost(-1)) / (2 * h)
    assert slope == pytest.approx(np.sum(gradient * direction), rel=1e-5)


def test_terms_without_derivatives_have_no_newton_step():
    x, p, _ = drawn(2)
    with pytest.raises(ValueError, match="without derivatives"):
        likelihood_terms(x, p, assumed("diffuse", x, 2), derivatives=False).newton()


@pytest.mark.parametrize("damping", [0.0, 0.2])
@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_cost_and_curvature_are_those_of_the_paper_s_dictionary(dimension, D, damping):
    """Without the determinant the cost is Eq. 7 with a Tikhonov weight v / s, over v; the curvature is that of
    its residual with the coefficients held (Kaufman)."""
    x, p, _ = drawn(D, seed=1)
    N, h = len(x), 1e-6
    field = FieldModel(K - 1j * damping if damping else K, POWER, NOISE, np.ones(N), dimension)
    found = likelihood_terms(x, p, field)
    expected, H = 0.0, np.zeros((N * D, N * D))
    for k, s, v, q in zip(field.wavenumbers, POWER, NOISE, p, strict=True):
        build = fourier_bessel if dimension == 2 else spherical_bessel
        order, centre, mu = int(max_order(k, 1.0, EXTRA_ORDERS)), x.mean(axis=0), v / s
        at = lambda y, k=k, build=build, order=order, centre=centre: build(y, k, order, centre)  # noqa: E731
        W = at(x)
        whole = np.vstack([W, np.sqrt(mu) * np.eye(W.shape[1])])
        target = np.append(q, np.zeros(W.shape[1]))
        alpha = np.linalg.lstsq(whole, target, rcond=None)[0]
        expected += np.sum(np.abs(whole @ alpha - target) ** 2) / v
        expected += np.linalg.slogdet(s * W @ W.conj().T + v * np.eye(N))[1]
        Q, J = np.linalg.qr(whole)[0], np.zeros((len(whole), N * D), complex)
        for i, a in np.ndindex(x.shape):
            step = np.zeros_like(x)
            step[i, a] = h
            moved = np.zeros(len(whole), complex)
            moved[i] = (at(x + step) - at(x - step))[i] @ alpha / (2 * h)
            J[:, D * i + a] = -(moved - Q @ (Q.conj().T @ moved))
        H += 2 / v * (J.conj().T @ J).real
    tolerance = ASIDE if damping else 1e-7
    assert found.cost == pytest.approx(expected, rel=tolerance)
    np.testing.assert_allclose(found.curvature.reshape(H.shape), H, rtol=0, atol=100 * tolerance * np.abs(H).max())


TRUTH = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 2)) + [2.61, 2.31]
WAVENUMBERS = np.linspace(0.5, 4.5, 40)  # rad/m


def diffuse_draws(ratio, count, x=TRUTH, k=WAVENUMBERS, seed=0):
    """Yield pressures drawn from the model itself, of unit power, `ratio` of it noise."""
    rng = np.random.default_rng(seed)
    G = np.linalg.cholesky((1 - ratio) * diffuse_matrices(x, k, 2, False)[0] + ratio * np.eye(len(x)))
    for _ in range(count):
        re, im = rng.standard_normal((2, len(k), len(x), 1)) / np.sqrt(2)
        yield (G @ (re + 1j * im))[..., 0]


def white(ratio, count, k=WAVENUMBERS):
    return FieldModel(k, np.full(len(k), 1 - ratio), np.full(len(k), ratio), np.ones(count), 2)


def test_the_curvature_is_the_hessian_in_the_mean():
    ratios, h, field = [], 1e-5, white(1e-3, len(TRUTH))
    for p in diffuse_draws(1e-3, 4):
        moves = h * np.eye(40)[::5].reshape(-1, 20, 2)
        slopes = [[likelihood_terms(TRUTH + way * d, p, field).gradient for way in (1, -1)] for d in moves]
        hessian = np.array([(there - back).ravel() / (2 * h) for there, back in slopes])
        curvature = likelihood_terms(TRUTH, p, field).curvature.reshape(40, 40)
        ratios.append(np.trace(hessian[:, ::5]) / np.diag(curvature)[::5].sum())
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_no_rigid_motion_no_mirror_and_no_order_of_the_microphones_changes_the_cost(
    kernel, dimension, D, count, conditioned
):
    """Directions are those of the axes, so that their field is only moved. Complex wavenumbers need their centre."""
    x, p, channels = drawn(D, count, seed=4)
    field = assumed(kernel, x, dimension)
    field = with_conditional(field, channels) if conditioned else field
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
    if conditioned:
        reference = replace(turned.conditional, reference=turned.conditional.reference[:, order])
        turned = replace(turned, conditional=reference)
    assert likelihood_terms(x[order], p[:, order], turned, channels[order]).cost == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_other_units_of_length_and_pressure_change_the_cost_by_a_constant(kernel, dimension, D, count):
    x, p, _ = drawn(D, count)
    field = assumed(kernel, x, dimension)
    about = None if field.about is None else 3 * field.about
    other = replace(field, wavenumbers=field.wavenumbers / 3, about=about, power=4 * POWER, noise=4 * NOISE)
    here, there = likelihood_terms(x, p, field), likelihood_terms(3 * x, 2 * p, other)
    assert there.cost - here.cost == pytest.approx(2 * M * count * np.log(2), rel=1e-8)
    np.testing.assert_allclose(3 * there.gradient, here.gradient, atol=1e-7 * np.abs(here.gradient).max())


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
@pytest.mark.parametrize("kernel", ["series", "near", "damped directional"])
def test_the_positions_given_for_it_set_the_centre_of_a_damped_field(kernel, dimension, D):
    x, p, _ = drawn(D, seed=5)
    field = assumed(kernel, x, dimension)
    about = 1.5 * x - 0.2
    shared = likelihood_terms(x, p, replace(field, about=about)).cost
    assert shared != pytest.approx(likelihood_terms(x, p, field).cost, rel=1e-6)
    away = likelihood_terms(x + 0.3, p, replace(field, about=about + 0.3)).cost
    assert away == pytest.approx(shared, rel=1e-9)
    assert likelihood_terms(x + 0.3, p, replace(field, about=about)).cost != pytest.approx(shared, rel=1e-6)
    own = likelihood_terms(x, p, replace(field, about=None)).cost
    assert own == pytest.approx(likelihood_terms(x, p, replace(field, about=x)).cost, rel=1e-12)


@pytest.mark.parametrize("kernel", KERNELS)
def test_positions_that_are_not_finite_are_refused(kernel):
    for D, count in ((3, 9), (2, MANY)):
        x, p, _ = drawn(D, count)
        field = assumed(kernel, x, D)
        y = x.copy()
        y[4, 1] = np.nan
        with pytest.raises(np.linalg.LinAlgError):
            likelihood_terms(y, p, field)


def test_far_away_microphones_do_not_fit_better():
    """There the kernel is the identity and explains anything; the determinant makes that expensive."""
    (p,) = diffuse_draws(1e-3, 1)
    field = white(1e-3, len(TRUTH))
    rough = TRUTH + np.random.default_rng(6).normal(0, 0.02, TRUTH.shape)
    flown = TRUTH.copy()
    flown[4] += 50.0
    for near, far in ((TRUTH, flown), (TRUTH, 100 * TRUTH), (rough, 100 * rough)):
        here, there = (likelihood_terms(x, p, field, derivatives=False).cost for x in (near, far))
        assert there > here + 100


@pytest.mark.parametrize("kernel", KERNELS)
def test_few_waves_without_noise_have_a_cost(kernel):
    """There the covariance is singular, and a least share of noise stands in."""
    x, _, _ = drawn(2, MANY)
    field = assumed(kernel, x, 2)
    field = replace(field, channel_noise=np.ones(MANY))
    p = np.exp(-1j * np.real(field.wavenumbers)[:, None] * (x @ [0.6, 0.8]))
    none, little = (likelihood_terms(x, p, replace(field, noise=share * POWER)) for share in (0.0, 1e-9))
    assert np.all(np.isfinite(none.costs)) and np.all(np.isfinite(none.gradient))
    assert none.cost < little.cost or kernel != "diffuse", "an undamped wave is explained but for rounding errors"


# Channels.


@pytest.mark.parametrize("parameters", [2, 4])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_channels_that_do_nothing_cost_what_positions_alone_cost(kernel, dimension, D, count, parameters):
    x, p, _ = drawn(D, count)
    field = assumed(kernel, x, dimension)
    plain, same = likelihood_terms(x, p, field), likelihood_terms(x, p, field, np.zeros((count, parameters)))
    np.testing.assert_allclose(same.costs, plain.costs, rtol=1e-12)
    np.testing.assert_allclose(same.gradient[:, :D], plain.gradient, atol=1e-9 * np.abs(plain.gradient).max())
    np.testing.assert_allclose(same.curvature[:, :D, :, :D], plain.curvature, atol=1e-9 * np.abs(plain.curvature).max())


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_what_channels_do_to_the_pressures_costs_its_jacobian_alone(kernel, dimension, D, count):
    x, p, channels = drawn(D, count)
    field = assumed(kernel, x, dimension)
    log_gain = log_response(channels, K)[0]
    plain = likelihood_terms(x, p, field, np.zeros_like(channels))
    played = likelihood_terms(x, p * np.exp(log_gain), field, channels)
    assert played.cost == pytest.approx(plain.cost + 2 * np.sum(log_gain.real), rel=1e-9)
    corner = slice(0, D + 3)  # the derivative by a corner depends on the corner itself
    atol = 1e-8 * np.abs(plain.gradient).max()
    np.testing.assert_allclose(played.gradient[:, corner], plain.gradient[:, corner], atol=atol)


def test_gains_multiplied_into_the_pressures_come_back():
    """By Gauss-Newton steps at the true positions, up to the factor that all channels share, within their error."""
    field, ratios = white(1e-3, len(TRUTH)), []
    gains = 0.3 * np.random.default_rng(2).normal(size=(len(TRUTH), 2))
    shared = np.kron(np.eye(len(TRUTH)) - 1 / len(TRUTH), np.eye(2))
    for p in diffuse_draws(1e-3, 8):
        played, found = p * np.exp(gains[:, 0] + 1j * gains[:, 1]), np.zeros_like(gains)
        for _ in range(8):
            gradient, curvature = likelihood_terms(TRUTH, played, field, found).newton()
            inverse = np.linalg.pinv(curvature[:, 2:, :, 2:].reshape(gains.size, -1), rcond=1e-9, hermitian=True)
            found = found - (shared @ inverse @ gradient[:, 2:].ravel()).reshape(gains.shape)
        error = shared @ (found - gains).ravel()
        assert np.sqrt(np.mean(gains**2)) > 20 * np.sqrt(np.mean(error**2))
        ratios.append(np.sum(error**2) / np.trace(shared @ inverse @ shared))  # the cost is -log likelihood
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.35)


def test_a_delay_and_a_high_pass_are_what_they_do_to_a_signal():
    d, corner = 0.34, 0.8  # metres and rad/m
    filtered = np.exp(log_response(np.array([[0, 0, d, 0], [0, 0, 0, corner], [0, 0, 0, -corner]]), K)[0])
    high_pass = 1j * K / (corner + 1j * K)
    expected = np.column_stack([np.exp(-1j * K * d), high_pass, 1 / high_pass])
    np.testing.assert_allclose(filtered, expected, rtol=1e-12)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize(("D", "count"), [(3, 9), (2, MANY + 1)])
def test_a_channel_of_pure_noise_pulls_on_no_other_microphone(kernel, D, count):
    x, p, channels = drawn(D, count)
    field, others = assumed(kernel, x, D), np.arange(1, count)
    noisy = np.where(np.arange(count) == 0, 1e9, field.channel_noise)
    about = None if field.about is None else x
    rest = replace(field, channel_noise=field.channel_noise[1:], about=about)
    whole = likelihood_terms(x, p, replace(field, channel_noise=noisy, about=about), channels)
    alone = likelihood_terms(x[others], p[:, others], rest, channels[others])
    np.testing.assert_allclose(whole.gradient[others], alone.gradient, atol=1e-5 * np.abs(alone.gradient).max())


# The conditional likelihood.


@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_the_conditional_cost_is_that_of_the_explicit_covariance(kernel, dimension, D, count):
    """That of an isotropic field, without near sources, and the given share of the cost of a random field."""
    x, p, channels = drawn(D, count)
    random = assumed(kernel, x, dimension)
    field, weight = with_conditional(random, 0.5 * channels, weight=0.3), 0.3
    isotropic = replace(random, directions=None, near=False, power=50.0 * POWER)
    B = np.linalg.inv(covariances(x, isotropic)[0])
    log_gain = log_response(channels, K)[0]
    q = p * np.exp(-log_gain)
    V = NOISE[:, None] * field.channel_noise * np.abs(np.exp(field.conditional.reference - log_gain)) ** 2
    costs = np.einsum("mi,mij,mj->m", q.conj(), B, q).real - np.einsum("mii,mi->m", B, V).real
    alone, found = likelihood_terms(x, p, random, channels), likelihood_terms(x, p, field, channels)
    np.testing.assert_allclose(found.costs, costs + weight * alone.costs, rtol=1e-6)
    assert found.cost == pytest.approx(found.costs.sum(), rel=1e-12)
    for name in ("weighted", "precision", "corrected"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
    none = likelihood_terms(x, p, with_conditional(random, 0.5 * channels, weight=0.0), channels)
    for name in ("gradient", "curvature", "slopes"):
        both = getattr(none, name) + weight * getattr(alone, name)
        np.testing.assert_allclose(getattr(found, name), both, atol=1e-9 * np.abs(both).max())


@pytest.mark.parametrize(("dimension", "D"), ARRAYS)
def test_damping_counts_in_the_conditional_part_only_where_it_is_asked_for(dimension, D):
    x, p, channels = drawn(D)
    damped, real = (with_conditional(assumed(kernel, x, dimension), channels, 0.0) for kernel in ("series", "diffuse"))
    without = replace(damped, conditional=replace(damped.conditional, damped=False))
    costs = [likelihood_terms(x, p, field, channels).costs for field in (real, without, damped)]
    np.testing.assert_allclose(costs[1], costs[0], rtol=1e-12)
    assert not np.allclose(costs[2], costs[0], rtol=1e-6)


ROOM_K = np.linspace(2.0, 7.0, 60)  # rad/m
COUNT, WAVES, LOUD = 40, 12, 20.0  # microphones, waves, amplitude of the first wave over that of the others


def room(rng, share, dimension=3):
    """Positions (N, D), pressures (M, N) of plane waves, one of them loud, from the same directions in every mode."""
    x = rng.uniform(-0.35, 0.35, (COUNT, dimension))
    u = rng.normal(size=(WAVES, dimension))
    u /= np.linalg.norm(u, axis=1)[:, None]
    a = rng.normal(size=(len(ROOM_K), WAVES)) + 1j * rng.normal(size=(len(ROOM_K), WAVES))
    a *= np.where(np.arange(WAVES), 1, LOUD)
    p = np.einsum("mq,mqn->mn", a, np.exp(-1j * ROOM_K[:, None, None] * (u @ x.T)))
    p /= np.sqrt(np.mean(np.abs(p) ** 2, axis=1))[:, None]
    noise = rng.normal(size=(2, len(ROOM_K), COUNT)) * np.sqrt(share / 2)
    return x, p + noise[0] + 1j * noise[1]


def of_room(share, dimension=3, conditional=True, weight=0.1, reference=0.0):
    ones = np.ones(len(ROOM_K))
    chosen = Conditional(50.0, weight, False, np.full((1, COUNT), reference)) if conditional else None
    return FieldModel(ROOM_K, ones, share * ones, np.ones(COUNT), dimension, conditional=chosen)


def newton_step(x, p, field):
    """RMS of the step (metres) from the true positions to the minimum of the cost, without rigid motions."""
    g, H = likelihood_terms(x, p, field, np.zeros((COUNT, 2))).newton()
    D, motions = x.shape[1], rigid_motions(x)
    g, H = g[:, :D].ravel(), H[:, :D, :, :D].reshape(x.size, x.size)
    others = np.linalg.svd(motions)[0][:, motions.shape[1] :]
    step = others @ np.linalg.solve(others.T @ H @ others, others.T @ g)
    return np.sqrt(np.sum(step**2) / COUNT)


@pytest.mark.parametrize(("dimension", "most"), [(2, 0.75), (3, 0.5)])
@pytest.mark.parametrize("seed", range(4))
def test_a_loud_wave_moves_the_minimum_less_than_that_of_a_random_field(seed, dimension, most):
    x, p = room(np.random.default_rng(seed), 1e-4, dimension)
    random, conditional = (newton_step(x, p, of_room(1e-4, dimension, kind)) for kind in (False, True))
    assert conditional < most * random


def test_the_noise_has_no_part_in_the_mean_of_the_conditional_gradient():
    share, repeats = 1e-2, 100
    rng = np.random.default_rng(0)
    x, clean = room(rng, 0.0)
    noise = rng.normal(size=(repeats, 2, len(ROOM_K), COUNT)) * np.sqrt(share / 2)

    def gradient(p, field):
        return likelihood_terms(x, p, field, np.zeros((COUNT, 2))).gradient

    def part_of_noise(field, without):
        """Mean change of the gradient by noise over its standard error, RMS over positions and gains."""
        silent = gradient(clean, without)
        change = [gradient(clean + n[0] + 1j * n[1], field) - silent for n in noise]
        error = np.std(change, axis=0) / np.sqrt(repeats)
        return np.sqrt(np.mean((np.mean(change, axis=0) / error) ** 2))

    with_trace, without = of_room(share, weight=0.0), of_room(share, weight=0.0, reference=-20.0)
    assert part_of_noise(with_trace, without) < 1.3
    assert part_of_noise(without, without) > 2.0, "without the trace it has one"


# Power, noise, spectra, blocks.


PROBLEM = measured(TRUTH, [0, 1, 2], highest=200.0, snr_db=30).problem()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9])
def test_power_of_field_and_noise_add_up_to_that_of_the_pressures(dimension, share):
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = isotropic_field(PROBLEM.pressures, PROBLEM.wavenumbers, share * power, dimension)
    np.testing.assert_allclose(field.power + field.noise, power, rtol=1e-12)
    assert np.isrealobj(field.wavenumbers) and field.dimension == dimension
    np.testing.assert_array_equal(field.channel_noise, np.ones(len(TRUTH)))


def test_pressures_of_pure_noise_still_have_a_field_of_little_power():
    power = np.mean(np.abs(PROBLEM.pressures) ** 2, axis=1)
    field = isotropic_field(PROBLEM.pressures, PROBLEM.wavenumbers, 2 * power, 2)
    assert np.all((field.power > 0) & (field.power < 0.01 * power))


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


def test_an_array_of_many_wavelengths_and_one_in_space_have_no_few_waves():
    x = drawn(2, MANY)[0]
    field = assumed("diffuse", x, 2)
    assert few_waves(x, field)[1] < MANY
    assert few_waves(20 * x, field) is None
    assert few_waves(drawn(3, MANY)[0], replace(field, dimension=3)) is None


@pytest.mark.parametrize("conditioned", [False, True])
@pytest.mark.parametrize(("kernel", "dimension", "D", "count"), CASES)
def test_threads_give_the_same_bits_as_one_core_and_blocks_the_same_numbers(
    kernel, dimension, D, count, conditioned, monkeypatch
):
    x, p, channels = drawn(D, count)
    field = assumed(kernel, x, dimension)
    field = with_conditional(field, channels) if conditioned else field
    found = []
    for largest, least in ((1.3e5, np.inf), (200, np.inf), (200, 0.0)):
        monkeypatch.setattr(batches, "BLOCK", largest)
        monkeypatch.setattr(batches, "WORTH_THREADS", least)
        terms, (values, along) = likelihood_terms(x, p, field, channels), spectra(x, p, field)
        spectrum = np.sort(values, axis=1), along.sum(axis=1)  # eigenvalues that are zero may stand in other places
        found.append([terms.costs, terms.gradient, terms.curvature, terms.weighted, terms.precision, *spectrum])
    for whole, one_core, threads in zip(*found, strict=True):
        np.testing.assert_array_equal(threads, one_core)
        np.testing.assert_allclose(one_core, whole, rtol=1e-7, atol=1e-9 * np.abs(whole).max())
