"""Eq. 7 over a whole search lattice, compiled, and a pruned search for its minimum.

The formula is `LeaveOneOutFit.cost_of` of `fdcal.cost.eq7`; the rows of W come from the lattice's table of radii. The
sum over modes only grows, so the search drops a candidate as soon as its partial sum exceeds the sum where the
microphone is. The result is the argmin of the whole landscape, the first one in lattice order where several are equal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..acoustics.lattice_dictionary import LatticeDictionary
from ..acoustics.threads import parallel_map
from ..model.problem import Problem
from . import lattice_kernels
from .eq7 import LeaveOneOutFit, known_weights, leave_one_out_fits

STRIP = 64 * lattice_kernels.BLOCK  # candidates that one core evaluates at a time


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


@dataclass(frozen=True)
class FitTables:
    """The `LeaveOneOutFit`s of several modes as the compiled loops read them; K is that of the highest order.

    Attributes
    ----------
    columns : (modes, K + 1, K) complex128, the columns of Z and, behind those of the mode, alpha; 0 elsewhere
    triangular : (modes,) bool
    r0 : (modes,) float64
    p_n : (modes,) complex128
    """

    columns: np.ndarray
    triangular: np.ndarray
    r0: np.ndarray
    p_n: np.ndarray

    @classmethod
    def of(cls, fits: list[LeaveOneOutFit]) -> FitTables:
        """Return the tables of the fits of `leave_one_out_fits`."""
        width = max(len(fit.alpha) for fit in fits)
        tables = cls(
            np.zeros((len(fits), width + 1, width), dtype=complex),
            np.empty(len(fits), dtype=bool),
            np.empty(len(fits)),
            np.array([fit.p_n for fit in fits]),
        )
        for m, fit in enumerate(fits):
            tables.put(m, fit)
        return tables

    def put(self, m: int, fit: LeaveOneOutFit) -> None:
        """Write the fit of mode `m`."""
        K = len(fit.alpha)
        self.columns[m, :K, :K], self.columns[m, K, :K] = fit.Z.T, fit.alpha
        self.triangular[m], self.r0[m] = fit.triangular, fit.r0


def lattice_fits(
    problem: Problem, lattice: LatticeDictionary, positions, n: int, centre, modes: slice, known_weight: float
) -> FitTables:
    """Return what `leave_one_out_fits` returns for the dictionary of the lattice, compiled.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    n : microphone left out
    centre : (2,) float64, metres, a lattice point
    modes : slice, the modes in use
    known_weight : weight of the squared residual of known microphones, dimensionless
    """
    unit, row, others = lattice.microphones(positions, centre)
    weights, pressures = known_weights(problem, known_weight), problem.pressures[modes]
    roots = np.sqrt(weights)
    roots[n] = 0.0
    columns, r0, whole = lattice_kernels.fits(
        unit, row, others[modes], lattice.radial[modes], lattice.orders[modes], pressures, roots
    )
    tables = FitTables(columns, whole, r0, pressures[:, n].copy())
    for m in np.flatnonzero(~whole).tolist():
        W = lattice.dictionary(positions, centre, [range(len(lattice.orders))[modes][m]])
        tables.put(m, leave_one_out_fits(W, pressures[m : m + 1], n, weights=weights)[0])
    return tables


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
    return candidate_costs(lattice, centre, modes, FitTables.of(fits)).reshape(-1, *lattice.shape)


def candidate_costs(lattice: CandidateLattice, centre, modes: slice, fits: FitTables) -> np.ndarray:
    """Return the cost of every candidate and mode; parameters as of `best_candidate`.

    Returns
    -------
    (modes, C) float64
    """
    unit, row, *rest = _arguments(lattice, centre, modes, fits)

    def strip(first: int) -> np.ndarray:
        return lattice_kernels.costs(unit[first : first + STRIP], row[first : first + STRIP], *rest)

    return np.concatenate(parallel_map(strip, range(0, len(unit), STRIP)), axis=1)


def best_candidate(lattice: CandidateLattice, centre, modes: slice, fits: FitTables, start: int) -> tuple[int, float]:
    """Return the index of the candidate of least cost and that cost, summed over `modes`.

    Parameters
    ----------
    centre : (2,) float64, metres, a lattice point
    modes : slice, the modes in use
    fits : of these modes
    start : candidate tried first; a good guess makes the search faster and never changes its result
    """
    return lattice_kernels.pruned_search(*_arguments(lattice, centre, modes, fits), start)


def _arguments(lattice: CandidateLattice, centre, modes: slice, fits: FitTables) -> tuple:
    """Return the arguments of the compiled loops: candidates about the centre, radii, orders and fits of the modes."""
    unit, row = lattice.phases(centre)
    return unit, row, lattice.radial[modes], lattice.orders[modes], fits.columns, fits.triangular, fits.r0, fits.p_n
