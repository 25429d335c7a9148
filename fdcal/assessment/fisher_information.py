"""Fisher information of a diffuse field on positions, channel gains and the sound speed, before anything is measured.

    C_m      = G [s_m kappa(k_m r_ij) + v_m I] G^H,   G = diag exp(a_n + j b_n)
    F_tu     = sum_m tr(C^-1 dC/dt C^-1 dC/du)         complex Gaussian pressures (Slepian 1954, Bangs 1971)
    S        = C^-1 K,   K = s kappa the covariance of the field, D_a[i, j] = dK_ij / dx_ia

    positions   F_(n a)(p b) = 2 [C^-1_np (D_a C^-1 D_b^T)_np + (C^-1 D_b^T)_np (C^-1 D_a^T)_pn]
    gains       F_np = 2 [C_np C^-1_np + delta_np];   with positions 2 [(C^-1 o D_a)_np + delta_np sum_j C^-1_nj D_a,nj]
    phases      independent of positions and gains in a diffuse field: they cost nothing
    log c       K depends on k r alone, so dK / dlog c = -sum_ia x_ia dK/dx_ia
    power s_m   unknown in every mode; eliminated by its Schur complement

Distances alone enter, so that the matrix has no information on rigid motions and mirror images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.channel_kernels import diffuse_kernel
from ..cost.channel_likelihood import ChannelField, channel_terms
from ..model.power import mode_power


@dataclass(frozen=True)
class Information:
    """Information of all modes on N microphones in D dimensions.

    Attributes
    ----------
    positions : (N, D) float64, metres, where it was computed
    matrix : (N D + N + 1, N D + N + 1) float64
        On coordinates (1/m), log gains (1/neper) and the logarithm of the sound speed, in this order.
    """

    positions: np.ndarray
    matrix: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """N and D."""
        N, D = self.positions.shape
        return N, D

    def scaled(self, factor: float) -> Information:
        """Return the information of `factor` times as many modes of the same kind."""
        return Information(self.positions, factor * self.matrix)


def diffuse_information(positions, wavenumbers, noise_share: float, dimension: int) -> Information:
    """Return the Fisher information of a diffuse field.

    Parameters
    ----------
    positions : (N, D) float64
        Metres.
    wavenumbers : (M,) float64
        k, rad/m.
    noise_share : float
        v / (s + v), power of the noise in that of the pressures, above 0 and below 1.
    dimension : int
        2 or 3, of the sound field; a plane array in space has D = 2 and 3 here.

    Returns
    -------
    Information

    References
    ----------
    P. Stoica, R. Moses, "Spectral Analysis of Signals", 2005, the Slepian-Bangs formula.
    """
    x = np.asarray(positions, float)
    N, D = x.shape
    apart = x[:, None] - x[None]
    pairs = np.tril_indices(N, -1)
    distance = np.linalg.norm(apart[pairs], axis=1)
    total = np.zeros((N * D + N + 1, N * D + N + 1))
    for k in np.asarray(wavenumbers, float):
        kappa, over = diffuse_kernel(distance, np.array([k]), dimension)
        total += _of_mode(
            x, apart, _square(kappa[0], pairs, N, 1.0), _square(np.asarray(over)[0], pairs, N, 0.0), noise_share
        )
    return Information(x, (total + total.T) / 2)


def field_information(positions, pressures, wavenumbers, noise_share: float, dimension: int) -> Information:
    """Return the information of one sound field, that of a room and a source, from its exact pressures.

    The Gauss-Newton matrix of the likelihood at the true positions, the phases of the channels eliminated.

    Parameters
    ----------
    positions : (N, D) float64
        Metres.
    pressures : (M, N) complex128
        Without noise.
    wavenumbers : (M,) complex128
        k, rad/m, with its decay.
    noise_share : float
        As of `diffuse_information`.
    dimension : int
        2 or 3, of the sound field.
    """
    x = np.asarray(positions, float)
    N, D = x.shape
    M = len(pressures)
    scaled = np.asarray(pressures) * np.sqrt((1 - noise_share) / mode_power(pressures))[:, None]
    field = ChannelField(
        np.asarray(wavenumbers, complex), np.full(M, 1 - noise_share), np.full(M, noise_share), np.ones(N), dimension
    )
    H = channel_terms(x, np.zeros((N, 2)), scaled, field).newton()[1]
    order = np.arange(N * (D + 2)).reshape(N, D + 2)
    kept, phases = np.concatenate([order[:, :D].ravel(), order[:, D]]), order[:, D + 1]
    flat = H.reshape(N * (D + 2), -1)
    cross = flat[np.ix_(kept, phases)]
    F = np.zeros((N * D + N + 1, N * D + N + 1))
    F[:-1, :-1] = flat[np.ix_(kept, kept)] - cross @ np.linalg.pinv(flat[np.ix_(phases, phases)]) @ cross.T
    _add_sound_speed(F, x, slice(N * D, N * D + N))
    return Information(x, (F + F.T) / 2)


def _square(values, pairs, count: int, diagonal: float) -> np.ndarray:
    full = np.full((count, count), 0.0)
    full[pairs] = values
    return full + full.T + diagonal * np.eye(count)


def _of_mode(x, apart, kappa, over, share: float) -> np.ndarray:
    """Return the information of one mode; `kappa` and `over`, (d kappa / dr) / r, are (N, N)."""
    N, D = x.shape
    s = 1 - share
    K = s * kappa
    C = K + share * np.eye(N)
    Ci = np.linalg.inv(C)
    slopes = s * np.moveaxis(over[..., None] * apart, -1, 0)  # D_a[i, j]
    CD = np.array([Ci @ S.T for S in slopes])  # C^-1 D_a^T
    F = np.zeros((N * D + N + 1, N * D + N + 1))
    places = F[: N * D, : N * D].reshape(N, D, N, D)
    for a in range(D):
        for b in range(D):
            places[:, a, :, b] = 2 * (Ci * (slopes[a] @ CD[b]) + CD[b] * CD[a].T)
    gains = slice(N * D, N * D + N)
    mixed = np.array([Ci * S + np.diag(np.einsum("nj,nj->n", Ci, S)) for S in slopes])  # (D, N, N)
    F[: N * D, gains] = 2 * mixed.transpose(1, 0, 2).reshape(N * D, N)
    F[gains, gains] = 2 * (C * Ci + np.eye(N))
    _add_sound_speed(F, x, gains)
    F[gains, : N * D] = F[: N * D, gains].T
    return _without_power(F, x, Ci, K, slopes, gains)


def _add_sound_speed(F, x, gains) -> None:
    """Fill the row and column of log c, along which the array shrinks: K depends on k r alone."""
    N, D = x.shape
    along = -x.ravel()
    F[: N * D, -1] = F[: N * D, : N * D] @ along
    F[gains, -1] = F[: N * D, gains].T @ along
    F[-1, : N * D], F[-1, gains] = F[: N * D, -1], F[gains, -1]
    F[-1, -1] = along @ F[: N * D, -1]


def _without_power(F, x, Ci, K, slopes, gains) -> np.ndarray:
    """Return the Schur complement of the power of the field, dC/ds = K / s: what the unknown power leaves."""
    N, D = x.shape
    inner = Ci @ K @ Ci
    own = float(np.sum(inner * K))
    cross = np.empty(len(F))
    cross[: N * D] = 2 * np.array([np.einsum("nj,nj->n", S, inner) for S in slopes]).T.ravel()
    cross[gains] = 2 * np.einsum("nj,nj->n", Ci, K)
    cross[-1] = -x.ravel() @ cross[: N * D]
    return F - np.outer(cross, cross) / own
