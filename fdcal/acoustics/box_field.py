"""The sound field of a point source in a box-shaped room, in closed form: the source of truth in three dimensions.

The field in the room, rigid, pressure-release or locally reacting alike, is a sum over its eigenfunctions along two
axes; along the third each term is a wave between two walls in closed form, which falls exponentially with the distance
from the source. So the sum converges exponentially, to rounding, away from the source:

    p(x) = sum_t  psi_t(x) psi_t(x_s) g_t(z, z_s),        gamma_t = sqrt(kappa_t^2 - k^2)
    g_t  = exp(-gamma |z - z_s|) (1 + R exp(-2 gamma z_<)) (1 + R exp(-2 gamma (l - z_>))) / N
    N    = 2 gamma (1 - R^2 exp(-2 gamma l))

k         wavenumber, rad/m, complex: (2 pi f - j s) / c with the time sign exp(+j w t)
s         rate of decay, 1/s
l         length of an axis, metres;  z_<, z_> the lesser and the greater of z and z_s
h         of a wall, 1/m: outwards dp/dn = -h p; 0 rigid, j k beta with the specific admittance beta = rho c / Z
R         (gamma - h) / (gamma + h), reflection by a wall: 1 rigid, -1 pressure-release
kappa     wavenumber of an eigenfunction along an axis, rad/m; kappa_t^2 is the sum of two

Damping. Each term solves Helmholtz's equation at the one k, so p does, exactly, wherever the source is not. It would
not with a damping of its own for each eigenvalue. One complex k for all of them has two readings, both exact: the air
takes s nepers a second from every wave, or the recordings of an undamped room were weighted with exp(-s t), as
`fdcal.acoustics.spectrum` does with simulated ones. Absorbing walls add their own damping, through h at that same k.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ..model.power import mode_power
from ..model.room import Room, Source
from ..model.settings import Sensing
from ..model.validation import InputError
from .spectrum import DECAY, pick_peaks, wavenumber_continuous

EXACT = 36.0  # nepers by which the first term left out has fallen: exp(-36) = 2e-16
ROUGH = 10.0  # likewise for the search of peaks alone
MOST_TERMS = 40_000
LINE_WIDTH = 2 * math.sqrt(3) / math.pi / 2 * DECAY  # width at -6 dB of a line that decays by DECAY, times duration
POINTS = 6  # of the spectrum in the width of a line
STEPS = 4.0  # from a rigid to an absorbing wall, each of a few Newton steps, for every |h| l
MOST_STEPS = 100


def modal_pressures(room: Room, source: Source, places, sensing: Sensing, progress=None):
    """What microphones hear of a source that is equally loud at all frequencies, at the peaks of its mean power.

    Parameters
    ----------
    room : Room with three lengths
    source : Source; its `duration` sets the decay, s = 12 / duration, as of a recording of that length
    places : (N, 3) float64, metres
    progress : callable(float) or None, told the fraction done

    Returns
    -------
    frequencies (M,) float64, Hz; wavenumbers (M,) complex128, rad/m; pressures (M, N) complex128, 1/m; and the mean
    power in which the peaks were found, (2, F) float64, Hz and 1/m^2

    Raises InputError where lines would run together, where nothing stands out, for a microphone at the source.
    """
    require_resolved(source, sensing)
    s, c = DECAY / source.duration, room.sound_speed
    step = LINE_WIDTH / source.duration / POINTS
    grid = sensing.lowest + step * np.arange(math.ceil((sensing.highest - sensing.lowest) / step) + 1)
    power = np.empty(len(grid))
    for start in range(0, len(grid), 64):
        block = slice(start, start + 64)
        p = point_source_pressures(room, source.position, places, wavenumber_continuous(grid[block], s, c), ROUGH)
        power[block] = mode_power(p)
        if progress is not None:
            progress(min(1.0, (start + 64) / len(grid)))
    frequencies = pick_peaks(power, sensing.lowest, step, sensing.prominence_db, sensing.resolution)
    wavenumbers = wavenumber_continuous(frequencies, s, c)
    spectrum = np.stack([grid, power])
    return frequencies, wavenumbers, point_source_pressures(room, source.position, places, wavenumbers), spectrum


def require_resolved(source: Source, sensing: Sensing) -> None:
    """Raise InputError unless lines `measurement.resolution` apart stay apart."""
    if source.duration * sensing.resolution < LINE_WIDTH * (1 - 1e-9):
        raise InputError(
            f"source.duration = {source.duration:g} s is too short for measurement.resolution ="
            f" {sensing.resolution:g} Hz; use at least {math.ceil(LINE_WIDTH / sensing.resolution * 100) / 100:g} s, or"
            f" a resolution of {math.ceil(LINE_WIDTH / source.duration * 100) / 100:g} Hz"
        )


def point_source_pressures(room: Room, source, places, wavenumbers, nepers: float = EXACT) -> np.ndarray:
    """Pressures of a point source of unit strength, of which p -> 1 / (4 pi d) close by : (M, N) complex128, 1/m.

    Parameters
    ----------
    room : Room with three lengths
    source : (3,) metres
    places : (N, 3) float64, metres
    wavenumbers : (M,) complex128, rad/m, each with an imaginary part below zero or walls that absorb
    nepers : by which the terms left out have fallen

    Raises InputError for a microphone so close to the source that too many terms are needed.
    """
    places, source = np.asarray(places, float), np.asarray(source, float)
    k = np.asarray(wavenumbers, complex)
    apart = np.abs(places - source)
    axes = apart.argmax(axis=1)  # each microphone's closed form runs along the axis that parts it most from the source
    sides = places[np.arange(len(places)), axes] < source[axes]
    p = np.empty((len(k), len(places)), complex)
    for axis, side in itertools.product(range(3), (False, True)):
        group = np.flatnonzero((axes == axis) & (sides == side))
        if len(group) == 0:
            continue
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        lengths = np.array(room.size)[order]
        reach = nepers / max(float(apart[group, axis].min()), 1e-9)
        terms = _terms(lengths, reach, float(np.abs(k).max()), group[apart[group, axis].argmin()])
        for m, one in enumerate(k):
            p[m, group] = _sum(room, lengths, source[order], places[group][:, order], one, terms)
    return p


def _terms(lengths, reach: float, k: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (T,) of the eigenfunctions along the two axes whose gamma is below `reach`, 1/m."""
    furthest = math.hypot(reach, k)
    counts = furthest * lengths[:2] / np.pi
    if np.prod(counts + 1) > MOST_TERMS:
        raise InputError(f"source.position is too close to microphone {n} for a sum over modes; move it further away")
    first, second = np.meshgrid(*(np.arange(math.ceil(count) + 1) for count in counts), indexing="ij")
    kept = (first / counts[0]) ** 2 + (second / counts[1]) ** 2 <= 1
    return first[kept], second[kept]


