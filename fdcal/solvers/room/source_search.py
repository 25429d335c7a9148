"""Where the source may be in a room of known size, and microphones once it is fitted: lattices, on the exact model."""

from __future__ import annotations

import numpy as np

from ...acoustics.room_modes import PointSourceModel, point_source_model, room_pressures
from .array_search import lattice, places, step_of

FINER = 1.5  # times as fine as the lattice of microphones
ROUGH = 0.05  # of the power, that a lattice leaves unexplained
ADMITTANCES = (0.0, 0.01, 0.04)  # tried with every place of the source
APART = 2.0  # lattice steps between two places of the source that are tried
BETTER = 0.3  # of what a microphone's place leaves unexplained: a place that leaves less is taken


def sources(positions, pressures, wavenumbers, size, most: int) -> list[tuple[np.ndarray, float]]:
    """The `most` likeliest places of the source (D,), metres, some steps apart, each with its admittance."""
    step = step_of(wavenumbers, size) / FINER
    axes = lattice(size, step)
    grid = places(axes)
    costs = [
        _source_costs(point_source_model(size, wavenumbers, beta), positions, pressures, axes) for beta in ADMITTANCES
    ]
    least, which = np.min(costs, axis=0), np.argmin(costs, axis=0)
    chosen: list[int] = []
    for c in np.argsort(least, kind="stable").tolist():
        if all(np.linalg.norm(grid[c] - grid[other]) > APART * step for other in chosen):
            chosen.append(c)
        if len(chosen) == most:
            break
    return [(grid[c], ADMITTANCES[which[c]]) for c in chosen]


def _source_costs(room: PointSourceModel, positions, pressures, axes) -> np.ndarray:
    """What a source at each place of a lattice leaves of the pressures, whatever its loudness : (C,) float64."""
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
        cost += len(p) * np.log(left / power + ROUGH)
    return cost


def put_anew(positions, walls, pressures, wavenumbers, size) -> np.ndarray:
    """`positions` (N, D), those of microphones that the fitted source explains far better elsewhere put there.

    walls : (D + 2,) source, metres, and admittance;  pressures : (M, N) of unit RMS
    """
    D = len(size)
    axes = lattice(size, step_of(wavenumbers, size) / FINER)
    room = point_source_model(size, wavenumbers, complex(*walls[D:]))
    excited, along = room.excitation(walls[:D]), _along(room, axes)
    here = room_pressures(excited, room.shapes(positions))
    loud = np.sum(here.conj() * pressures, axis=1, keepdims=True) / np.sum(np.abs(here) ** 2, axis=1, keepdims=True)
    there = np.array([_everywhere(T[None], along, m)[0] for m, T in enumerate(excited)])  # (M, C)
    now = np.sum(np.abs(pressures - loud * here) ** 2, axis=0)
    fitted = loud * there
    costs = np.sum(np.abs(fitted) ** 2, axis=0)[:, None] - 2 * np.real(fitted.conj().T @ pressures)
    costs += np.sum(np.abs(pressures) ** 2, axis=0)
    better = costs.min(axis=0) < BETTER * now
    return np.where(better[:, None], places(axes)[costs.argmin(axis=0)], positions)


def _along(room: PointSourceModel, axes) -> list[np.ndarray]:
    """Eigenfunctions along each axis at a lattice's coordinates: D arrays (M, C_a, n_a)."""
    middle = np.asarray(room.size) / 2
    return [room.shapes(_on_axis(axis, a, middle))[a] for a, axis in enumerate(axes)]


def _everywhere(T, along, m: int) -> np.ndarray:
    """Sums over eigenfunctions of frequency m at each place of a lattice, of `T` (X, n_1, ..., n_D) : (X, C)."""
    for shape in along:  # each contraction takes the first of the axes left and puts the places last
        T = np.tensordot(T, shape[m], axes=(1, 1))
    return T.reshape(len(T), -1)


def _on_axis(axis: np.ndarray, a: int, middle: np.ndarray) -> np.ndarray:
    """Points (C, D) along axis `a`, elsewhere in the middle."""
    points = np.tile(middle, (len(axis), 1))
    points[:, a] = axis
    return points
