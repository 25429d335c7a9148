"""The likelihood of many short windows: the field of each is random, and its covariance follows from the positions.

A short window of a take holds the sound of a few reflections. Over many windows these come from all directions, though
with unequal power, so that the spectra p of all windows of a take and frequency have the same covariance matrix up to
the power s of each window:

    p    ~ CN(0, s C)
    C    = G (K + sum_w b h h^H + e I) G^H,   G = diag exp(a_n + j b_n), the gains of the channels
    K_ij = j_0(k d) + sum_l a_l j_2(k d) Y_l(u) + r (J_0(k d_h cos g) cos(k d_v sin g) - j_0(k d)),   d u = x_i - x_j
    h_n  = exp(-j k t_n),   t_n = -v . x_n + q (|x_n|^2 - (v . x_n)^2) / 2, a wave w of the take: the direct sound or
           an early reflection

    Y_l  the five quadratic harmonics
    r    fraction of the sound that comes from the elevations g and -g; d_h and d_v are the horizontal and the vertical
         part of d. Floor and ceiling absorb most in a room, so that late sound comes from nearly horizontal directions
    b    power of the wave, from direction v (3,), of curvature q, 1/m
    e    power of the noise; b and e are interpolated in frequency between a few nodes

A window smooths the spectrum: K and h h^H are means over its bandwidth, taken at k - B and k + B, with B the standard
deviation of the wavenumber, weighted by the power spectrum of the window. With the values at k alone an array of 1.6 m
in windows of 30 ms ends 48 instead of 30 mm off.

With the power of each window at its likeliest value, p^H C^-1 p / N, the cost is

    cost = sum over groups of W log det C + N sum over windows of log p^H C^-1 p

(Tyler 1987: the angular Gaussian distribution). A group is one take at one frequency. The Fisher information is that of
the complex Gaussian distribution with the powers eliminated, times N / (N + 1). No interpolation limit such as Eq. 9
applies: the coherence of distant microphones is small at high frequencies, but still informative.
"""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.special import j0, j1, spherical_jn

from ..model.validation import Bools, Complexes, Integers, Reals

CHANNEL = ("x", "y", "z", "log gain", "phase")  # parameters of a microphone
# Y_l = u^T Q u
QUADRATIC = np.array(
    [
        [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[-0.5, 0, 0], [0, -0.5, 0], [0, 0, 1]],
    ]
)
SPECTRUM = ("x^2 - y^2", "xy", "xz", "yz", "z^2", "ring", "elevation")  # a_l, r, g
NOISE_NODES, POWER_NODES = 5, 2
DIRECTIONS = 1200  # number of directions among which a wave is sought
SPACING = 0.125  # distance of the places where a microphone is sought, in shortest wavelengths
# number of parameters of a wave: power, direction along two tangents, curvature; in one group, with one power, IN_GROUP
OF_WAVE, IN_GROUP = POWER_NODES + 3, 4
# means and standard deviations of the priors: of the spectrum, g in radians; of gains, nepers, and phases, radians; of
# the logarithms of noise and waves, over the diffuse field, and of the curvature, 1/m
SPECTRUM_MEAN = np.array([0, 0, 0, 0, 0, 0, 0.14])
SPECTRUM_SPREAD = np.array([0.5, 0.5, 0.5, 0.5, 1.0, 0.5, 0.07])
CHANNEL_SPREAD = 0.05
NOISE_PRIOR, POWER_PRIOR, CURVATURE_PRIOR = (-3.5, 2.0), (-1.5, 2.0), (0.4, 0.3)
NEGATIVE = 1e4  # nats, stiffness of the penalty on a negative power, relative to the mean, from one direction
NOISE_BOUNDS = (np.log(1e-5), np.log(5.0))


@dataclass(frozen=True)
class ShortField:
    """Positions, channels and field parameters; the takes share all of them except their W waves."""

    positions: Reals  # (N, 3) float64, metres
    channels: Reals  # (N, 2) float64, nepers and radians
    spectrum: Reals  # (7,) float64, a_l, r, g
    noise: Reals  # (NOISE_NODES,) float64, log e
    powers: Reals  # (T, W, POWER_NODES) float64, log b
    directions: Reals  # (T, W, 3) float64, v
    curvature: Reals  # (T, W) float64, q, 1/m


