"""Box-shaped and rectangular rooms: the sound field of a point source in closed form, and the density of the modes.

In three dimensions this closed form replaces a simulation. Walls are rigid, pressure-release or locally reacting. The
field is a sum over the eigenfunctions along two axes. Along the third axis each term is a wave between two walls, in
closed form, which decays exponentially with the distance from the source. Away from the source the sum therefore
converges exponentially, down to rounding errors. In a rectangle of two dimensions the source is a line perpendicular to
the rectangle, the sum is over one axis, and the closed form holds along the other:

    p(x) = sum_t  psi_t(x) psi_t(x_s) g_t(z, z_s),        gamma_t = sqrt(kappa_t^2 - k^2)
    g_t  = exp(-gamma |z - z_s|) (1 + R exp(-2 gamma z_<)) (1 + R exp(-2 gamma (l - z_>))) / N
    N    = 2 gamma (1 - R^2 exp(-2 gamma l))

k         wavenumber, rad/m, complex: (2 pi f - j s) / c with the time sign exp(+j w t)
s         rate of decay, 1/s
psi_t     eigenfunction of number t, normalised so that the integral of its square is 1;  x_s position of the source
z, z_s    coordinates of x and x_s along the axis of the closed form;  z_< the smaller of the two, z_> the larger
l         length of that axis, metres
h         coefficient of a wall with outward normal n, 1/m: dp/dn = -h p. It is 0 at a rigid wall, and j k beta at an
          absorbing wall of the specific admittance beta = rho c / Z
R         (gamma - h) / (gamma + h), reflection factor of a wall: 1 if it is rigid, -1 if it is pressure-release
kappa     wavenumber of an eigenfunction along one axis, rad/m; in a box kappa_t^2 is the sum of the squares of two such
          wavenumbers, one for each axis of the eigenfunctions

Damping. Each term solves Helmholtz's equation at the same k, so p solves it exactly everywhere except at the source; p
would not solve it if each eigenvalue had its own damping. A complex k that all terms have in common has two exact
interpretations. Either the air damps every wave by s nepers per second, or the recordings of an undamped room were
weighted with exp(-s t), as `fdcal.acoustics.spectrum` does with simulated recordings. Absorbing walls add their own
damping, through h at the same k.

The number M of modes below f, and the number n of frequencies in 1 Hz that carry independent information, are

    M(f)  = 4 pi/3 V (f/c)^3 + pi/4 S (f/c)^2 + L/8 f/c    in a box (Kuttruff, Room Acoustics, ch. 3)
    M(f)  = pi A (f/c)^2 + P/2 f/c                         in a rectangle of two dimensions
    n(f)  = min(dM/df, T60 / 2.2)                          independent frequencies in 1 Hz

V, S, L are the volume, the surface and the total edge length of a box; A and P are the area and the perimeter of a
rectangle. 2.2 / T60 is the width of a resonance at -3 dB, Hz. Where resonances overlap (Schroeder 1962), the pressures
at two frequencies that are closer than this width are not independent.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..model.problem import mode_power
from ..model.scene import Room, Source
from ..model.settings import Sensing
from ..model.validation import LIMITS, InputError, Numbers, Reals, refusal
from .spectrum import SPECTRUM, ModalPressures, pick_peaks, require_duration, wavenumber_continuous

EXACT = 36.0  # nepers by which the first omitted term has decayed: exp(-36) = 2e-16
ROUGH = 10.0  # the same for a less accurate field, which suffices to find the peaks
MAX_TERMS = 40_000  # largest number of terms of the sum
BLOCK_VALUES = 65_536  # terms times microphones times wavenumbers in one batch; such an array takes 1 MB
LINE_WIDTH = math.sqrt(3) / math.pi * SPECTRUM.decay  # width at -6 dB of a line with this decay, times the duration
POINTS = 6  # points of the spectrum per line width
# Between absorbing walls the eigenvalues are followed while h grows in small steps from 0, a rigid wall, to its value.
# The number of these steps is STEPS |h| l, and MAX_STEPS at most.
STEPS = 4.0
MAX_STEPS = 100
NEWTON_STEPS = 12  # largest number of Newton iterations in each of these steps


def modal_pressures(room: Room, source: Source, positions, sensing: Sensing, progress=None) -> ModalPressures:
    """Return the pressures, 1/m, of a source of flat spectrum at positions (N, 3), metres.

    They are computed at the frequencies where their mean power has peaks. The decay rate is s = 12 / (duration of the
    source), as for a recording of that length. Raises InputError for a duration that does not resolve the lines.
    """
    require_duration(source.duration, sensing.resolution, LINE_WIDTH)
    s, c = SPECTRUM.decay / source.duration, room.sound_speed
    step = LINE_WIDTH / source.duration / POINTS
    grid = sensing.lowest + step * np.arange(math.ceil((sensing.highest - sensing.lowest) / step) + 1)
    power = np.empty(len(grid))
    for start in range(0, len(grid), 64):
        block = slice(start, start + 64)
        p = point_source_pressures(room, source.place, positions, wavenumber_continuous(grid[block], s, c), ROUGH)
        power[block] = mode_power(p)
        if progress is not None:
            progress(min(1.0, (start + 64) / len(grid)))
    frequencies = pick_peaks(power, sensing.lowest, step, sensing.prominence_db, sensing.resolution)
    wavenumbers = wavenumber_continuous(frequencies, s, c)
    pressures = point_source_pressures(room, source.place, positions, wavenumbers)
    return ModalPressures(frequencies, wavenumbers, pressures, np.stack([grid, power]))


def require_affordable(source: Source, sensing: Sensing, microphones: int) -> None:
    """Raise InputError for a duration that does not resolve the lines, or that needs a spectrum of too many values."""
    require_duration(source.duration, sensing.resolution, LINE_WIDTH)
    band = sensing.highest - sensing.lowest
    values = microphones * band * source.duration * POINTS / LINE_WIDTH
    if values > LIMITS.field_values:
        longest = LIMITS.field_values * LINE_WIDTH / POINTS / microphones / band
        why = f"needs {values:.3g} values of the spectrum from {sensing.lowest:g} Hz to {sensing.highest:g} Hz at"
        remedy = f"use at most {longest:.3g} s, a narrower band or fewer microphones"
        raise refusal("source.duration", source.duration, f"{why} {microphones} microphones", remedy, "s")


def point_source_pressures(room: Room, source, positions, wavenumbers, nepers: float = EXACT) -> np.ndarray:
    """Return the pressures of a point source whose field is 1 / (4 pi d) at a small distance d : (M, N), 1/m.

    `source` is (3,) and `positions` (N, 3), metres; in a rectangle they are (2,) and (N, 2), and the pressures are
    dimensionless. `wavenumbers` (M,), rad/m, have a negative imaginary part unless the walls absorb. Terms are omitted
    once they have decayed by `nepers`. Raises InputError for a sum of too many terms.
    """
    positions, source = np.asarray(positions, float), np.asarray(source, float)
    D = len(source)
    k = np.asarray(wavenumbers, complex)
    apart = np.abs(positions - source)
    axes = apart.argmax(axis=1)  # the closed form is used along the axis with the largest distance from the source
    sides = positions[np.arange(len(positions)), axes] < source[axes]
    p = np.empty((len(k), len(positions)), complex)
    for axis, side in itertools.product(range(D), (False, True)):
        group = np.flatnonzero((axes == axis) & (sides == side))
        if len(group) == 0:
            continue
        order = [(axis + 1 + i) % D for i in range(D)]
        lengths = np.array(room.size)[order]
        # `terms` holds, for every axis but the last, the numbers (T,) of the eigenfunctions with gamma <= reach, 1/m.
        reach = nepers / max(float(apart[group, axis].min()), 1e-9)
        counts = math.hypot(reach, float(np.abs(k).max())) * lengths[:-1] / np.pi
        if np.prod(counts + 1) > MAX_TERMS:
            nearest = group[apart[group, axis].argmin()]
            problem = f"source.position is too close to microphone {nearest}, or room.size too large, for a modal sum"
            raise InputError(problem, "move it, or lower measurement.highest", key="source.position")
        numbers = np.meshgrid(*(np.arange(math.ceil(count) + 1) for count in counts), indexing="ij")
        kept = sum((along / count) ** 2 for along, count in zip(numbers, counts, strict=True)) <= 1
        terms = tuple(along[kept] for along in numbers)
        block = max(1, BLOCK_VALUES // (len(terms[0]) * len(group)))
        for first in range(0, len(k), block):
            some = slice(first, first + block)
            p[some, group] = closed_form_sum(room, lengths, source[order], positions[group][:, order], k[some], terms)
    return p


def closed_form_sum(room: Room, lengths, source, positions, k, terms) -> np.ndarray:
    """Return the field at some wavenumbers, with the closed form along the last axis : (M, N) complex128.

    lengths, source : (D,), metres; positions : (N, D), metres, all on the same side of the source along the last axis;
    k : (M,), rad/m; terms : for every axis but the last, the numbers (T,) of the eigenfunctions in the sum
    """
    squares, shapes = 0.0, 1.0
    for axis, numbers in enumerate(terms):
        x = np.append(positions[:, axis], source[axis])
        kappa, psi = _eigenfunctions(room, lengths[axis], k, x, numbers.max() + 1)
        squares = squares + kappa[:, numbers] ** 2
        shapes = shapes * (psi[..., :-1] * psi[..., -1:])[:, numbers]
    gamma = np.sqrt(squares - k[:, None] ** 2 + 0j)[..., None]
    heights, level = np.unique(positions[:, -1], return_inverse=True)  # a lattice has few heights
    low, high = (heights, source[-1:]) if heights[0] < source[-1] else (source[-1:], heights)
    h, length = 1j * k[:, None, None] * room.admittance, lengths[-1]
    R = -1.0 if room.walls == "pressure-release" else (gamma - h) / (gamma + h)
    echoes = (1 + R * np.exp(-2 * gamma * low)) * (1 + R * np.exp(-2 * gamma * (length - high)))
    g = np.exp(-gamma * (high - low)) * echoes / (2 * gamma * (1 - R**2 * np.exp(-2 * gamma * length)))
    return np.sum(shapes * g[..., level], axis=1)


def _eigenfunctions(room: Room, length: float, k, x, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return kappa (B, count), rad/m, and the normalised eigenfunctions at x (X,), metres : (B, count, X).

    B is len(k) for absorbing walls, else 1. The integral of the square of each function is 1. About the middle of the
    axis the eigenfunctions are alternately even (cosines) and odd (sines).
    """
    n = np.arange(count)
    kappa = ((n + (room.walls == "pressure-release")) * np.pi / length)[None]
    if room.walls == "absorbing":
        h = 1j * k * room.admittance
        steps = max(1, math.ceil(STEPS * float(np.abs(h).max()) * length))
        kappa, residual = _wall_eigenvalues(count, length, h, min(steps, MAX_STEPS))
        exact = np.all(np.abs(residual) < 1e-10 * (np.abs(kappa) + np.abs(h)[:, None]))
        distinct = np.all(np.abs(kappa[:, 2:] - kappa[:, :-2]) > 0.5 / length)  # at a high admittance two may coincide
        if steps > MAX_STEPS or not (exact and distinct):
            problem = f"room.admittance is too high for a sum over modes (|h| = {np.abs(h).max():.3g} 1/m)"
            raise InputError(problem, "use a lower one", key="room.admittance")
    odd = n % 2 == 1
    phase = kappa[..., None] * (np.asarray(x) - length / 2)
    norm = length / 2 * (1 + np.where(odd, -1, 1) * np.sinc(kappa * length / np.pi))
    return kappa, np.where(odd[:, None], np.sin(phase), np.cos(phase)) / np.sqrt(norm + 0j)[..., None]


