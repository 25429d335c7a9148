"""The cost of the paper, Eq. 7, in one place.

    W         dictionary of one mode at the estimated positions (Eq. 4)
    alpha     W^+ p, coefficients of the field (Eq. 5)
    residual  W alpha - p (Eqs. 6 and 7), one value per microphone
    cost      |residual|^2, summed over the modes in use (Eq. 7)
    landscape cost over candidate positions of one microphone, all others constrained

With microphone n left out, W_-n = Q S, Z = S^-1, alpha = Z Z^H W_-n^H p_-n and r0 = |p_-n - W_-n alpha|^2, the cost
with microphone n at x is

    cost(x) = r0 + |p_n - f(x)|^2 / (1 + h(x)),    f = w(x) alpha,    h = |w(x) Z|^2,

w(x) the row of W at x. It equals Eq. 7 where W_-n has full column rank; otherwise W_-n is reduced to its column space
once for all candidates. The centre of the expansion is the same for all candidates. This is the one formula of every
search and every map: descent evaluates it in compiled loops (`fdcal.cost.lattice`), maps interpolate f and h
(`fdcal.cost.maps`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..acoustics.dictionary import fourier_bessel
from ..model.problem import Problem
from ..model.validation import Complexes, InputError, Integers, Numbers, Reals

RANK_TOLERANCE = 1e-12  # singular values below this fraction of the largest count as zero


def residual(
    positions: Reals, pressures: Complexes, wavenumbers: Numbers, orders: Integers, centre: Reals
) -> np.ndarray:
    """Return the residual of every mode, W W^+ p - p (Eq. 7), of positions (N, 2), metres : (M, N) complex128."""
    dictionaries = (fourier_bessel(positions, k, L, centre) for k, L in zip(wavenumbers, orders, strict=True))
    fitted = [W @ coefficients(W, p) for W, p in zip(dictionaries, pressures, strict=True)]
    return np.reshape(fitted, pressures.shape) - pressures


def coefficients(W: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return alpha = W^+ p (Eq. 5) : (2L + 1,) complex128, of W (N, 2L + 1) and p (N,)."""
    return fit(W[None], p[None])[1][0]


def cost(positions: Reals, pressures: Complexes, wavenumbers: Numbers, orders: Integers, centre: Reals) -> np.ndarray:
    """Return the cost of every mode (Eq. 7 before the sum), parameters as of `residual` : (M,) float64."""
    return np.sum(np.abs(residual(positions, pressures, wavenumbers, orders, centre)) ** 2, axis=1)


def landscape(
    positions: Reals,
    n: int,
    candidates: Reals,
    pressures: Complexes,
    wavenumbers: Numbers,
    orders: Integers,
    centre: Reals,
) -> np.ndarray:
    """Return the cost of every mode with microphone `n` at each of `candidates` (C, 2), metres : (M, C) float64.

    The others stay at `positions`; parameters as of `residual`. The sum over the modes is the paper's joint cost
    (Fig. 1, bottom right).
    """
    W = [fourier_bessel(positions, k, L, centre) for k, L in zip(wavenumbers, orders, strict=True)]
    rows = (fourier_bessel(candidates, k, L, centre) for k, L in zip(wavenumbers, orders, strict=True))
    return np.stack([fit.cost_of(w) for fit, w in zip(leave_one_out_fits(W, pressures, n), rows, strict=True)])