@dataclass(frozen=True)
class ShortTerms:
    """Cost and derivatives by the Q free ones of P parameters: (N, 5) of the microphones, spectrum, noise, takes."""

    cost: float
    gradient: Reals  # (Q,) float64; all derivatives are empty where only the cost was asked for
    fisher: Reals  # (Q, Q) float64
    scores: Reals  # (G, Q) float64, gradient of each group, without the priors


def first_field(positions: Reals, takes: int) -> ShortField:
    """Return an isotropic field without waves at positions (N, D), metres."""
    x = np.zeros((len(positions), 3))
    x[:, : positions.shape[1]] = positions - positions.mean(axis=0)
    return ShortField(
        positions=x,
        channels=np.zeros((len(x), 2)),
        spectrum=SPECTRUM_MEAN,
        noise=np.full(NOISE_NODES, np.log(0.05)),
        powers=np.zeros((takes, 0, POWER_NODES)),
        directions=np.zeros((takes, 0, 3)),
        curvature=np.zeros((takes, 0)),
    )


def free_parameters(field: ShortField, axes: Integers, channels: bool = False, spectrum: int = 0) -> np.ndarray:
    """Return which parameters are free : (P,) bool.

    axes : coordinates that are free, two for an array in a plane; spectrum : number of spectrum parameters that are
    free, from the first
    """
    each = np.tile([*np.isin(np.arange(3), axes), channels, channels], len(field.positions))
    shape = np.arange(len(SPECTRUM)) < spectrum
    if len(axes) == 2:  # an array in a plane cannot distinguish sound from the two sides of the plane
        across = 3 - int(np.sum(axes))
        shape[:5] &= np.array([across not in pair for pair in ((), (0, 1), (0, 2), (1, 2), ())])
    return np.concatenate([each, shape, np.full(NOISE_NODES + OF_WAVE * field.curvature.size, True)])


def advanced(field: ShortField, step: Reals) -> ShortField:
    """Return the field after a step (P,) of all parameters."""
    N, S = len(field.positions), len(SPECTRUM)
    each, rest = step[: 5 * N].reshape(N, 5), step[5 * N :]
    waves = rest[S + NOISE_NODES :].reshape(*field.curvature.shape, OF_WAVE)
    turned = np.einsum("twa,twab->twb", waves[..., POWER_NODES:-1], _tangents(field.directions))
    v = field.directions + turned
    return ShortField(
        positions=field.positions + each[:, :3],
        channels=field.channels + each[:, 3:],
        spectrum=field.spectrum + rest[:S],
        noise=np.clip(field.noise + rest[S : S + NOISE_NODES], *NOISE_BOUNDS),
        powers=field.powers + waves[..., :POWER_NODES],
        directions=v / np.linalg.norm(v, axis=-1, keepdims=True),
        curvature=np.clip(field.curvature + waves[..., -1], 0.0, 2.0),
    )


def upright(field: ShortField, axes: Integers) -> list[tuple[ShortField, np.ndarray]]:
    """Return, for each possible vertical, the field rotated so that z is vertical, and the free coordinates (D,).

    The vertical is the direction from which the least sound comes, according to the spectrum of degree 2. An array in
    the plane of x and y is either level, with z as its normal, or upright, with z as an axis in its plane. An upright
    array is rotated into the plane y = 0.
    """
    tensor = np.tensordot(field.spectrum[:5], QUADRATIC, 1)
    turn = np.linalg.eigh(tensor)[1]  # the axis of the largest eigenvalue is last
    cases = [(turn, axes)]
    if len(axes) == 2:
        standing = np.eye(3)[:, [0, 2, 1]]
        standing[:2, [0, 2]] = np.linalg.eigh(tensor[:2, :2])[1]
        cases = [(np.eye(3), axes), (standing, np.array([0, 2]))]
    turned = list[tuple[ShortField, np.ndarray]]()
    for turn, free in cases:
        turn[:, 0] *= np.sign(np.linalg.det(turn))
        t = turn.T @ tensor @ turn
        spectrum = np.array([(t[0, 0] - t[1, 1]) / 2, t[0, 1], t[0, 2], t[1, 2], t[2, 2], *SPECTRUM_MEAN[5:]])
        x, v = field.positions @ turn, field.directions @ turn
        turned.append((replace(field, positions=x, directions=v, spectrum=spectrum), free))
    return turned


