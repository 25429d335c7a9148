"""Sound fields in closed form, with which the tests compare results."""

import numpy as np

from fdcal.model.measurement import Measurement
from fdcal.model.settings import Search


def rigid_room(points, source, wavenumbers, size=(6.0, 5.0), terms=200):
    """Field of a point source in a rigid rectangle, a cosine series in x and closed form in y : (M, N) complex.

    Valid for complex wavenumbers (damped by the exponential window), where no resonance makes it infinite.
    """
    (width, depth), n = size, np.arange(terms)
    x, y = np.asarray(points).T
    low, high = np.minimum(y, source[1])[:, None], np.maximum(y, source[1])[:, None]
    shape = np.cos(n * np.pi * source[0] / width) * np.cos(n * np.pi * x[:, None] / width)
    shape *= np.where(n == 0, 1, 2) / width
    fields = []
    for k in wavenumbers:
        g = np.sqrt((n * np.pi / width) ** 2 - k**2 + 0j)
        g = np.where(g.real < 0, -g, g)
        echo = (1 + np.exp(-2 * g * low)) * (1 + np.exp(-2 * g * (depth - high)))
        fields.append(np.sum(shape * np.exp(-g * (high - low)) * echo / (2 * g * (1 - np.exp(-2 * g * depth))), axis=1))
    return np.array(fields)


def room_frequencies(highest, sound_speed=343.0, size=(6.0, 5.0), apart=1.5):
    """Eigenfrequencies of the rigid rectangle from 20 Hz up, hertz, leaving out those closer than `apart`."""
    m, n = np.meshgrid(np.arange(60), np.arange(60))
    every = np.sort((sound_speed / 2 * np.hypot(m / size[0], n / size[1])).ravel())
    chosen = []
    for f in every[(every > 20) & (every < highest)]:
        if not chosen or f - chosen[-1] > apart:
            chosen.append(f)
    return np.array(chosen)


def with_noise(pressures, snr_db, rng):
    """Return pressures (M, N) with complex noise at an SNR in each mode, and the power of the noise (M,)."""
    noise = np.mean(np.abs(pressures) ** 2, axis=1) * 10 ** (-snr_db / 10)
    draws = rng.standard_normal((2, *pressures.shape))
    return pressures + np.sqrt(noise / 2)[:, None] * (draws[0] + 1j * draws[1]), noise


def measured(positions, known, highest=300.0, snr_db=np.inf, seed=0, search=None, source=(5.47, 4.53), modes=None):
    """Measurement of the modes of the 6 x 5 m rigid room at `positions`, c = 343 m/s, windowed with 3 / s."""
    frequencies = room_frequencies(highest)[:modes]
    wavenumbers = (2 * np.pi * frequencies - 3j) / 343.0
    pressures = rigid_room(positions, source, wavenumbers)
    pressures, noise = with_noise(pressures, snr_db, np.random.default_rng(seed))
    reported, search = noise if np.isfinite(snr_db) else None, search or Search((2.01, 1.71), (1.2, 1.2), 0.04, 0.8)
    places = {"positions": positions, "known": known, "search": search}
    return Measurement(frequencies, pressures, 343.0, wavenumbers=wavenumbers, noise_power=reported, **places)


def placed(positions, search=None, known=()):
    """A measurement of one frequency, for tests of pictures that show where the microphones are."""
    p, dimension = np.exp(1j * np.sum(positions, axis=1))[None], np.shape(positions)[1]
    return Measurement([100.0], p, 343.0, dimension, positions=positions, known=known, search=search)


def jittered_grid():
    """Positions (25, 2), metres, near the points of a grid of 1 m by 1 m in the room of `measured`."""
    x, y = np.meshgrid(*[np.linspace(-0.5, 0.5, 5)] * 2, indexing="ij")
    grid = np.stack([x.ravel(), y.ravel()], axis=1) + [2.6, 2.3]
    return grid + np.random.default_rng(0).normal(scale=0.03, size=grid.shape)


def plane_wave(points, k, angle):
    """exp(-j k x cos - j k y sin) at `points`."""
    return np.exp(-1j * k * (np.asarray(points) @ [np.cos(angle), np.sin(angle)]))


def plane_wave_coefficients(k, angle, order, centre):
    """Return the coefficients of a plane wave by Jacobi and Anger: exp(-j z cos t) = sum (-j)^l J_l(z) exp(j l t)."""
    l = np.arange(-order, order + 1)  # noqa: E741
    return (-1j) ** l * np.exp(-1j * l * angle) * plane_wave([centre], k, angle)


def disc(count, radius=0.5, seed=0, centre=(0.0, 0.0)):
    """Positions (N, 2), metres, evenly distributed over a disc."""
    rng = np.random.default_rng(seed)
    r, angle = radius * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.array(centre) + np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def waves(x, wavenumbers, count=40, rng=0, noise=0.0):
    """Pressures (M, N) of unit power at x (N, D): plane waves from random directions, and white noise."""
    rng, k = np.random.default_rng(rng), np.asarray(wavenumbers)
    u = rng.normal(size=(len(k), count, x.shape[1]))
    u /= np.linalg.norm(u, axis=2, keepdims=True)
    a, e = rng.normal(size=(2, len(k), count)), rng.normal(size=(2, len(k), len(x)))
    p = np.einsum("mw,mwn->mn", a[0] + 1j * a[1], np.exp(-1j * k[:, None, None] * (u @ x.T)))
    return np.sqrt((1 - noise) / 2 / count) * p + np.sqrt(noise / 2) * (e[0] + 1j * e[1])
