"""The sound field of a rectangular or box-shaped room of known size, as a sum over its eigenmodes.

Two models of what microphones at x hear of one source, each of a frequency m of its own unknown loudness and phase:

    diffuse   C_m = s_m sum_e w_me psi_e(x) psi_e(x') + v_m I,    w_me ~ 1 / |kappa_e^2 - k_m^2|^2
    source    p_m = A_m sum_e D_me psi_e(x) psi_e(x_s),    D_me = exp(-(kappa_e^2 - k_m^2) tau) / (kappa_e^2 - k_m^2)

    kappa_e^2   eigenvalue, the sum of kappa^2 along each axis, rad^2/m^2
    psi_e       eigenfunction, the product of one along each axis, of unit mean square in a rigid room
    k           wavenumber, rad/m, time sign exp(+j w t)
    h           j k beta, outwards dp/dn = -h p at the walls; beta the specific admittance, the same on all walls
    tau         m^2: the exponential is the room's heat kernel; it makes the sum converge fast, and the sum is exact
                where a microphone is further than some 6 sqrt(tau) from the source

The first knows nothing of the source: modes near the frequency count with independent random parts. It is what a search
begins with; walls are rigid. The second is exact, for absorbing walls, too, as far as beta describes them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

NEAREST = 0.7, 1.0  # metres from the source from which the second model is exact, in 2-D and 3-D
NEGLIGIBLE = 9.2  # nepers by which the first mode left out has fallen
LEAST_SQUARE = 1e-12  # 1/m^2, least of abs(kappa^2 - k^2), which may vanish at a nominal resonance
RATHER_NEAR = 1.6  # times the highest wavenumber: modes up to there count in the first model
NEWTON_STEPS = 8


@dataclass(frozen=True)
class DiffuseModel:
    """The first model, of a rigid room.

    Attributes
    ----------
    kappa : (E, D) float64, rad/m, of every mode along each axis
    gains : (E,) float64, sqrt(2) for every axis along which it varies
    weights : (M, E) float64, w, sum 1 for each frequency
    """

    kappa: np.ndarray
    gains: np.ndarray
    weights: np.ndarray

    def shapes(self, points) -> np.ndarray:
        """psi (C, E) float64 at `points` (C, D), metres."""
        return self.gains * np.prod(np.cos(np.asarray(points)[:, None] * self.kappa), axis=2)

    def slopes(self, points) -> np.ndarray:
        """d psi / dx along each axis : (D, C, E) float64, 1/m."""
        phase = np.asarray(points)[:, None] * self.kappa
        cos, slope = np.cos(phase), -self.kappa * np.sin(phase)
        axes = range(self.kappa.shape[1])
        parts = [[slope if a == b else cos for b in axes] for a in axes]
        return np.array([self.gains * np.prod([parts[a][b][..., b] for b in axes], axis=0) for a in axes])


def diffuse_model(size, wavenumbers, width: float) -> DiffuseModel:
    """The first model of a room of `size` (D lengths, metres) at `wavenumbers` (M,), rad/m.

    width : rad/m, half the width of a resonance, which walls that absorb make wider
    """
    k = np.asarray(wavenumbers, complex)
    top = RATHER_NEAR * float(k.real.max())
    numbers = _numbers(size, top)
    kappa = np.pi * numbers / np.asarray(size)
    kept = np.sum(kappa**2, axis=1) < top**2
    kappa, numbers = kappa[kept], numbers[kept]
    apart = np.abs(np.sum(kappa**2, axis=1) - k[:, None] ** 2) ** 2 + (2 * k.real[:, None] * width) ** 2
    weights = 1 / apart
    gains = np.sqrt(2.0) ** np.sum(numbers > 0, axis=1)
    return DiffuseModel(kappa, gains, weights / weights.sum(axis=1, keepdims=True))


def _numbers(size, top: float) -> np.ndarray:
    """Numbers of half waves along each axis, of every mode with kappa up to `top` along each : (E, D) int."""
    counts = [int(top * length / np.pi) + 1 for length in size]
    return np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, len(size))


@dataclass(frozen=True)
class PointSourceModel:
    """The second model: the room's response at its wavenumbers, D_me laid out along the axes.

    Attributes
    ----------
    size : D lengths, metres
    kappa : D arrays (M, n_a) complex128, rad/m, along each axis
    norms : D arrays (M, n_a) complex128, 1 / square root of the mean of the eigenfunction's square
    response : (M, n_1, ..., n_D) complex128, m^2
    """

    size: tuple[float, ...]
    kappa: tuple[np.ndarray, ...]
    norms: tuple[np.ndarray, ...]
    response: np.ndarray

    def shapes(self, points, slope: int | None = None) -> list[np.ndarray]:
        """Eigenfunctions along each axis at `points` (C, D): D arrays (M, C, n_a); that of axis `slope` derived."""
        found = []
        for a, (kappa, norm, length) in enumerate(zip(self.kappa, self.norms, self.size, strict=True)):
            phase = kappa[:, None] * (np.asarray(points)[None, :, a, None] - length / 2)
            odd, sin, cos = np.arange(kappa.shape[1]) % 2 == 1, np.sin(phase), np.cos(phase)
            values = np.where(odd, cos, -sin) * kappa[:, None] if a == slope else np.where(odd, sin, cos)
            found.append(values * norm[:, None])
        return found

    def excitation(self, source, slope: int | None = None) -> np.ndarray:
        """D_me psi_e(x_s) : (M, n_1, ..., n_D) complex128; of axis `slope` the derivative by x_s."""
        result = self.response
        for a, shape in enumerate(self.shapes(np.asarray(source)[None], slope)):
            result = result * shape[:, 0].reshape(len(result), *(-1 if b == a else 1 for b in range(len(self.size))))
        return result


def room_pressures(excited: np.ndarray, shapes: list[np.ndarray]) -> np.ndarray:
    """Pressures (M, C) of an excited room at the points of `shapes`, the source of unit loudness."""
    M, C = shapes[0].shape[:2]
    result = shapes[0] @ excited.reshape(M, excited.shape[1], -1)  # (M, C, the other axes)
    for shape in shapes[1:]:
        result = np.einsum("mca,mcar->mcr", shape, result.reshape(M, C, shape.shape[2], -1))
    return result[..., 0]


def point_source_model(size, wavenumbers, admittance: complex) -> PointSourceModel:
    """The second model of a room of `size` (D lengths, metres) at `wavenumbers` (M,), rad/m."""
    k = np.asarray(wavenumbers, complex)
    tau = (NEAREST[len(size) - 2] / 6) ** 2
    top = float(np.sqrt(NEGLIGIBLE / tau + k.real.max() ** 2))
    h = 1j * k * admittance
    kappa = tuple(_eigenvalues(int(top * length / np.pi) + 1, length, h) for length in size)
    norms = []
    for values, length in zip(kappa, size, strict=True):
        sign = np.where(np.arange(values.shape[1]) % 2 == 1, -1, 1)
        norms.append(1 / np.sqrt((1 + sign * np.sinc(values * length / np.pi)) / 2))
    squares = -(k**2).reshape(-1, *[1] * len(size))
    for a, values in enumerate(kappa):
        squares = squares + (values**2).reshape(len(k), *(-1 if b == a else 1 for b in range(len(size))))
    squares = np.where(np.abs(squares) < LEAST_SQUARE, LEAST_SQUARE, squares)  # at a resonance to the last bit
    return PointSourceModel(tuple(size), kappa, tuple(norms), np.exp(-squares * tau) / squares)


def _eigenvalues(count: int, length: float, h: np.ndarray) -> np.ndarray:
    """kappa (M, count) complex128 between two walls of `h` (M,), 1/m, by Newton's method from nearly rigid ones.

    Even ones: kappa sin(kappa l / 2) = h cos(kappa l / 2); odd ones: kappa cos(kappa l / 2) = -h sin(kappa l / 2).
    """
    n, h, half = np.arange(count), h[:, None], length / 2
    odd = n % 2 == 1
    kappa = np.sqrt((n * np.pi / length) ** 2 + np.where(n == 0, 2, 4) * h / length)
    kappa = np.where(np.abs(kappa) < 1e-9, 1e-9, kappa)
    for _ in range(NEWTON_STEPS if np.any(h) else 0):
        sin, cos = np.sin(kappa * half), np.cos(kappa * half)
        fault = np.where(odd, kappa * cos + h * sin, kappa * sin - h * cos)
        slope = (1 + h * half) * np.where(odd, cos, sin) + half * kappa * np.where(odd, -sin, cos)
        kappa = kappa - fault / slope
    return kappa


@dataclass(frozen=True)
class RoomSymmetry:
    """A motion of a room onto itself, which no pressure of it can tell from standing still.

    Attributes
    ----------
    size : D lengths, metres
    order : which axis each coordinate is taken from
    flipped : D bool, coordinates counted from the far wall
    """

    size: tuple[float, ...]
    order: tuple[int, ...]
    flipped: tuple[bool, ...]

    def of(self, points) -> np.ndarray:
        """Points (..., D), metres, moved."""
        points = np.asarray(points, float)[..., self.order]
        return np.where(self.flipped, np.asarray(self.size) - points, points)

    def __str__(self) -> str:
        names = ["xyz"[a] for a in self.order]
        parts = [f"{s:g} - {n}" if f else n for n, s, f in zip(names, self.size, self.flipped, strict=True)]
        return f"({', '.join(parts)})"


def room_symmetries(size) -> list[RoomSymmetry]:
    """Every symmetry of a room of `size`: mirrors along its axes, axes of equal length exchanged; itself first."""
    D = len(size)
    orders = [o for o in itertools.permutations(range(D)) if all(size[a] == size[b] for a, b in enumerate(o))]
    flips = itertools.product((False, True), repeat=D)
    return [RoomSymmetry(tuple(size), order, flipped) for flipped, order in itertools.product(flips, orders)]


def nearest_symmetry(points, to, size) -> RoomSymmetry:
    """The symmetry of a room that brings `points` (N, D) nearest to others, metres."""
    return min(room_symmetries(size), key=lambda image: float(np.sum((image.of(points) - to) ** 2)))
