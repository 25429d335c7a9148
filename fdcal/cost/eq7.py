"""The cost of the paper, Eq. 7, in one place.

    W         dictionary of one mode at the estimated positions (Eq. 4)
    alpha     W^+ p, coefficients of the field (Eq. 5)
    residual  W alpha - p (Eqs. 6 and 7), one value per microphone
    cost      |residual|^2, summed over the modes in use (Eq. 7)
    landscape cost over candidate positions of one microphone, all others held

The landscape serves the step of descent, the picture on the screen and the tests. With microphone n left out,
W_-n = Q S, Z = S^-1, alpha = Z Z^H W_-n^H p_-n and r0 = |p_-n - W_-n alpha|^2, the cost with microphone n at x is

    cost(x) = r0 + |p_n - w(x) alpha|^2 / (1 + |w(x) Z|^2),

w(x) the row of W at x. It equals Eq. 7 where W_-n has full column rank; otherwise W_-n is reduced to its
column space once for all candidates. The centre of the expansion is the same for all candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..acoustics.fourier_bessel import fourier_bessel
from ..model.problem import Problem
from ..model.validation import InputError

RANK_TOLERANCE = 1e-12  # singular values below this fraction of the largest count as zero


def residual(positions, pressures, wavenumbers, orders, centre, tikhonov: float = 0.0) -> np.ndarray:
    """Return the residual of every mode, W W^+ p - p (Eq. 7).

    Parameters
    ----------
    positions : (N, 2) float64, metres
    pressures : (M, N) complex128
    wavenumbers : (M,) complex128, rad/m
    orders : (M,) int64
    centre : (2,) float64, metres
    tikhonov : weight mu of |alpha|^2 in the fit, dimensionless; 0 is Eq. 5

    Returns
    -------
    (M, N) complex128, unit of `pressures`
    """
    fitted = np.empty_like(pressures)
    for m, (p, k, L) in enumerate(zip(pressures, wavenumbers, orders, strict=True)):
        W = fourier_bessel(positions, k, L, centre)
        fitted[m] = W @ coefficients(W, p, tikhonov)
    return fitted - pressures


def coefficients(W: np.ndarray, p: np.ndarray, tikhonov: float = 0.0) -> np.ndarray:
    """Return alpha = W^+ p (Eq. 5), or the minimiser of |W alpha - p|^2 + tikhonov |alpha|^2.

    Parameters
    ----------
    W : (N, 2L + 1) complex128
    p : (N,) complex128
    tikhonov : weight mu of |alpha|^2, dimensionless

    Returns
    -------
    (2L + 1,) complex128, unit of `p`
    """
    U, s, Vh = np.linalg.svd(W, full_matrices=False)
    keep = s > RANK_TOLERANCE * s[0]
    weight = np.where(keep, s / np.where(keep, s**2 + tikhonov, 1.0), 0.0)
    return Vh.conj().T @ (weight * (U.conj().T @ p))


def cost(positions, pressures, wavenumbers, orders, centre, tikhonov: float = 0.0) -> np.ndarray:
    """Return the cost of every mode (Eq. 7 before the sum).

    Parameters as of `residual`. With `tikhonov` the penalty tikhonov |alpha|^2 is part of the cost.

    Returns
    -------
    (M,) float64, squared unit of `pressures`
    """
    total = np.sum(np.abs(residual(positions, pressures, wavenumbers, orders, centre, tikhonov)) ** 2, axis=1)
    if tikhonov:
        for m, (p, k, L) in enumerate(zip(pressures, wavenumbers, orders, strict=True)):
            alpha = coefficients(fourier_bessel(positions, k, L, centre), p, tikhonov)
            total[m] += tikhonov * np.sum(np.abs(alpha) ** 2)
    return total


@dataclass(frozen=True)
class LeaveOneOutFit:
    """The fit of one mode to all microphones but one; the symbols are those of the module's docstring.

    Attributes
    ----------
    Z : (K, K) complex128, Z Z^H is the inverse of W_-n^H W_-n; K = 2L + 1
    alpha : (K,) complex128, coefficients, unit of the pressures
    r0 : float, squared residual of the other microphones
    p_n : complex, pressure of the microphone left out
    triangular : whether Z is upper triangular, which it is unless W_-n is rank-deficient
    """

    Z: np.ndarray
    alpha: np.ndarray
    r0: float
    p_n: complex
    triangular: bool

    def cost_of(self, rows: np.ndarray) -> np.ndarray:
        """Return the cost with the left-out microphone at each candidate.

        Parameters
        ----------
        rows : (C, K) complex128, row of W at each candidate

        Returns
        -------
        (C,) float64
        """
        product = rows @ np.column_stack([self.Z, self.alpha])
        parts = product.view(float)
        leverage = np.einsum("ij,ij->i", parts[:, :-2], parts[:, :-2])
        error = self.p_n - product[:, -1]
        return self.r0 + (error.real**2 + error.imag**2) / (1 + leverage)


def leave_one_out_fits(
    dictionaries, pressures: np.ndarray, n: int, tikhonov: float = 0.0, weights: np.ndarray | None = None
) -> list[LeaveOneOutFit]:
    """Return the fit of every mode to all microphones but `n`.

    Parameters
    ----------
    dictionaries : M arrays (N, 2L + 1) complex128
    pressures : (M, N) complex128
    n : microphone left out
    tikhonov : weight mu of |alpha|^2
    weights : (N,) float64 or None, of the squared residual of each microphone; that of `n` counts as 1

    Raises
    ------
    InputError
        A mode has more functions than there are microphones left.
    """
    others = np.arange(pressures.shape[1]) != n
    scale = None if weights is None else np.sqrt(weights[others])
    fits: dict[int, LeaveOneOutFit] = {}
    widths = np.array([W.shape[1] for W in dictionaries])
    for width in np.unique(widths):  # modes of equal order in one batch
        modes = np.flatnonzero(widths == width)
        W = np.stack([dictionaries[m][others] for m in modes])
        p = pressures[modes][:, others]
        if scale is not None:
            W, p = W * scale[:, None], p * scale
        Z, alpha, r0, triangular = _fit(W, p, tikhonov)
        for i, m in enumerate(modes):
            fits[int(m)] = LeaveOneOutFit(Z[i], alpha[i], float(r0[i]), complex(pressures[m, n]), bool(triangular[i]))
    return [fits[m] for m in range(len(dictionaries))]


def _fit(W: np.ndarray, p: np.ndarray, tikhonov: float):
    """Z, alpha, r0 and whether Z is triangular, of a batch of modes: W (B, N-1, K), p (B, N-1)."""
    batch, _, width = W.shape
    if tikhonov:
        penalty = np.broadcast_to(np.sqrt(tikhonov) * np.eye(width), (batch, width, width))
        W = np.concatenate([W, penalty], axis=1)
        p = np.concatenate([p, np.zeros((batch, width))], axis=1)
    if W.shape[1] < width:
        raise InputError(
            f"an expansion of {width} functions (2L + 1) needs more than {W.shape[1]} microphones",
            "use a smaller search.radius or solver.order_offset",
        )
    S = np.asarray(np.linalg.qr(W, mode="r"))
    diagonal = np.abs(np.diagonal(S, axis1=1, axis2=2))
    deficient = diagonal.min(axis=1) <= RANK_TOLERANCE * diagonal.max(axis=1)
    S[deficient] = np.eye(width)
    Z = np.linalg.inv(S)
    alpha = _solve(W, Z, p)
    alpha += _solve(W, Z, p - (W @ alpha[..., None])[..., 0])  # refines: forming Q would cost more than S
    for b in np.flatnonzero(deficient):
        Z[b], alpha[b] = _reduced_fit(W[b], p[b])
    r0 = np.sum(np.abs(p - (W @ alpha[..., None])[..., 0]) ** 2, axis=1)
    return Z, alpha, r0, ~deficient


def _solve(W: np.ndarray, Z: np.ndarray, p: np.ndarray) -> np.ndarray:
    """(W^H W)^-1 W^H p of a batch, Z Z^H being the inverse."""
    return (Z @ (Z.conj().swapaxes(1, 2) @ (W.conj().swapaxes(1, 2) @ p[..., None])))[..., 0]


def _reduced_fit(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Z and alpha of a rank-deficient W, restricted to its row space; the columns of Z beyond the rank are zero."""
    U, s, Vh = np.linalg.svd(W, full_matrices=False)
    inverse = np.where(s > RANK_TOLERANCE * s[0], 1 / np.maximum(s, np.finfo(float).tiny), 0.0)
    Z = Vh.conj().T * inverse
    return Z, Z @ (U.conj().T @ p)


def landscape(positions, n: int, candidates, pressures, wavenumbers, orders, centre, tikhonov=0.0) -> np.ndarray:
    """Return the cost of every mode with microphone `n` at each candidate, the others at `positions`.

    Parameters
    ----------
    candidates : (C, 2) float64, metres; the others as of `residual`

    Returns
    -------
    (M, C) float64; sum over the modes for the paper's joint cost (Fig. 1, bottom right)
    """
    W = [fourier_bessel(positions, k, L, centre) for k, L in zip(wavenumbers, orders, strict=True)]
    rows = (fourier_bessel(candidates, k, L, centre) for k, L in zip(wavenumbers, orders, strict=True))
    fits = leave_one_out_fits(W, pressures, n, tikhonov)
    return np.stack([fit.cost_of(w) for fit, w in zip(fits, rows, strict=True)])


def known_weights(problem: Problem, known_weight: float) -> np.ndarray:
    """Return the weights of the squared residuals: `known_weight` for known microphones, 1 for the others.

    Returns
    -------
    (N,) float64, dimensionless
    """
    weights = np.ones(problem.pressures.shape[1])
    weights[problem.known] = known_weight
    return weights
