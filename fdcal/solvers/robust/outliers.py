"""Channels that do not fit where they are: another place, another gain, or both.

With channel n left out, the others predict its pressure at a place x as e_m(x) with the variance V_m(x). With a
complex gain g in between,

    cost(x) = sum_m log V_m + |q_mn - g e_m|^2 / V_m + prior(g),    g by weighted least squares

so a channel of inverted polarity, and one in a wrong basin, both find their places.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from ...cost.channel_kernels import diffuse_kernel
from ..deadline import check_deadline
from .objective import NU
from .settings import OUTLIERS


def relocate(positions, gains, offsets, pressures, wavenumbers, power, noise, channel_noise, dimension: int):
    """Suspicious channels where, and how, they fit best.

    wavenumbers, power, noise : (M,), of pressures (M, N)

    Returns
    -------
    positions : (N, D);  gains, offsets : (N, 2);  channel_noise : (N,);  moved : list of the channels changed
    """
    x, g, off, tau = (np.array(v) for v in (positions, gains, offsets, channel_noise))
    k = np.real(wavenumbers)
    spacing = OUTLIERS.spacing * 2 * np.pi / float(k.max())
    noise = noise + power * (k * spacing / 2) ** 2 / dimension  # a candidate is only near the place
    suspects = [n for n in np.argsort(-tau)[: OUTLIERS.moved] if tau[n] > OUTLIERS.suspicious]
    moved = []
    for n in suspects:
        check_deadline()
        others = np.delete(np.arange(len(x)), n)
        q = pressures[:, others] * np.exp(-g[others, 0] - 1j * g[others, 1])
        candidates = np.vstack([x[n], _lattice(x[tau < OUTLIERS.suspicious], spacing)])
        e, V = _predicted(x[others], q, candidates, k, power, noise, tau[others], dimension)
        cost, value = _fitted(pressures[:, n], e, V)
        extra = noise * (tau[n] - 1)
        own = pressures[:, n] * np.exp(-g[n, 0] - 1j * g[n, 1]) - e[:, 0]
        noisy = np.sum(np.log(V[:, 0] + extra) + np.abs(own) ** 2 / (V[:, 0] + extra) + 2 * g[n, 0])
        best = int(np.argmin(cost))
        if cost[best] < noisy - OUTLIERS.nats:
            x[n], tau[n] = candidates[best], 1.0
            off[n] = (value[best].real, value[best].imag) if abs(value[best]) > OUTLIERS.gross else 0.0
            g[n] = off[n]
            moved.append(int(n))
    return x, g, off, tau, moved


def _lattice(x, spacing: float) -> np.ndarray:
    low, high = x.min(axis=0) - 2 * spacing, x.max(axis=0) + 2 * spacing
    spacing = max(spacing, float((np.prod(high - low) / OUTLIERS.candidates) ** (1 / x.shape[1])))
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, x.shape[1])


def _predicted(x, q, candidates, k, power, noise, tau, dimension: int):
    """Prediction (M, C) at candidates (C, D) by microphones at x (N, D) of pressures q (M, N), and its variance."""
    between = np.linalg.norm(x[:, None] - x[None], axis=-1)
    across = np.linalg.norm(x[:, None] - candidates[None], axis=-1)
    e, V = np.empty((len(k), len(candidates)), complex), np.empty((len(k), len(candidates)))
    for m in range(len(k)):
        K, c = (
            power[m] * diffuse_kernel(r.ravel(), k[m : m + 1], dimension, slope=False)[0].reshape(r.shape)
            for r in (between, across)
        )
        K[np.diag_indices(len(K))] += noise[m] * tau
        y = solve_triangular(
            np.linalg.cholesky(K), np.column_stack([q[m].real, q[m].imag, c]), lower=True, check_finite=False
        )
        e[m] = (y[:, 0] + 1j * y[:, 1]) @ y[:, 2:]
        V[m] = np.maximum(power[m] - np.sum(y[:, 2:] ** 2, axis=0), 0.0) + noise[m]
    return e, V


def _fitted(p, e, V):
    """Cost (C,) and log gain (C,) complex128 of a channel p (M,) of which e (M, C) is predicted with variance V."""
    gain = np.sum(np.conj(e) * p[:, None] / V, axis=0) / (np.sum(np.abs(e) ** 2 / V, axis=0) + 1e-6)
    value = np.log(np.where(np.abs(gain) < 1e-6, 1e-6, gain))
    value = np.clip(np.real(value), -OUTLIERS.most_gain, OUTLIERS.most_gain) + 1j * np.imag(value)
    prior = sum(
        (NU + 1) / 2 * np.log1p(part**2 / (NU * OUTLIERS.gain_sigma**2)) for part in (np.real(value), np.imag(value))
    )
    misfit = np.sum(np.log(V) + np.abs(p[:, None] * np.exp(-value) - e) ** 2 / V, axis=0)
    return misfit + 2 * len(p) * np.real(value) + prior, value