@dataclass(frozen=True)
class LeaveOneOutFit:
    """The fit of one mode to all microphones but one; the symbols are those of the module's docstring."""

    Z: Complexes  # (K, K) complex128, Z Z^H is the inverse of W_-n^H W_-n; K = 2L + 1
    alpha: Complexes  # (K,) complex128, coefficients, unit of the pressures
    r0: float  # squared residual of the other microphones
    p_n: complex  # complex, pressure of the microphone left out

    def terms(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return h (C,) float64 and f (C,) complex128 at candidates, from the row of W at each (C, K)."""
        product = rows @ np.column_stack([self.Z, self.alpha])
        parts = product.view(float)[:, :-2]
        return np.einsum("ij,ij->i", parts, parts), product[:, -1]

    def cost(self, h: np.ndarray, re: np.ndarray, im: np.ndarray) -> np.ndarray:
        """Return the cost where h and f = re + j im are these, of any shape : float64 of that shape."""
        return self.r0 + ((self.p_n.real - re) ** 2 + (self.p_n.imag - im) ** 2) / (1 + h)

    def cost_of(self, rows: np.ndarray) -> np.ndarray:
        """Return the cost with the left-out microphone at candidates, from the row of W at each (C, K) : (C,)."""
        h, f = self.terms(rows)
        return self.cost(h, np.real(f), np.imag(f))


def leave_one_out_fits(
    dictionaries: Sequence[Complexes], pressures: np.ndarray, n: int, weights: np.ndarray | None = None
) -> list[LeaveOneOutFit]:
    """Return the fit of every mode to all microphones but `n`, from M dictionaries (N, 2L + 1) and pressures (M, N).

    `weights` (N,) are those of the squared residual of each microphone; that of `n` counts as 1.
    """
    others = np.arange(int(pressures.shape[1])) != n
    scale = np.ones(np.count_nonzero(others)) if weights is None else np.sqrt(weights[others])
    fits: dict[int, LeaveOneOutFit] = {}
    widths = np.array([W.shape[1] for W in dictionaries])
    for width in np.unique(widths):  # modes of equal order in one batch
        modes = np.flatnonzero(widths == width)
        W = np.stack([dictionaries[m][others] for m in modes.tolist()]) * scale[:, None]
        if W.shape[1] < width:
            problem = f"an expansion of {width} functions (2L + 1) needs more than {W.shape[1]} microphones"
            raise InputError(problem, "use a smaller search.radius or solver.order_offset")
        parts = fit(W, pressures[modes][:, others] * scale)
        for m, Z, alpha, r0 in zip(modes.tolist(), *parts, strict=True):
            fits[m] = LeaveOneOutFit(Z, alpha, float(r0), complex(pressures[m, n]))
    return [fits[m] for m in range(len(dictionaries))]


def fit(W: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Z (B, K, K), alpha (B, K) and r0 (B,) of a batch of modes: W (B, N, K), p (B, N).

    [W p] = Q R, and R holds S, S alpha and, in its last diagonal, the root of r0. Where the rank of W is below K, they
    are those of its column space, from its singular values: the columns of Z beyond the rank are zero.
    """
    N, K = W.shape[1:]
    R = np.asarray(np.linalg.qr(np.concatenate([W, p[..., None]], axis=2), mode="r"))
    diagonal = np.abs(np.diagonal(R[:, :K, :K], axis1=1, axis2=2))
    deficient = (diagonal.min(axis=1) <= RANK_TOLERANCE * diagonal.max(axis=1)) | (N < K)
    S = np.where(deficient[:, None, None], np.eye(K), R[:, :K, :K] if N >= K else 0.0)
    Z = np.linalg.inv(S)
    alpha = (Z @ R[:, :K, K:])[..., 0] if N >= K else np.zeros((len(W), K), complex)
    r0 = np.abs(R[:, K, K]) ** 2 if N > K else np.zeros(len(W))
    for b in np.flatnonzero(deficient):
        U, s, Vh = np.linalg.svd(W[b], full_matrices=False)
        rank = s > RANK_TOLERANCE * s[0]
        Z[b] = 0.0
        Z[b, :, : len(s)] = Vh.conj().T * np.where(rank, 1 / np.where(rank, s, 1.0), 0.0)
        alpha[b] = Z[b, :, : len(s)] @ (U.conj().T @ p[b])
        r0[b] = np.sum(np.abs(p[b] - W[b] @ alpha[b]) ** 2)
    return Z, alpha, r0


def known_weights(problem: Problem, known_weight: float) -> np.ndarray:
    """Return the weights of the squared residuals, `known_weight` of known microphones, 1 of the others : (N,)."""
    weights = np.ones(problem.pressures.shape[1])
    weights[problem.known] = known_weight
    return weights
