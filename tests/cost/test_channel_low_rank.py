"""The likelihood by few waves is that of the covariance itself."""

from dataclasses import replace

import numpy as np
import pytest

from fdcal.cost.angular_prior import diffuse_prior
from fdcal.cost.channel_dense import channel_kernel, dense_channel_terms
from fdcal.cost.channel_field import ChannelField
from fdcal.cost.channel_likelihood import channel_spectra, channel_terms, log_response
from fdcal.cost.channel_low_rank import few_waves

K = np.array([1.5, 2.5, 4.0])  # rad/m
N = 48


def drawn(kernel, noise=1e-3):
    """Positions, pressures, gains and what is assumed of the field; channels of unequal noise, one of them faulty."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-0.4, 0.4, (N, 2))
    p = rng.normal(size=(3, N)) + 1j * rng.normal(size=(3, N))
    tau = rng.uniform(0.5, 2.0, N)
    tau[3] = 1e4
    k = K if kernel == "diffuse" else K - 0.02j
    field = ChannelField(k, np.array([1.0, 0.5, 2.0]), np.full(3, noise), tau, 2, kernel == "near", x + 1e-3)
    if kernel == "directional":
        field = replace(field, directions=rng.uniform(0.1, 2.0, diffuse_prior(x, k).shape))
    return x, p, 0.1 * rng.normal(size=(N, 4)), field


@pytest.mark.parametrize("kernel", ["diffuse", "series", "near", "directional"])
@pytest.mark.parametrize("parameters", [2, 4])
def test_few_waves_give_the_terms_of_the_covariance(kernel, parameters):
    x, p, gains, field = drawn(kernel)
    assert few_waves(x, field) is not None
    gains = gains[:, :parameters]
    found = channel_terms(x, gains, p, field, 3)
    log_gain, by_parameter = log_response(gains, K)
    expected = dense_channel_terms(x, p * np.exp(-log_gain), log_gain, by_parameter, field, 3)
    for name in ("costs", "weighted", "precision", "corrected", "gradient", "curvature", "slopes"):
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(one, other, atol=1e-7 * np.abs(other).max(), err_msg=name)


@pytest.mark.parametrize("kernel", ["diffuse", "near", "directional"])
def test_few_waves_give_the_spectra_of_the_covariance(kernel):
    x, p, _, field = drawn(kernel)
    values, along = channel_spectra(x, p, field)
    weight = 1 / np.sqrt(field.channel_noise)
    whole = channel_kernel(x, field, False)[0] * np.multiply.outer(weight, weight)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(whole), atol=1e-6 * values.max())
    np.testing.assert_allclose(along.sum(axis=1), np.sum(np.abs(weight * p) ** 2, axis=1))


def test_an_array_of_many_wavelengths_and_one_in_space_take_the_covariance():
    x, _, _, field = drawn("diffuse")
    assert few_waves(20 * x, field) is None
    assert few_waves(np.column_stack([x, x[:, 0]]), replace(field, dimension=3)) is None
