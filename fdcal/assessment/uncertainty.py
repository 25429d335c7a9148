"""The uncertainty of each position: covariances and error ellipses.

    H      Gauss-Newton matrix of the cost, which is -log of the probability density. Its inverse over the observable
           moves is the covariance of the positions.
    g_m    gradient of mode m alone; the sum over the modes is zero at the solution
    J      sum of g_m g_m^T: how far the modes disagree. J = H where the sound field is as diffuse as assumed; a room's
           standing waves are not, and the sandwich estimate H^-1 J H^-1 (Huber 1967, White 1982) is then several
           times H^-1.

The errors of neighbouring modes are correlated, because they share what the prior does not know of the room. So J is
also computed from groups of neighbours, sum over the groups of (sum g_m) (sum g_m)^T, as Newey and West (1987) do with
neighbours in time; the larger of the two counts.

`robust_covariance` takes, microphone by microphone, H^-1 enlarged to the size of H^-1 J H^-1 where that is larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.likelihood import DiffuseField, diffuse_field, mode_gradients, newton_terms
from ..cost.noise_model import NOISE, estimate_noise_share
from ..model.gauge import rigid_motions
from ..model.power import mode_power
from ..model.problem import Problem

ZERO = 1e-9  # of the largest singular value: what is below counts as zero
LEAST_CURVATURE = 1e-12  # of the largest eigenvalue of H: directions with less are as good as free
GROUP_SIZE = 8  # neighbouring modes in a group
LEAST_GROUPS = 6  # with fewer, the groups are made smaller


@dataclass(frozen=True)
class Information:
    """Second-order information on the positions of N microphones in D dimensions at a minimum of the cost.

    Attributes
    ----------
    basis : (N D, F) float64, orthonormal moves that the pressures or the known microphones determine
    inverse : (F, F) float64, metres^2, inverse of H in that basis
    curvature : (N D, N D) float64, 1/m^2, H
    gradients : (M, N D) float64, 1/m, gradient of each mode
    shape : (N, D)
    """

    basis: np.ndarray
    inverse: np.ndarray
    curvature: np.ndarray
    gradients: np.ndarray
    shape: tuple[int, int]

    @property
    def influences(self) -> tuple[np.ndarray, np.ndarray]:
        """Influence of each mode, and of each group of neighbours, on the positions : (G, N D) float64, metres."""
        modes = small_sample_corrected(self.gradients)
        groups = small_sample_corrected(grouped_gradients(self.gradients))
        return self._moves(modes), self._moves(groups)

    def _moves(self, gradients: np.ndarray) -> np.ndarray:
        return -gradients @ self.basis @ self.inverse @ self.basis.T


def grouped_gradients(gradients: np.ndarray) -> np.ndarray:
    """Return the sums of the gradients of neighbouring modes.

    Parameters
    ----------
    gradients : (M, F) float64

    Returns
    -------
    (G, F) float64
    """
    count = max(1, len(gradients) // max(1, min(GROUP_SIZE, len(gradients) // LEAST_GROUPS)))
    return np.array([part.sum(axis=0) for part in np.array_split(gradients, count)])


def small_sample_corrected(gradients: np.ndarray) -> np.ndarray:
    """Return gradients scaled by sqrt(G / (G - 1)).

    Their mean is zero at the solution by construction, which takes a share 1 / G off their squares.

    Parameters
    ----------
    gradients : (G, F) float64
    """
    return gradients * np.sqrt(len(gradients) / max(len(gradients) - 1, 1))


def observable_moves(positions, known) -> np.ndarray:
    """Return the moves of the free microphones, without the rigid motions that leave all known ones in place.

    Parameters
    ----------
    positions : (N, D) float64, metres
    known : (A,) int, numbers of the known microphones

    Returns
    -------
    (N D, F) float64, orthonormal columns
    """
    N, D = positions.shape
    free = np.isin(np.arange(N), known, invert=True).repeat(D)
    rigid = rigid_motions(positions)
    if len(known):
        _, values, turned = np.linalg.svd(rigid[~free])
        rigid = rigid @ turned[int(np.sum(values > ZERO * np.abs(rigid).max())) :].T
    inside = rigid[free]
    rest = np.linalg.svd(inside, full_matrices=True)[0][:, rigid.shape[1] :] if rigid.size else np.eye(int(free.sum()))
    basis = np.zeros((N * D, rest.shape[1]))
    basis[free] = rest
    return basis


def pressures_and_field(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None
) -> tuple[np.ndarray, DiffuseField]:
    """Return the pressures of the modes in use and the model of their field and noise.

    Parameters
    ----------
    positions : (N, D) float64, metres
    noise : (M,) float64, of all measured modes, in the unit of abs(problem.pressures)**2, raised to the share that the
        real kernel leaves of a decaying field; None to estimate it

    Returns
    -------
    pressures : (modes, N) complex128
    field : DiffuseField
    """
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    power = mode_power(p)
    if noise is None:
        v = estimate_noise_share(positions, p, k, problem.dimension) * power
    else:
        v = np.maximum(np.asarray(noise)[modes], NOISE.diffuse_floor * power)
    return p, diffuse_field(p, np.real(k), v, problem.dimension)


def bounded_inverse(curvature: np.ndarray) -> np.ndarray:
    """Return the inverse of a curvature whose eigenvalues are raised to LEAST_CURVATURE of the largest.

    Parameters
    ----------
    curvature : (F, F) float64, symmetric, 1/m^2

    Returns
    -------
    (F, F) float64, metres^2
    """
    values, vectors = np.linalg.eigh(curvature)
    return (vectors / np.maximum(values, LEAST_CURVATURE * values[-1])) @ vectors.T


def information(positions, pressures, field: DiffuseField, known) -> Information:
    """Return the information of the modes on positions where the cost is least.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures, field : as of `pressures_and_field`
    known : (A,) int, numbers of the known microphones
    """
    basis = observable_moves(positions, known)
    size = positions.size
    H = newton_terms(positions, pressures, field)[2].reshape(size, size)
    gradients = mode_gradients(positions, pressures, field).reshape(len(pressures), size)
    return Information(basis, bounded_inverse(basis.T @ H @ basis), H, gradients, positions.shape)


def model_covariance(found: Information) -> np.ndarray:
    """Return the covariance of each position for a field that is as diffuse as assumed.

    Returns
    -------
    (N, D, D) float64, metres^2
    """
    N, D = found.shape
    left, right = (found.basis @ found.inverse).reshape(N, D, -1), found.basis.reshape(N, D, -1)
    return np.einsum("naf,nbf->nab", left, right)


def robust_covariance(found: Information) -> np.ndarray:
    """Return the covariance of each position, enlarged where the modes disagree.

    Returns
    -------
    (N, D, D) float64, metres^2
    """
    blocks = model_covariance(found)
    variance = np.max([np.sum(v.reshape(-1, *found.shape) ** 2, axis=(0, 2)) for v in found.influences], axis=0)
    size = np.trace(blocks, axis1=1, axis2=2)
    factor = np.maximum(1.0, variance / np.maximum(size, np.finfo(float).tiny))
    return factor[:, None, None] * blocks


def scale_sigma(found: Information, positions) -> float:
    """Return one sigma of the array's size, relative: the uncertainty along `positions` about their centre.

    Parameters
    ----------
    positions : (N, D) float64, metres
    """
    centred = (positions - positions.mean(axis=0)).ravel()
    along = found.basis.T @ centred / np.sum(centred**2)
    variances = [float(np.sum((v @ found.basis @ along) ** 2)) for v in found.influences]
    return float(np.sqrt(max(along @ found.inverse @ along, *variances)))


def step_along(found: Information, moves) -> tuple[np.ndarray, np.ndarray]:
    """Return the Newton step along moves that the solver held fixed, such as those of a known microphone.

    Parameters
    ----------
    moves : (N D, Q) float64

    Returns
    -------
    step : (Q,) float64, multiples of the moves
    covariance : (Q, Q) float64, of the step, enlarged where the modes disagree
    """
    H, B = found.curvature, found.basis
    along = moves - B @ (found.inverse @ (B.T @ H @ moves))  # the free microphones follow
    inverse = np.linalg.pinv(along.T @ H @ along)
    influences = [-g @ along @ inverse for g in (found.gradients, grouped_gradients(found.gradients))]
    # Here the influences sum to the step, not to zero: their scatter is about their mean.
    scatter = max(float(np.sum(small_sample_corrected(v - v.mean(axis=0)) ** 2)) for v in influences)
    factor = max(1.0, scatter / max(np.trace(inverse), np.finfo(float).tiny))
    return influences[0].sum(axis=0), factor * inverse
