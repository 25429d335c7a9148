"""The Cramer-Rao bound of the positions: how exact an array can be calibrated, before anything is measured.

    P = (B^T (F + prior) B)^-1      F of `fisher_information`, B the directions that anything determines

The prior holds what is given beside the pressures: positions of some microphones with their uncertainty, the spread of
the gains, the uncertainty of the sound speed. Without given positions the rigid motions are left out of B, and the
bound is of the array after the best rigid alignment.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..model.gauge import fixes_gauge, rigid_motions
from .fisher_information import Information

EXACT = 1e-7  # metres, one sigma of a position that is given exactly
LEAST_EIGENVALUE = 1e-13  # of the scaled information: directions with less are as good as undetermined


@dataclass(frozen=True)
class Prior:
    """What is known beside the pressures.

    Attributes
    ----------
    known : (A,) int, microphones whose positions are given
    known_sigma : float, metres, one sigma of each of their coordinates; 0 for exact ones
    gain_sigma : float, nepers, spread of the channels' gains; 0 for equal channels
    sound_speed_sigma : float, relative
    """

    known: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    known_sigma: float = 0.0
    gain_sigma: float = 0.0
    sound_speed_sigma: float = 0.0


@dataclass(frozen=True)
class Bound:
    """The least covariance of the positions.

    Attributes
    ----------
    covariance : (N, D, D) float64, metres^2
    free : (N,) bool, microphones that are sought
    deformations : (D (D + 1) / 2,) float64
        One sigma of stretches and shears of the array as a whole, relative, ascending.
    shapes : (D (D + 1) / 2, D, D) float64, the symmetric maps to which they belong, of unit norm
    scale_sigma : float, one sigma of the size of the array, relative
    """

    covariance: np.ndarray
    free: np.ndarray
    deformations: np.ndarray
    shapes: np.ndarray
    scale_sigma: float

    @property
    def sigma(self) -> np.ndarray:
        """One sigma of the distance of each microphone from its place : (N,) float64, metres."""
        return np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))

    @property
    def rms(self) -> float:
        """Root mean square of `sigma` over the microphones that are sought, metres."""
        return float(np.sqrt(np.mean(self.sigma[self.free] ** 2)))


def position_bound(information: Information, prior: Prior) -> Bound:
    """Return the Cramer-Rao bound of the positions.

    Parameters
    ----------
    information : Information
    prior : Prior
    """
    P = _covariance(information, prior)
    N, D = information.shape
    free = np.ones(N, bool)
    free[prior.known] = False
    blocks = np.einsum("nanb->nab", P.reshape(N, D, N, D))
    sigmas, shapes, scale = _deformations(information.positions, P)
    return Bound(blocks, free, sigmas, shapes, scale)


def aligned_rms(information: Information, prior: Prior) -> float:
    """Return the bound of the shape: of all microphones after the best rigid motion, root mean square, metres.

    Parameters
    ----------
    information : Information
    prior : Prior
        Its given positions count by what they say on the shape.
    """
    P, R = _covariance(information, prior), rigid_motions(information.positions)
    Q = np.eye(len(P)) - R @ np.linalg.pinv(R)
    return float(np.sqrt(np.trace(Q @ P @ Q) / len(information.positions)))


def _covariance(information: Information, prior: Prior) -> np.ndarray:
    """Return the covariance of all coordinates : (N D, N D), metres^2."""
    x = information.positions
    N, D = information.shape
    F = np.array(information.matrix)
    coordinates = (D * np.asarray(prior.known, int)[:, None] + np.arange(D)).ravel()
    F[coordinates, coordinates] += 1 / max(prior.known_sigma, EXACT) ** 2
    used = np.arange(N * D)
    if prior.gain_sigma > 0:
        gains = np.arange(N * D, N * D + N)
        F[gains, gains] += 1 / prior.gain_sigma**2
        used = np.append(used, gains)
    if prior.sound_speed_sigma > 0:
        F[-1, -1] += 1 / prior.sound_speed_sigma**2
        used = np.append(used, len(F) - 1)
    basis = np.eye(len(used))
    lost = _undetermined(x, np.asarray(prior.known, int))
    if lost.shape[1]:
        outside = np.linalg.svd(lost, full_matrices=True)[0][:, lost.shape[1] :]
        rest = np.eye(len(used))[:, N * D :]
        basis = np.column_stack([np.vstack([outside, np.zeros((len(used) - N * D, outside.shape[1]))]), rest])
    inverse = basis @ _bounded_inverse(basis.T @ F[np.ix_(used, used)] @ basis) @ basis.T
    return inverse[: N * D, : N * D]


def _undetermined(x, known) -> np.ndarray:
    """Return the rigid motions that leave the known microphones where they are : (N D, R) float64."""
    R = rigid_motions(x)
    if not len(known):
        return R
    rows = (x.shape[1] * known[:, None] + np.arange(x.shape[1])).ravel()
    _, values, turned = np.linalg.svd(R[rows], full_matrices=True)
    kept = np.append(values, np.zeros(R.shape[1] - len(values))) < 1e-9 * np.abs(R).max()
    return R @ turned[kept].T


def _bounded_inverse(F) -> np.ndarray:
    scale = 1 / np.sqrt(np.diag(F))
    values, vectors = np.linalg.eigh(scale[:, None] * F * scale)
    values = np.maximum(values, LEAST_EIGENVALUE * values[-1])
    return scale[:, None] * ((vectors / values) @ vectors.T) * scale


def _deformations(x, P) -> tuple[np.ndarray, np.ndarray, float]:
    """Return sigmas and maps of the linear deformations x -> x + B x, and one sigma of the size."""
    N, D = x.shape
    centred = x - x.mean(axis=0)
    fit = np.kron(np.linalg.pinv(np.column_stack([centred, np.ones(N)]))[:D].T, np.eye(D))  # (N D, D D), of B^T
    maps = np.array([_symmetric(a, b, D) for a in range(D) for b in range(a, D)])
    along = maps.reshape(len(maps), -1) @ fit.T
    values, vectors = np.linalg.eigh(along @ P @ along.T)
    size = centred.ravel() / np.sum(centred**2)
    shapes = np.einsum("sm,sab->mab", vectors, maps)
    return np.sqrt(np.maximum(values, 0.0)), shapes, float(np.sqrt(size @ P @ size))


def _symmetric(a: int, b: int, D: int) -> np.ndarray:
    S = np.zeros((D, D))
    S[a, b] = S[b, a] = 1.0 if a == b else np.sqrt(0.5)
    return S


def with_known(prior: Prior, known, sigma: float) -> Prior:
    """Return `prior` with other given positions."""
    return replace(prior, known=np.asarray(known, int), known_sigma=sigma)


def mirror_remains(positions, known) -> bool:
    """Return whether the mirror image of an array fits the given positions equally well."""
    return not (len(known) and fixes_gauge(np.asarray(positions, float)[np.asarray(known, int)]))
