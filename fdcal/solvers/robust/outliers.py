"""Channels that do not fit where they are: another place, another gain, or both.

With channel n left out, the others predict its pressure at a place x as e_m(x) with the variance V_m(x). With a
complex gain g in between,

    cost(x) = sum_m log V_m + |q_mn - g e_m|^2 / V_m + prior(g),    g by weighted least squares

so a channel of inverted polarity, and one in a wrong basin, both find their places. A single channel may also have a
delay or a high-pass, where that explains it much better.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from ...cost.channel_kernels import diffuse_kernel
from ...cost.channel_likelihood import log_response
from ..bounds import check_deadline
from .objective import NU
from .settings import FILTERS, OUTLIERS


@dataclass(frozen=True)
class Placed:
    """Where the microphones are supposed to be, and what their channels do.

    positions (N, D), metres; gains, offsets and filters (N, 2), as of `fdcal.solvers.robust.state`; channel_noise (N,)
    """

    positions: np.ndarray
    gains: np.ndarray
    offsets: np.ndarray
    filters: np.ndarray
    channel_noise: np.ndarray


def relocate(
    placed: Placed, pressures, wavenumbers, power, noise, dimension: int, filters: bool = False, local: bool = False
) -> Placed | None:
    """Suspicious channels where, and how, they fit best; None if none is changed.

    wavenumbers, power, noise : (M,), of pressures (M, N)
    filters : whether a delay or a high-pass may explain a channel, too
    local : only with a filter, and near where they are, on a finer lattice
    """
    x, g, off, cut, tau = (
        np.array(v) for v in (placed.positions, placed.gains, placed.offsets, placed.filters, placed.channel_noise)
    )
    k = np.real(wavenumbers)
    spacing = OUTLIERS.spacing * 2 * np.pi / float(k.max()) / (OUTLIERS.finer if local else 1)
    noise = noise + power * (k * spacing / 2) ** 2 / dimension  # a candidate is only near the place
    suspects = [n for n in np.argsort(-tau)[: OUTLIERS.moved] if tau[n] > OUTLIERS.suspicious]
    filters = filters and len(suspects) <= FILTERS.channels
    sought = FILTER_GRID[int(local) :] if filters else FILTER_GRID[: int(not local)]
    q = pressures * np.exp(-log_response(np.hstack([g, cut]), k)[0])
    moved = False
    for n in suspects if sought else ():
        check_deadline()
        others = np.delete(np.arange(len(x)), n)
        about = x[n] + spacing * OUTLIERS.finer * np.array([[-1.0], [1.0]]) if local else x[tau < OUTLIERS.suspicious]
        candidates = np.vstack([x[n], _lattice(about, spacing)])
        e, V = _predicted(x[others], q[:, others], candidates, k, power, noise, tau[others], dimension)
        extra = noise * (tau[n] - 1)
        share = np.abs(q[:, n] - e[:, 0]) ** 2 / (V[:, 0] + extra)
        noisy = np.sum(np.log(V[:, 0] + extra) + share) + 2 * np.sum(log_response(np.hstack([g, cut]), k)[0].real[:, n])
        found = min((_best(pressures[:, n], e, V, k, one) for one in sought), key=lambda one: one[0])
        if found[0] < noisy - OUTLIERS.nats:
            _, best, value, cut[n] = found
            x[n], tau[n] = candidates[best], 1.0
            off[n] = (value.real, value.imag) if abs(value) > OUTLIERS.gross else 0.0
            g[n] = off[n]
            q[:, n] = pressures[:, n] * np.exp(-log_response(np.hstack([g, cut])[n : n + 1], k)[0][:, 0])
            moved = True
    return Placed(x, g, off, cut, tau) if moved else None


def _filter_grid() -> list[np.ndarray]:
    """Filters to try: none, then delays or corners : list of (2,)."""
    delays = np.linspace(-FILTERS.longest_delay, FILTERS.longest_delay, FILTERS.delays)
    corners = np.linspace(-FILTERS.highest_corner, FILTERS.highest_corner, FILTERS.corners)
    grid = [np.zeros(2)] + [np.array([d, 0.0]) for d in delays if d] + [np.array([0.0, one]) for one in corners if one]
    return [np.where(np.abs(one) < 1e-9, 0.0, one) for one in grid]


FILTER_GRID = _filter_grid()


def _best(p, e, V, k, cut):
    """Cost, candidate, log gain and filter, where a channel p (M,) with the filter `cut` (2,) fits best."""
    response = log_response(np.array([[0.0, 0.0, *cut]]), k)[0][:, 0]
    cost, value = _fitted(p * np.exp(-response), e, V)
    best = int(np.argmin(cost))
    price = 2 * np.sum(response.real)
    if np.any(cut):  # among so many, some filter and place fit a channel of noise a little
        across = np.abs(np.vdot(e[:, best], p * np.exp(-response))) ** 2
        coherent = across > FILTERS.coherent * np.sum(np.abs(e[:, best]) ** 2) * np.sum(
            np.abs(p * np.exp(-response)) ** 2
        )
        price += FILTERS.nats if coherent else np.inf
    return float(cost[best] + price), best, value[best], cut


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
