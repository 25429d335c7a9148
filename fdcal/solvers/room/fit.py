"""Microphones and source in a room of known size, fitted together: both models' terms and one damped step.

diffuse model  the field is a sum of the room's modes with random amplitudes; it needs no source
exact model    the field of a point source in a room whose walls have an admittance

Pressures (M, N) have unit RMS in each mode, the noise (M,) is a fraction of their power, wavenumbers (M,) are in rad/m
and lengths of the room in metres.

theta   all unknowns in one array: positions (N D) and, of the exact model, source (D), real and imaginary part of the
        admittance (2) and, if the size of the room is unknown, its relative changes of length (D)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...acoustics.room_modes import DiffuseModel, point_source_model, room_pressures
from ...model.problem import mode_power
from ...model.types import Complexes, Numbers, Reals
from ..estimate import SizeFit
from ..levenberg_marquardt import FIRST_DAMPING, NewtonTerms, Step, damped_step

Cost = Callable[[np.ndarray], float]  # of given unknowns


MIN_CURVATURE = 1e-12  # of the largest eigenvalue: directions with less are as good as free
MAX_SIZE_STEPS = 12  # of the fit of the size
SIZE_TOLERANCE = 1e-5  # metres: a shorter step ends that fit
LARGE_RESIDUAL = 2.0  # reduced chi-square from which another size may be far away


def degrees_of_freedom(modes: int, count: int, D: int) -> float:
    """Return the number of complex pressures of `count` microphones less that of the unknowns of the exact model."""
    return max(modes * (count - 1) - (count * D + D + 2) / 2, 1.0)


def field_power(pressures: Complexes, noise: Reals) -> np.ndarray:
    """Return s (M,) of the diffuse model: the power of the pressures less that of the noise."""
    whole = mode_power(pressures)
    return np.maximum(whole - noise, 1e-3 * whole)


def diffuse_terms(theta: Reals, pressures: Complexes, noise: Reals, model: DiffuseModel) -> NewtonTerms:
    """Return -log of the probability density by the diffuse model at positions `theta` (N D,), and its derivatives.

    It is known up to a constant. The noise includes the power of position errors.
    """
    N, D = pressures.shape[1], model.kappa.shape[1]
    x = theta.reshape(N, D)
    W, dW = model.shapes(x), model.slopes(x)
    cost, gradient, hessian = 0.0, np.zeros((N, D)), np.zeros((N, D, N, D))
    for p, s, v, w in zip(pressures, field_power(pressures, noise), noise, model.weights, strict=True):
        C = np.asarray(s * (W * w) @ W.T + v * np.eye(N))
        inverse = np.linalg.inv(C)
        u = inverse @ p
        cost += float(np.linalg.slogdet(C)[1]) + float((p.conj() @ u).real)
        g = s * (dW * w) @ (W.T @ u)  # (D, N), slopes of the field that fits
        widening = s * np.einsum("dne,en->nd", dW * w, W.T @ inverse)
        gradient += 2 * widening - 2 * np.real(u.conj() * g).T
        hessian += 2 * np.real(np.einsum("an,nk,bk->nakb", g.conj(), inverse, g))
    return NewtonTerms(cost, gradient.ravel(), hessian.reshape(N * D, N * D))


@dataclass(frozen=True)
class Exact:
    """The exact model's residual at `theta`."""

    # theta, prior: (P,) float64; prior is 1 / standard deviation of the admittance, 0 for the other unknowns
    theta: Reals
    prior: Reals
    residual: Complexes  # (M, N) complex128, in standard deviations of the noise
    fitted: Complexes  # (M, N) complex128, A_m g_m, in the unit of the pressures
    # (M N, P) complex128, of the residual by Kaufman's approximation: the derivative of A_m is left out
    jacobian: np.ndarray

    @property
    def cost(self) -> float:
        """The sum of the squared residuals and of the prior of the admittance."""
        return float(np.sum(np.abs(self.residual.ravel()) ** 2) + np.sum((self.prior * self.theta) ** 2))

    @property
    def terms(self) -> NewtonTerms:
        """The cost and its derivatives."""
        r, J, weights = self.residual.ravel(), self.jacobian, self.prior**2
        gradient = 2 * np.real(J.conj().T @ r) + 2 * weights * self.theta
        return NewtonTerms(self.cost, gradient, 2 * np.real(J.conj().T @ J) + 2 * np.diag(weights))


ADMITTANCE_SIGMA = 0.05  # of the real and of the imaginary part
DIFFERENCE = 1e-6  # of the admittance or of a relative length, for a derivative


