"""Eq. 7 over a whole search lattice, compiled, and a pruned search for its minimum.

The formula is `LeaveOneOutFit.cost_of` of `fdcal.cost.eq7`; the rows of W come from the lattice's table of radii. The
sum over modes only grows, so the search drops a candidate as soon as its partial sum exceeds the best sum so far. The
result is the argmin of the whole landscape, the first one in lattice order where several are equal.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..acoustics.compiled import compiled
from ..acoustics.lattice_dictionary import LatticeDictionary
from ..acoustics.threads import parallel_map
from ..model.problem import Problem
from .eq7 import LeaveOneOutFit, known_weights, leave_one_out_fits

BLOCK = 32  # neighbouring candidates evaluated together, so that the compiler can use vector instructions
STRIP = 64 * BLOCK  # candidates that one core evaluates at a time


class CandidateLattice(Protocol):
    """The lattice of candidates that the compiled loops read, as `LatticeDictionary` and `OneModeLattice` are.

    Attributes
    ----------
    radial : (M, U, Lmax + 1) complex128, J_l at U radii
    orders : (M,) int64
    """

    radial: np.ndarray
    orders: np.ndarray

    def phases(self, centre) -> tuple[np.ndarray, np.ndarray]:
        """Return exp(j theta) (C,) complex128 and row of `radial` (C,) int32 of every candidate about `centre`."""
        ...


def lattice_landscape(
    problem: Problem, lattice: LatticeDictionary, positions, n: int, centre, modes: slice, known_weight=1.0
):
    """Return the cost of every mode over the lattice with microphone `n` there (Eq. 7).

    Parameters
    ----------
    positions : (N, 2) float64, metres
    centre : (2,) float64, metres, a lattice point
    modes : slice, the modes in use
    known_weight : weight of the squared residual of known microphones, dimensionless

    Returns
    -------
    (modes, ny, nx) float64, as `fdcal.cost.eq7.landscape`
    """
    W = lattice.dictionary(positions, centre, range(len(lattice.orders))[modes])
    fits = leave_one_out_fits(W, problem.pressures[modes], n, weights=known_weights(problem, known_weight))
    return candidate_costs(lattice, centre, modes, fits).reshape(-1, *lattice.shape)


def candidate_costs(lattice: CandidateLattice, centre, modes: slice, fits: list[LeaveOneOutFit]) -> np.ndarray:
    """Return the cost of every candidate and mode; parameters as of `best_candidate`.

    Returns
    -------
    (modes, C) float64
    """
    unit, row, *rest = _tables(lattice, centre, modes, fits)
    firsts = range(0, len(unit), STRIP)
    strips = parallel_map(lambda first: _costs(unit[first : first + STRIP], row[first : first + STRIP], *rest), firsts)
    return np.concatenate(strips, axis=1)


def best_candidate(
    lattice: CandidateLattice, centre, modes: slice, fits: list[LeaveOneOutFit], start: int
) -> tuple[int, float]:
    """Return the index of the candidate of least cost and that cost, summed over `modes`.

    Parameters
    ----------
    centre : (2,) float64, metres, a lattice point
    modes : slice, the modes in use
    fits : their `leave_one_out_fits`, in the same order
    start : candidate tried first; a good guess makes the search faster and never changes its result
    """
    return _pruned_search(*_tables(lattice, centre, modes, fits), start)


def _tables(lattice: CandidateLattice, centre, modes: slice, fits: list[LeaveOneOutFit]) -> tuple:
    """Return the arguments of the compiled loops: candidates about the centre, radii, orders and fits of the modes."""
    unit, row = lattice.phases(centre)
    width = max(len(fit.alpha) for fit in fits)
    columns = np.zeros((len(fits), width + 1, width), dtype=complex)  # those of Z and, behind them, alpha
    for m, fit in enumerate(fits):
        K = len(fit.alpha)
        columns[m, :K, :K], columns[m, K, :K] = fit.Z.T, fit.alpha
    triangular = np.array([fit.triangular for fit in fits])
    r0, p_n = np.array([fit.r0 for fit in fits]), np.array([fit.p_n for fit in fits])
    return unit, row, lattice.radial[modes], lattice.orders[modes], columns, triangular, r0, p_n


@compiled
def _costs(unit, row, radial, orders, columns, triangular, r0, p_n):
    w = np.empty((2, columns.shape[2], BLOCK))
    scratch = (np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))
    costs, block = np.empty((len(orders), len(unit))), np.empty(BLOCK)
    for m in range(len(orders)):
        for first in range(0, len(unit), BLOCK):
            count = min(BLOCK, len(unit) - first)
            block[:] = r0[m]
            for c in range(count):
                _row_of_dictionary(radial[m, row[first + c]], unit[first + c], orders[m], w[:, :, c])
            _add_excess(w[0], w[1], columns[m], p_n[m], 2 * orders[m] + 1, triangular[m], scratch, block)
            costs[m, first : first + count] = block[:count]
    return costs


@compiled
def _pruned_search(unit, row, radial, orders, columns, triangular, r0, p_n, start):
    w = np.empty((2, columns.shape[2], BLOCK))
    total, scratch = np.empty(BLOCK), (np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))
    best, least, floor = start, np.inf, r0.sum()
    for visit in range(-1, (len(unit) + BLOCK - 1) // BLOCK):
        first = (start // BLOCK if visit < 0 else visit) * BLOCK
        count = min(BLOCK, len(unit) - first)
        total[:] = floor
        for m in range(len(orders)):  # the lowest mode first: it is the cheapest and drops most candidates
            for c in range(count):
                _row_of_dictionary(radial[m, row[first + c]], unit[first + c], orders[m], w[:, :, c])
            _add_excess(w[0], w[1], columns[m], p_n[m], 2 * orders[m] + 1, triangular[m], scratch, total)
            if total[:count].min() > least:
                break
        for c in range(count):
            if total[c] < least or (total[c] == least and first + c < best):
                best, least = first + c, total[c]
    return best, least


@compiled
def _row_of_dictionary(J, unit, L, w):
    """w[l] = J_l exp(j l theta), l = -L..L, real parts in w[0], imaginary ones in w[1]."""
    phase = 1.0 + 0.0j
    sign = 1.0
    w[0, L], w[1, L] = J[0].real, J[0].imag
    for l in range(1, L + 1):  # noqa: E741
        phase *= unit
        sign = -sign
        above, below = J[l] * phase, sign * J[l] * phase.conjugate()
        w[0, L + l], w[1, L + l] = above.real, above.imag
        w[0, L - l], w[1, L - l] = below.real, below.imag


@compiled
def _add_excess(re, im, columns, p_n, K, triangular, scratch, total):
    """Add |p_n - w alpha|^2 / (1 + |w Z|^2) of a block of candidates to `total`."""
    leverage, x, y = scratch
    leverage[:] = 1.0
    for j in range(K + 1):
        x[:] = 0.0
        y[:] = 0.0
        for i in range(min(j + 1, K) if triangular else K):
            a, b = columns[j, i].real, columns[j, i].imag
            u, v = re[i], im[i]
            for c in range(BLOCK):
                x[c] += a * u[c] - b * v[c]
                y[c] += a * v[c] + b * u[c]
        if j < K:
            for c in range(BLOCK):
                leverage[c] += x[c] * x[c] + y[c] * y[c]
    for c in range(BLOCK):  # the last column was alpha
        total[c] += ((p_n.real - x[c]) ** 2 + (p_n.imag - y[c]) ** 2) / leverage[c]
