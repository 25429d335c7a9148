"""The compiled loops of Eq. 7 over a search lattice; `fdcal.cost.lattice` calls them.

Rows of W are computed for many points at once, real and imaginary parts apart and the points along the last axis, so
that the compiler can use vector instructions. The symbols are those of `fdcal.cost.eq7`. Loops copy arrays, because of
`a[i:] = b[i:]` numba also compiles the text of an error, which takes longer than all else here.
"""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numpy as np

from ..acoustics.compiled import compiled
from ..model.validation import Bools, Complexes, Integers, Reals
from .eq7 import RANK_TOLERANCE

P = ParamSpec("P")
Found = TypeVar("Found")


def compiled_sums(function: Callable[P, Found]) -> Callable[P, Found]:
    """Decorate as `compiled` does, with sums in the order of the vectors."""
    return compiled(function, fastmath={"reassoc", "contract"})


BLOCK = 32  # candidates evaluated together
VECTOR = 8  # microphones are padded to a multiple of it


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


@compiled
def fits(
    unit: Complexes,
    row: Integers,
    others: Complexes,
    radial: Complexes,
    orders: Integers,
    pressures: Complexes,
    roots: Reals,
):
    """Return Z and alpha as `columns`, r0, and whether W has full rank, of every mode.

    `unit`, `row` (N,) of the microphones; row is -1 for one that is not on the lattice; `others` (modes, N_off, Kmax)
    complex128, rows of W of those, in the order of the microphones; `roots` (N,) float64, roots of the weights; 0 for
    the microphone left out.
    """
    width, padded = 2 * orders.max() + 1, -(-len(row) // VECTOR) * VECTOR
    columns = np.zeros((len(orders), width + 1, width), np.complex128)
    r0, whole = np.empty(len(orders)), np.empty(len(orders), np.bool_)
    re, im = np.zeros((width + 1, padded)), np.zeros((width + 1, padded))
    everyone, on = np.arange(len(row)), row.copy()
    for i in range(len(row)):
        on[i] = max(row[i], 0)
    for m in range(len(orders)):
        L, K = orders[m], 2 * orders[m] + 1
        _rows(radial[m], unit, on, everyone, L, re, im)
        off = 0
        for i in range(len(row)):
            if row[i] < 0:
                for j in range(K):
                    re[j, i], im[j, i] = others[m, off, j].real, others[m, off, j].imag
                off += 1
            re[K, i], im[K, i] = pressures[m, i].real, pressures[m, i].imag
        for j in range(K + 1):
            for i in range(len(row)):
                re[j, i], im[j, i] = roots[i] * re[j, i], roots[i] * im[j, i]
        S = np.zeros((K, K + 1), np.complex128)
        _triangularise(re, im, K, S)
        r0[m] = 0.0
        for i in range(K, padded):
            r0[m] += re[K, i] ** 2 + im[K, i] ** 2
        low, high = abs(S[0, 0]), abs(S[0, 0])
        for i in range(1, K):
            low, high = min(low, abs(S[i, i])), max(high, abs(S[i, i]))
        whole[m] = low > RANK_TOLERANCE * high
        if whole[m]:
            _invert(S, columns[m])
    return columns, r0, whole


@compiled_sums
def _triangularise(re: Reals, im: Reals, K: int, S: Complexes):
    """S = Q^H [W p] by Householder reflections, upper triangular; the first K + 1 columns of re + j im become it."""
    x, y = np.empty(re.shape[1]), np.empty(re.shape[1])
    for j in range(K):
        x[:j], y[:j] = 0.0, 0.0
        for i in range(j, len(x)):
            x[i], y[i] = re[j, i], im[j, i]
        square = 0.0
        for i in range(len(x)):
            square += x[i] * x[i] + y[i] * y[i]
        length, size = np.sqrt(square), np.hypot(x[j], y[j])
        turn = complex(x[j] / size, y[j] / size) if size > 0 else complex(1.0, 0.0)
        S[j, j] = -length * turn
        x[j] += length * turn.real
        y[j] += length * turn.imag
        if length > 0:
            _reflect(x, y, 1 / (length * (length + size)), re[j + 1 : K + 1], im[j + 1 : K + 1])
        for c in range(j + 1, K + 1):
            S[j, c] = complex(re[c, j], im[c, j])


@compiled_sums
def _reflect(x: Reals, y: Reals, scale: float, re: Reals, im: Reals):
    """Subtract scale v v^H a from each column a, v = x + j y."""
    for c in range(len(re)):
        a, b = re[c], im[c]
        s, t = 0.0, 0.0
        for i in range(len(x)):
            s += x[i] * a[i] + y[i] * b[i]
            t += x[i] * b[i] - y[i] * a[i]
        s, t = s * scale, t * scale
        for i in range(len(x)):
            a[i] -= s * x[i] - t * y[i]
            b[i] -= s * y[i] + t * x[i]


@compiled
def _invert(S: Complexes, columns: Complexes):
    """Columns of S^-1 and, behind them, S^-1 times the last column of S."""
    K = len(S)
    for j in range(K + 1):
        z = columns[j]
        for i in range(min(j, K - 1), -1, -1):
            rest = S[i, j] if j == K else complex(1.0 if i == j else 0.0, 0.0)
            for l in range(i + 1, min(j + 1, K)):  # noqa: E741
                rest -= S[i, l] * z[l]
            z[i] = rest * (1 / S[i, i])
