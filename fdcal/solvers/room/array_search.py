"""Where microphones may be in a room of known size: lattices tried through, nothing refined.

One microphone, the loudest, is supposed at every place of a part of the room that the room's mirrors make the whole of.
With it the pressures at all other places are foretold up to what the diffuse model leaves open
(`fdcal.acoustics.room_modes`), so
that each other microphone is placed for itself: microphones x places, not places to the power of microphones.
"""

from __future__ import annotations

import numpy as np

from ...acoustics.room_modes import DiffuseModel, diffuse_model
from .fit import diffuse_terms, loudness

MODES = 30  # the lowest, of the search of arrays
PLACES_A_WAVE = 8  # lattice places in the shortest wavelength
MOST_PLACES = 8000  # of a lattice at most, which is coarser otherwise
OFF = 0.6  # lattice steps: how far a microphone may be from its place on the lattice
WIDTHS = 0.006, 0.04  # rad/m, of resonances, tried
CANDIDATES, ARRAYS = 6, 3  # of each width; those of them that are kept
BLOCK = 16  # places of the loudest microphone at a time
GIVEN = 12  # microphones that say where another one is
SWEEPS = 3  # of microphones put anew, at most


def lattice(size, step: float) -> list[np.ndarray]:
    """Coordinates along each axis of places about `step` apart, metres, the first half a step from the wall."""
    counts = [max(2, round(length / step)) for length in size]
    return [(np.arange(n) + 0.5) * length / n for n, length in zip(counts, size, strict=True)]


def places(axes: list[np.ndarray]) -> np.ndarray:
    """Every place (C, D) of a lattice, the last coordinate fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def step_of(wavenumbers, size) -> float:
    """Of the lattice, metres."""
    fine = 2 * np.pi / float(np.real(wavenumbers).max()) / PLACES_A_WAVE
    return max(fine, float(np.prod(size) / MOST_PLACES) ** (1 / len(size)))


def spread(noise, wavenumbers, D: int, far: float) -> np.ndarray:
    """Noise and what microphones `far` away, metres, add to it, of unit power."""
    return noise + np.minimum((np.real(wavenumbers) * far) ** 2 / D, 0.5)


def likeliest(pressures, noise, wavenumbers, size) -> list[tuple[float, np.ndarray]]:
    """Widths of resonances, rad/m, and arrays (N, D), metres, the likeliest first.

    pressures (M, N) complex128 of unit RMS; noise (M,)
    """
    p, k = pressures[:MODES], wavenumbers[:MODES]
    between = step_of(k, size)
    noise = spread(noise[:MODES], k, len(size), OFF * between)
    everywhere, part = (places(lattice(np.asarray(size) / parts, between)) for parts in (1, 2))
    found = []
    for width in WIDTHS:
        there = Places(everywhere, p, noise, diffuse_model(size, k, width))
        found += [(there.cost(x), width, x, there) for x in there.arrays(part, CANDIDATES)]
    found.sort(key=lambda one: one[0])
    better = {}
    for _, width, x, there in found[:ARRAYS]:
        x = there.rehomed(x)
        better[x.tobytes()] = there.cost(x), width, x
    return [one[1:] for one in sorted(better.values(), key=lambda one: one[0])]


class Places:
    """Places (C, D), metres, and what is the same of the first model at them, whatever is supposed."""

    def __init__(self, where: np.ndarray, pressures, noise, model: DiffuseModel):
        self.where, self.p, self.noise, self.model = where, pressures, noise, model
        self.weights = loudness(pressures, noise)[:, None] * model.weights  # (M, E)
        self.shapes = model.shapes(where)
        self.own = self.weights @ self.shapes.T**2 + noise[:, None]  # (M, C)

    def cost(self, positions) -> float:
        """Of an array (N, D)."""
        return diffuse_terms(positions.ravel(), self.p, self.noise, self.model).cost

    def others(self, supposed, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Least cost (B,) with microphone `first` at each of `supposed` (B, D), and the places of all (B, N)."""
        here, squares = self.model.shapes(supposed), np.abs(self.p) ** 2
        mine = (self.weights @ here.T**2 + self.noise[:, None])[..., None]  # (M, B, 1)
        shared = (here * self.weights[:, None]) @ self.shapes.T  # (M, B, C)
        foretold = shared / mine
        variance = self.own[:, None] - shared * foretold
        loud, together = squares[:, first, None, None], np.real(self.p.conj() * self.p[:, first, None])
        costs = np.sum(np.log(variance) + loud * foretold**2 / variance, axis=0)
        costs = costs + np.tensordot(squares.T, 1 / variance, 1)  # (N, B, C)
        costs -= 2 * np.tensordot(together.T, foretold / variance, 1)
        costs[first] = np.sum(np.log(mine) + loud / mine, axis=0)
        return costs.min(axis=2).sum(axis=0), costs.argmin(axis=2).T

    def costs(self, positions, n: int, most: int | None = None) -> np.ndarray:
        """-log of the probability density of microphone `n` at each place, given all others or `most` : (M, C)."""
        others = np.delete(np.arange(len(positions)), n)
        if most is not None and len(others) > most:
            others = others[np.linspace(0, len(others) - 1, most).astype(int)]
        W = self.model.shapes(positions[others])
        weighted = W * self.weights[:, None]  # (M, N - 1, E)
        C = weighted @ W.T + self.noise[:, None, None] * np.eye(len(W))
        c = self.shapes @ weighted.transpose(0, 2, 1)  # (M, C, N - 1)
        t = c @ np.linalg.inv(C)
        variance = self.own - np.sum(t * c, axis=2)
        foretold = (t @ self.p[:, others, None])[..., 0]
        return np.log(variance) + np.abs(self.p[:, n, None] - foretold) ** 2 / variance

    def arrays(self, part, most: int) -> list[np.ndarray]:
        """The `most` likeliest arrays (N, D), the loudest microphone at a place of `part` (B, D), likeliest first."""
        first = int(np.argmax(np.sum(np.abs(self.p) ** 2 / self.weights.sum(axis=1)[:, None], axis=0)))
        blocks = [self.others(part[start : start + BLOCK], first) for start in range(0, len(part), BLOCK)]
        costs, found = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        likeliest = np.argsort(costs, kind="stable")[:most]
        result = self.where[found[likeliest]]
        result[:, first] = part[likeliest]
        return list(result)

    def rehomed(self, positions) -> np.ndarray:
        """`positions` with one microphone after the other put where all the others say : (N, D)."""
        positions = np.array(positions)
        for _ in range(SWEEPS):
            before = positions.copy()
            for n in range(len(positions)):
                positions[n] = self.where[self.costs(positions, n, GIVEN).sum(axis=0).argmin()]
            if np.array_equal(before, positions):
                break
        return positions