def _gain(field: ShortField) -> Complexes:
    """Return the gains of the channels (N,) complex128."""
    return np.exp(field.channels[:, 0] + 1j * field.channels[:, 1])


def _tangents(directions: Reals) -> np.ndarray:
    """Return two unit vectors perpendicular to each direction (T, W, 3) : (T, W, 2, 3)."""
    return np.linalg.svd(directions[..., None, :])[2][..., 1:, :]


@dataclass(frozen=True)
class ShortLikelihood:
    """The windows of all takes, and their wavenumbers."""

    wavenumbers: Reals  # (G,) float64, rad/m, of each group
    takes: Integers  # (G,) int64
    pressures: Complexes  # (G, W, N) complex64 or complex128; a window that is not used is 0 in all channels
    bandwidth: float = 0.0  # rad/m, B
    dispersion: float = 1.0  # windows per independent window; the cost is divided by it

    def waves(self, field: ShortField, nodes: Reals) -> tuple[Complexes, Complexes, Reals]:
        """Return sqrt(b / 2) h (G, 2 W, N), derivatives (G, 2 W, 4, N) by the wave, and slopes of k t (3, G, 2 W, N).

        nodes : (G, POWER_NODES), weights of the nodes of the powers. The waves are those at k - B, then those at k + B.
        The derivatives are those by the logarithm of the power, by the direction along two tangents, and by the
        curvature.
        """
        both = self.wavenumbers[:, None] + self.bandwidth * np.array([-1, 1])
        k: Reals = np.repeat(both, field.curvature.shape[1], axis=1)[..., None]
        delays, slopes, *turned = (np.concatenate([one[..., self.takes, :, :]] * 2, axis=-2) for one in _delays(field))
        power = np.einsum("gn,gwn->gw", nodes, field.powers[self.takes]) - np.log(2)
        h: Complexes = np.exp(np.hstack([power, power])[..., None] / 2 - 1j * k * delays)
        return h, np.stack([h / 2, *(-1j * k * one * h for one in turned)], axis=2), k * slopes

    def powers(self, L: Complexes, field: ShortField) -> Reals:
        """Return p^H C^-1 p of each window (G, W), 0 if it is not used; L : (G, N, N), Cholesky factor of C."""
        whitener = (np.linalg.inv(L) / _gain(field)).swapaxes(1, 2).astype(self.pressures.dtype)
        whitened = self.pressures @ whitener
        return (whitened.real**2 + whitened.imag**2).sum(axis=2, dtype=np.float64)

    def scatter(self, q: Reals, field: ShortField) -> Complexes:
        """Return the sum of N p p^H / q over the windows, without gains (G, N, N); q : result of `powers`."""
        weight = np.where(q > 0, len(field.positions) / np.where(q > 0, q, 1.0), 0.0) / self.dispersion
        weighted = self.pressures * weight[..., None].astype(self.pressures.real.dtype)
        scatter = weighted.swapaxes(1, 2) @ np.conj(self.pressures)
        return scatter / (_gain(field)[:, None] * np.conj(_gain(field)))

    def terms(self, field: ShortField, free: Bools | None = None) -> ShortTerms:
        """Return the cost with priors, and its derivatives by the parameters that are `free`, (P,) bool, if given.

        All microphones must have the same free parameters. Raises LinAlgError for a covariance that is not positive
        definite.
        """
        take, x, N = self.takes, field.positions, len(field.positions)
        each, of_group = np.unique(self.wavenumbers, return_inverse=True)
        K, slopes, shapes = anisotropic_kernel(x, each, field.spectrum, free is not None, self.bandwidth)
        noise_nodes, power_nodes = _nodes(each, NOISE_NODES)[of_group], _nodes(each, POWER_NODES)[of_group]
        noise = np.exp(noise_nodes @ field.noise)
        h, by_wave, phase_slopes = self.waves(field, power_nodes)
        C = _covariance(K[of_group], noise, h)
        L: Complexes = np.linalg.cholesky(C)
        q = self.powers(L, field)
        windows = np.sum(q > 0, axis=1) / self.dispersion
        log_det = 2 * np.log(np.diagonal(L, axis1=1, axis2=2).real).sum(axis=1)
        prior_cost, prior_gradient, stiffness = _priors(field)
        cost = prior_cost + float(windows @ (log_det + 2 * field.channels[:, 0].sum()))
        cost += N * float(np.log(q[q > 0]).sum()) / self.dispersion
        if free is None:
            return ShortTerms(cost, np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0)))
        inverse: Complexes = np.linalg.inv(C)
        M = windows[:, None, None] * inverse - inverse @ self.scatter(q, field) @ inverse
        # A parameter of microphone n changes one row and one column: dC = e_n D_n + (e_n D_n)^H.
        of_each, of_all = np.flatnonzero(free[: len(CHANNEL)]), free[len(CHANNEL) * N :]
        rows = [
            slopes[a][of_group] - 1j * ((phase_slopes[a] * h).swapaxes(1, 2) @ h.conj()) for a in of_each[of_each < 3]
        ]
        rows += [(C, 1j * C)[a - 3] for a in of_each[of_each >= 3]]
        shape = np.flatnonzero(of_all[: len(SPECTRUM)])
        whole = np.append(shapes[shape][:, of_group], (noise[:, None, None] * np.eye(N))[None], axis=0)
        design = _design(take, field, noise_nodes, power_nodes)
        design = design[:, np.append(shape, np.arange(len(SPECTRUM), design.shape[1]))][:, :, of_all]
        scores, fisher = _scores_and_fisher(windows, inverse, M, np.array(rows), whole, h, by_wave, design)
        gradient = scores.sum(axis=0) + prior_gradient[free]
        return ShortTerms(cost, gradient, fisher + stiffness[np.ix_(free, free)], scores)


