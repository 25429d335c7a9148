"""A likelihood of the positions that hardly assumes anything of the sound field: the noise is random, the field is not.

    B_m  = beta s_m K_m + v_m diag(tau_n)
    V_m  = v_m diag(tau_n |g_0n / g_n|^2)
    cost = sum_m [q_m^H B_m^-1 q_m - tr(B_m^-1 V_m)]  +  weight * cost of a random field

The symbols are those of `fdcal.cost.channel_likelihood`; g_0 are the responses behind which the noise is v tau. The
likelihood of a random (isotropic, Gaussian) field, called unconditional or stochastic, is sharper, but a room has few
waves, and what it takes for evidence of its isotropy moves the positions: where the noise is low its minimum is many
sigmas from the truth. The first part here is the conditional, or deterministic, likelihood (Stoica and Nehorai, IEEE
Trans. ASSP 38 (1990) 1783) of pressures that are waves of any amplitude: for beta -> infinity the residual of Eq. 7
over the noise. A finite beta, as in a Tikhonov problem, keeps waves of high order from explaining noise. The trace is
what the noise adds in the mean: the expectation over the noise is least at the true positions whatever the field, up to
a term that falls as 1 / beta. Without a log-determinant nothing there holds the size of an array of few waves, and a
small part of the other likelihood does.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .channel_dense import applied, channel_kernel, curvature, gradients
from .channel_field import ChannelField, Conditional, Terms
from .mode_sums import hermitian_inverses


def conditional_terms(
    x, q, log_gain, by_parameter, field: ChannelField, assumed: Conditional, derivatives: int
) -> Terms:
    """Return the terms of the first part of the cost.

    Parameters
    ----------
    x : (N, D) float64, metres
    q : (M, N) complex128, corrected pressures
    log_gain, by_parameter : as of `fdcal.cost.channel_likelihood.log_response`
    field : ChannelField
    assumed : Conditional
    derivatives : int
        As of `fdcal.cost.channel_likelihood.channel_terms`.

    Raises
    ------
    numpy.linalg.LinAlgError
        A covariance is not positive definite.
    """
    k, power = field.wavenumbers, assumed.power * field.power
    isotropic = replace(field, wavenumbers=k if assumed.damped else np.real(k), directions=None, near=False)
    B, D = channel_kernel(x, isotropic, derivatives > 0)
    B *= power[:, None, None]
    diagonal, noise = np.arange(len(x)), np.multiply.outer(field.noise, field.channel_noise)
    B[:, diagonal, diagonal] += noise
    B = hermitian_inverses(B)[0]
    noise = noise * np.exp(2 * np.real(assumed.reference - log_gain))
    u, d = applied(B, q), np.ascontiguousarray(np.real(B[:, diagonal, diagonal]))
    costs = np.sum(np.real(np.conj(q) * u) - d * noise, axis=1)
    if not derivatives:
        return Terms(float(costs.sum()), costs, None, None, u, d, q)
    widened = (B * noise[:, None, :]) @ B
    slopes, J = gradients(x, q, u, widened, D, power, by_parameter, noise * d)
    slopes_wanted = slopes if derivatives > 2 else None
    return Terms(float(costs.sum()), costs, slopes.sum(axis=0), curvature(B, J), u, d, q, slopes_wanted)


def joined(conditional: Terms, random: Terms, weight: float) -> Terms:
    """Return both parts of the cost; u, d and q are those of the random field."""
    costs = conditional.costs + weight * random.costs
    if random.gradient is None:
        return replace(random, cost=float(costs.sum()), costs=costs)
    (slope, H), (own_slope, own_H) = conditional.newton(), random.newton()
    slopes = None
    if conditional.slopes is not None and random.slopes is not None:
        slopes = conditional.slopes + weight * random.slopes
    gradient, whole = slope + weight * own_slope, H + weight * own_H
    return replace(random, cost=float(costs.sum()), costs=costs, gradient=gradient, curvature=whole, slopes=slopes)
