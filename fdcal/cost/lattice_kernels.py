"""The compiled loops of Eq. 7 over a search lattice; `fdcal.cost.lattice` calls them.

Rows of W are computed for many points at once, real and imaginary parts apart and the points along the last axis, so
that the compiler can use vector instructions. The symbols are those of `fdcal.cost.eq7`. Loops copy arrays, because of
`a[i:] = b[i:]` numba also compiles the text of an error, which takes longer than all else here.
"""

import numpy as np

from ..acoustics.compiled import compiled
from ..model.validation import Bools, Complexes, Integers, Reals

BLOCK = 32  # candidates evaluated together


@compiled
def pruned_search(
    unit: Complexes,
    row: Integers,
    radial: Complexes,
    orders: Integers,
    columns: Complexes,
    triangular: Bools,
    r0: Reals,
    p_n: Complexes,
    start: int,
):
    """Return the candidate of least cost summed over the modes, and that cost; `start` is tried first.

    All candidates are summed mode by mode, the lowest and cheapest first, and after each mode only those stay whose sum
    is not above the cost of `start`.
    """
    floor = r0.sum()
    kept, total = np.array([start]), np.array([floor])
    for m in range(len(orders)):
        _add_mode(unit, row, radial[m], orders[m], columns[m], triangular[m], p_n[m], kept, total)
    least = total[0]
    kept, total = np.arange(len(unit)), np.full(len(unit), floor)
    for m in range(len(orders)):
        _add_mode(unit, row, radial[m], orders[m], columns[m], triangular[m], p_n[m], kept, total)
        low = total <= least
        kept, total = kept[low], total[low]
    best = start
    for c in range(len(kept)):  # the first in the order of the lattice where several are equal
        if total[c] < least or (total[c] == least and kept[c] < best):
            best, least = kept[c], total[c]
    return best, least


@compiled
def _add_mode(
    unit: Complexes,
    row: Integers,
    J: Complexes,
    L: int,
    columns: Complexes,
    triangular: bool,
    p_n: complex,
    kept: Integers,
    total: Reals,
):
    """Add the excess of one mode to the sums of the candidates `kept`."""
    re, im, work = np.empty((2 * L + 1, BLOCK)), np.empty((2 * L + 1, BLOCK)), np.empty((3, BLOCK))
    which, block = np.empty(BLOCK, np.int64), np.empty(BLOCK)
    for first in range(0, len(kept), BLOCK):
        count = min(BLOCK, len(kept) - first)
        for c in range(BLOCK):
            which[c] = kept[first + min(c, count - 1)]
        block[:] = 0.0
        _rows(J, unit, row, which, L, re, im)
        _add_excess(re, im, columns, p_n, 2 * L + 1, triangular, work, block)
        for c in range(count):
            total[first + c] += block[c]


@compiled
def _rows(J: Complexes, unit: Complexes, row: Integers, which: Integers, L: int, re: Reals, im: Reals):
    """re[l] + j im[l] = J_l exp(j l theta), l = -L..L, of the points `which`; their rows of the table J are `row`."""
    for c in range(len(which)):
        point = which[c]
        r, u, v = row[point], unit[point].real, unit[point].imag
        x, y, sign = 1.0, 0.0, 1.0  # x + j y is exp(j l theta)
        re[L, c], im[L, c] = J[r, 0].real, J[r, 0].imag
        for l in range(1, L + 1):  # noqa: E741
            x, y, sign = x * u - y * v, x * v + y * u, -sign
            a, b = J[r, l].real, J[r, l].imag
            re[L + l, c], im[L + l, c] = a * x - b * y, a * y + b * x
            re[L - l, c], im[L - l, c] = sign * (a * x + b * y), sign * (b * x - a * y)


@compiled
def _add_excess(
    re: Reals, im: Reals, columns: Complexes, p_n: complex, K: int, triangular: bool, work: Reals, total: Reals
):
    """Add |p_n - w alpha|^2 / (1 + |w Z|^2) of a block of candidates to `total`."""
    leverage, x, y = work[0], work[1], work[2]
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
