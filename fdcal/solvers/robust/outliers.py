"""Channels that do not fit where they are, and groups of microphones that are turned or mirrored against the others.

With channel n left out, the others predict its pressure at a place x as e_m(x) with the variance V_m(x). With a
complex gain g in between,

    cost(x) = sum_m log V_m + |q_mn - g e_m|^2 / V_m + prior(g),    g by weighted least squares

so a channel of inverted polarity, and one in a wrong basin, both find their places. A single channel may also have a
delay of more than a period, where that explains it much better; smaller ones, and high-passes, are found by the steps
(`noise.with_filters`).

Groups lie far from each other, each right in itself. The distances inside a group follow from the pressures far better
than those between groups: a restart then finds every group to a millimetre and leaves the whole in a wrong basin, one
group turned or mirrored against the others. A rigid motion of a group leaves the covariance inside it as it is, so that
only the block C_ab between groups depends on the pose. With the whitened pressures y = L^-1 q of each group, L L^T its
covariance, and S = L_a^-1 C_ab L_b^-T, the cost of q_b given q_a is, up to a constant,

    sum_m log det G_m + e_m^H G_m^-1 e_m,   G = I - S^T S,   e = y_b - S^T y_a.

A lattice of poses is searched with the lowest modes of a few microphones, and the best are refined with modes of all
frequencies. The noise counts as larger by what a pose may be away from the right one: so wide are the basins then.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.linalg import solve_triangular
from scipy.optimize import minimize

from ...cost.kernels import diffuse_kernel
from ...cost.likelihood import FieldModel, likelihood_terms, log_response
from ...model.problem import Problem
from ...model.validation import Complexes, Integers, Reals, frozen_array
from ..interface import check_deadline
from .noise import with_noise
from .objective import NU, constrained_positions, gains_are_free, used_modes, wavenumbers
from .state import SUSPICIOUS, State

SEARCH_MODES = 16  # of a search for other places; with all of them it takes 1.1 times the time
MAX_EXAMINED = 6  # channels examined at once, a cap of time: of all, searches take 2.7 times as long
# absolute log gain from which a gain is gross, as that of an inverted channel; without it the error of a blind circle
# grows from 18 to 25 mm
GROSS = 0.5
# suspicious channels at most that may have a filter; without it six healthy channels get one, and an array with an
# error of 5.4 mm and a claim of 1.1 mm is good
MAX_FILTERED = 3
SPACING = 0.125  # distance of candidates over the shortest wavelength


def relocated(problem: Problem, state: State, local: bool = False) -> tuple[State, bool]:
    """Return `state` with suspicious channels where they fit best (if `local`, near), and whether any was changed."""
    used, model, gains = used_modes(problem, state, SEARCH_MODES), state.model, gains_are_free(state)
    p, k, power = problem.pressures[used], np.real(wavenumbers(problem, state)[used]), model.power[used]
    x, g, off, cut, tau = (
        np.array(v) for v in (state.positions, state.gains, state.offsets, model.filters, model.channel_noise)
    )
    spacing = SPACING * 2 * np.pi / float(k.max())
    noise = model.noise[used] + power * (k * spacing / 2) ** 2 / problem.dimension  # a candidate is near the place only
    suspects = [n for n in np.argsort(-tau)[:MAX_EXAMINED] if tau[n] > SUSPICIOUS]
    filters = gains and len(suspects) <= MAX_FILTERED
    sought = FILTER_GRID[int(local) :] if filters else FILTER_GRID[: int(not local)]
    q = p * np.exp(-log_response(np.hstack([g, cut]), k)[0])
    moved = False
    for n in suspects if sought else ():
        check_deadline()
        others = np.delete(np.arange(len(x)), n)
        about = x[n] + spacing * np.array([[-1.0], [1.0]]) if local else x[tau < SUSPICIOUS]
        stays = model.known_sigma == 0 and n in constrained_positions(problem, state)[0]  # whatever its channel does
        candidates = x[n : n + 1] if stays else np.vstack([x[n], _lattice(about, spacing)])
        e, V = _predicted(x[others], q[:, others], candidates, k, power, noise, tau[others], problem.dimension)
        extra = noise * (tau[n] - 1)
        share = np.abs(q[:, n] - e[:, 0]) ** 2 / (V[:, 0] + extra)
        noisy = np.sum(np.log(V[:, 0] + extra) + share) + 2 * np.sum(
            np.real(log_response(np.hstack([g, cut]), k)[0][:, n])
        )
        found = min((_best(p[:, n], e, V, k, one) for one in sought), key=lambda one: one[0])
        if found[0] < noisy:
            _, best, value, cut[n] = found
            x[n], tau[n] = candidates[best], 1.0
            off[n] = (value.real, value.imag) if abs(value) > GROSS else 0.0
            g[n] = off[n]
            q[:, n] = p[:, n] * np.exp(-log_response(np.hstack([g, cut])[n : n + 1], k)[0][:, 0])
            moved = True
    if not moved:
        return state, False
    x, g, off, cut = (frozen_array(v, float) for v in (x, g, off, cut))
    model = replace(model, channel_noise=tau, filters=cut)
    elsewhere = replace(state, positions=x, gains=g, offsets=off, model=model)
    return with_noise(problem, elsewhere, rough=not gains), True


# delays tried: the greatest, metres, times the sound speed, and how many
MAX_DELAY = 0.7
DELAY_COUNT = 41
# filters tried: none, then delays; a corner is found by the steps, if it is any channel's
FILTER_GRID = [np.array([d, 0.0]) for d in (0.0, *(d for d in np.linspace(-MAX_DELAY, MAX_DELAY, DELAY_COUNT) if d))]
FILTER_NATS = 8.0  # by which a filter must be likelier than a place and a gain alone
COHERENT = 0.75  # fraction of the power that it must explain


def _best(p: Complexes, e: Complexes, V: Reals, k: Reals, cut: Reals):
    """Cost, candidate, log gain and filter, where a channel p (M,) with the filter `cut` (2,) fits best."""
    response = log_response(np.array([[0.0, 0.0, *cut]]), k)[0][:, 0]
    cost, value = _fitted(p * np.exp(-response), e, V)
    best = int(np.argmin(cost))
    price = 2 * np.sum(np.real(response))
    if np.any(cut):  # among so many, some filter and place fit a channel of noise a little
        across = np.abs(np.vdot(e[:, best], p * np.exp(-response))) ** 2
        coherent = across > COHERENT * np.sum(np.abs(e[:, best]) ** 2) * np.sum(np.abs(p * np.exp(-response)) ** 2)
        price += FILTER_NATS if coherent else np.inf
    return float(cost[best] + price), best, value[best], cut


CANDIDATES = 1500  # at most, a cap of memory


def _lattice(x: Reals, spacing: float) -> np.ndarray:
    low, high = x.min(axis=0) - 2 * spacing, x.max(axis=0) + 2 * spacing
    spacing = max(spacing, float(((high - low).prod() / CANDIDATES) ** (1 / x.shape[1])))
    axes = [np.arange(a, b + spacing, spacing) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, x.shape[1])


def _predicted(
    x: Reals, q: Complexes, candidates: Reals, k: Reals, power: Reals, noise: Reals, tau: Reals, dimension: int
):
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


# nepers and radians, of the prior of a gross gain, and its greatest value; without that value the error with a dead
# channel grows from 4.6 to 5.2 mm, and its claim falls from 8.9 to 5.5 mm
GROSS_GAIN_SIGMA = 0.05
MAX_GAIN = 1.5


def _fitted(p: Complexes, e: Complexes, V: Reals):
    """Cost (C,) and log gain (C,) complex128 of a channel p (M,) of which e (M, C) is predicted with variance V."""
    gain = np.sum(np.conj(e) * p[:, None] / V, axis=0) / (np.sum(np.abs(e) ** 2 / V, axis=0) + 1e-6)
    value = np.log(np.where(np.abs(gain) < 1e-6, 1e-6, gain))
    value = np.clip(np.real(value), -MAX_GAIN, MAX_GAIN) + 1j * np.imag(value)
    prior = sum(
        (NU + 1) / 2 * np.log1p(part**2 / (NU * GROSS_GAIN_SIGMA**2)) for part in (np.real(value), np.imag(value))
    )
    misfit = np.sum(np.log(V) + np.abs(p[:, None] * np.exp(-value) - e) ** 2 / V, axis=0)
    return misfit + 2 * len(p) * np.real(value) + prior, value


GAP = 0.35  # distance between two groups at least, over the shortest wavelength
MIN_GROUP = 6  # microphones of a group at least; those of a smaller one belong to the nearest


def groups(positions: Reals, wavelength: float) -> list[np.ndarray]:
    """Return the microphones of each group, (G,) int64 each, of positions (N, 2), metres; one if there are no gaps."""
    label = fcluster(linkage(positions, "single"), GAP * wavelength, "distance")
    large = [one for one in np.unique(label) if np.sum(label == one) >= MIN_GROUP]
    if len(large) < 2:
        return [np.arange(len(positions))]
    away = [np.linalg.norm(positions[:, None] - positions[label == one], axis=-1).min(axis=1) for one in large]
    nearest = np.argmin(away, axis=0)
    return [np.flatnonzero(nearest == number) for number in range(len(large))]


# error of a pose in each round of the refinement, over the shortest wavelength
BLURS = (0.1, 0.05)
# by which another pose may be less likely than the present one and still be tried: the groups are not yet what they
# are at its minimum
MAX_RISE = 60.0
MAX_POSES = 3  # poses that are tried after one end at most
MAX_GROUPS = 4  # groups that are posed at most, the largest but one first


def other_poses(positions: Reals, pressures: Complexes, field: FieldModel) -> list[np.ndarray]:
    """Return arrays (N, 2), metres, with one group in another pose that may be the right one, the likeliest first.

    `pressures` (M, N) are divided by the responses of the channels; `field`: diffuse, of real wavenumbers.
    """
    wavelength = 2 * np.pi / float(field.wavenumbers.max())
    found = groups(positions, wavelength)
    healthy = field.channel_noise < SUSPICIOUS
    results: list[tuple[float, Reals]] = []
    for group in sorted(found, key=len)[:-1][-MAX_GROUPS:]:
        rest = np.setdiff1d(np.arange(len(positions)), group)
        if min(np.sum(healthy[group]), np.sum(healthy[rest])) >= MIN_GROUP:
            results += _refined(positions, pressures, field, group, rest)
    kept = [np.asarray(positions, float)]
    for rise, moved in sorted(results, key=lambda one: one[0]):
        if rise < MAX_RISE and all(np.abs(moved - other).max() > BLURS[0] * wavelength for other in kept):
            kept.append(moved)
    return kept[1 : 1 + MAX_POSES]


REFINED_MICROPHONES = 14  # microphones of each side in the refinement
REFINED_MODES = 16  # of the refinement, evenly taken
ANGLES = 12  # turns of a group, each with its mirror image
EVALUATIONS = 40  # of the likelihood in each of these rounds


def _refined(
    x: Reals, q: Complexes, field: FieldModel, group: Integers, rest: Integers
) -> list[tuple[float, np.ndarray]]:
    """Cost of poses of `group` over that of the present one, and the positions (N, 2), metres, with each."""
    healthy = field.channel_noise < SUSPICIOUS
    inside, outside = group[healthy[group]], rest[healthy[rest]]
    few = np.concatenate([one[_spread(x[one], REFINED_MICROPHONES)] for one in (outside, inside)])
    used = np.unique(np.linspace(0, len(q) - 1, min(len(q), REFINED_MODES)).astype(int))
    wavelength = 2 * np.pi / float(field.wavenumbers.max())

    def cost(y: Reals, blur: float) -> float:
        k, power = field.wavenumbers[used], field.power[used]
        noise = field.noise[used] + power * (k * blur) ** 2 / field.dimension
        blurred = FieldModel(k, power, noise, field.channel_noise[few], field.dimension)
        return likelihood_terms(y[few], q[np.ix_(used, few)], blurred, derivatives=False).cost

    present, results = cost(x, BLURS[-1] * wavelength), list[tuple[float, Reals]]()
    for turn, place in _searched(x, q, field, inside, outside):
        shape, pose, least = (x[group] - x[inside].mean(axis=0)) @ turn.T, np.append(place / wavelength, 0.0), np.inf
        for blur in BLURS:
            check_deadline()
            start = pose + np.vstack([np.zeros(3), np.diag([blur, blur, np.pi / ANGLES / 2])])
            objective = _placing(cost, x, group, shape, blur, wavelength)
            options = {"initial_simplex": start, "maxfev": EVALUATIONS, "xatol": 3e-3, "fatol": 0.1}
            fit = minimize(objective, pose, method="Nelder-Mead", options=options)
            pose, least = fit.x, float(fit.fun)
        results.append((least - present, _moved(x, group, shape, pose, wavelength)))
    return results


def _placing(
    cost: Callable[[Reals, float], float], x: Reals, group: Integers, shape: Reals, blur: float, wavelength: float
) -> Callable[[Reals], float]:
    return lambda pose: cost(_moved(x, group, shape, pose, wavelength), blur * wavelength)


def _moved(x: Reals, group: Integers, shape: Reals, pose: Reals, wavelength: float) -> np.ndarray:
    """Return `x` with the group at `shape` (G, 2), metres, in a `pose` (3,): middle, wavelengths, and turn, radians."""
    y = np.array(x)
    y[group] = pose[:2] * wavelength + shape @ _turn(pose[2]).T
    return y


def _turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def _spread(x: Reals, count: int) -> np.ndarray:
    """At most `count` of the positions (N, 2), each the farthest from those before : int64."""
    chosen = [int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))]
    away = np.linalg.norm(x - x[chosen[0]], axis=1)
    while len(chosen) < min(count, len(x)):
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(x - x[chosen[-1]], axis=1))
    return np.array(chosen)


LOWEST_MODES = 8  # modes of the search over the lattice
SEARCHED_MICROPHONES = 8  # of each side in that search
CELL = 1 / 6  # of the lattice, over the shortest wavelength of the lowest modes
REFINED_POSES = 16  # poses that are refined


def _searched(
    x: Reals, q: Complexes, field: FieldModel, inside: Integers, outside: Integers
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Turn (2, 2) and place (2,) of the likeliest poses of microphones `inside`, no two of them alike."""
    low = slice(0, LOWEST_MODES)
    k, middle = field.wavenumbers[low], x[inside].mean(axis=0)
    cell = CELL * 2 * np.pi / float(k.max())
    near, far = inside[_spread(x[inside], SEARCHED_MICROPHONES)], outside[_spread(x[outside], SEARCHED_MICROPHONES)]
    blurred = field.noise[low] + field.power[low] * (k * cell / 3) ** 2 / field.dimension
    pair = FieldModel(k, field.power[low], blurred, field.channel_noise, field.dimension)
    places = _places(x[inside], x[outside], 2 * np.pi / k, cell)
    mirror = np.diag([-1.0, 1.0])
    turns: list[np.ndarray] = [
        _turn(angle) @ one for one in (np.eye(2), mirror) for angle in 2 * np.pi * np.arange(ANGLES) / ANGLES
    ]
    cost = np.empty((len(turns), len(places)))
    for row, turn in zip(cost, turns, strict=True):
        check_deadline()
        row[:] = _costs(x[far], (x[near] - middle) @ turn.T, q[low][:, far], q[low][:, near], pair, places)
    kept: list[tuple[Reals, Reals, Reals]] = []
    for number in np.argsort(cost, axis=None).tolist():
        turn, place = divmod(int(number), len(places))
        shape = places[place] + (x[inside] - middle) @ turns[turn].T
        if all(np.sqrt(np.sum((shape - one) ** 2, axis=1).mean()) > cell for *_, one in kept):
            kept.append((turns[turn], places[place], shape))
        if len(kept) == REFINED_POSES:
            break
    return [one[:2] for one in kept]


