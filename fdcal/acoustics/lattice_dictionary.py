"""The Fourier-Bessel dictionary of every candidate of a search lattice.

k, L and the dictionary W are those of `fdcal.acoustics.dictionary`.
"""

import numpy as np
from numpy.typing import ArrayLike

from ..model.settings import Search
from ..model.types import Reals
from ..model.validation import InputError
from .dictionary import fourier_bessel, join_orders
from .special_functions import bessel

SPARE_ORDERS = 8  # that the recurrence starts above those in use: exact to rounding


class LatticeDictionary:
    """The dictionary of every candidate of a search lattice, from one table of radial functions.

    Every `centre` below is a point of the lattice. So the offsets of all candidates are multiples of the step, their
    squared lengths are integers, and J_l is needed at a few thousand radii only, once for all centres.

    `points` (C, 2), candidates, metres, x fastest; `shape`: (ny, nx); `radial` (M, U, Lmax + 1), J_l at U radii, zero
    above the order of the mode; `row` (d2max + 1,), row of `radial` for each squared offset in steps, else -1.
    """

    def __init__(self, search: Search, wavenumbers: np.ndarray, orders: np.ndarray):
        if len(search.size) != 2:
            problem = f"search.size = {list(search.size)} has 3 lengths and a lattice search is two-dimensional"
            raise InputError(problem, "use another solver", key="search.size", value=search.size)
        nx, ny = search.shape
        self.search, self.wavenumbers, self.orders = search, np.asarray(wavenumbers, complex), np.asarray(orders)
        self.shape = (ny, nx)
        ix, iy = np.meshgrid(np.arange(nx), np.arange(ny))
        self.steps = np.stack([ix.ravel(), iy.ravel()], axis=1)
        self.points = np.asarray(search.origin) + search.step * self.steps
        self._phases: tuple = None, None
        self._others: tuple = None, None
        squared = np.unique(np.add.outer(np.arange(nx) ** 2, np.arange(ny) ** 2))
        self.row = np.full(squared[-1] + 1, -1, dtype=np.int32)
        self.row[squared] = np.arange(len(squared))
        radii = search.step * np.sqrt(squared)
        self.radial = np.zeros((len(self.orders), len(radii), int(self.orders.max()) + 1), dtype=complex)
        for table, k, L in zip(self.radial, self.wavenumbers, self.orders, strict=True):
            table[:, : L + 1] = bessel(k * radii, int(L) + SPARE_ORDERS)[: L + 1].T

    def nearest(self, point: ArrayLike) -> np.ndarray:
        """Return the lattice point nearest to `point` (..., 2), inside the search domain : (..., 2) float64, metres."""
        return np.asarray(self.search.origin) + self.search.step * self._index(point)

    def _index(self, point: ArrayLike) -> np.ndarray:
        index = np.rint((np.asarray(point) - self.search.origin) / self.search.step).astype(np.int64)
        return np.clip(index, 0, np.array(self.shape[::-1]) - 1)

    def index(self, point: ArrayLike) -> int:
        """Return the number of the candidate nearest to `point` (2,), metres."""
        ix, iy = self._index(point)
        return int(iy * self.shape[1] + ix)

    def phases(self, centre: Reals) -> tuple[np.ndarray, np.ndarray]:
        """Return exp(j theta) (C,) complex128 and the row of `radial` (C,) int32 of every candidate about `centre`."""
        index = tuple(self._index(centre).tolist())
        cached, phases = self._phases  # the centre rarely moves from step to step
        if cached != index:
            phases = self._unit_and_row(self.steps - index)
            self._phases = index, phases
        return phases

    def _unit_and_row(self, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        squared = np.sum(offset**2, axis=1)
        unit = (offset[:, 0] + 1j * offset[:, 1]) / np.sqrt(np.maximum(squared, 1))
        unit[squared == 0] = 1.0
        return unit, self.row[squared]

    def microphones(self, positions: Reals, centre: Reals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return exp(j theta) and the row of `radial` of given positions, and W of those that are off the lattice.

        `positions` (N, 2), metres. Returns `unit` (N,), 1 off the lattice; `row` (N,), -1 off the lattice; `others`
        (M, N_off, 2 Lmax + 1), zero beyond the order of the mode.
        """
        steps = (np.asarray(positions) - self.nearest(centre)) / self.search.step
        offset = np.rint(steps).astype(np.int64)
        off = (np.abs(steps - offset) >= 1e-6).any(axis=1) | (np.abs(offset) >= self.shape[::-1]).any(axis=1)
        offset[off] = 0
        unit, row = self._unit_and_row(offset)
        row[off] = -1
        return unit, row, self._off_lattice(positions[off], centre)

    def _off_lattice(self, positions: np.ndarray, centre: Reals) -> np.ndarray:
        index = tuple(self._index(centre).tolist()), positions.tobytes()
        cached, W = self._others  # these are known microphones, which stay in place
        if cached != index:
            W = np.zeros((len(self.orders), len(positions), 2 * int(self.orders.max()) + 1), dtype=complex)
            for m, (k, L) in enumerate(zip(self.wavenumbers, self.orders, strict=True) if len(positions) else ()):
                W[m, :, : 2 * L + 1] = fourier_bessel(positions, complex(k), int(L), centre)
            self._others = index, W
        return W

    def dictionary(self, positions: Reals, centre: Reals, modes: ArrayLike) -> list[np.ndarray]:
        """Return W (N, 2L + 1) of positions (N, 2), metres, on the lattice or off it, for each of `modes`."""
        unit, row, others = self.microphones(np.asarray(positions), centre)
        phase = unit[:, None] ** np.arange(self.radial.shape[2])
        modes = np.asarray(modes)
        W: dict[int, np.ndarray] = {}
        for L in np.unique(self.orders[modes]):  # modes of equal order in one batch
            batch = modes[self.orders[modes] == L]
            J = self.radial[batch[:, None], row, : L + 1]
            W |= zip(batch.tolist(), join_orders(J, phase[:, : L + 1]), strict=True)
        for m in modes.tolist() if (row < 0).any() else ():
            W[m][row < 0] = others[m, :, : 2 * self.orders[m] + 1]
        return [W[m] for m in modes.tolist()]
