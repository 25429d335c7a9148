"""The uncertainty of each position after a run, and its lower bound before a measurement.

After a run it follows from what the solver reports at its minimum (`PositionSpread`):

    P   inverse of the Gauss-Newton matrix of cost and priors: the covariance if the field is as assumed
    Q   P H P, the part of P that is due to errors of the data, where H is the data's part of the Gauss-Newton matrix
    r   dispersion: the trace of the covariance that the differences between blocks of frequencies and takes imply,
        divided by the trace of Q
    C   P + max(0, 3 (r - 1) / 4) Q + d d^T,   d the Newton step that remains at the end of the run

P assumes the estimated noise and field, and the priors of gains, given positions and sound speed. A field of few waves
is less random than this model, so that the blocks differ more than P predicts; r measures by how much. Since r is
estimated from about ten blocks only, three quarters of its excess over 1 are used, and r < 1 does not reduce the
covariance. The part of P that is due to the priors is not enlarged.

One sigma of a position is the root of the trace of C, which is the RMS distance from the true position. One sigma of a
coordinate is the root of an element of the diagonal of C.

C describes one minimum. The spread of the search describes the distances between the optima of several restarts:

    w_e = exp(-score_e) / sum_f exp(-score_f),   spread of microphone n = sqrt(sum_e w_e |d_en|^2)

score_e is the negative log evidence of optimum e, nats; d_en is the distance between the positions of microphone n in
optimum e and in the likeliest one.

Before a measurement the Cramer-Rao bound is the least possible uncertainty. It follows from the Fisher information that
a diffuse field holds on positions, channel gains and the sound speed. In mode m the field has the power s_m, the noise
v_m and the wavenumber k_m; r_ij is the distance of two microphones, a_n + j b_n the log gain of a channel, x_ia the
coordinate a of microphone i, and o the product element by element. From here on C is the covariance of the
pressures in one mode and not that of a position; the index m is omitted where all modes have the same formula:

    C_m      = G [s_m kappa(k_m r_ij) + v_m I] G^H,   G = diag exp(a_n + j b_n)
    F_tu     = sum_m tr(C^-1 dC/dt C^-1 dC/du)         complex Gaussian pressures (Slepian 1954, Bangs 1971)
    K        = s kappa, the covariance of the field;   D_a[i, j] = dK_ij / dx_ia

    positions   F_(n a)(p b) = 2 [C^-1_np (D_a C^-1 D_b^T)_np + (C^-1 D_b^T)_np (C^-1 D_a^T)_pn]
    gains       F_np = 2 [C_np C^-1_np + delta_np]
    mixed       F_(n a) p = 2 [(C^-1 o D_a)_np + delta_np sum_j C^-1_nj D_a,nj], of position n and gain p
    phases      omitted, because they are independent of positions and gains in a diffuse field
    log c       K depends on k r only, so that dK / dlog c = -sum_ia x_ia dK/dx_ia
    power s_m   unknown in every mode; eliminated by its Schur complement

C depends on distances only, so that F holds no information on rigid motions and mirror images.

    P = (B^T (F + prior) B)^-1      B a basis of the directions that information or prior determine

The prior holds what is known in addition to the pressures: given positions and their uncertainty, the standard
deviation of the gains, and the uncertainty of the sound speed. Without given positions B excludes the rigid motions,
and the bound is that of the array after the best rigid alignment.

P. Stoica, R. Moses, "Spectral Analysis of Signals", 2005: the Slepian-Bangs formula.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import block_diag
from scipy.special import chdtri

from ..cost.kernels import diffuse_kernel
from ..model.gauge import align, rigid_motions

if TYPE_CHECKING:  # a plan needs no solver
    from ..solvers.interface import Estimate

EXACT = 1e-7  # metres, one sigma of a position that is given exactly
MIN_EIGENVALUE = 1e-13  # eigenvalues of the scaled information are raised to at least this fraction of the largest one
BLOCK = 100_000  # numbers in the largest array of a block of modes


@dataclass(frozen=True)
class Information:
    """The Fisher information of all modes on N microphones in D dimensions."""

    positions: np.ndarray  # (N, D) float64, metres, at which it was computed
    # (N D + N + 1, N D + N + 1) float64, on coordinates (1/m), log gains (1/neper) and the logarithm of the sound
    # speed, in this order
    matrix: np.ndarray

    def scaled(self, factor: float) -> Information:
        """Return the information of `factor` times as many modes of the same kind."""
        return Information(self.positions, factor * self.matrix)


@dataclass(frozen=True)
class Prior:
    """What is known in addition to the pressures."""

    # (A,) int, microphones whose positions are given
    known: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    known_sigma: float = 0.0  # metres, one sigma of each of their coordinates; 0 for exact ones
    gain_sigma: float = 0.0  # nepers, standard deviation of the channels' gains; 0 for equal channels
    sound_speed_sigma: float = 0.0  # one sigma of the sound speed, relative


@dataclass(frozen=True)
class Bound:
    """The least covariance of the positions."""

    covariance: np.ndarray  # (N, D, D) float64, metres^2
    free: np.ndarray  # (N,) bool, microphones that are sought
    scale_sigma: float  # one sigma of the size of the array, relative
    # degrees of freedom of a chi-square that approximates the sum of the squared errors (Satterthwaite), whose relative
    # standard deviation is sqrt(2 / freedom)
    freedom: float

    @property
    def sigma(self) -> np.ndarray:
        """One sigma of each position, the root of the trace of its covariance : (N,) float64, metres."""
        return one_sigma(self.covariance)

    @property
    def rms(self) -> float:
        """Root mean square of `sigma` over the microphones that are sought, metres."""
        return root_mean_square(self.sigma[self.free])


def diffuse_information(positions, wavenumbers, noise_fraction: float, dimension: int) -> Information:
    """Return the Fisher information of a diffuse field on positions (N, D), metres.

    `wavenumbers` (M,) are real, rad/m; `noise_fraction` is v / (s + v), noise in the power of the pressures,
    above 0 and below 1; `dimension` is that of the sound field: 3 for a plane array in space, too.
    """
    x = np.asarray(positions, float)
    N, D = x.shape
    apart, k = x[:, None] - x[None], np.asarray(wavenumbers, float)
    distance = np.linalg.norm(apart, axis=-1).ravel()
    total = 0.0
    for some in np.array_split(k, min(len(k), 1 + len(k) * (N * D) ** 2 // BLOCK)):
        kappa, over = diffuse_kernel(distance, some, dimension)
        slopes = np.asarray(over).reshape(-1, 1, N, N) * np.moveaxis(apart, -1, 0)
        # Information on positions and gains; the power of each mode is unknown. `slopes` are d kappa_ij / dx_ia, 1/m.
        M, one = len(some), np.eye(N)
        K, S = (1 - noise_fraction) * kappa.reshape(-1, N, N), (1 - noise_fraction) * slopes
        C = K + noise_fraction * one
        Ci = np.linalg.inv(C)
        CS = Ci[:, None] @ S.swapaxes(2, 3)
        places = Ci[:, None, None] * (S[:, :, None] @ CS[:, None]) + CS[:, None] * CS.swapaxes(2, 3)[:, :, None]
        places = places.sum(axis=0).transpose(2, 0, 3, 1)
        mixed = np.sum(Ci[:, None] * S, axis=0) + np.einsum("mnj,manj->an", Ci, S)[:, None] * one
        mixed = mixed.transpose(1, 0, 2).reshape(N * D, N)
        F = 2 * np.block([[places.reshape(N * D, N * D), mixed], [mixed.T, np.sum(C * Ci, axis=0) + M * one]])
        # The Schur complement of the power of the field, dC/ds = K / s.
        inner = Ci @ K @ Ci
        cross = [np.einsum("manj,mnj->mna", S, inner).reshape(M, -1), np.einsum("mnj,mnj->mn", Ci, K)]
        cross = 2 * np.concatenate(cross, axis=1)
        total = total + (F - (cross / np.sum(inner * K, axis=(1, 2))[:, None]).T @ cross)
    F = np.asarray(total)
    T = np.vstack([np.eye(len(F)), np.append(-x.ravel(), np.zeros(len(x)))])
    return Information(x, T @ (F + F.T) @ T.T / 2)


def position_bound(information: Information, prior: Prior) -> Bound:
    """Return the Cramer-Rao bound of the positions."""
    x = information.positions
    N, D = x.shape
    given = (D * np.asarray(prior.known, int)[:, None] + np.arange(D)).ravel()
    sigma = np.concatenate([np.full(N * D, np.inf), np.full(N, prior.gain_sigma), [prior.sound_speed_sigma]])
    sigma[given] = max(prior.known_sigma, EXACT)
    used = sigma > 0  # gains and sound speed are not unknown if their sigma is 0
    F = information.matrix[np.ix_(used, used)] + np.diag(sigma[used] ** -2.0)
    # The rigid motions that leave the given microphones where they are remain undetermined.
    R = rigid_motions(x)
    _, values, directions = np.linalg.svd(R[given], full_matrices=True)
    lost = R @ directions[np.append(values, np.zeros(len(directions) - len(values))) < 1e-9 * np.abs(R).max()].T
    outside = np.linalg.qr(lost, mode="complete")[0][:, lost.shape[1] :]
    B = np.asarray(block_diag(outside, np.eye(len(F) - N * D)))
    F = B.T @ F @ B
    scale = 1 / np.sqrt(np.diag(F))
    values, vectors = np.linalg.eigh(scale[:, None] * F * scale)
    vectors = B @ (scale[:, None] * vectors / np.sqrt(np.maximum(values, MIN_EIGENVALUE * values[-1])))
    P = vectors[: N * D] @ vectors[: N * D].T
    free = np.ones(N, bool)
    free[prior.known] = False
    blocks = np.einsum("nanb->nab", P.reshape(N, D, N, D))
    centred = x - x.mean(axis=0)
    size = centred.ravel() / np.sum(centred**2)
    sought = np.repeat(free, D)
    of_sought = P[np.ix_(sought, sought)]
    freedom = float(np.trace(of_sought) ** 2 / np.sum(of_sought**2))
    return Bound(blocks, free, float(np.sqrt(size @ P @ size)), freedom)


def covariance_of(estimate: Estimate, by_model: bool = False) -> np.ndarray:
    """Return the covariance of each position (N, D, D), metres^2: C of the module docstring, or P if `by_model`."""
    (N, D), spread = estimate.positions.shape, estimate.spread
    blocks = np.einsum("nanb->nab", (spread.newton if by_model else spread.covariance).reshape(N, D, N, D))
    return blocks if by_model else blocks + spread.step[:, :, None] * spread.step[:, None, :]


# If short windows determine the array, its extent along every axis counts as at least this fraction of the longest one,
# because a flat array has no height that a stretching could change. Without short windows, this rule would give the
# verdict "good" in 1 of 60 cases to a wrong array: a line in a plane, with an error of 2.4 times the claimed sigma.
LEAST_EXTENT = 0.5


def scale_sigma_of(estimate: Estimate, healthy: np.ndarray) -> float:
    """Return one sigma of the least certain stretching or shearing of the array as a whole, relative.

    These are maps x -> x + B x with symmetric B, fitted to moves of the `healthy` (N,) bool microphones.
    """
    positions, covariance = estimate.positions, estimate.spread.covariance
    D, index = positions.shape[1], np.flatnonzero(np.repeat(healthy, positions.shape[1]))
    x = positions[healthy] - positions[healthy].mean(axis=0)
    along, extents, axes = np.linalg.svd(x, full_matrices=False)
    least = (LEAST_EXTENT if estimate.window_ratio else 1e-9) * extents[0]
    inverse = (along / np.maximum(extents, least)).T  # inverse of x in its own axes
    fit = np.kron(inverse, axes)  # (D D, N D)
    fit = np.array([(B + B.T).ravel() / 2 for B in np.eye(D * D).reshape(-1, D, D)]) @ fit
    return float(np.sqrt(np.linalg.eigvalsh(fit @ covariance[np.ix_(index, index)] @ fit.T)[-1]))


def search_spread_of(estimate: Estimate, healthy: np.ndarray) -> np.ndarray:
    """Return the spread of the search, as defined in this module : (N,) float64, metres.

    Arrays without a common frame are first aligned by their `healthy` (N,) microphones.
    """
    tried = estimate.tried
    if not tried:
        return np.zeros(len(estimate.positions))
    weights = np.exp(-np.array([one.score - tried[0].score for one in tried]))
    best, away = tried[0].positions, []
    for one in tried:
        placed = one.positions if one.same_frame else align(one.positions, best, healthy)
        away.append(np.linalg.norm(placed - best, axis=1))
    return np.sqrt(weights @ np.array(away) ** 2 / weights.sum())


def root_mean_square(values: np.ndarray) -> float:
    """Return the root mean square of some values; 0 if there are none."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def one_sigma(blocks: np.ndarray) -> np.ndarray:
    """Return the root of the trace of each covariance (N, D, D), metres^2 : (N,) float64, metres."""
    return np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))


def confidence_factor(probability: float, dimension: int) -> float:
    """Return the half axes, in standard deviations, of the ellipse that holds a given probability in D dimensions.

    The squared Mahalanobis distance of a Gaussian has a chi-square distribution with D degrees of freedom.
    """
    return float(np.sqrt(chdtri(dimension, 1 - probability)))


def ellipse_axes(blocks: np.ndarray, factor: float = 1.0) -> np.ndarray:
    """Return the half axes (N, D, D), metres, in rows, shortest first, of ellipses of `factor` standard deviations."""
    values, vectors = np.linalg.eigh(blocks)
    return factor * np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)
