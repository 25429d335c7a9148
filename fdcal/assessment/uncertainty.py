"""How far each microphone may be from where it was found: error ellipses.

    H      Gauss-Newton matrix of the cost, which is -log of the probability density: the inverse of H over the
           directions that may move and that the pressures can see is the covariance of the positions
    g_m    gradient of mode m alone; the sum over the modes is zero at the solution
    J      sum of g_m g_m^T: how far the modes disagree. J = H where the sound field is as diffuse as is supposed; a
           room's standing waves are not, and H^-1 J H^-1 (Huber 1967, White 1982) is then several times H^-1

Neighbouring modes may err alike: they share what the prior does not know of the room. So J is also taken of groups of
neighbours as one, sum over the groups of (sum g_m) (sum g_m)^T, as Newey and West (1987) do with neighbours in time; of
the two the larger counts.

`covariance` takes, microphone by microphone, H^-1 enlarged to the size of H^-1 J H^-1 where that is larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cost.likelihood import DiffuseField, diffuse_field, mode_gradients, newton_terms
from ..cost.noise_model import NOISE, estimate_noise_share
from ..model.gauge import rigid_motions
from ..model.power import mode_power
from ..model.problem import Problem

SAME = 1e-9  # of the largest: a singular value this small is none
NEIGHBOURS, GROUPS = 8, 6  # modes in a group, and how many groups there must be for that
SINGULAR = 1e-12  # likewise of the curvature; a direction below it is as good as free


@dataclass(frozen=True)
class Information:
    """What is left uncertain of N microphones in D dimensions.

    Attributes
    ----------
    basis : (N D, F) float64, orthonormal moves that the pressures or the known microphones can tell
    newton : (F, F) float64, metres^2, inverse of H in that basis
    curvature : (N D, N D) float64, 1/m^2, H
    slopes : (M, N D) float64, 1/m, gradient of each mode
    shape : (N, D)
    """

    basis: np.ndarray
    newton: np.ndarray
    curvature: np.ndarray
    slopes: np.ndarray
    shape: tuple[int, int]

    @property
    def votes(self) -> tuple[np.ndarray, np.ndarray]:
        """How far each mode, and each group of neighbours, alone would move the array : (G, N D) float64, metres."""
        alone, together = (small_sample_corrected(votes) for votes in (self.slopes, grouped_gradients(self.slopes)))
        return tuple(-votes @ self.basis @ self.newton @ self.basis.T for votes in (alone, together))


def grouped_gradients(slopes: np.ndarray) -> np.ndarray:
    """Sums of the slopes (M, F) of neighbouring modes : (G, F)."""
    count = max(1, len(slopes) // max(1, min(NEIGHBOURS, len(slopes) // GROUPS)))
    return np.array([part.sum(axis=0) for part in np.array_split(slopes, count)])


def small_sample_corrected(votes: np.ndarray) -> np.ndarray:
    """Votes (G, F) whose mean is zero because they decided it, enlarged by what their squares lack for that."""
    return votes * np.sqrt(len(votes) / max(len(votes) - 1, 1))


def observable_moves(positions, known) -> np.ndarray:
    """Orthonormal moves of the free microphones, less the rigid motions that leave all known ones : (N D, F)."""
    N, D = positions.shape
    free = np.isin(np.arange(N), known, invert=True).repeat(D)
    rigid = rigid_motions(positions)
    if len(known):
        _, values, turned = np.linalg.svd(rigid[~free])
        rigid = rigid @ turned[int(np.sum(values > SAME * np.abs(rigid).max())) :].T
    inside = rigid[free]
    left = np.linalg.svd(inside, full_matrices=True)[0][:, rigid.shape[1] :] if rigid.size else np.eye(int(free.sum()))
    basis = np.zeros((N * D, left.shape[1]))
    basis[free] = left
    return basis


def pressures_and_field(
    problem: Problem, positions, modes: slice, noise: np.ndarray | None
) -> tuple[np.ndarray, DiffuseField]:
    """Pressures of the modes in use and what is supposed of field and noise; without noise told, it is estimated.

    noise : (M,) float64 of all measured modes, in the unit of abs(problem.pressures)**2, or None; no less than the
        real kernel leaves of a field that decays is taken
    """
    p, k = problem.pressures[modes], problem.wavenumbers[modes]
    power = mode_power(p)
    if noise is None:
        v = estimate_noise_share(positions, p, k, problem.dimension) * power
    else:
        v = np.maximum(np.asarray(noise)[modes], NOISE.diffuse_floor * power)
    return p, diffuse_field(p, np.real(k), v, problem.dimension)


def information(positions, pressures, field: DiffuseField, known) -> Information:
    """What the modes (see `field_of`) leave uncertain at `positions` (N, D), metres, where the cost is least."""
    basis = observable_moves(positions, known)
    size = positions.size
    H = newton_terms(positions, pressures, field)[2].reshape(size, size)
    values, vectors = np.linalg.eigh(basis.T @ H @ basis)
    newton = (vectors / np.maximum(values, SINGULAR * values[-1])) @ vectors.T
    each = mode_gradients(positions, pressures, field).reshape(len(pressures), size)
    return Information(basis, newton, H, each, positions.shape)


def model_covariance(found: Information) -> np.ndarray:
    """Covariance of each microphone in a field that is as diffuse as supposed : (N, D, D) float64, metres^2."""
    N, D = found.shape
    left, right = (found.basis @ found.newton).reshape(N, D, -1), found.basis.reshape(N, D, -1)
    return np.einsum("naf,nbf->nab", left, right)


def robust_covariance(found: Information) -> np.ndarray:
    """Covariance of each microphone, enlarged where the modes disagree : (N, D, D) float64, metres^2."""
    blocks = model_covariance(found)
    votes = np.max([np.sum(v.reshape(-1, *found.shape) ** 2, axis=(0, 2)) for v in found.votes], axis=0)
    size = np.trace(blocks, axis1=1, axis2=2)
    factor = np.maximum(1.0, votes / np.maximum(size, np.finfo(float).tiny))
    return factor[:, None, None] * blocks


def one_sigma(blocks: np.ndarray) -> np.ndarray:
    """Square root of the trace of each covariance (N, D, D) : (N,) float64, metres; 0 for a known microphone."""
    return np.sqrt(np.maximum(np.trace(blocks, axis1=1, axis2=2), 0.0))


def ellipse_axes(blocks: np.ndarray, sigmas: float = 1.0) -> np.ndarray:
    """Half axes of the error ellipses or ellipsoids of covariances (N, D, D) : (N, D, D) float64, metres.

    Row a of an entry is the vector of half axis a, shortest first; its length is `sigmas` standard deviations. The
    ellipse that covers a share q of a plane's Gaussian has sqrt(-2 log(1 - q)) sigmas: 2.45 for 95 %.
    """
    values, vectors = np.linalg.eigh(blocks)
    return sigmas * np.sqrt(np.maximum(values, 0.0))[:, :, None] * vectors.swapaxes(1, 2)


def scale_sigma(found: Information, positions) -> float:
    """One sigma of the array's size, relative : the uncertainty along `positions` about their centre."""
    centred = (positions - positions.mean(axis=0)).ravel()
    along = found.basis.T @ centred / np.sum(centred**2)
    votes = [float(np.sum((v @ found.basis @ along) ** 2)) for v in found.votes]
    return float(np.sqrt(max(along @ found.newton @ along, *votes)))


def step_along(found: Information, moves) -> tuple[np.ndarray, np.ndarray]:
    """Where the least cost would be if the array might move along `moves` (N D, Q), too: a Newton step.

    Returns
    -------
    (Q,) float64 multiples of the moves, and their covariance (Q, Q), enlarged where the modes disagree
    """
    H, B = found.curvature, found.basis
    along = moves - B @ (found.newton @ (B.T @ H @ moves))  # the free microphones follow
    inverse = np.linalg.pinv(along.T @ H @ along)
    groupings = [-slopes @ along @ inverse for slopes in (found.slopes, grouped_gradients(found.slopes))]
    # They agree on a step, and differ about it.
    apart = max(float(np.sum(small_sample_corrected(votes - votes.mean(axis=0)) ** 2)) for votes in groupings)
    factor = max(1.0, apart / max(np.trace(inverse), np.finfo(float).tiny))
    return groupings[0].sum(axis=0), factor * inverse
