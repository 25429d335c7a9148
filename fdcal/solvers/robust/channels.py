"""Search for the position, gain and delay of suspicious channels, which may be in a wrong basin or inverted.

Channel n is left out. The other channels predict its pressure at a position x as e_m(x), with the variance V_m(x). With
a complex gain g, found by weighted least squares, the cost of the channel is

    cost(x) = sum_m [log(|g|^2 V_m) + |q_mn / g - e_m|^2 / V_m] + prior(g)

Delays of the channel from a grid of values are also tried, and kept if they lower the cost clearly. Delays smaller than
the spacing of this grid, and high-pass filters, are left to the steps of the solver (`noise.with_filters`).
"""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from ...acoustics.compiled import check_deadline
from ...cost.kernels import diffuse_kernel
from ...cost.likelihood import log_response
from ...model.problem import Problem
from ...model.validation import Complexes, Reals, frozen_array
from .noise import with_noise
from .objective import NU, gains_are_free, given_in_use, used_modes, wavenumbers
from .state import SUSPICIOUS, State

SEARCH_MODES = 16  # number of modes used in the search, to save time
MAX_EXAMINED = 6  # largest number of channels that are examined in one search, to save time
# absolute complex log gain above which a gain is a gross fault, such as that of an inverted channel; without this rule
# the error of a circle without given positions grows from 18 to 25 mm
GROSS = 0.5
# Filters are only sought if no more channels than this are suspicious. If many channels are, the positions are probably
# wrong. Filters of healthy channels could then fit the wrong positions, which would get the verdict "good".
MAX_FILTERED = 3
SPACING = 0.125  # spacing of the candidates, in shortest wavelengths


def relocated(problem: Problem, state: State, local: bool = False) -> tuple[State, bool]:
    """Return `state` with suspicious channels moved to where they fit best, and whether any was changed.

    local : whether only positions near the present one are candidates, each of them with a filter
    """
    used, model, gains = used_modes(problem, state, SEARCH_MODES), state.model, gains_are_free(state)
    p, k, power = problem.pressures[used], np.real(wavenumbers(problem, state)[used]), model.power[used]
    x, g, off, cut, tau = (
        np.array(v) for v in (state.positions, state.gains, state.offsets, model.filters, model.channel_noise)
    )
    spacing = SPACING * 2 * np.pi / float(k.max())
    # The nearest candidate can be half a spacing away from the right position along each axis; this adds noise.
    noise = model.noise[used] + power * (k * spacing / 2) ** 2 / problem.dimension
    suspects = [n for n in np.argsort(-tau)[:MAX_EXAMINED] if tau[n] > SUSPICIOUS]
    filters = gains and len(suspects) <= MAX_FILTERED
    sought = FILTER_GRID[int(local) :] if filters else FILTER_GRID[: int(not local)]
    moved = False
    for n in suspects if sought else ():
        check_deadline()
        log_gain = log_response(np.hstack([g, cut]), k)[0]
        q, others = p * np.exp(-log_gain), np.delete(np.arange(len(x)), n)
        about = x[n] + spacing * np.array([[-1.0], [1.0]]) if local else x[tau < SUSPICIOUS]
        stays = model.known_sigma == 0 and n in given_in_use(problem, state)[0]
        candidates = x[n : n + 1] if stays else np.vstack([x[n], _lattice(about, spacing)])
        e, V = _predicted(x[others], q[:, others], candidates, k, power, noise, tau[others], problem.dimension)
        extra = noise * (tau[n] - 1)
        misfit = np.abs(q[:, n] - e[:, 0]) ** 2 / (V[:, 0] + extra)
        noisy = np.sum(np.log(V[:, 0] + extra) + misfit) + 2 * np.sum(np.real(log_gain[:, n]))  # the present cost
        found = min((_best(p[:, n], e, V, k, one) for one in sought), key=lambda one: one[0])
        if found[0] < noisy:
            _, best, value, cut[n] = found
            x[n], tau[n] = candidates[best], 1.0
            off[n] = (value.real, value.imag) if abs(value) > GROSS else 0.0
            g[n] = off[n]
            moved = True
    if not moved:
        return state, False
    x, g, off, cut = (frozen_array(v, float) for v in (x, g, off, cut))
    model = replace(model, channel_noise=tau, filters=cut)
    elsewhere = replace(state, positions=x, gains=g, offsets=off, model=model)
    return with_noise(problem, elsewhere, rough=not gains), True


