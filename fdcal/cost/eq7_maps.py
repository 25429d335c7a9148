"""Eq. 7 of one microphone over the search domain, mode by mode, at one fixed order and on a lattice of any fineness.

The cost of `fdcal.cost.yardstick`: every microphone has the weight 1, or 1 / noise of its channel where the solver
estimates gains and noise of the channels. The centre of the expansion is the centre of the estimate, and the order of a
mode does not depend on which others are in use. With microphone n at x it is

    cost(x) = r0 + |p_n - f(x)|^2 / (1 + h(x)),    f = w(x) alpha,    h = |w(x) Z|^2    (`fdcal.cost.eq7`)

f and h are computed at the nodes of `fdcal.cost.map_nodes` and interpolated; the quotient is taken after that. So maps
on different lattices agree at the points that they share. In three dimensions a map is the horizontal layer at the
microphone's height.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from ..acoustics.fourier_bessel import max_order
from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import InputError
from .channel_correction import ChannelCorrection, equalised
from .eq7 import LeaveOneOutFit, leave_one_out_fits
from .field_expansion import FieldExpansion, functions
from .map_nodes import from_nodes, node_counts, node_points


def eq7_maps(
    problem: Problem,
    positions,
    n: int,
    modes: Sequence[int],
    order_offset: int,
    search: Search | None = None,
    channels: ChannelCorrection | None = None,
) -> np.ndarray:
    """Return the cost of each of `modes` with microphone `n` moved, the others at `positions`.

    Parameters
    ----------
    problem : Problem
    positions : (N, D) float64, metres
    n : int, microphone
    modes : (P,) int, counted from 1
    order_offset : added to ceil(k R) in the order of every mode
    search : lattice within the area of the problem's search domain; that domain's own unless given
    channels : gains and noise that the solver estimates; None for the pressures as recorded

    Returns
    -------
    (P, ny, nx) float64, relative to the power of the pressures of all P modes

    Raises
    ------
    InputError
        There is no search domain, or a mode has too many functions for the microphones at this order.
    """
    domain, x = problem.search, np.asarray(positions, float)
    require_carried(problem, modes, order_offset)
    if domain is None:
        raise ValueError("require_carried has checked that there is a search domain")
    search = domain if search is None else search
    expansion = expansion_of(problem, order_offset)
    numbers = np.searchsorted(expansion.carried.modes, np.asarray(modes) - 1)
    counts = [node_counts(domain, float(problem.wavenumbers[mode - 1].real)) for mode in modes]
    pressures, scale = equalised(problem.pressures, channels)
    maps = np.empty((len(numbers), *search.shape[1::-1]))
    for shape in sorted(set(counts)):
        alike = np.flatnonzero([count == shape for count in counts])
        points = node_points(domain, shape)
        points = np.concatenate([points, np.tile(x[n, 2:], (len(points), 1))], axis=1)
        onto = [from_nodes(domain, search, axis, count) for axis, count in enumerate(shape)]
        for group in expansion.groups(numbers[alike]):
            fits, rows = fits_and_rows(pressures, scale, expansion, x, n, points, group)
            for number, fit, w in zip(group, fits, rows, strict=True):
                maps[alike[numbers[alike] == number]] = map_of(fit, w, shape, onto)
    return maps / float(np.sum(np.abs(pressures[np.asarray(modes) - 1]) ** 2))


def require_carried(problem: Problem, modes: Sequence[int], order_offset: int) -> None:
    """Raise InputError for a mode that the microphones cannot carry at its order, one of them left out.

    Parameters
    ----------
    modes : (P,) int, counted from 1
    order_offset : added to ceil(k R)
    """
    if problem.search is None:
        raise InputError("the measurement has no search domain", "give <search> and <radius>", key="search")
    for mode in modes:
        L = int(max_order(problem.wavenumbers[mode - 1], problem.search.radius, order_offset))
        if functions(problem, L) >= problem.pressures.shape[1]:
            raise InputError(
                f"mode {mode} at {problem.frequencies[mode - 1]:.4g} Hz has order {L}, that is {functions(problem, L)}"
                f" functions for {problem.pressures.shape[1]} microphones",
                "use a lower order or lower modes",
                key="order_offset",
                value=order_offset,
            )


@functools.lru_cache(maxsize=8)
def expansion_of(problem: Problem, order_offset: int) -> FieldExpansion:
    """Return the expansion of a problem, whose tables serve all maps."""
    return FieldExpansion(problem, order_offset)


def fits_and_rows(
    pressures, scale, expansion: FieldExpansion, x: np.ndarray, n: int, points: np.ndarray, group: np.ndarray
):
    """Return the fit of each mode of a group without microphone `n`, and its rows of W at some points.

    Parameters
    ----------
    pressures : (M, N) complex128, of all modes
    scale : (N,) float64, of the rows, so that all channels have equal noise
    expansion : FieldExpansion
    x : (N, D) float64, positions, metres
    n : int, microphone
    points : (C, D) float64, metres
    group : (B,) int, modes of one order, indices of `expansion.carried`

    Returns
    -------
    list of B LeaveOneOutFit, and (B, C, K) complex128
    """
    centre = x.mean(axis=0)
    rows = expansion.rows(np.concatenate([x, points]), centre, group)
    dictionaries = scale[:, None] * rows[:, : len(x)]
    fits = leave_one_out_fits(list(dictionaries), pressures[expansion.carried.modes[group]], n)
    return fits, scale[n] * rows[:, len(x) :]


def map_of(fit: LeaveOneOutFit, rows: np.ndarray, shape: tuple[int, ...], onto: list[np.ndarray]) -> np.ndarray:
    """Return the cost of one mode on a lattice from the rows of W at the nodes : (ny, nx) float64.

    Parameters
    ----------
    fit : LeaveOneOutFit
    rows : (C, K) complex128
    shape : numbers of nodes along x and y
    onto : for x and y, the matrix of `from_nodes`
    """
    product = rows @ np.column_stack([fit.Z, fit.alpha])
    f, parts = product[:, -1], np.ascontiguousarray(product[:, :-1]).view(float)
    h = np.einsum("ij,ij->i", parts, parts)
    x_map, y_map = onto
    parts = np.stack([h, np.real(f), np.imag(f)]).reshape(3, *shape[::-1])
    h, re, im = y_map @ (parts @ x_map.T)
    return fit.r0 + ((fit.p_n.real - re) ** 2 + (fit.p_n.imag - im) ** 2) / (1.0 + np.maximum(h, 0.0))