def _covariance(K: Reals, noise: Reals, h: Complexes) -> Any:
    """Return C (G, N, N) complex128 without gains, from K (G, N, N), the noise (G,) and the waves (G, 2 W, N)."""
    return K + noise[:, None, None] * np.eye(K.shape[1]) + h.swapaxes(1, 2) @ h.conj()


def _design(take: Integers, field: ShortField, noise_nodes: Reals, power_nodes: Reals) -> np.ndarray:
    """Return the derivatives (G, S + 1 + 2 W IN_GROUP, V) of the parameters of each group by those of all groups.

    The parameters of a group are the spectrum, the noise, and power, direction (2) and curvature of each of its 2 W
    waves: each wave of a take stands for two, at k - B and at k + B, with the same parameters.
    """
    every, S, (takes, waves) = np.arange(len(take))[:, None], len(SPECTRUM), field.curvature.shape
    design = np.zeros((len(take), S + 1 + 2 * IN_GROUP * waves, S + NOISE_NODES + OF_WAVE * takes * waves))
    design[:, range(S), range(S)] = 1.0
    design[:, S, S : S + NOISE_NODES] = noise_nodes
    for wave in range(2 * waves):
        row, own = S + 1 + IN_GROUP * wave, S + NOISE_NODES + OF_WAVE * (take[:, None] * waves + wave % waves)
        design[every, row, own + np.arange(POWER_NODES)] = power_nodes
        design[every, row + 1 + np.arange(3), own + POWER_NODES + np.arange(3)] = 1.0
    return design


