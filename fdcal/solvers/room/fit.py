"""Microphones and source in a room of known size, fitted together: both models' terms and one damped step.

diffuse model  the field is a sum of the room's modes with random amplitudes; it needs no source
exact model    the field of a point source in a room whose walls have an admittance

theta   all unknowns in one array: positions (N D) and, of the exact model, source (D), real and imaginary part of the
        admittance (2) and, if the size of the room is unknown, its relative changes of length (D)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...acoustics.room_modes import DiffuseModel, point_source_model, room_pressures
from ...model.power import mode_power
from ..levenberg_marquardt import NewtonTerms, Step, damped_step


@dataclass(frozen=True)
class FitRules:
    """The prior of the walls, and the step of numerical derivatives.

    Attributes
    ----------
    admittance_sigma : one standard deviation of the real and of the imaginary part of the admittance, dimensionless
    difference : of the admittance or of a relative length, for a derivative, dimensionless
    """

    admittance_sigma: float = 0.05
    difference: float = 1e-6


RULES = FitRules()


def field_power(pressures, noise) -> np.ndarray:
    """Return s (M,) of the diffuse model: the power of the pressures (M, N) less that of the noise (M,)."""
    whole = mode_power(pressures)
    return np.maximum(whole - noise, 1e-3 * whole)


def diffuse_terms(theta, pressures, noise, model: DiffuseModel) -> NewtonTerms:
    """Return -log of the probability density by the diffuse model, up to a constant, and its derivatives.

    Parameters
    ----------
    theta : (N D,) float64, positions, metres
    pressures : (M, N) complex128 of unit RMS
    noise : (M,) float64, noise's share of the power, position errors included
    model : DiffuseModel
    """
    N, D = pressures.shape[1], model.kappa.shape[1]
    x = theta.reshape(N, D)
    W, dW = model.shapes(x), model.slopes(x)
    cost, gradient, H = 0.0, np.zeros((N, D)), np.zeros((N, D, N, D))
    for p, s, v, w in zip(pressures, field_power(pressures, noise), noise, model.weights, strict=True):
        C = s * (W * w) @ W.T + v * np.eye(N)
        inverse = np.linalg.inv(C)
        u = inverse @ p
        cost += np.linalg.slogdet(C)[1] + float(np.real(p.conj() @ u))
        g = s * (dW * w) @ (W.T @ u)  # (D, N), slopes of the field that fits
        widening = s * np.einsum("dne,en->nd", dW * w, W.T @ inverse)
        gradient += 2 * widening - 2 * np.real(u.conj() * g).T
        H += 2 * np.real(np.einsum("an,nk,bk->nakb", g.conj(), inverse, g))
    return NewtonTerms(cost, gradient.ravel(), H.reshape(N * D, N * D))


@dataclass(frozen=True)
class Exact:
    """The exact model's residual at `theta`.

    Attributes
    ----------
    residual : (M, N) complex128, in standard deviations of the noise
    fitted : (M, N) complex128, A_m g_m, in the unit of the pressures
    jacobian : (M N, P) complex128, of the residual by Kaufman's approximation: the derivative of A_m is left out
    """

    residual: np.ndarray
    fitted: np.ndarray
    jacobian: np.ndarray

    def cost(self, theta, count: int, D: int) -> float:
        """Return the sum of the squared residuals and of the prior of the admittance, for `count` microphones."""
        return float(np.sum(np.abs(self.residual.ravel()) ** 2) + np.sum((_walls(theta, count, D) * theta) ** 2))

    def terms(self, theta, count: int, D: int) -> NewtonTerms:
        """Return `cost` and its derivatives."""
        r, J = self.residual.ravel(), self.jacobian
        walls = _walls(theta, count, D)
        gradient = 2 * np.real(J.conj().T @ r) + 2 * walls**2 * theta
        curvature = 2 * np.real(J.conj().T @ J) + 2 * np.diag(walls**2)
        return NewtonTerms(self.cost(theta, count, D), gradient, curvature)


def _walls(theta, count: int, D: int) -> np.ndarray:
    """One over the standard deviation of each unknown in the prior of the admittance; 0 for the others."""
    walls = np.zeros(len(theta))
    walls[count * D + D : count * D + D + 2] = 1 / RULES.admittance_sigma
    return walls


@np.errstate(all="ignore")
def exact(theta, pressures, noise, wavenumbers, size, slopes: bool = True) -> Exact:
    """Return the exact model's residual, and its Jacobian if `slopes`.

    Values without bound, as far outside of a room of another size, give a cost that no step is taken to.

    Parameters
    ----------
    theta : (P,) float64, N D + D + 2 unknowns, or D more with the relative changes of the room's lengths
    pressures : (M, N) complex128 of unit RMS
    noise : (M,) float64, noise's share of the power
    wavenumbers : (M,) complex128, rad/m
    size : lengths of the room, metres
    slopes : whether the Jacobian is computed; without it that has no rows
    """
    N, D = pressures.shape[1], len(size)
    x, source, beta, size = unpacked(theta, N, size)
    room = point_source_model(size, wavenumbers, beta)
    excited, shapes = room.excitation(source), room.shapes(x)
    g = room_pressures(excited, shapes)
    square = np.sum(np.abs(g) ** 2, axis=1, keepdims=True)
    A = np.sum(g.conj() * pressures, axis=1, keepdims=True) / square
    scale = 1 / np.sqrt(noise)[:, None]
    if not slopes:
        return Exact(scale * (pressures - A * g), A * g, np.zeros((0, len(theta))))
    dg = np.zeros((*g.shape, len(theta)), complex)
    for a in range(D):
        dg[:, np.arange(N), D * np.arange(N) + a] = room_pressures(excited, room.shapes(x, a))
        dg[:, :, N * D + a] = room_pressures(room.excitation(source, a), shapes)
    changed = point_source_model(size, wavenumbers, beta + RULES.difference)
    dg[:, :, N * D + D] = (room_pressures(changed.excitation(source), changed.shapes(x)) - g) / RULES.difference
    dg[:, :, N * D + D + 1] = 1j * dg[:, :, N * D + D]
    for a in range(D if len(theta) > N * D + D + 2 else 0):
        grown = 1 + RULES.difference / (1 + theta[N * D + D + 2 + a])
        longer = tuple(length * (grown if a == b else 1) for b, length in enumerate(size))
        changed = point_source_model(longer, wavenumbers, beta)
        pressures_there = room_pressures(changed.excitation(source), changed.shapes(x))
        dg[:, :, N * D + D + 2 + a] = (pressures_there - g) / RULES.difference
    along = np.sum(g.conj()[..., None] * dg, axis=1, keepdims=True) / square[..., None]
    jacobian = -(scale * A)[..., None] * (dg - g[..., None] * along)
    return Exact(scale * (pressures - A * g), A * g, jacobian.reshape(-1, len(theta)))


def unpacked(theta, count: int, size) -> tuple[np.ndarray, np.ndarray, complex, tuple[float, ...]]:
    """Return positions (N, D), source (D,), admittance and size of the room that `theta` stands for."""
    D = len(size)
    positions, source = theta[: count * D].reshape(count, D), theta[count * D : count * D + D]
    beta = complex(*theta[count * D + D : count * D + D + 2])
    longer = theta[count * D + D + 2 :]
    return positions, source, beta, tuple(np.asarray(size) * (1 + longer)) if len(longer) else tuple(size)


def bounded_step(
    theta: np.ndarray,
    terms: NewtonTerms,
    cost: Callable[[np.ndarray], float],
    bounded: Callable[[np.ndarray], np.ndarray],
    coordinates: int,
    damping: float,
    furthest: float,
) -> Step:
    """Return one damped Gauss-Newton step of unknowns that have bounds.

    Parameters
    ----------
    theta : (P,) float64
    terms : NewtonTerms, at `theta`
    cost : cost of given unknowns
    bounded : given unknowns, clipped to their bounds
    coordinates : int, how many of the unknowns, from the first, are coordinates of microphones, metres
    damping, furthest : as of `fdcal.solvers.levenberg_marquardt.damped_step`
    """
    return damped_step(
        theta,
        terms,
        cost,
        lambda y: bounded(theta + y),
        lambda tried: float(np.abs(tried - theta)[:coordinates].max()),
        damping,
        furthest,
    )
