"""Search for the source in a room of known size, and for microphones once it is fitted: on lattices, exact model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...acoustics.room_modes import PointSourceModel, point_source_model, room_pressures
from ...model.validation import frozen_array
from ..bounds import check_deadline
from .array_search import lattice, lattice_points, step_of
from .state import SourceCandidate


@dataclass(frozen=True)
class SearchRules:
    """How the source is searched for.

    Attributes
    ----------
    finer : points of this lattice in a step of that of `array_search`
    unexplained : share of the power that a lattice leaves unexplained
    admittances : of the walls, that are tried with every place of the source
    apart : lattice steps between two places of the source at least
    better : a microphone is relocated to where it leaves less than this part of what it leaves now
    """

    finer: float = 1.5
    unexplained: float = 0.05
    admittances: tuple[float, ...] = (0.0, 0.01, 0.04)
    apart: float = 2.0
    better: float = 0.3


RULES = SearchRules()


def sources(positions, pressures, wavenumbers, size, most: int) -> list[SourceCandidate]:
    """Return the `most` likeliest places of the source, some lattice steps apart, the likeliest first.

    Parameters
    ----------
    positions : (N, D) float64, metres
    pressures : (M, N) complex128 of unit RMS
    wavenumbers : (M,) complex128, rad/m
    size : lengths of the room, metres
    most : int
    """
    step = step_of(wavenumbers, size) / RULES.finer
    axes = lattice(size, step)
    grid = lattice_points(axes)
    costs = [
        _source_costs(point_source_model(size, wavenumbers, beta), positions, pressures, axes)
        for beta in RULES.admittances
    ]
    least, which = np.min(costs, axis=0), np.argmin(costs, axis=0)
    chosen: list[int] = []
    for c in np.argsort(least, kind="stable").tolist():
        if all(np.linalg.norm(grid[c] - grid[other]) > RULES.apart * step for other in chosen):
            chosen.append(c)
        if len(chosen) == most:
            break
    return [SourceCandidate(frozen_array(grid[c], float), RULES.admittances[which[c]]) for c in chosen]


def _source_costs(room: PointSourceModel, positions, pressures, axes) -> np.ndarray:
    """Cost of the residual with a source of any strength at each point of a lattice : (C,) float64."""
    D = len(axes)
    shapes, along = room.shapes(positions), _along(room, axes)
    cost = np.zeros(np.prod([len(axis) for axis in axes]))
    for m, p in enumerate(pressures):
        T = np.broadcast_to(room.response[m], (len(positions), *room.response[m].shape))
        for a in range(D):
            T = T * shapes[a][m].reshape(len(positions), *(-1 if b == a else 1 for b in range(D)))
        g = _everywhere(T, along, m)
        power = np.sum(np.abs(p) ** 2)
        left = power - np.abs(p.conj() @ g) ** 2 / np.sum(np.abs(g) ** 2, axis=0)
        cost += len(p) * np.log(left / power + RULES.unexplained)
    return cost


def relocated(positions, walls, pressures, wavenumbers, size) -> np.ndarray:
    """Return the positions, with each microphone that fits far better elsewhere put there.

    Parameters
    ----------
    positions : (N, D) float64, metres
    walls : (D + 2,) float64, source, metres, and admittance, real and imaginary part
    pressures : (M, N) complex128 of unit RMS
    wavenumbers : (M,) complex128, rad/m
    size : lengths of the room, metres

    Returns
    -------
    (N, D) float64, metres
    """
    D = len(size)
    axes = lattice(size, step_of(wavenumbers, size) / RULES.finer)
    room = point_source_model(size, wavenumbers, complex(*walls[D:]))
    excited, along = room.excitation(walls[:D]), _along(room, axes)
    here = room_pressures(excited, room.shapes(positions))
    loud = np.sum(here.conj() * pressures, axis=1, keepdims=True) / np.sum(np.abs(here) ** 2, axis=1, keepdims=True)
    there = np.array([_everywhere(T[None], along, m)[0] for m, T in enumerate(excited)])  # (M, C)
    now = np.sum(np.abs(pressures - loud * here) ** 2, axis=0)
    fitted = loud * there
    costs = np.sum(np.abs(fitted) ** 2, axis=0)[:, None] - 2 * np.real(fitted.conj().T @ pressures)
    costs += np.sum(np.abs(pressures) ** 2, axis=0)
    better = costs.min(axis=0) < RULES.better * now
    return np.where(better[:, None], lattice_points(axes)[costs.argmin(axis=0)], positions)


def _along(room: PointSourceModel, axes) -> list[np.ndarray]:
    """Eigenfunctions along each axis at the coordinates of a lattice: D arrays (M, C_a, n_a)."""
    middle = np.asarray(room.size) / 2
    return [room.shapes(_on_axis(axis, a, middle))[a] for a, axis in enumerate(axes)]


def _everywhere(T, along, m: int) -> np.ndarray:
    """Sums over the eigenfunctions of mode m, with weights `T` (X, n_1, ..., n_D), at each lattice point : (X, C)."""
    check_deadline()
    for shape in along:  # each contraction takes the first of the axes left and puts the points last
        T = np.tensordot(T, shape[m], axes=(1, 1))
    return T.reshape(len(T), -1)


def _on_axis(axis: np.ndarray, a: int, middle: np.ndarray) -> np.ndarray:
    """Points (C, D) along axis `a`, in the middle of the other axes."""
    points = np.tile(middle, (len(axis), 1))
    points[:, a] = axis
    return points
