"""Where microphones and source may be in a room of known size: lattices tried through, nothing refined.

One microphone, the loudest, is supposed at every place of a part of the room that the room's mirrors make the whole of.
With it the pressures at all other places are foretold up to what the diffuse model leaves open (`fdcal.rectangle`), so
that each other microphone is placed for itself: microphones x places, not places to the power of microphones.
"""

from __future__ import annotations

import numpy as np

from ..rectangle import Diffuse, Echoing, echoing

PLACES_A_WAVE = 8  # lattice places in the shortest wavelength
BLOCK = 16  # places of the loudest microphone at a time
ROUGH = 0.05  # of the power, that a lattice leaves unexplained
ADMITTANCES = (0.0, 0.01, 0.04)  # tried with every place of the source
APART = 2.0  # lattice steps between two places of the source that are tried


def lattice(size, step: float) -> list[np.ndarray]:
    """Coordinates along each axis of places about `step` apart, metres, the first half a step from the wall."""
    counts = [max(2, round(length / step)) for length in size]
    return [(np.arange(n) + 0.5) * length / n for n, length in zip(counts, size, strict=True)]


def places(axes: list[np.ndarray]) -> np.ndarray:
    """Every place (C, D) of a lattice, the last coordinate fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def step_of(wavenumbers) -> float:
    """Of the lattice, metres."""
    return 2 * np.pi / float(np.real(wavenumbers).max()) / PLACES_A_WAVE


def arrays(pressures, noise, model: Diffuse, size, step: float, most: int) -> list[np.ndarray]:
    """The `most` likeliest arrays (N, D), metres, on the lattice, the likeliest first.

    pressures (M, N) complex128; noise (M,) with what the lattice adds to it
    """
    everywhere, part = places(lattice(size, step)), places(lattice(np.asarray(size) / 2, step))
    power = np.maximum(np.mean(np.abs(pressures) ** 2, axis=1) - noise, 1e-3 * np.mean(np.abs(pressures) ** 2, axis=1))
    first = int(np.argmax(np.sum(np.abs(pressures) ** 2 / power[:, None], axis=0)))
    there = model.shapes(everywhere)
    own = power * (there**2 @ model.weights.T) + noise  # (C, M)
    costs, found = [], []
    for start in range(0, len(part), BLOCK):
        cost, index = _others(pressures, power, noise, model, part[start : start + BLOCK], there, own, first)
        costs.append(cost)
        found.append(index)
    costs, found = np.concatenate(costs), np.concatenate(found)
    likeliest = np.argsort(costs, kind="stable")[:most]
    result = everywhere[found[likeliest]]
    result[:, first] = part[likeliest]
    return list(result)


def _others(p, power, noise, model: Diffuse, supposed, there, own, first: int) -> tuple[np.ndarray, np.ndarray]:
    """Least cost (B,) with microphone `first` at each of `supposed` (B, D), and the places of all (B, N)."""
    here = model.shapes(supposed)
    costs = np.zeros((len(supposed), p.shape[1], len(there)))
    for m, (s, v, w) in enumerate(zip(power, noise, model.weights, strict=True)):
        mine = s * (here**2 @ w) + v
        t = s * ((here * w) @ there.T)
        foretold = t / mine[:, None]
        variance = own[:, m] - t * foretold
        logarithm = np.log(variance)
        costs[:, first] += (np.log(mine) + np.abs(p[m, first]) ** 2 / mine)[:, None]
        for n in range(p.shape[1]):
            if n != first:
                costs[:, n] += logarithm + np.abs(p[m, n] - foretold * p[m, first]) ** 2 / variance
    return costs.min(axis=2).sum(axis=1), costs.argmin(axis=2)


def sources(positions, pressures, wavenumbers, size, step: float, most: int) -> list[tuple[np.ndarray, float]]:
    """The `most` likeliest places of the source (D,), metres, some steps apart, each with its admittance."""
    axes = lattice(size, step)
    grid = places(axes)
    costs = [_source_costs(echoing(size, wavenumbers, beta), positions, pressures, axes) for beta in ADMITTANCES]
    least, which = np.min(costs, axis=0), np.argmin(costs, axis=0)
    chosen: list[int] = []
    for c in np.argsort(least, kind="stable").tolist():
        if all(np.linalg.norm(grid[c] - grid[other]) > APART * step for other in chosen):
            chosen.append(c)
        if len(chosen) == most:
            break
    return [(grid[c], ADMITTANCES[which[c]]) for c in chosen]


def _source_costs(room: Echoing, positions, pressures, axes) -> np.ndarray:
    """What a source at each place of a lattice leaves of the pressures, whatever its loudness : (C,) float64."""
    D = len(axes)
    middle = np.asarray(room.size) / 2
    shapes = room.shapes(positions)
    along = [room.shapes(_on_axis(axis, a, middle))[a] for a, axis in enumerate(axes)]
    cost = np.zeros(np.prod([len(axis) for axis in axes]))
    for m, p in enumerate(pressures):
        T = np.broadcast_to(room.response[m], (len(positions), *room.response[m].shape))
        for a in range(D):
            T = T * shapes[a][m].reshape(len(positions), *(-1 if b == a else 1 for b in range(D)))
        for a in range(D):  # each contraction takes the first of the axes left and puts the places last
            T = np.tensordot(T, along[a][m], axes=(1, 1))
        g = T.reshape(len(positions), -1)
        power = np.sum(np.abs(p) ** 2)
        left = power - np.abs(p.conj() @ g) ** 2 / np.sum(np.abs(g) ** 2, axis=0)
        cost += len(p) * np.log(left / power + ROUGH)
    return cost


def _on_axis(axis: np.ndarray, a: int, middle: np.ndarray) -> np.ndarray:
    """Points (C, D) along axis `a`, elsewhere in the middle."""
    points = np.tile(middle, (len(axis), 1))
    points[:, a] = axis
    return points


def landscape(positions, n: int, points, pressures, noise, model: Diffuse) -> np.ndarray:
    """-log of the probability density of microphone `n` at each of `points` (C, D), given all others : (M, C)."""
    others = np.arange(len(positions)) != n
    W, there = model.shapes(positions[others]), model.shapes(points)
    costs = np.empty((len(pressures), len(points)))
    for m, (p, v, w) in enumerate(zip(pressures, noise, model.weights, strict=True)):
        C = (W * w) @ W.T + v * np.eye(len(W))
        c = (there * w) @ W.T
        t = np.linalg.solve(C, c.T).T
        variance = there**2 @ w + v - np.sum(t * c, axis=1)
        costs[m] = np.log(variance) + np.abs(p[n] - t @ p[others]) ** 2 / variance
    return costs - np.minimum(costs.min(axis=1, keepdims=True), 0.0)
