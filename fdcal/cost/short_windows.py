"""The likelihood of many short windows. The field in each window is random; its covariance depends on the positions.

A short window of a take holds the sound of a few reflections. Over many windows the reflections come from all
directions, with unequal power. The spectra p of all windows of a take at one frequency therefore have the same
covariance matrix, except for the power s of each window:

    p    ~ CN(0, s C)
    C    = G (K + sum_w b h h^H + e I) G^H,   G = diag exp(a_n + j b_n), the gains of the channels
    K_ij = j_0(k d) + sum_l a_l j_2(k d) Y_l(u) + r (J_0(k d_h cos g) cos(k d_v sin g) - j_0(k d)),   d u = x_i - x_j
    h_n  = exp(-j k t_n),   t_n = -v . x_n + q (|x_n|^2 - (v . x_n)^2) / 2

    h    phases of wave w of the take at the microphones; the waves are the direct sound and early reflections
    b    its power;   v (3,) the direction that it comes from;   q its curvature, 1/m;   t_n its delay times c, metres
    Y_l  the five quadratic harmonics
    r    fraction of the sound that comes from the elevations g and -g; d_h and d_v are the horizontal and the vertical
         part of d. Floor and ceiling of a room absorb most of the sound, so that late sound is nearly horizontal
    e    power of the noise. Both b and e are interpolated in frequency between a few nodes

A window smooths the spectrum. K and h h^H are therefore means over its bandwidth. They are approximated by the mean of
the values at k - B and k + B, where B is the standard deviation of the wavenumber over the window's power spectrum. The
values at k alone would be less accurate: for an array of 1.6 m and windows of 30 ms, they would increase the error of
the positions from 30 to 48 mm.

If the power of each window has its most likely value, p^H C^-1 p / N, the cost is

    cost = sum over groups of U log det C + N sum over windows of log p^H C^-1 p

(the angular Gaussian distribution, Tyler 1987). A group consists of the U windows of one take at one frequency. The
Fisher information is that of the complex Gaussian distribution after elimination of the powers, times N / (N + 1). No
interpolation limit such as Eq. 9 applies, because the small coherence of distant microphones at high frequencies still
carries information.
"""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import minimum_filter
from scipy.special import j0, j1

from ..acoustics.dictionary import sinc
from ..model.validation import Bools, Complexes, Integers, Reals

