"""Rectangular and box-shaped rooms of known size: their modes, the field as a sum over them, and their symmetries.

Two models of the pressures p of one source at microphones x; at each frequency m its amplitude and phase are unknown:

    diffuse   C_m = s_m sum_e w_me psi_e(x) psi_e(x') + v_m I,    w_me ~ 1 / |kappa_e^2 - k_m^2|^2
    source    p_m = A_m sum_e D_me psi_e(x) psi_e(x_s),    D_me = exp(-(kappa_e^2 - k_m^2) tau) / (kappa_e^2 - k_m^2)

    kappa_e^2   eigenvalue, the sum of kappa^2 along each axis, rad^2/m^2
    psi_e       eigenfunction, the product of one along each axis, of unit mean square in a rigid room
    k           wavenumber, rad/m, time sign exp(+j w t)
    h           j k beta, outwards dp/dn = -h p at the walls; beta the specific admittance, the same on all walls
    tau         m^2: the exponential is the room's heat kernel; it makes the sum converge fast, and the sum is exact
                at distances above about 6 sqrt(tau) from the source

C is the covariance of p. The diffuse model does not depend on the source position: the modes near the frequency have
independent random amplitudes. A search starts with it; its walls are rigid. The point-source model is exact, also for
absorbing walls, as far as beta describes them.

The number N of modes below f, and the number n of frequencies in 1 Hz that carry independent information:

    N(f)  = 4 pi/3 V (f/c)^3 + pi/4 S (f/c)^2 + L/8 f/c    in a box (Kuttruff, Room Acoustics, ch. 3)
    N(f)  = pi A (f/c)^2 + P/2 f/c                         in a rectangle of two dimensions
    n(f)  = min(dN/df, T60 / 2.2)                          independent frequencies in 1 Hz

V, S, L, A, P: volume, surface, sum of the edges; area and perimeter. 2.2 / T60 is the width of a resonance at -3 dB,
Hz: where resonances overlap (Schroeder 1962), pressures at two frequencies closer than that are not independent.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..model.validation import InputError, Numbers, Reals

RESONANCE_WIDTH = 2.2  # times 1 / T60, Hz
MAX_FREQUENCIES = 1_000_000  # of a band: more are a mistake, and would fill the memory


def mode_count(size: Sequence[float] | Reals, frequencies: ArrayLike, sound_speed: float) -> np.ndarray:
    """Return the mean number of modes of a room of `size` (2,) or (3,), metres, below frequencies (F,), Hz : (F,)."""
    ratio = np.asarray(frequencies, float) / sound_speed
    if len(size) == 2:
        return np.pi * size[0] * size[1] * ratio**2 + sum(size) * ratio
    x, y, z = size
    surface, edges = 2 * (x * y + y * z + z * x), 4 * (x + y + z)
    return 4 * np.pi / 3 * x * y * z * ratio**3 + np.pi / 4 * surface * ratio**2 + edges / 8 * ratio


def independent_frequencies(
    low: float, high: float, reverberation_time: float, sound_speed: float, size: Sequence[float] | None = None
):
    """Return frequencies, Hz, from `low` to `high`, that a source in the room excites independently : (M,), ascending.

    `size`: lengths of the room, metres; without it resonances are assumed to overlap everywhere.
    """
    grid = np.linspace(low, high, 4000)
    count = (grid - low) * reverberation_time / RESONANCE_WIDTH
    if size is not None:
        slope = np.gradient(mode_count(size, grid, sound_speed), grid)
        rate = np.minimum(slope, reverberation_time / RESONANCE_WIDTH)
        count = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(grid))])
    if count[-1] > MAX_FREQUENCIES:
        problem = f"{low:g} to {high:g} Hz with a reverberation time of {reverberation_time:g} s hold {count[-1]:.2g}"
        remedy = "use a narrower band (<frequencies>) or a shorter reverberation time"
        raise InputError(f"{problem} independent frequencies", remedy, key="frequencies")
    return np.interp(np.arange(0.5, count[-1]), count, grid)


@dataclass(frozen=True)
class RoomSymmetry:
    """A symmetry of a room, which leaves all pressures in it unchanged."""

    size: tuple[float, ...]  # (D,) float, metres
    order: tuple[int, ...]  # (D,) int, axis that each coordinate is taken from
    flipped: tuple[bool, ...]  # (D,) bool, whether a coordinate is counted from the far wall

    def apply(self, points: Reals) -> np.ndarray:
        """Return `points` (..., D), metres, mirrored and with axes exchanged."""
        points = np.asarray(points, float)[..., self.order]
        return np.where(self.flipped, np.asarray(self.size) - points, points)

    def __str__(self) -> str:
        names = ["xyz"[a] for a in self.order]
        parts = [f"{s:g} - {n}" if f else n for n, s, f in zip(names, self.size, self.flipped, strict=True)]
        return f"({', '.join(parts)})"


def room_symmetries(size: Sequence[float]) -> list[RoomSymmetry]:
    """Return the symmetries of a room (D,), metres, the identity first: mirror images, equal axes exchanged."""
    D = len(size)
    orders = [o for o in itertools.permutations(range(D)) if all(size[a] == size[b] for a, b in enumerate(o))]
    flips = itertools.product((False, True), repeat=D)
    return [RoomSymmetry(tuple(size), order, flipped) for flipped, order in itertools.product(flips, orders)]


def nearest_symmetry(points: Reals, to: Reals, size: Sequence[float]) -> RoomSymmetry:
    """Return the symmetry of a room that brings points (N, D), metres, closest to those in `to` (least squares)."""
    return min(room_symmetries(size), key=lambda image: float(np.sum((image.apply(points) - to) ** 2)))


@dataclass(frozen=True)
class Truncation:
    """Limits of the sums over modes."""

    # exact_from_2d, exact_from_3d: distance from the source from which the point-source model is exact, metres
    exact_from_2d: float = 0.7
    exact_from_3d: float = 1.0
    exact_from_tau: float = 6.0  # the same distance in units of sqrt(tau)
    decay: float = 9.2  # nepers by which the first omitted mode of the point-source model has decayed
    smallest_difference: float = 1e-12  # least abs(kappa^2 - k^2), which may vanish at a nominal resonance, 1/m^2
    # highest wavenumber of a mode of the diffuse model, relative to the highest wavenumber measured
    diffuse_range: float = 1.6
    newton_steps: int = 12  # iterations for the eigenvalues between absorbing walls, at most

    def tau(self, dimension: int) -> float:
        """Return tau of the point-source model, m^2."""
        return ((self.exact_from_2d if dimension == 2 else self.exact_from_3d) / self.exact_from_tau) ** 2


TRUNCATION = Truncation()


@dataclass(frozen=True)
class DiffuseModel:
    """The diffuse model of a rigid room."""

    kappa: np.ndarray  # (E, D) float64, wavenumber of every mode along each axis, rad/m
    gains: np.ndarray  # (E,) float64, a factor sqrt(2) for every axis along which the mode varies
    weights: np.ndarray  # (M, E) float64 w, of sum 1 for each frequency.

    def shapes(self, points: Reals) -> np.ndarray:
        """Return the mode shapes psi at `points` (C, D), metres : (C, E) float64."""
        return self.gains * np.prod(np.cos(np.asarray(points)[:, None] * self.kappa), axis=2)

    def slopes(self, points: Reals) -> np.ndarray:
        """Return d psi / dx along each axis at `points` (C, D), metres : (D, C, E) float64, 1/m."""
        phase = np.asarray(points)[:, None] * self.kappa
        cos, slope = np.cos(phase), -self.kappa * np.sin(phase)
        axes = range(self.kappa.shape[1])
        parts = [[slope if a == b else cos for b in axes] for a in axes]
        return np.array([self.gains * np.prod([parts[a][b][..., b] for b in axes], axis=0) for a in axes])


def diffuse_model(size: Sequence[float] | Reals, wavenumbers: Numbers, width: float) -> DiffuseModel:
    """Return the diffuse model of a room of `size` (D,), metres; `width`: half the width of a resonance, rad/m."""
    k = np.asarray(wavenumbers, complex)
    top = TRUNCATION.diffuse_range * float(np.real(k).max())
    counts = [int(top * length / np.pi) + 1 for length in size]  # of half waves along each axis
    numbers = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(size))
    kappa = np.pi * numbers / np.asarray(size)
    kept = np.sum(kappa**2, axis=1) < top**2
    kappa, numbers = kappa[kept], numbers[kept]
    apart = np.abs(np.sum(kappa**2, axis=1) - k[:, None] ** 2) ** 2 + (2 * np.real(k)[:, None] * width) ** 2
    weights = 1 / apart
    gains = np.sqrt(2.0) ** np.sum(numbers > 0, axis=1)
    return DiffuseModel(kappa, gains, weights / weights.sum(axis=1, keepdims=True))


@dataclass(frozen=True)
class PointSourceModel:
    """The point-source model: the room's response at its wavenumbers."""

    size: tuple[float, ...]  # (D,) float, metres
    kappa: tuple[np.ndarray, ...]  # D arrays (M, n_a) complex128, wavenumbers of the modes along each axis, rad/m
    # D arrays (M, n_a) complex128, 1 / square root of the mean of the eigenfunction's square
    norms: tuple[np.ndarray, ...]
    response: np.ndarray  # (M, n_1, ..., n_D) complex128, D_me, one axis of the array for each axis of the room, m^2

    def shapes(self, points: Reals, slope: int | None = None) -> list[np.ndarray]:
        """Return the eigenfunctions, along `slope` derivatives, at (C, D), metres : D arrays (M, C, n_a)."""
        found = []
        for a, (kappa, norm, length) in enumerate(zip(self.kappa, self.norms, self.size, strict=True)):
            phase = kappa[:, None] * (np.asarray(points)[None, :, a, None] - length / 2)
            odd, sin, cos = np.arange(kappa.shape[1]) % 2 == 1, np.sin(phase), np.cos(phase)
            values = np.where(odd, cos, -sin) * kappa[:, None] if a == slope else np.where(odd, sin, cos)
            found.append(values * norm[:, None])
        return found

    def excitation(self, source: Reals, slope: int | None = None) -> np.ndarray:
        """Return D_me psi_e(x_s) of a source, metres, or its derivative along `slope` : (M, n_1, ..., n_D)."""
        result = self.response
        for a, shape in enumerate(self.shapes(np.asarray(source)[None], slope)):
            result = result * shape[:, 0].reshape(len(result), *(-1 if b == a else 1 for b in range(len(self.size))))
        return result