def _scores_and_fisher(
    windows: Reals,
    inverse: Complexes,
    M: Complexes,
    rows: Complexes,
    whole: Reals,
    h: Complexes,
    by_wave: Complexes,
    design: Reals,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient of each group (G, Q) and the Fisher information (Q, Q), by the free parameters.

    M : (G, N, N), gradient by C; rows : (A, G, N, N), D of each free parameter of a microphone; whole : (V, G, N, N),
    derivatives of C by each free parameter of the group but those of its waves, symmetric; h, by_wave : the waves and
    their derivatives, of `ShortLikelihood.waves`; design : result of `_design`, of the free parameters
    """
    G, N, A, V = len(inverse), inverse.shape[1], len(rows), len(whole)
    P, weight = N * A, windows * N / (N + 1)
    X, transposed = rows @ inverse, inverse.swapaxes(1, 2)
    # S C^-1 of each `whole` S, transposed (G, N, N, V), in real and imaginary part (G, N, 2, N, V)
    parts = np.stack([transposed.real, transposed.imag], axis=2).reshape(G, 2 * N, N)
    parts = (parts @ np.ascontiguousarray(whole.transpose(1, 2, 3, 0)).reshape(G, N, N * V)).reshape(G, N, 2, N, V)
    # A parameter of a wave changes C by u h^H + h u^H.
    u, repeated = by_wave.reshape(G, -1, N), np.repeat(h, by_wave.shape[2], axis=1)
    inner_u, inner_h = u @ transposed, repeated @ transposed
    of_rows = 2 * np.einsum("agij,gji->gia", rows, M).real.reshape(G, P)
    traces = 2 * np.einsum("agii->gia", X).real.reshape(G, P)
    F, cross = np.zeros((N, A, N, A)), np.zeros((G, N, A, V + u.shape[1]))
    real_X = np.stack([X.real, -X.imag], axis=3).transpose(1, 2, 0, 3, 4).reshape(G, N, A, 2 * N)
    cross[..., :V] = 2 * (real_X @ parts.reshape(G, N, 2 * N, V))
    for a, one in enumerate(rows):
        for b in range(a, A):
            both = X[a] * X[b].swapaxes(1, 2) + transposed * (X[a] @ np.conj(rows[b].swapaxes(1, 2)))
            F[:, a, :, b] = 2 * np.tensordot(weight, both.real, 1)
            F[:, b, :, a] = F[:, a, :, b].T
        with_waves = (one @ inner_u.swapaxes(1, 2)) * inner_h.conj().swapaxes(1, 2)
        with_waves += (one @ inner_h.swapaxes(1, 2)) * inner_u.conj().swapaxes(1, 2)
        cross[:, :, a, V:] = 2 * with_waves.real
    flat = whole.swapaxes(0, 1).reshape(G, V, -1)
    of_waves = [2 * np.sum(repeated.conj() * (u @ one.swapaxes(1, 2)), axis=2).real for one in (M, inverse)]
    of_whole, traces_whole = (
        np.hstack([(flat @ one.real.reshape(G, -1, 1))[..., 0], waves])
        for one, waves in zip((M, inverse), of_waves, strict=True)
    )
    inner_whole = np.conj(h @ (parts[:, :, 0] + 1j * parts[:, :, 1]).reshape(G, N, N * V)).reshape(G, -1, N, V)
    across_waves = 2 * np.einsum("gwj,gwjv->gvw", inner_u, np.repeat(inner_whole, by_wave.shape[2], axis=1)).real
    mixed = repeated.conj() @ inner_u.swapaxes(1, 2)
    waves = mixed * mixed.swapaxes(1, 2)
    waves += (repeated.conj() @ inner_h.swapaxes(1, 2)) * np.conj(u.conj() @ inner_u.swapaxes(1, 2))
    plain = np.zeros((G, V, V))
    for sign, part in ((1, parts[:, :, 0]), (-1, parts[:, :, 1])):
        plain += sign * (part.transpose(0, 3, 1, 2).reshape(G, V, -1) @ part.swapaxes(1, 2).reshape(G, -1, V))
    own = np.block([[plain, across_waves], [across_waves.swapaxes(1, 2), 2 * waves.real]])
    weighted = weight[:, None, None] * design
    shared = np.tensordot(weighted, own @ design, ((0, 1), (0, 1)))
    across = np.tensordot(cross.reshape(G, P, -1), weighted, ((0, 2), (0, 1)))

    def by_all(values: Reals, of_group: Reals) -> np.ndarray:
        return np.hstack([values, np.einsum("gl,glv->gv", of_group, design)])

    tall = by_all(traces, traces_whole)
    fisher = np.block([[F.reshape(P, P), across], [across.T, shared]]) - (tall * (weight / N)[:, None]).T @ tall
    return by_all(of_rows, of_whole), fisher


# K, its derivatives by coordinates, and those by the spectrum; the derivatives may be empty arrays
Kernel = tuple[np.ndarray, np.ndarray, np.ndarray]


def anisotropic_kernel(x: Reals, k: Reals, spectrum: Reals, slope: bool = True, bandwidth: float = 0.0) -> Kernel:
    """Return K (F, N, N), its derivatives (3, F, N, N) by x_i - x_j, and (7, F, N, N) by the spectrum parameters.

    x : (N, 3), metres; k, bandwidth : (F,) and B, rad/m; spectrum : (7,). The derivatives are empty without `slope`.
    """
    N = len(x)
    i, j = np.triu_indices(N, 1)

    def whole(values: Reals, sign: float = 1.0) -> np.ndarray:
        out = np.zeros((*values.shape[:-1], N, N))
        out[..., i, j], out[..., j, i] = values, sign * values
        return out

    values, slopes, shapes = _pair_kernel(x[i] - x[j], k, spectrum, slope, bandwidth)
    K = whole(values)
    K[:, np.arange(N), np.arange(N)] = 1.0
    if not slope:
        return K, np.zeros((0, *K.shape)), np.zeros((0, *K.shape))
    return K, whole(np.moveaxis(slopes, -1, 0), -1.0), whole(shapes)


def _pair_kernel(d: Reals, k: Reals, spectrum: Reals, slope: bool, bandwidth: float) -> Kernel:
    """Return K (F, P) of pairs at distances d (P, 3), metres, and its derivatives (F, P, 3) and (7, F, P).

    The derivatives are those by d and by the spectrum parameters, empty without `slope`.
    """
    k, shape = np.concatenate([k - bandwidth, k + bandwidth]), (2, len(k), len(d))
    *a, ring, elevation = spectrum
    r = np.linalg.norm(d, axis=1) + 1e-9
    u, Y = d / r[:, None], _quadratic(d / r[:, None])
    z = np.maximum(k[:, None] * r, 1e-4)
    isotropic, second = spherical_jn(0, z), spherical_jn(2, z)
    across = np.linalg.norm(d[:, :2], axis=1) + 1e-9
    flat, up = np.cos(elevation), np.sin(elevation)
    round_, level = k[:, None] * across * flat, k[:, None] * d[:, 2] * up
    bessel, wave = j0(round_), np.cos(level)
    values = (1 - ring) * isotropic + second * np.dot(a, Y) + ring * bessel * wave
    if not slope:
        return values.reshape(shape).mean(axis=0), np.zeros(0), np.zeros(0)
    outward, upward = -j1(round_) * wave, -bessel * np.sin(level)  # by the arguments of the two factors of the ring
    radial = (1 - ring) * spherical_jn(0, z, True) + np.dot(a, Y) * spherical_jn(2, z, True)
    slopes = k[:, None, None] * (radial[..., None] * u)
    tensor = np.tensordot(a, QUADRATIC, 1)
    slopes += second[..., None] * (2 * (u @ tensor - np.dot(a, Y)[:, None] * u) / r[:, None])
    slopes[..., :2] += ring * k[:, None, None] * flat * outward[..., None] * (d[:, :2] / across[:, None])
    slopes[..., 2] += ring * k[:, None] * up * upward
    turned = ring * k[:, None] * (upward * d[:, 2] * flat - outward * across * up)
    shapes = np.array([*(second * y for y in Y), bessel * wave - isotropic, turned]).reshape(-1, *shape)
    return values.reshape(shape).mean(axis=0), slopes.reshape(*shape, 3).mean(axis=0), shapes.mean(axis=1)


def _nodes(k: Reals, count: int) -> np.ndarray:
    """Return the weights (F, count) of linear interpolation between nodes over the band of ascending k (F,)."""
    along = (k - k[0]) / max(float(k[-1] - k[0]), 1e-9)
    return np.maximum(0.0, 1 - np.abs(along[:, None] - np.linspace(0, 1, count)) * (count - 1))


def _delays(field: ShortField) -> list[np.ndarray]:
    """Return t (T, W, N), metres, its slopes (3, T, W, N) by the coordinates, and three slopes (T, W, N) by the wave.

    The last three are those by the direction, along two tangents, and by the curvature.
    """
    x, v, q = field.positions, field.directions, field.curvature[..., None]
    along, tangents = v @ x.T, _tangents(v) @ x.T
    across = np.sum(x**2, axis=1) - along**2
    toward = np.moveaxis(v, -1, 0)[..., None]
    slopes = -toward + q * (x.T[:, None, None] - along * toward)
    turned = [-tangents[..., one, :] - q * along * tangents[..., one, :] for one in range(2)]
    return [-along + q / 2 * across, slopes, *turned, across / 2]


def _priors(field: ShortField) -> tuple[float, np.ndarray, np.ndarray]:
    """Return cost, gradient (P,) and stiffness (P, P) of the priors, in the order of the parameters.

    The priors are Gaussian. A penalty keeps two powers from becoming negative: 1 - r - sum_l a_l Y_l(u), relative to
    the mean, from any direction u, and r.
    """
    N = len(field.channels)
    each, spread = np.zeros((N, 5)), np.full((N, 5), np.inf)
    each[:, 3:], spread[:, 3:] = field.channels, CHANNEL_SPREAD
    waves = np.zeros((*field.curvature.shape, OF_WAVE))
    widths = np.full(waves.shape, np.inf)
    waves[..., :POWER_NODES], widths[..., :POWER_NODES] = field.powers - POWER_PRIOR[0], POWER_PRIOR[1]
    waves[..., -1], widths[..., -1] = field.curvature - CURVATURE_PRIOR[0], CURVATURE_PRIOR[1]
    away = np.concatenate([each.ravel(), field.spectrum - SPECTRUM_MEAN, field.noise - NOISE_PRIOR[0], waves.ravel()])
    noise = np.full(NOISE_NODES, NOISE_PRIOR[1])
    diagonal = 1 / np.concatenate([spread.ravel(), SPECTRUM_SPREAD, noise, widths.ravel()]) ** 2
    gradient, stiffness = away * diagonal, np.diag(diagonal)
    slopes = np.zeros((101, len(SPECTRUM)))
    slopes[:100, :5], slopes[:100, 5], slopes[100, 5] = -_quadratic(_directions(100)).T, -1.0, 1.0
    power = np.minimum(np.append(np.ones(100), 0.0) + slopes @ field.spectrum, 0.0)
    own = slice(5 * N, 5 * N + len(SPECTRUM))
    gradient[own] += NEGATIVE * power @ slopes
    stiffness[own, own] += NEGATIVE * slopes[power < 0].T @ slopes[power < 0]
    return float(np.sum(away**2 * diagonal) + NEGATIVE * np.sum(power**2)) / 2, gradient, stiffness


def _quadratic(u: Reals) -> np.ndarray:
    """Return Y_l (5, P) in the directions u (P, 3)."""
    return np.einsum("pa,lab,pb->lp", u, QUADRATIC, u)


@functools.cache
def _directions(count: int) -> np.ndarray:
    """Return unit vectors (count, 3) that are evenly distributed over the sphere, on a spiral."""
    turn = np.arange(count)
    height = 1 - 2 * (turn + 0.5) / count
    angle, flat = turn * np.pi * (3 - np.sqrt(5.0)), np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)


def _observed(likelihood: ShortLikelihood, field: ShortField) -> tuple[Complexes, Complexes, Complexes, Reals]:
    """Return the waves (G, 2 W, N), the inverse of C and the scatter (G, N, N), and the number of windows (G,)."""
    each, of_group = np.unique(likelihood.wavenumbers, return_inverse=True)
    K = anisotropic_kernel(field.positions, each, field.spectrum, False, likelihood.bandwidth)[0]
    noise = np.exp(_nodes(each, NOISE_NODES) @ field.noise)
    h = likelihood.waves(field, _nodes(each, POWER_NODES)[of_group])[0]
    C = _covariance(K[of_group], noise[of_group], h)
    q = likelihood.powers(np.linalg.cholesky(C), field)
    return h, np.linalg.inv(C), likelihood.scatter(q, field), np.sum(q > 0, axis=1) / likelihood.dispersion


def with_wave(likelihood: ShortLikelihood, field: ShortField) -> ShortField:
    """Return the field with one more wave of each take, the likeliest among DIRECTIONS directions and five powers.

    A wave sqrt(b) h changes log det C by log(1 + b s), s = h^H C^-1 h, and p^H C^-1 p by -b |h^H C^-1 p|^2 / (1 + b s).
    The bandwidth is neglected here; the steps that follow take it into account.
    """
    inverse, scatter, windows = _observed(likelihood, field)[1:]
    received = inverse @ scatter @ inverse
    directions, powers = _directions(DIRECTIONS), np.exp([-4.5, -3.0, -1.5, 0.0, 1.5])
    curvature = np.full((1, DIRECTIONS), CURVATURE_PRIOR[0])
    delays = _delays(replace(field, directions=directions[None], curvature=curvature))[0][0]
    value = np.zeros((len(field.curvature), DIRECTIONS, len(powers)))
    for g, take in enumerate(likelihood.takes):
        h = np.exp(-1j * likelihood.wavenumbers[g] * delays)
        s, along = (np.sum((h @ one.T) * h.conj(), axis=1).real[:, None] for one in (inverse[g], received[g]))
        value[take] += windows[g] * np.log1p(powers * s) - powers / (1 + powers * s) * along
    best = np.array([np.unravel_index(np.argmin(one), one.shape) for one in value])
    new = np.log(powers[best[:, 1]])[:, None, None] * np.ones(POWER_NODES)
    return replace(
        field,
        directions=np.concatenate([field.directions, directions[best[:, :1]]], axis=1),
        powers=np.concatenate([field.powers, new], axis=1),
        curvature=np.concatenate([field.curvature, np.full((len(new), 1), CURVATURE_PRIOR[0])], axis=1),
    )


def other_places(
    likelihood: ShortLikelihood, field: ShortField, axes: Integers, apart: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the likeliest other place of each microphone (N, 3), metres, and by how much its cost is higher (N,).

    The places are minima of the cost on a lattice, at least `apart`, metres, from the present place, with all other
    microphones where they are. The difference is infinite if there is none. axes : (D,), coordinates that are free
    """
    x, spacing = field.positions, SPACING * 2 * np.pi / float(likelihood.wavenumbers.max())
    ranges = [np.arange(x[:, a].min() - spacing, x[:, a].max() + 2 * spacing, spacing) for a in axes]
    places = np.tile(x.mean(axis=0), (int(np.prod([len(one) for one in ranges])), 1))
    places[:, axes] = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, len(axes))
    costs = costs_of_places(likelihood, field, np.vstack([x, places]), spacing / 2 / np.sqrt(3))
    gaps, best = np.full(len(x), np.inf), np.array(x)
    for n, of_places in enumerate(costs[:, len(x) :]):
        lattice = of_places.reshape([len(one) for one in ranges])
        minima = (lattice == minimum_filter(lattice, 3, mode="nearest")).ravel()
        minima &= np.linalg.norm(places - x[n], axis=1) > apart
        if minima.any():
            at = np.flatnonzero(minima)[np.argmin(of_places[minima])]
            best[n], gaps[n] = places[at], of_places[at] - costs[n, n]
    return best, gaps


