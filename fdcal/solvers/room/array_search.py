"""Search for arrays in a room of known size: candidates on a lattice, without refinement.

The loudest microphone is placed at every point of a part of the room of which the whole is made by reflections. With
it the diffuse model (`fdcal.acoustics.room_modes`) predicts the pressures at all other points, so that every other
microphone is placed by itself: the effort is microphones x points, not points to the power of microphones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...acoustics.room_modes import DiffuseModel, diffuse_model
from ...model.validation import frozen_array
from ..bounds import check_deadline
from .fit import diffuse_terms, field_power
from .state import ArrayCandidate


@dataclass(frozen=True)
class SearchRules:
    """How arrays are searched for.

    Attributes
    ----------
    modes : lowest modes that are used
    points_a_wave : lattice points in the shortest wavelength
    points : points of a lattice at most; it is coarser otherwise
    off : lattice steps that a microphone may be from its lattice point
    widths : rad/m, half widths of resonances that are tried
    candidates : arrays that are kept for each width
    arrays : of those, arrays whose microphones are placed again
    block : places of the loudest microphone that are computed at a time
    neighbours : microphones that predict where another one is
    sweeps : sweeps at most, in which the microphones of an array are placed again
    """

    modes: int = 30
    points_a_wave: int = 8
    points: int = 8000
    off: float = 0.6
    widths: tuple[float, ...] = (0.006, 0.04)
    candidates: int = 6
    arrays: int = 3
    block: int = 16
    neighbours: int = 12
    sweeps: int = 3


RULES = SearchRules()


def lattice(size, step: float) -> list[np.ndarray]:
    """Return coordinates along each axis, metres, about `step` apart, the first half a step from the wall."""
    counts = [max(2, round(length / step)) for length in size]
    return [(np.arange(n) + 0.5) * length / n for n, length in zip(counts, size, strict=True)]


def lattice_points(axes: list[np.ndarray]) -> np.ndarray:
    """Return every point (C, D) of a lattice, metres, the last coordinate fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def step_of(wavenumbers, size) -> float:
    """Return the step of the lattice, metres, for wavenumbers (M,), rad/m, and a room of `size`, metres."""
    fine = 2 * np.pi / float(np.real(wavenumbers).max()) / RULES.points_a_wave
    return max(fine, float(np.prod(size) / RULES.points) ** (1 / len(size)))


def spread(noise, wavenumbers, D: int, error: float) -> np.ndarray:
    """Return noise (M,) and the power that position errors of `error` metres add to it, of unit power."""
    return noise + np.minimum((np.real(wavenumbers) * error) ** 2 / D, 0.5)


def likeliest(pressures, noise, wavenumbers, size) -> list[ArrayCandidate]:
    """Return array candidates, the likeliest first.

    Parameters
    ----------
    pressures : (M, N) complex128 of unit RMS
    noise : (M,) float64, noise's share of the power
    wavenumbers : (M,) complex128, rad/m
    size : lengths of the room, metres
    """
    p, k = pressures[: RULES.modes], wavenumbers[: RULES.modes]
    between = step_of(k, size)
    noise = spread(noise[: RULES.modes], k, len(size), RULES.off * between)
    everywhere, part = (lattice_points(lattice(np.asarray(size) / parts, between)) for parts in (1, 2))
    found = []
    for width in RULES.widths:
        points = LatticePoints(everywhere, p, noise, diffuse_model(size, k, width))
        found += [(points.cost(x), width, x, points) for x in points.arrays(part, RULES.candidates)]
    found.sort(key=lambda one: one[0])
    better = {}
    for _, width, x, points in found[: RULES.arrays]:
        x = points.relocated(x)
        better[x.tobytes()] = points.cost(x), ArrayCandidate(width, frozen_array(x, float))
    return [one[1] for one in sorted(better.values(), key=lambda one: one[0])]


class LatticePoints:
    """Points (C, D), metres, and what the diffuse model gives at them for any array."""

    def __init__(self, points: np.ndarray, pressures, noise, model: DiffuseModel):
        self.points, self.p, self.noise, self.model = points, pressures, noise, model
        self.weights = field_power(pressures, noise)[:, None] * model.weights  # (M, E)
        self.shapes = model.shapes(points)
        self.own = self.weights @ self.shapes.T**2 + noise[:, None]  # (M, C)

    def cost(self, positions) -> float:
        """Return the cost of an array (N, D) by the diffuse model."""
        return diffuse_terms(positions.ravel(), self.p, self.noise, self.model).cost

    def others(self, assumed, first: int) -> tuple[np.ndarray, np.ndarray]:
        """Return least costs (B,) with microphone `first` at each of `assumed` (B, D), and the points of all (B, N)."""
        check_deadline()
        here, squares = self.model.shapes(assumed), np.abs(self.p) ** 2
        mine = (self.weights @ here.T**2 + self.noise[:, None])[..., None]  # (M, B, 1)
        shared = (here * self.weights[:, None]) @ self.shapes.T  # (M, B, C)
        predicted = shared / mine
        variance = self.own[:, None] - shared * predicted
        loud, together = squares[:, first, None, None], np.real(self.p.conj() * self.p[:, first, None])
        costs = np.sum(np.log(variance) + loud * predicted**2 / variance, axis=0)
        costs = costs + np.tensordot(squares.T, 1 / variance, 1)  # (N, B, C)
        costs -= 2 * np.tensordot(together.T, predicted / variance, 1)
        costs[first] = np.sum(np.log(mine) + loud / mine, axis=0)
        return costs.min(axis=2).sum(axis=0), costs.argmin(axis=2).T

    def costs(self, positions, n: int, most: int | None = None) -> np.ndarray:
        """Return -log of the probability density of microphone `n` at each point, given the others : (M, C).

        `most` limits the number of the others.
        """
        check_deadline()
        others = np.delete(np.arange(len(positions)), n)
        if most is not None and len(others) > most:
            others = others[np.linspace(0, len(others) - 1, most).astype(int)]
        W = self.model.shapes(positions[others])
        weighted = W * self.weights[:, None]  # (M, N - 1, E)
        C = weighted @ W.T + self.noise[:, None, None] * np.eye(len(W))
        c = self.shapes @ weighted.transpose(0, 2, 1)  # (M, C, N - 1)
        t = c @ np.linalg.inv(C)
        variance = self.own - np.sum(t * c, axis=2)
        predicted = (t @ self.p[:, others, None])[..., 0]
        return np.log(variance) + np.abs(self.p[:, n, None] - predicted) ** 2 / variance

    def arrays(self, part, most: int) -> list[np.ndarray]:
        """Return the `most` likeliest arrays (N, D) with the loudest microphone at a point of `part` (B, D)."""
        first = int(np.argmax(np.sum(np.abs(self.p) ** 2 / self.weights.sum(axis=1)[:, None], axis=0)))
        blocks = [self.others(part[start : start + RULES.block], first) for start in range(0, len(part), RULES.block)]
        costs, found = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        likeliest = np.argsort(costs, kind="stable")[:most]
        result = self.points[found[likeliest]]
        result[:, first] = part[likeliest]
        return list(result)

    def relocated(self, positions) -> np.ndarray:
        """Return `positions` with one microphone after the other put where the others predict it : (N, D)."""
        positions = np.array(positions)
        for _ in range(RULES.sweeps):
            before = positions.copy()
            for n in range(len(positions)):
                positions[n] = self.points[self.costs(positions, n, RULES.neighbours).sum(axis=0).argmin()]
            if np.array_equal(before, positions):
                break
        return positions