def room_pressures(excitation: np.ndarray, shapes: list[np.ndarray]) -> np.ndarray:
    """Return the pressures (M, C) of a source of unit amplitude: `excitation` and `shapes` as of `PointSourceModel`."""
    M, C = shapes[0].shape[:2]
    result = shapes[0] @ excitation.reshape(M, excitation.shape[1], -1)  # (M, C, the other axes)
    for shape in shapes[1:]:
        result = np.einsum("mca,mcar->mcr", shape, result.reshape(M, C, shape.shape[2], -1))
    return result[..., 0]


def point_source_model(size: Sequence[float] | Reals, wavenumbers: Numbers, admittance: complex) -> PointSourceModel:
    """Return the point-source model of a room of `size` (D,), metres, `admittance` beta the same on all walls."""
    k = np.asarray(wavenumbers, complex)
    tau = TRUNCATION.tau(len(size))
    top = float(np.sqrt(TRUNCATION.decay / tau + np.real(k).max() ** 2))
    h = 1j * k * admittance
    kappa = tuple(wall_eigenvalues(int(top * length / np.pi) + 1, length, h)[0] for length in size)
    norms = []
    for values, length in zip(kappa, size, strict=True):
        sign = np.where(np.arange(values.shape[1]) % 2 == 1, -1, 1)
        norms.append(1 / np.sqrt((1 + sign * np.sinc(values * length / np.pi)) / 2))
    squares = -(k**2).reshape(-1, *[1] * len(size))
    for a, values in enumerate(kappa):
        squares = squares + (values**2).reshape(len(k), *(-1 if b == a else 1 for b in range(len(size))))
    least = TRUNCATION.smallest_difference
    squares = np.where(np.abs(squares) < least, least, squares)  # at an exact resonance
    return PointSourceModel(tuple(size), kappa, tuple(norms), np.exp(-squares * tau) / squares)