# largest delay (times the sound speed) that is tried, metres, and number of delays
MAX_DELAY = 0.7
DELAY_COUNT = 41
# filters (delay, corner) that are tried: first no filter, then delays
FILTER_GRID = [np.array([d, 0.0]) for d in (0.0, *(d for d in np.linspace(-MAX_DELAY, MAX_DELAY, DELAY_COUNT) if d))]
FILTER_NATS = 8.0  # nats by which a filter must lower the cost
COHERENT = 0.75  # smallest squared coherence between a channel with a filter and its prediction


def _best(p: Complexes, e: Complexes, V: Reals, k: Reals, cut: Reals):
    """Return cost, candidate, log gain and filter for the best fit of a channel p (M,) with the filter `cut` (2,).

    e, V : (M, C), prediction by the other channels at the candidates, and its variance; k : (M,), rad/m
    """
    response = log_response(np.array([[0.0, 0.0, *cut]]), k)[0][:, 0]
    q = p * np.exp(-response)
    cost, value = _fitted(q, e, V)
    best, price = int(np.argmin(cost)), 2 * np.sum(np.real(response))
    if np.any(cut):  # even a channel of noise has some combination of filter and position that fits slightly
        across = np.abs(np.vdot(e[:, best], q)) ** 2
        coherent = across > COHERENT * np.sum(np.abs(e[:, best]) ** 2) * np.sum(np.abs(q) ** 2)
        price += FILTER_NATS if coherent else np.inf
    return float(cost[best] + price), best, value[best], cut


CANDIDATES = 1500  # approximate largest number of candidates, to save memory


def _lattice(x: Reals, spacing: float) -> np.ndarray:
    low, high = x.min(axis=0) - 2 * spacing, x.max(axis=0) + 2 * spacing
    spacing = max(spacing, float(((high - low).prod() / CANDIDATES) ** (1 / x.shape[1])))
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, x.shape[1])


def _predicted(
    x: Reals, q: Complexes, candidates: Reals, k: Reals, power: Reals, noise: Reals, tau: Reals, dimension: int
):
    """Return the prediction at candidates (C, D) from pressures q (M, N) at x (N, D), and its variance : (M, C) each.

    k : (M,), rad/m; power, noise : (M,), of the field and of a healthy channel; tau : (N,), relative channel noise
    """
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


# prior sigma of the complex log gain in this search, nepers and radians; without this prior 1 of 11 arrays does not
# converge
GROSS_GAIN_SIGMA = 0.05
# largest absolute log gain, nepers; without this limit the error of an array with a dead channel grows from 4.6 to
# 5.2 mm, while its claimed sigma falls from 8.9 to 5.5 mm
MAX_GAIN = 1.5


def _fitted(p: Complexes, e: Complexes, V: Reals):
    """Return cost (C,) and log gain (C,) complex128 of a channel p (M,) with the prediction e (M, C) of variance V."""
    gain = np.sum(np.conj(e) * p[:, None] / V, axis=0) / (np.sum(np.abs(e) ** 2 / V, axis=0) + 1e-6)
    value = np.log(np.where(np.abs(gain) < 1e-6, 1e-6, gain))
    value = np.clip(np.real(value), -MAX_GAIN, MAX_GAIN) + 1j * np.imag(value)
    prior = sum(
        (NU + 1) / 2 * np.log1p(part**2 / (NU * GROSS_GAIN_SIGMA**2)) for part in (np.real(value), np.imag(value))
    )
    misfit = np.sum(np.log(V) + np.abs(p[:, None] * np.exp(-value) - e) ** 2 / V, axis=0)
    return misfit + 2 * len(p) * np.real(value) + prior, value
