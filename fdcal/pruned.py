"""The argmin of a landscape without the landscape: candidates are dropped as soon as they cannot win.

The sum over modes only grows, so a candidate whose partial sum passes the best so far is left at once. The answer is
the argmin of `fdcal.cost.landscape` summed over the modes, the first one in lattice order where several are equal.
"""

from __future__ import annotations

import numba
import numpy as np

from .cost import LeaveOneOut
from .dictionary import Lattice


def best_candidate(lattice: Lattice, centre, modes: slice, fits: list[LeaveOneOut], start: int) -> tuple[int, float]:
    """Index of the candidate of least cost, and that cost, summed over `modes`.

    Parameters
    ----------
    centre : (2,) float64, metres, a lattice point
    modes : slice, the modes in use
    fits : their `leave_one_out`, in the same order
    start : candidate tried first; a good guess makes the search faster, never different
    """
    unit, row = lattice.phases(centre)
    width = max(len(fit.alpha) for fit in fits)
    columns = np.zeros((len(fits), width + 1, width), dtype=complex)  # those of Z and, behind them, alpha
    triangular = np.array([fit.triangular for fit in fits])
    for m, fit in enumerate(fits):
        K = len(fit.alpha)
        columns[m, :K, :K], columns[m, K, :K] = fit.Z.T, fit.alpha
    r0 = np.array([fit.r0 for fit in fits])
    p_n = np.array([fit.p_n for fit in fits])
    modes = np.arange(len(lattice.orders))[modes]
    return _search(unit, row, lattice.radial, modes, lattice.orders, columns, triangular, r0, p_n, start)


BLOCK = 32  # neighbouring candidates are weighed together, which vector instructions serve well
_compiled = numba.njit(nogil=True, cache=True, error_model="numpy")


@_compiled
def _search(unit, row, radial, modes, orders, columns, triangular, r0, p_n, start):
    w = np.empty((2, columns.shape[2], BLOCK))
    total, scratch = np.empty(BLOCK), (np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK))
    best, least, floor = start, np.inf, r0.sum()
    for visit in range(-1, (len(unit) + BLOCK - 1) // BLOCK):
        first = (start // BLOCK if visit < 0 else visit) * BLOCK
        count = min(BLOCK, len(unit) - first)
        total[:] = floor
        for m in range(len(modes)):  # the lowest first: the cheapest, and it drops most
            L = orders[modes[m]]
            for c in range(count):
                _row_of_dictionary(radial[modes[m], row[first + c]], unit[first + c], L, w[:, :, c])
            _add_excess(w[0], w[1], columns[m], p_n[m], 2 * L + 1, triangular[m], scratch, total)
            if total[:count].min() > least:
                break
        for c in range(count):
            if total[c] < least or (total[c] == least and first + c < best):
                best, least = first + c, total[c]
    return best, least


@_compiled
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


@_compiled
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