def wall_eigenvalues(count: int, length: float, h: Numbers, steps: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return kappa between two walls of equal `h` (M,), 1/m, and the residuals of its equation : (M, count) complex128.

    Even ones: kappa sin(kappa l / 2) = h cos(kappa l / 2); odd ones: kappa cos(kappa l / 2) = -h sin(kappa l / 2).
    Newton's method starts at nearly rigid walls, from which h grows in `steps` steps.
    """
    n, h, half = np.arange(count), np.asarray(h)[:, None], length / 2
    odd, residual = n % 2 == 1, np.zeros((len(h), count), complex)
    kappa = np.sqrt((n * np.pi / length) ** 2 + np.where(n == 0, 2, 4) * h / steps / length + 0j)
    kappa = np.where(np.abs(kappa) < 1e-9, 1e-9, kappa)
    for part in h * np.arange(1, steps + 1)[:, None, None] / steps if np.any(h) else ():
        for _ in range(TRUNCATION.newton_steps):
            sin, cos = np.sin(kappa * half), np.cos(kappa * half)
            residual = np.where(odd, kappa * cos + part * sin, kappa * sin - part * cos)
            if np.all(np.abs(residual) < 1e-13 * (np.abs(kappa) + np.abs(h))):
                break
            slope = (1 + part * half) * np.where(odd, cos, sin) + half * kappa * np.where(odd, -sin, cos)
            kappa = kappa - residual / slope
    return kappa, residual