CHANNEL = ("x", "y", "z", "log gain", "phase")  # parameters of a microphone and its channel
# matrices Q_l of the quadratic harmonics Y_l(u) = u^T Q_l u
QUADRATIC = np.array(
    [
        [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
        [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[-0.5, 0, 0], [0, -0.5, 0], [0, 0, 1]],
    ]
)
SPECTRUM = ("x^2 - y^2", "xy", "xz", "yz", "z^2", "ring", "elevation")  # parameters of power by direction: a_l, r, g
NOISE_NODES, POWER_NODES = 5, 2  # numbers of nodes in frequency of e and b
DIRECTIONS = 1200  # number of directions that are tried for a new wave
SPACING = 0.125  # spacing of the lattice on which a microphone is sought, in shortest wavelengths
# OF_WAVE is the number of parameters of a wave: its power at each node, its direction along two tangents, and its
# curvature. IN_GROUP is their number within one group, where the wave has one power instead of those at the nodes
OF_WAVE, IN_GROUP = POWER_NODES + 3, 4
# Means and standard deviations of the priors. SPECTRUM: a_l, r and g, radians. CHANNEL: gains, nepers, and phases,
# radians. NOISE and POWER: logarithms of the power relative to the diffuse field. CURVATURE: 1/m
SPECTRUM_MEAN = np.array([0, 0, 0, 0, 0, 0, 0.14])
SPECTRUM_SPREAD = np.array([0.5, 0.5, 0.5, 0.5, 1.0, 0.5, 0.07])
CHANNEL_SPREAD = 0.05
NOISE_PRIOR, POWER_PRIOR, CURVATURE_PRIOR = (-3.5, 2.0), (-1.5, 2.0), (0.4, 0.3)
NEGATIVE = 1e4  # nats, stiffness of the penalty on a negative power from a direction, relative to the mean power
NOISE_BOUNDS = (np.log(1e-5), np.log(5.0))  # bounds on log e


@dataclass(frozen=True)
class ShortField:
    """Positions, channels and parameters of the field, common to all takes except for the W waves of each take."""

    positions: Reals  # (N, 3) float64, metres
    channels: Reals  # (N, 2) float64, nepers and radians
    spectrum: Reals  # (7,) float64, a_l, r, g
    noise: Reals  # (NOISE_NODES,) float64, log e
    powers: Reals  # (T, W, POWER_NODES) float64, log b
    directions: Reals  # (T, W, 3) float64, v
    curvature: Reals  # (T, W) float64, q, 1/m


@dataclass(frozen=True)
class ShortTerms:
    """The cost and its derivatives with respect to the Q free parameters.

    The free parameters are some of P parameters: five of each microphone, then the spectrum, the noise and the waves of
    each take.
    """

    cost: float  # nats
    gradient: Reals  # (Q,) float64; all derivatives are empty if only the cost was asked for
    fisher: Reals  # (Q, Q) float64, Fisher information, including the priors
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

    axes : the free coordinates, two for an array in a plane; channels : whether gains and phases are free; spectrum :
    how many parameters of the spectrum are free, from the first on
    """
    each = np.tile([*np.isin(np.arange(3), axes), channels, channels], len(field.positions))
    shape = np.arange(len(SPECTRUM)) < spectrum
    if len(axes) == 2:  # an array in a plane cannot distinguish between sound from the two sides of the plane
        across = 3 - int(np.sum(axes))
        shape[:5] &= np.array([across not in pair for pair in ((), (0, 1), (0, 2), (1, 2), ())])
    return np.concatenate([each, shape, np.full(NOISE_NODES + OF_WAVE * field.curvature.size, True)])


def advanced(field: ShortField, step: Reals) -> ShortField:
    """Return the field after all parameters are changed by `step` (P,)."""
    N, S = len(field.positions), len(SPECTRUM)
    each, rest = step[: 5 * N].reshape(N, 5), step[5 * N :]
    waves = rest[S + NOISE_NODES :].reshape(*field.curvature.shape, OF_WAVE)
    v = field.directions + np.einsum("twa,twab->twb", waves[..., POWER_NODES:-1], _tangents(field.directions))
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

    The vertical is the direction from which the least sound comes, according to the quadratic harmonics of the
    spectrum. An array in the plane of x and y is either level, so that z is its normal, or upright, so that z lies in
    its plane. An upright array is rotated into the plane y = 0.
    """
    tensor = np.tensordot(field.spectrum[:5], QUADRATIC, 1)
    turn = np.linalg.eigh(tensor)[1]  # least sound comes from the last axis, which has the largest eigenvalue
    cases = [(turn, axes)]
    if len(axes) == 2:
        standing = np.eye(3)[:, [0, 2, 1]]
        standing[:2, [0, 2]] = np.linalg.eigh(tensor[:2, :2])[1]
        cases = [(np.eye(3), axes), (standing, np.array([0, 2]))]
    rotated = list[tuple[ShortField, np.ndarray]]()
    for turn, free in cases:
        turn[:, 0] *= np.sign(np.linalg.det(turn))
        t = turn.T @ tensor @ turn
        spectrum = np.array([(t[0, 0] - t[1, 1]) / 2, t[0, 1], t[0, 2], t[1, 2], t[2, 2], *SPECTRUM_MEAN[5:]])
        x, v = field.positions @ turn, field.directions @ turn
        rotated.append((replace(field, positions=x, directions=v, spectrum=spectrum), free))
    return rotated


def _gain(field: ShortField) -> Complexes:
    """Return the gains of the channels (N,) complex128."""
    return np.exp(field.channels[:, 0] + 1j * field.channels[:, 1])


def _tangents(directions: Reals) -> np.ndarray:
    """Return two unit vectors perpendicular to each direction (T, W, 3) : (T, W, 2, 3)."""
    return np.linalg.svd(directions[..., None, :])[2][..., 1:, :]


@dataclass(frozen=True)
class ShortLikelihood:
    """The windows of all takes, their wavenumbers, and the cost of a `ShortField`."""

    wavenumbers: Reals  # (G,) float64, rad/m, of each group
    takes: Integers  # (G,) int64
    pressures: Complexes  # (G, U, N) complex64 or complex128; an unused window is 0 in all channels
    bandwidth: float  # rad/m, B
    dispersion: float = 1.0  # number of windows with the information of one independent window; it divides the cost

    def waves(self, field: ShortField, nodes: Reals) -> tuple[Complexes, Complexes, Reals]:
        """Return the waves sqrt(b / 2) h (G, 2 W, N), their derivatives (G, 2 W, 4, N), and slopes of k t.

        nodes : (G, POWER_NODES), weights of the nodes of the powers. The waves at k - B come first, then those at
        k + B. The derivatives are those with respect to the logarithm of the power, the direction along two tangents,
        and the curvature. The slopes (3, G, 2 W, N), rad/m, are those with respect to the coordinates.
        """
        both = self.wavenumbers[:, None] + self.bandwidth * np.array([-1, 1])
        k: Reals = np.repeat(both, field.curvature.shape[1], axis=1)[..., None]
        delays, slopes, *turned = (np.concatenate([one[..., self.takes, :, :]] * 2, axis=-2) for one in _delays(field))
        power = np.einsum("gn,gwn->gw", nodes, field.powers[self.takes]) - np.log(2)
        h: Complexes = np.exp(np.hstack([power, power])[..., None] / 2 - 1j * k * delays)
        return h, np.stack([h / 2, *(-1j * k * one * h for one in turned)], axis=2), k * slopes

    def powers(self, L: Complexes, field: ShortField) -> Reals:
        """Return p^H C^-1 p of each window (G, U), 0 if it is not used; L : (G, N, N), Cholesky factor of C."""
        whitener = (np.linalg.inv(L) / _gain(field)).swapaxes(1, 2).astype(self.pressures.dtype)
        parts = (self.pressures @ whitener).view(self.pressures.real.dtype)
        return np.einsum("gwn,gwn->gw", parts, parts).astype(float)

    def scatter(self, q: Reals, field: ShortField) -> Complexes:
        """Return the sum of N p p^H / q over the windows, divided by `dispersion` : (G, N, N) complex.

        p are the pressures divided by the gains; q : (G, U), result of `powers`
        """
        weight = np.where(q > 0, len(field.positions) / np.where(q > 0, q, 1.0), 0.0) / self.dispersion
        weighted = self.pressures * weight[..., None].astype(self.pressures.real.dtype)
        return weighted.swapaxes(1, 2) @ np.conj(self.pressures) / (_gain(field)[:, None] * np.conj(_gain(field)))

    def terms(self, field: ShortField, free: Bools | None = None) -> ShortTerms:
        """Return the cost including the priors and, if `free` is given, its derivatives.

        They are the derivatives with respect to the parameters where `free` (P,) is true; all microphones must have the
        same free parameters. Raises LinAlgError for a covariance that is not positive definite.
        """
        take, x, N = self.takes, field.positions, len(field.positions)
        each, of_group = np.unique(self.wavenumbers, return_inverse=True)
        K, slopes, shapes = anisotropic_kernel(x, each, field.spectrum, self.bandwidth, free is not None)
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
        # A parameter of microphone n changes row n and column n of C: dC = e_n D_n + (e_n D_n)^H with a row D_n.
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
    """Return C (G, N, N) complex128 for gains of 1, from K (G, N, N), the noise (G,) and the waves (G, 2 W, N)."""
    return K + noise[:, None, None] * np.eye(K.shape[1]) + h.swapaxes(1, 2) @ h.conj()


def _design(take: Integers, field: ShortField, noise_nodes: Reals, power_nodes: Reals) -> np.ndarray:
    """Return the Jacobian (G, S + 1 + 2 W IN_GROUP, V) of each group's parameters with respect to the common ones.

    The parameters of a group are the S of the spectrum, the noise, and the power, direction (2) and curvature of each
    of its 2 W waves: a wave of the take appears twice, at k - B and at k + B, with the same parameters. The V common
    parameters, which all groups depend on, are the spectrum, the noise at its nodes, and the waves of all takes.
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
    """Return the gradient of each group (G, Q) and the Fisher information (Q, Q) of the Q free parameters.

    windows : (G,), number of windows; inverse : (G, N, N), C^-1; M : (G, N, N), gradient of the cost with respect to C;
    rows : (A, G, N, N), the rows D_n of each of the A free parameters of a microphone; whole : (V, G, N, N), symmetric,
    the derivatives of C with respect to the free parameters of a group except those of its waves; h, by_wave : the
    waves and their derivatives, from `ShortLikelihood.waves`; design : result of `_design` for the free parameters
    """
    G, N, A, V = len(inverse), inverse.shape[1], len(rows), len(whole)
    P, weight = N * A, windows * N / (N + 1)
    X, transposed = rows @ inverse, inverse.swapaxes(1, 2)
    # `parts` holds the transpose of S C^-1 for each matrix S in `whole`, with real and imaginary part on axis 2
    parts = np.stack([transposed.real, transposed.imag], axis=2).reshape(G, 2 * N, N)
    parts = (parts @ np.ascontiguousarray(whole.transpose(1, 2, 3, 0)).reshape(G, N, N * V)).reshape(G, N, 2, N, V)
    # A parameter of a wave changes C by u h^H + h u^H, with u the derivative of h.
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


# K, its derivatives with respect to coordinates, and those with respect to the spectrum, which may be empty arrays
Kernel = tuple[np.ndarray, np.ndarray, np.ndarray]


def anisotropic_kernel(x: Reals, k: Reals, spectrum: Reals, bandwidth: float, slope: bool = True) -> Kernel:
    """Return K (F, N, N), its derivatives with respect to x_i - x_j (3, F, N, N) and to the spectrum (7, F, N, N).

    x : (N, 3), metres; k : (F,), rad/m; bandwidth : B, rad/m; spectrum : (7,), a_l, r, g. The derivatives are empty
    without `slope`.
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
    """Return K (F, P) of pairs with the difference d (P, 3), metres, and its derivatives (F, P, 3) and (7, F, P).

    The derivatives are those with respect to d and to the spectrum parameters; they are empty without `slope`.
    """
    k, shape = np.concatenate([k - bandwidth, k + bandwidth]), (2, len(k), len(d))
    *a, ring, elevation = spectrum
    r = np.linalg.norm(d, axis=1) + 1e-9
    u, Y = d / r[:, None], _quadratic(d / r[:, None])
    z = np.maximum(k[:, None] * r, 1e-4)
    isotropic, over = sinc(z)
    second = -3 * over - isotropic  # j_2, because j_0' = z over and j_2 = -3 j_0' / z - j_0
    across = np.linalg.norm(d[:, :2], axis=1) + 1e-9
    flat, up = np.cos(elevation), np.sin(elevation)
    horizontal, vertical = k[:, None] * across * flat, k[:, None] * d[:, 2] * up
    bessel, wave = j0(horizontal), np.cos(vertical)
    values = (1 - ring) * isotropic + second * np.dot(a, Y) + ring * bessel * wave
    if not slope:
        return values.reshape(shape).mean(axis=0), np.zeros(0), np.zeros(0)
    # derivatives of bessel * wave with respect to `horizontal` and `vertical`
    outward, upward = -j1(horizontal) * wave, -bessel * np.sin(vertical)
    radial = (1 - ring) * z * over - np.dot(a, Y) * (z * over + 3 * second / z)  # j_2' = -j_0' - 3 j_2 / z
    slopes = k[:, None, None] * (radial[..., None] * u)
    tensor = np.tensordot(a, QUADRATIC, 1)
    slopes += second[..., None] * (2 * (u @ tensor - np.dot(a, Y)[:, None] * u) / r[:, None])
    slopes[..., :2] += ring * k[:, None, None] * flat * outward[..., None] * (d[:, :2] / across[:, None])
    slopes[..., 2] += ring * k[:, None] * up * upward
    tilted = ring * k[:, None] * (upward * d[:, 2] * flat - outward * across * up)
    shapes = np.array([*(second * y for y in Y), bessel * wave - isotropic, tilted]).reshape(-1, *shape)
    return values.reshape(shape).mean(axis=0), slopes.reshape(*shape, 3).mean(axis=0), shapes.mean(axis=1)


def _nodes(k: Reals, count: int) -> np.ndarray:
    """Return the weights (F, count) of linear interpolation between nodes evenly spaced over ascending k (F,)."""
    along = (k - k[0]) / max(float(k[-1] - k[0]), 1e-9)
    return np.maximum(0.0, 1 - np.abs(along[:, None] - np.linspace(0, 1, count)) * (count - 1))


def _delays(field: ShortField) -> list[np.ndarray]:
    """Return t (T, W, N), metres, its derivatives (3, T, W, N) with respect to the coordinates, and three more arrays.

    These three, (T, W, N) each, are the derivatives with respect to the direction of the wave, along two tangents, and
    to its curvature.
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

    The priors are Gaussian. In addition a penalty prevents negative values of r, and of the power of the sound from any
    direction u, which is 1 - r - sum_l a_l Y_l(u) relative to the mean.
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
    """Return unit vectors (count, 3) on a spiral that are evenly distributed over the sphere."""
    turn = np.arange(count)
    height = 1 - 2 * (turn + 0.5) / count
    angle, flat = turn * np.pi * (3 - np.sqrt(5.0)), np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)


def _observed(likelihood: ShortLikelihood, field: ShortField) -> tuple[Complexes, Complexes, Complexes, Reals]:
    """Return the waves (G, 2 W, N), C^-1 and the result of `scatter` (G, N, N), and the number of windows (G,)."""
    each, of_group = np.unique(likelihood.wavenumbers, return_inverse=True)
    K = anisotropic_kernel(field.positions, each, field.spectrum, likelihood.bandwidth, False)[0]
    noise = np.exp(_nodes(each, NOISE_NODES) @ field.noise)
    h = likelihood.waves(field, _nodes(each, POWER_NODES)[of_group])[0]
    C = _covariance(K[of_group], noise[of_group], h)
    q = likelihood.powers(np.linalg.cholesky(C), field)
    return h, np.linalg.inv(C), likelihood.scatter(q, field), np.sum(q > 0, axis=1) / likelihood.dispersion


def with_wave(likelihood: ShortLikelihood, field: ShortField) -> ShortField:
    """Return the field with one more wave in each take, the most likely of DIRECTIONS directions and five powers.

    With s = h^H C^-1 h, a new wave sqrt(b) h changes log det C by log(1 + b s) and p^H C^-1 p by -b |h^H C^-1 p|^2 /
    (1 + b s). The bandwidth is neglected here; the optimisation that follows takes it into account.
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


def other_places(likelihood: ShortLikelihood, field: ShortField, axes: Integers, apart: float) -> tuple[Reals, Reals]:
    """Return the most likely other place of each microphone (N, 3), metres, and by how much the cost is higher there.

    The places are minima of the cost on a lattice, more than `apart`, metres, away from the present place; all other
    microphones stay where they are. The differences of the costs are (N,), nats; infinite without such a minimum.
    axes : (D,), the free coordinates
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

    The cost follows from the prediction of its pressure by the other microphones, and is defined up to a constant for
    each microphone. `error`, metres, is the standard deviation of each coordinate of the places, which adds to the
    variance of the prediction. The powers of the windows are those at the present positions.
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
            # X holds the weights of all microphones in the prediction. Without microphone n they are X - X_n R_n, with
            # R_n row n of R.
            X, own = across @ inverse, np.real(np.diag(inverse))
            R, T, squared = inverse / own[:, None], X @ S, np.abs(X) ** 2
            alone = (1 + np.sum(np.abs(there) ** 2, axis=0)) * (1 + (k * error) ** 2) + noise[f]
            variance = (alone - np.sum(X * across.conj(), axis=1).real)[:, None] + squared / own
            squares = np.sum(T * X.conj(), axis=1).real[:, None] + squared * np.sum((R @ S) * R.conj(), axis=1).real
            squares += np.real(np.diag(S)) - 2 * (X.conj() * (T @ R.conj().T) + T - X * np.diag(R @ S)).real
            costs += windows[g] * np.log(variance) + squares / variance
    return costs.T