def costs_of_places(likelihood: ShortLikelihood, field: ShortField, places: Reals, error: float) -> np.ndarray:
    """Return the cost (N, C) of moving one microphone alone to each of `places` (C, 3), metres.

    The cost is defined up to a constant for each microphone. The other microphones predict its pressure. One sigma of
    each coordinate of the places, `error`, metres, adds to the variance of the prediction. The powers of the windows
    are those at the present array.
    """
    each, of_group = np.unique(likelihood.wavenumbers, return_inverse=True)
    nodes, noise = _nodes(each, POWER_NODES)[of_group], np.exp(_nodes(each, NOISE_NODES) @ field.noise)
    h, inverses, scatters, windows = _observed(likelihood, field)
    delays, N = _delays(replace(field, positions=places))[0], len(field.positions)
    apart, costs = (places[:, None] - field.positions).reshape(-1, 3), np.zeros((len(places), N))
    for f, k in enumerate(each):
        K = _pair_kernel(apart, each[f : f + 1], field.spectrum, False, likelihood.bandwidth)[0].reshape(-1, N)
        for g in np.flatnonzero(of_group == f):
            inverse, S, delay = inverses[g], scatters[g], delays[likelihood.takes[g]]
            amplitude = np.exp((field.powers[likelihood.takes[g]] @ nodes[g] - np.log(2)) / 2)[:, None]
            there = np.vstack(
                [amplitude * np.exp(-1j * end * delay) for end in (k - likelihood.bandwidth, k + likelihood.bandwidth)]
            )
            across = K + there.T @ h[g].conj()
            # Weights that leave out microphone n are X - X_n R_n, with X the weights of all and R_n a row of R.
            X, own = across @ inverse, np.real(np.diag(inverse))
            R, T, squared = inverse / own[:, None], X @ S, np.abs(X) ** 2
            alone = (1 + np.sum(np.abs(there) ** 2, axis=0)) * (1 + (k * error) ** 2) + noise[f]
            variance = (alone - np.sum(X * across.conj(), axis=1).real)[:, None] + squared / own
            squares = np.sum(T * X.conj(), axis=1).real[:, None] + squared * np.sum((R @ S) * R.conj(), axis=1).real
            squares += np.real(np.diag(S)) - 2 * (X.conj() * (T @ R.conj().T) + T - X * np.diag(R @ S)).real
            costs += windows[g] * np.log(variance) + squares / variance
    return costs.T
