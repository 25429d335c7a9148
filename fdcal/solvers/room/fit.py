"""Microphones and source in a room of known size, moved together: terms of both models and one damped step.

theta   all unknowns in a row: positions (N D), and of the second model the source (D) and the walls' admittance (2);
        where the size is in doubt its lengths (D), relative
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...acoustics.room_modes import DiffuseModel, point_source_model, room_pressures
from ...model.power import mode_power

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-9, 1e6
PRIOR = 0.05  # one sigma of the admittance, either part
SMALL = 1e-6  # difference of admittance or of relative length for a derivative


@dataclass(frozen=True)
class Terms:
    """Cost, gradient (P,) and Gauss-Newton matrix (P, P)."""

    cost: float
    gradient: np.ndarray
    curvature: np.ndarray


def loudness(pressures, noise) -> np.ndarray:
    """s (M,) of the first model: the power less the noise."""
    whole = mode_power(pressures)
    return np.maximum(whole - noise, 1e-3 * whole)


def diffuse_terms(theta, pressures, noise, model: DiffuseModel) -> Terms:
    """-log of the probability density of the first model, up to a constant. noise : (M,), spread included."""
    N, D = pressures.shape[1], model.kappa.shape[1]
    x = theta.reshape(N, D)
    W, dW = model.shapes(x), model.slopes(x)
    cost, gradient, H = 0.0, np.zeros((N, D)), np.zeros((N, D, N, D))
    for p, s, v, w in zip(pressures, loudness(pressures, noise), noise, model.weights, strict=True):
        C = s * (W * w) @ W.T + v * np.eye(N)
        inverse = np.linalg.inv(C)
        u = inverse @ p
        cost += np.linalg.slogdet(C)[1] + float(np.real(p.conj() @ u))
        g = s * (dW * w) @ (W.T @ u)  # (D, N), slopes of the field that fits
        widening = s * np.einsum("dne,en->nd", dW * w, W.T @ inverse)
        gradient += 2 * widening - 2 * np.real(u.conj() * g).T
        H += 2 * np.real(np.einsum("an,nk,bk->nakb", g.conj(), inverse, g))
    return Terms(cost, gradient.ravel(), H.reshape(N * D, N * D))


@dataclass(frozen=True)
class Exact:
    """The second model's residual at `theta`.

    Attributes
    ----------
    residual : (M, N) complex128, in noise's standard deviations
    fitted : (M, N) complex128, A_m g_m, in the unit of the pressures
    jacobian : (M N, P) complex128 of the residual (Kaufman's: that of A_m is left out)
    """

    residual: np.ndarray
    fitted: np.ndarray
    jacobian: np.ndarray

    def terms(self, theta, count: int, D: int) -> Terms:
        """Squared residuals and the prior of the walls; count: of microphones."""
        r, J = self.residual.ravel(), self.jacobian
        walls = np.zeros(len(theta))
        walls[count * D + D : count * D + D + 2] = 1 / PRIOR
        cost = float(np.sum(np.abs(r) ** 2) + np.sum((walls * theta) ** 2))
        if not len(J):
            return Terms(cost, np.zeros(0), np.zeros((0, 0)))
        gradient = 2 * np.real(J.conj().T @ r) + 2 * walls**2 * theta
        return Terms(cost, gradient, 2 * np.real(J.conj().T @ J) + 2 * np.diag(walls**2))


def exact(theta, pressures, noise, wavenumbers, size, slopes: bool = True) -> Exact:
    """The second model at `theta`, of N D + D + 2 entries, or D more with relative lengths of the room."""
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
    changed = point_source_model(size, wavenumbers, beta + SMALL)
    dg[:, :, N * D + D] = (room_pressures(changed.excitation(source), changed.shapes(x)) - g) / SMALL
    dg[:, :, N * D + D + 1] = 1j * dg[:, :, N * D + D]
    for a in range(D if len(theta) > N * D + D + 2 else 0):
        grown = 1 + SMALL / (1 + theta[N * D + D + 2 + a])
        longer = tuple(length * (grown if a == b else 1) for b, length in enumerate(size))
        changed = point_source_model(longer, wavenumbers, beta)
        dg[:, :, N * D + D + 2 + a] = (room_pressures(changed.excitation(source), changed.shapes(x)) - g) / SMALL
    along = np.sum(g.conj()[..., None] * dg, axis=1, keepdims=True) / square[..., None]
    jacobian = -(scale * A)[..., None] * (dg - g[..., None] * along)
    return Exact(scale * (pressures - A * g), A * g, jacobian.reshape(-1, len(theta)))


def unpacked(theta, count: int, size) -> tuple[np.ndarray, np.ndarray, complex, tuple[float, ...]]:
    """Positions (N, D), source (D,), admittance, and the size, made longer where `theta` says so."""
    D = len(size)
    positions, source = theta[: count * D].reshape(count, D), theta[count * D : count * D + D]
    beta = complex(*theta[count * D + D : count * D + D + 2])
    longer = theta[count * D + D + 2 :]
    return positions, source, beta, tuple(np.asarray(size) * (1 + longer)) if len(longer) else tuple(size)


@dataclass(frozen=True)
class Step:
    """Unknowns (P,) after a damped step, their cost, how far the furthest position went, metres, the next damping."""

    theta: np.ndarray
    cost: float
    moved: float
    damping: float


def damped(
    theta, terms: Terms, cost: Callable, kept: Callable, coordinates: int, damping: float, furthest: float
) -> Step:
    """One Gauss-Newton step, damped as much as it takes for the cost to fall; where nothing helps, no step.

    cost : of unknowns;  kept : unknowns to those that may be;  coordinates : how many, from the first, are metres
    """
    scale = np.maximum(np.diag(terms.curvature), 1e-12 * np.diag(terms.curvature).max())
    while damping < MOST_DAMPING:
        tried = kept(theta - np.linalg.solve(terms.curvature + damping * np.diag(scale), terms.gradient))
        moved = float(np.abs(tried - theta)[:coordinates].max())
        if moved <= furthest:
            lower = cost(tried)
            if lower < terms.cost:
                return Step(tried, lower, moved, max(damping / 10, LEAST_DAMPING))
        damping = max(damping, FIRST_DAMPING) * 6
    return Step(theta, terms.cost, 0.0, FIRST_DAMPING)