def _wall_eigenvalues(count: int, length: float, h: Numbers, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Return kappa between two walls of equal `h` (M,), 1/m, and the residuals of its equation : (M, count) complex128.

    Even eigenfunctions satisfy kappa sin(kappa l / 2) = h cos(kappa l / 2), odd ones kappa cos(kappa l / 2) =
    -h sin(kappa l / 2). Newton's method starts at nearly rigid walls, and h grows to its value in `steps` steps.
    """
    n, h, half = np.arange(count), np.asarray(h)[:, None], length / 2
    odd, residual = n % 2 == 1, np.zeros((len(h), count), complex)
    kappa = np.sqrt((n * np.pi / length) ** 2 + np.where(n == 0, 2, 4) * h / steps / length + 0j)
    for part in h * np.arange(1, steps + 1)[:, None, None] / steps:
        for _ in range(NEWTON_STEPS):
            sin, cos = np.sin(kappa * half), np.cos(kappa * half)
            residual = np.where(odd, kappa * cos + part * sin, kappa * sin - part * cos)
            if np.all(np.abs(residual) < 1e-13 * (np.abs(kappa) + np.abs(h))):
                break
            slope = (1 + part * half) * np.where(odd, cos, sin) + half * kappa * np.where(odd, -sin, cos)
            kappa = kappa - residual / slope
    return kappa, residual


RESONANCE_WIDTH = 2.2  # width of a resonance at -3 dB, Hz, times T60, s
MAX_FREQUENCIES = 1_000_000  # largest number of frequencies in a band; only a mistake in the input leads to more


def mode_count(size: Sequence[float] | Reals, frequencies: ArrayLike, sound_speed: float) -> np.ndarray:
    """Return the mean number of modes of a room below frequencies (F,), Hz : (F,) float64.

    size : (2,) or (3,), metres; sound_speed : m/s

    The formula is Weyl's law for rigid walls, including the terms for the walls and the edges.
    """
    ratio = np.asarray(frequencies, float) / sound_speed
    if len(size) == 2:
        return np.pi * size[0] * size[1] * ratio**2 + sum(size) * ratio
    x, y, z = size
    surface, edges = 2 * (x * y + y * z + z * x), 4 * (x + y + z)
    return 4 * np.pi / 3 * x * y * z * ratio**3 + np.pi / 4 * surface * ratio**2 + edges / 8 * ratio


def independent_frequencies(
    low: float, high: float, reverberation_time: float, sound_speed: float, size: Sequence[float] | None = None
):
    """Return frequencies from `low` to `high` at which the pressures in a room are independent : (M,), Hz, ascending.

    `reverberation_time` is T60, seconds. `size` holds the lengths of the room, metres; without it resonances are
    assumed to overlap everywhere. Raises InputError for more than MAX_FREQUENCIES of them.
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
