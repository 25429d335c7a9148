"""Cost maps for display: the cost of moving one microphone, mode by mode, at the resolution of a screen.

    mode_shape       the sound field of one mode, as the microphones recorded it
    cost_maps        what the page shows: Eq. 7 at a fixed order, or the cost of the solver
    power_shares     weights with which maps of single modes add up to that of all of them
    mode_landscapes  costs of single modes over the search lattice, as the running solver computes them
    refined          the same domain with a lattice as fine as the screen
    local_minima     minima of a map that are deeper than its ripple
    interpolate      the value of a map between its points

The formula is `fdcal.cost.lattice_search.candidate_costs`, on a fine lattice with the radial functions of
`fdcal.cost.fine_lattice`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..acoustics.fourier_bessel import fourier_bessel, max_order
from ..model.problem import Problem
from ..model.settings import Search
from ..model.validation import InputError
from .channel_correction import ChannelCorrection, equalised
from .eq7 import coefficients, known_weights, leave_one_out_fits
from .eq7_maps import eq7_maps
from .fine_lattice import OneModeLattice

FINE = 500  # points along the longer edge of a fine map
DEPTH = 1e-3  # least prominence of a local minimum, as a share of the map's range


def mode_landscapes(problem: Problem, solver, state, n: int, modes: Sequence[int]) -> np.ndarray:
    """Return the cost of each of `modes` with microphone `n` moved over the search lattice.

    Parameters
    ----------
    solver : module of the solver that `state` belongs to; its `landscape` defines the cost
    modes : (P,) int, counted from 1

    Returns
    -------
    (P, ny, nx) float64

    Raises
    ------
    InputError
        As `solver.landscape` does, for example without a search domain.
    """
    low, high = min(modes), max(modes)
    maps = solver.landscape(problem, state, n, slice(low - 1, high))
    return maps[np.asarray(modes) - low]


def cost_maps(
    problem: Problem,
    solver,
    state,
    n: int,
    modes: Sequence[int],
    order_offset: int | None,
    search: Search | None = None,
) -> np.ndarray:
    """Return the maps that the page shows: Eq. 7 at a fixed order, or what the solver minimises.

    Parameters
    ----------
    solver, state, modes : as of `mode_landscapes`
    order_offset : added to ceil(k R); None for the cost of the solver
    search : lattice; that of the search domain unless given

    Returns
    -------
    (P, ny, nx) float64; of Eq. 7 relative to the power of the pressures of these modes

    Raises
    ------
    InputError
        As of `eq7_maps` and `solver.landscape`.
    """
    if order_offset is not None:
        return eq7_maps(problem, state.positions, n, modes, order_offset, search, state.channels)
    if search is None:
        return mode_landscapes(problem, solver, state, n, modes)
    return np.stack([fine_landscape(problem, solver, state, n, mode, search) for mode in modes])


def power_shares(problem: Problem, state, modes: Sequence[int]) -> np.ndarray:
    """Return the power of each of `modes`, counted from 1, as a share of that of all of them : (P,) float64.

    With these weights, maps of Eq. 7 of single modes (`cost_maps`) add up to that of all modes.
    """
    pressures, _ = equalised(problem.pressures[np.asarray(modes) - 1], state.channels)
    power = np.sum(np.abs(pressures) ** 2, axis=1)
    return power / power.sum()


def fine_landscape(problem: Problem, solver, state, n: int, mode: int, search: Search) -> np.ndarray:
    """Return the cost of one mode with microphone `n` moved over any lattice of the search domain's area.

    Parameters
    ----------
    solver, state : as of `mode_landscapes`
    mode : counted from 1
    search : the lattice. For Eq. 7 the centre of the expansion is its point nearest to the centre of `state`.

    Returns
    -------
    (ny, nx) float64
    """
    if state.landscape_takes_lattice:
        return solver.landscape(problem, state, n, slice(mode - 1, mode), search)[0]
    from .lattice_search import FitTables, candidate_costs  # compiled code, loaded with the first map

    k = complex(problem.wavenumbers[mode - 1])
    L = int(max_order(problem.wavenumbers[mode - 1 : mode], search.radius, state.order_offset)[0])
    lattice = OneModeLattice(search, k, L)
    centre = lattice.nearest(state.centre)
    W = fourier_bessel(np.asarray(state.positions), k, L, centre)
    weights = known_weights(problem, state.settings.known_weight)
    fits = leave_one_out_fits([W], problem.pressures[mode - 1 : mode], n, weights=weights)
    return candidate_costs(lattice, centre, slice(0, 1), FitTables.of(fits)).reshape(lattice.shape)


def mode_shape(
    problem: Problem, positions, mode: int, order_offset: int, channels: ChannelCorrection | None = None
) -> np.ndarray:
    """Return the pressure of one mode over the search lattice, reconstructed from the microphones and scaled to 1.

    It is the real part of W alpha (Eq. 6) at the phase with most pressure. It matches the room among the microphones
    and where the positions are right.

    Parameters
    ----------
    positions : (N, 2) float64, metres
    mode : counted from 1
    order_offset : added to the order of Eq. 3
    channels : gains and noise that the solver estimates; None for the pressures as recorded

    Returns
    -------
    (ny, nx) float64, dimensionless, largest magnitude 1

    Raises
    ------
    InputError
        The field is not two-dimensional, or there is no search domain.
    """
    search = problem.search
    if problem.dimension != 2 or search is None:
        raise InputError(
            "the shape of a mode needs a two-dimensional field and a search domain",
            "give <search> and <radius>",
            key="search",
        )
    positions, k = np.asarray(positions, float), problem.wavenumbers[mode - 1]
    most = (len(positions) - 2) // 2  # 2L + 1 functions (Eq. 8) for fewer than N microphones
    L = min(int(max_order(k[None], search.radius, order_offset)[0]), most)
    centre = positions.mean(axis=0)
    p, scale = equalised(problem.pressures[mode - 1 : mode], channels)
    alpha = coefficients(scale[:, None] * fourier_bessel(positions, complex(k), L, centre), p[0])
    x, y = (o + search.step * np.arange(n) for o, n in zip(search.origin, search.shape, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    field = fourier_bessel(points, complex(k), L, centre) @ alpha
    field = np.real(field * np.exp(-0.5j * np.angle(np.sum(field**2))))
    field /= field[np.abs(field).argmax()]
    return field.reshape(len(y), len(x))


def refined(search: Search, count: int = FINE) -> Search:
    """Return a finer lattice of the same area, the cells at its edge included; in space of one layer of it.

    Parameters
    ----------
    count : points along the longer edge
    """
    step = search.step * max(search.shape[:2]) / count
    corner = np.subtract(search.origin[:2], search.step / 2)
    numbers = [max(round(search.step * n / step), 2) for n in search.shape[:2]]
    origin = (*(float(x) for x in corner + step / 2), *search.origin[2:])
    size = (*((n - 1) * step for n in numbers), *(step for _ in search.origin[2:]))
    return replace(search, origin=origin, size=size, step=step)


def local_minima(cost: np.ndarray, depth: float = DEPTH) -> np.ndarray:
    """Return the local minima of a map, the lowest first.

    A minimum counts where its prominence, the climb out of it to a lower one, exceeds `depth` of the map's range: a
    valley oblique to the lattice has a string of shallower ones. Minima at the edge do not count, because the cost
    beyond it is unknown.

    Parameters
    ----------
    cost : (ny, nx) float64, or (nz, ny, nx) of a volume
    depth : least prominence as a share of the map's range

    Returns
    -------
    (K, 2) int64, rows and columns; (K, 3) of a volume, its layers first
    """
    from .watershed import prominent_minima

    indices = np.stack(np.unravel_index(prominent_minima(cost, depth * float(np.ptp(cost))), cost.shape), axis=1)
    return indices[np.all((indices > 0) & (indices < np.array(cost.shape) - 1), axis=1)]


def map_positions(indices: np.ndarray, search: Search) -> np.ndarray:
    """Return the positions of points of a map, or of a volume.

    Parameters
    ----------
    indices : (K, 2) int, rows and columns; (K, 3) of a volume, its layers first
    search : the lattice of the map or volume

    Returns
    -------
    (K, 2) float64, metres, x and y; (K, 3) of a volume
    """
    places = np.asarray(indices)[:, ::-1]
    return np.asarray(search.origin)[: places.shape[1]] + search.step * places


def interpolate(cost: np.ndarray, search: Search, point) -> float:
    """Return the value of a map at a point, by bilinear interpolation; outside, that of the nearest edge.

    Parameters
    ----------
    cost : (ny, nx) float64, over `search`
    point : (2,) or (3,) float64, metres
    """
    place = (np.asarray(point, float)[:2] - search.origin[:2]) / search.step
    x, y = np.clip(place, 0, np.array(cost.shape[::-1]) - 1)
    i, j = min(int(x), cost.shape[1] - 2), min(int(y), cost.shape[0] - 2)
    u, v = x - i, y - j
    low, high = cost[j, i : i + 2] @ [1 - u, u], cost[j + 1, i : i + 2] @ [1 - u, u]
    return float((1 - v) * low + v * high)