def _places(inside: Reals, outside: Reals, wavelengths: Reals, cell: float) -> np.ndarray:
    """Places (G, 2) of the middle of a group about the others: as far as the low modes cohere."""
    radii = [np.linalg.norm(one - one.mean(axis=0), axis=1).max() for one in (inside, outside)]
    extent = min(1.2 * sum(radii) + 0.5 * float(wavelengths.min()), float(wavelengths.max()))
    reach = int(np.ceil(extent / cell))
    axis = np.arange(-reach, reach + 1) * cell
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    return outside.mean(axis=0) + grid[np.linalg.norm(grid, axis=1) <= max(extent, cell)]


def _costs(
    far: Reals, near: Reals, q_far: Complexes, q_near: Complexes, field: FieldModel, places: Reals
) -> np.ndarray:
    """Cost (G,) of the group at `near` (n, 2) moved to each of `places` (G, 2), given the pressures of the others."""
    across = np.linalg.norm(places[:, None, None] + near[None, None] - far[:, None], axis=-1)
    total = np.zeros(len(places))
    for m, k in enumerate(field.wavenumbers):
        inverse, y = zip(*(_whitened(x, q[m], k, field, m) for x, q in ((far, q_far), (near, q_near))), strict=True)
        C = field.power[m] * diffuse_kernel(across.ravel(), k[None], field.dimension, slope=False)[0]
        S = np.swapaxes(inverse[0] @ C.reshape(across.shape) @ inverse[1].T, 1, 2)
        G = np.eye(len(near)) - S @ np.swapaxes(S, 1, 2)
        e = y[1] - S @ y[0]
        total += np.linalg.slogdet(G)[1] + np.sum(e * np.linalg.solve(np.asarray(G), np.asarray(e)), axis=(1, 2))
    return total


def _whitened(x: Reals, q: Complexes, k: float, field: FieldModel, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Inverse (N, N) of the Cholesky factor of the covariance, and real and imaginary parts (N, 2) it whitens."""
    between = np.linalg.norm(x[:, None] - x[None], axis=-1)
    K = diffuse_kernel(between.ravel(), np.array([k]), field.dimension, slope=False)[0].reshape(between.shape)
    inverse = np.linalg.inv(np.linalg.cholesky(np.asarray(field.power[m] * K + field.noise[m] * np.eye(len(x)))))
    return inverse, inverse @ np.column_stack([q.real, q.imag])