def _sum(room: Room, lengths, source, places, k: complex, terms) -> np.ndarray:
    """The field at one wavenumber, the closed form along the last axis : (N,) complex128."""
    squares, shapes = 0.0, 1.0
    for axis, numbers in enumerate(terms):
        kappa, psi = _eigenfunctions(
            room, lengths[axis], k, np.append(places[:, axis], source[axis]), numbers.max() + 1
        )
        squares = squares + kappa[numbers] ** 2
        shapes = shapes * (psi[:, :-1] * psi[:, -1:])[numbers]
    gamma = np.sqrt(squares - k**2 + 0j)[:, None]
    heights, level = np.unique(places[:, 2], return_inverse=True)  # few in a lattice
    ends = (heights, source[2:]) if heights[0] < source[2] else (source[2:], heights)
    g = _between(room, lengths[2], k, gamma, *ends)
    return np.einsum("tn,tn->n", shapes, g[:, level])


def _eigenfunctions(room: Room, length: float, k: complex, x, count: int) -> tuple[np.ndarray, np.ndarray]:
    """kappa (count,), rad/m, and the eigenfunctions, of unit mean square integral, at x : (count, len(x)).

    About the middle of the axis they are cosines and sines in turn.
    """
    n = np.arange(count)
    kappa = (n + (room.walls == "pressure-release")) * np.pi / length
    if room.walls == "absorbing":
        kappa = _absorbed(kappa, length, 1j * k * room.admittance)
    odd = (n % 2 == 1)[:, None]
    phase = kappa[:, None] * (np.asarray(x) - length / 2)
    sign = np.where(odd[:, 0], -1, 1)
    norm = length / 2 * (1 + sign * np.sinc(kappa * length / np.pi))
    return kappa, np.where(odd, np.sin(phase), np.cos(phase)) / np.sqrt(norm + 0j)[:, None]


def _absorbed(rigid: np.ndarray, length: float, h: complex) -> np.ndarray:
    """kappa between two walls of equal h, each followed from its `rigid` value as h grows from 0 : (n,) complex128.

    kappa sin(kappa l / 2) = h cos(kappa l / 2) for the cosines, kappa cos(kappa l / 2) = -h sin(kappa l / 2) for the
    sines. Raises InputError where two of them meet, which walls of high admittance bring about.
    """
    half, odd = length / 2, np.arange(len(rigid)) % 2 == 1
    steps = max(1, math.ceil(STEPS * abs(h) * length))
    kappa = rigid.astype(complex)
    kappa[:1] = np.sqrt(2 * h / steps / length)
    fault = np.full(len(kappa), np.inf)
    for part in h * np.arange(1, steps + 1) / steps if steps <= MOST_STEPS else ():
        for _ in range(12):
            sin, cos = np.sin(kappa * half), np.cos(kappa * half)
            fault = np.where(odd, kappa * cos + part * sin, kappa * sin - part * cos)
            if np.all(np.abs(fault) < 1e-13 * (np.abs(kappa) + abs(h))):
                break
            slope = (1 + part * half) * np.where(odd, cos, sin) + half * kappa * np.where(odd, -sin, cos)
            kappa = kappa - fault / slope
    apart = np.abs(kappa[2:] - kappa[:-2])
    if not (np.all(np.abs(fault) < 1e-10 * (np.abs(kappa) + abs(h))) and np.all(apart > 0.5 / length)):
        raise InputError("room.admittance is too high for a sum over modes; lower it")
    return kappa


def _between(room: Room, length: float, k: complex, gamma, low, high) -> np.ndarray:
    """g of every term and pair of ends, each (N,) or (1,), low <= high : (T, N) complex128, metres."""
    h = 1j * k * room.admittance
    R = -1.0 if room.walls == "pressure-release" else (gamma - h) / (gamma + h)
    echoes = (1 + R * np.exp(-2 * gamma * low)) * (1 + R * np.exp(-2 * gamma * (length - high)))
    return np.exp(-gamma * (high - low)) * echoes / (2 * gamma * (1 - R**2 * np.exp(-2 * gamma * length)))