@np.errstate(all="ignore")
def exact(
    theta: Reals,
    pressures: Complexes,
    noise: Reals,
    wavenumbers: Numbers,
    size: Sequence[float] | Reals,
    slopes: bool = True,
) -> Exact:
    """Return the exact model's residual, and its Jacobian if `slopes`; without it the Jacobian has no rows.

    Values without bound, as far outside of a room of another size, give a cost that no step is taken to.
    """
    N, D = pressures.shape[1], len(size)
    source_at, walls_at, lengths_at = N * D, N * D + D, N * D + D + 2
    x, source = theta[:source_at].reshape(N, D), theta[source_at:walls_at]
    beta, longer = complex(*theta[walls_at:lengths_at]), theta[lengths_at:]
    size = tuple(np.asarray(size) * (1 + longer)) if len(longer) else tuple(size)
    room = point_source_model(size, wavenumbers, beta)
    excited, shapes = room.excitation(source), room.shapes(x)
    g = room_pressures(excited, shapes)
    square = np.sum(np.abs(g) ** 2, axis=1, keepdims=True)
    A = np.sum(g.conj() * pressures, axis=1, keepdims=True) / square
    scale = 1 / np.sqrt(noise)[:, None]
    prior = np.zeros(len(theta))
    prior[walls_at:lengths_at] = 1 / ADMITTANCE_SIGMA
    residual, jacobian = scale * (pressures - A * g), np.zeros((0, len(theta)))
    if not slopes:
        return Exact(theta, prior, residual, A * g, jacobian)

    def slope(size: Sequence[float] | Reals, beta: complex) -> np.ndarray:
        changed = point_source_model(size, wavenumbers, beta)
        return (room_pressures(changed.excitation(source), changed.shapes(x)) - g) / DIFFERENCE

    dg = np.zeros((*g.shape, len(theta)), complex)
    for a in range(D):
        dg[:, np.arange(N), D * np.arange(N) + a] = room_pressures(excited, room.shapes(x, a))
        dg[:, :, source_at + a] = room_pressures(room.excitation(source, a), shapes)
    dg[:, :, walls_at] = slope(size, beta + DIFFERENCE)
    dg[:, :, walls_at + 1] = 1j * dg[:, :, walls_at]
    for a, change in enumerate(longer):
        grown = 1 + DIFFERENCE / (1 + change)
        dg[:, :, lengths_at + a] = slope(np.where(np.arange(D) == a, grown, 1) * size, beta)
    along = np.sum(g.conj()[..., None] * dg, axis=1, keepdims=True) / square[..., None]
    jacobian = -(scale * A)[..., None] * (dg - g[..., None] * along)
    return Exact(theta, prior, residual, A * g, jacobian.reshape(-1, len(theta)))


def bounded_step(
    theta: Reals,
    terms: NewtonTerms,
    cost: Cost,
    bounds: tuple[np.ndarray | float, np.ndarray | float],
    coordinates: int,
    damping: float,
    max_step: float,
) -> Step:
    """Return one damped Gauss-Newton step of unknowns `theta` (P,), clipped to their lower and upper `bounds`.

    No coordinate of a microphone, the first `coordinates` of the unknowns, moves further than `max_step`, metres.
    """

    def advance(y: np.ndarray) -> np.ndarray:
        return np.clip(theta + y, *bounds)

    def length(tried: np.ndarray) -> float:
        return float(np.abs(tried - theta)[:coordinates].max())

    return damped_step(theta, terms, cost, advance, length, damping, max_step)


def bounded_inverse(curvature: np.ndarray) -> np.ndarray:
    """Return the inverse (P, P) of a curvature whose eigenvalues are raised to MIN_CURVATURE of the largest."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors / np.maximum(values, MIN_CURVATURE * values[-1])) @ vectors.T


def fitted_size(
    theta: Reals,
    pressures: Complexes,
    noise: Reals,
    wavenumbers: Numbers,
    size: Sequence[float] | Reals,
    residual: float,
) -> SizeFit:
    """Return the lengths of the room that fit best, everything else adapting to them.

    It starts at the solution `theta` with the given size. Where its reduced chi-square `residual` is small, one step is
    enough.
    """
    N, D = pressures.shape[1], len(size)
    model = pressures, noise, wavenumbers, size

    def stepped(grown: Reals, damping: float):
        terms, free = exact(grown, *model).terms, (-np.inf, np.inf)
        return terms, bounded_step(
            grown, terms, lambda y: exact(y, *model, False).cost, free, N * D, damping, max_step=0.5
        )

    terms, step = stepped(np.concatenate([theta, np.zeros(D)]), FIRST_DAMPING)
    for _ in range(MAX_SIZE_STEPS - 1 if residual > LARGE_RESIDUAL else 0):
        if step.moved < SIZE_TOLERANCE:
            break
        terms, step = stepped(step.unknowns, step.damping)
    grown = step.unknowns
    after = step.cost / degrees_of_freedom(len(pressures), N, D)
    sigma = np.sqrt(np.diag(bounded_inverse(terms.curvature))[-D:] * max(1.0, after))
    return SizeFit(grown[-D:], sigma, after)
