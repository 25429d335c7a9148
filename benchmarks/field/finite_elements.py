"""Rooms of other shapes with absorbing walls, by finite elements of degree 4 (scikit-fem).

The field of the source in free space is subtracted, so that the part that is solved for is smooth. A room is solved
once; its solutions are kept in a folder.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.special import hankel2

from .constants import SOUND_SPEED

MODES = 60  # eigenfrequencies of a room
APART = 0.5  # Hz between two eigenfrequencies that are both used


@dataclass(frozen=True)
class Shape:
    """A room: the cells of a tensor grid that are kept, then warped, so that walls are slanted.

    size : lengths of the grid, metres; keep(x, y) and warp(x, y) in metres; admittance(x, y) : specific, dimensionless;
    source, centre : (x, y) of the source and of the arrays, metres; damping : 1/s
    """

    size: tuple[float, float]
    keep: Callable
    warp: Callable
    admittance: Callable
    source: tuple[float, float]
    centre: tuple[float, float]
    damping: float = 0.0
    cell: float = 0.25  # metres


SHAPES = {
    "L": Shape(
        (7.0, 6.0),
        lambda x, y: ~((x > 4) & (y > 3.5)),
        lambda x, y: (x + 0.05 * y, y - 0.06 * x + 0.01 * x * y),
        lambda x, y: 0.01 + 0 * x,
        (6.2, 1.0),
        (2.2, 2.2),
        damping=3.0,
    ),
    "U": Shape(
        (7.5, 6.0),
        lambda x, y: ~((x > 2.5) & (x < 5.0) & (y > 3.0)),
        lambda x, y: (x - 0.07 * y, y + 0.08 * x - 0.01 * x * y),
        lambda x, y: np.where(x < 1.0, 0.15, 0.02),
        (6.0, 4.8),
        (2.0, 2.2),
    ),
}


class FiniteElementRoom:
    """Matrices of a room; `solve` gives the smooth part of the field of its source at one wavenumber."""

    def __init__(self, shape: Shape):
        from skfem import Basis, BilinearForm, FacetBasis, MeshTri
        from skfem.element import ElementTriP4
        from skfem.helpers import dot, grad

        counts = [int(np.ceil(length / shape.cell)) for length in shape.size]
        sides = (np.linspace(0, length, n + 1) for length, n in zip(shape.size, counts, strict=True))
        mesh = MeshTri.init_tensor(*sides)
        middle = mesh.p[:, mesh.t].mean(axis=1)
        mesh = mesh.restrict(np.flatnonzero(shape.keep(middle[0], middle[1])))
        mesh = MeshTri(np.array(shape.warp(mesh.p[0], mesh.p[1])), mesh.t)
        element = ElementTriP4()
        self.shape = shape
        self.basis, self.walls = Basis(mesh, element, intorder=9), FacetBasis(mesh, element, intorder=9)
        self.stiffness = BilinearForm(lambda u, v, w: dot(grad(u), grad(v))).assemble(self.basis)
        self.mass = BilinearForm(lambda u, v, w: u * v).assemble(self.basis)
        self.absorption = BilinearForm(lambda u, v, w: shape.admittance(w.x[0], w.x[1]) * u * v).assemble(self.walls)

    def solve(self, k: complex) -> np.ndarray:
        """Return the smooth part of the field at wavenumber `k`, rad/m : (degrees of freedom,) complex128."""
        from scipy.sparse.linalg import splu

        system = (self.stiffness - k**2 * self.mass + 1j * k * self.absorption).tocsc().astype(complex)
        load = self._load(k, np.real) + 1j * self._load(k, np.imag)
        options = dict(SymmetricMode=True)
        return splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options=options).solve(load)

    def _load(self, k: complex, part) -> np.ndarray:
        from skfem import LinearForm

        source, admittance = np.asarray(self.shape.source), self.shape.admittance

        def form(v, w):
            d = w.x - source[:, None, None]
            r = np.sqrt((d**2).sum(axis=0))
            free = -0.25j * hankel2(0, k * r)
            slope = 0.25j * k * hankel2(1, k * r) * (d[0] * w.n[0] + d[1] * w.n[1]) / r
            return -part(slope + 1j * k * admittance(w.x[0], w.x[1]) * free) * v

        return LinearForm(form).assemble(self.walls)

    def pressures(self, points, wavenumbers, solutions) -> np.ndarray:
        """Return the pressures at `points` (N, 2), metres, of solutions of `solve` : (M, N) complex128."""
        points = np.asarray(points, float)
        probes = self.basis.probes(points.T)
        r = np.linalg.norm(points - np.asarray(self.shape.source), axis=1)
        return np.array([probes @ u - 0.25j * hankel2(0, k * r) for u, k in zip(solutions, wavenumbers, strict=True)])

    def eigenfrequencies(self) -> np.ndarray:
        """Return the lowest MODES frequencies of the room without absorption, Hz, those closer than APART once."""
        from scipy.sparse.linalg import eigsh

        squares = np.sort(eigsh(self.stiffness, MODES + 2, self.mass, sigma=0.5, return_eigenvectors=False))
        frequencies = np.sqrt(squares[1 : MODES + 1]) * SOUND_SPEED / (2 * np.pi)
        return frequencies[np.r_[True, np.diff(frequencies) > APART]]


@dataclass(frozen=True)
class SolvedRoom:
    """A room with its solutions: frequencies (M,) Hz, wavenumbers (M,) rad/m, solutions (M, degrees of freedom)."""

    room: FiniteElementRoom
    frequencies: np.ndarray
    wavenumbers: np.ndarray
    solutions: np.ndarray


@cache
def solved_room(name: str, folder: Path) -> SolvedRoom:
    """Return room `name` of SHAPES, solved now or before into `folder`."""
    shape, path = SHAPES[name], folder / f"finite_elements_{name}.npz"
    room = FiniteElementRoom(shape)
    if not path.exists():
        frequencies = room.eigenfrequencies()
        wavenumbers = (2 * np.pi * frequencies - 1j * shape.damping) / SOUND_SPEED
        folder.mkdir(parents=True, exist_ok=True)
        solutions = np.array([room.solve(k) for k in wavenumbers])
        np.savez(path, frequencies=frequencies, wavenumbers=wavenumbers, solutions=solutions)
    with np.load(path) as kept:
        return SolvedRoom(room, *(kept[key] for key in ("frequencies", "wavenumbers", "solutions")))
