"""Pressures in box-shaped rooms: image sources in the frequency domain, and the rooms of pyroomacoustics."""

import numpy as np

from .constants import SOUND_SPEED

FAINTEST = 1e-4  # amplitude of an image, relative to the loudest, below which it is left out
BLOCK = 16  # number of wavenumbers computed at once
RATE = 4000  # Hz, of pyroomacoustics


def image_source_field(points, source, size, wavenumbers, reflection, order: int) -> np.ndarray:
    """Return the pressures of a unit point source in a box.

    Parameters
    ----------
    points : (N, 3) float64, metres
    source, size : (3,) float64, metres
    wavenumbers : (M,) complex128, rad/m
    reflection : (3, 2) float64
        Pressure reflection factors of the walls at 0 and at `size` of each axis.
    order : int
        Highest order of an image along each axis.

    Returns
    -------
    (M, N) complex128
    """
    places, amplitudes = _images(source, size, reflection, order)
    points, wavenumbers = np.asarray(points, float), np.asarray(wavenumbers)
    pressures = np.zeros((len(wavenumbers), len(points)), complex)
    for n, point in enumerate(points):
        distance = np.linalg.norm(places - point, axis=1)
        spread = amplitudes / (4 * np.pi * distance)
        for first in range(0, len(wavenumbers), BLOCK):
            block = slice(first, first + BLOCK)
            pressures[block, n] = np.exp(-1j * np.outer(wavenumbers[block], distance)) @ spread
    return pressures


def _images(source, size, reflection, order: int):
    """Places (I, 3) and amplitudes (I,) of the images that are loud enough."""
    n = np.arange(-order, order + 1)
    axes, gains = [], []
    for length, place, (first, second) in zip(size, source, reflection, strict=True):
        axes.append(np.concatenate([2 * n * length + place, 2 * n * length - place]))
        even, odd = (first * second) ** np.abs(n), first ** np.abs(n - 1) * second ** np.abs(n)
        gains.append(np.concatenate([even, odd]))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    amplitudes = (gains[0][:, None, None] * gains[1][None, :, None] * gains[2][None, None, :]).ravel()
    loud = amplitudes > FAINTEST * amplitudes.max()
    return places[loud], amplitudes[loud]


def pyroomacoustics_field(points, source, size, wavenumbers, reflection) -> np.ndarray:
    """Return the pressures in the room of `image_source_field` as pyroomacoustics computes them : (M, N) complex128."""
    import pyroomacoustics

    names = ("west", "east", "south", "north", "floor", "ceiling")
    materials = {
        name: pyroomacoustics.Material(float(1 - factor**2))
        for name, factor in zip(names, np.ravel(reflection), strict=True)
    }
    room = pyroomacoustics.ShoeBox(size, fs=RATE, materials=materials, max_order=14, air_absorption=False)
    room.add_source(list(source))
    room.add_microphone_array(np.asarray(points).T)
    room.compute_rir()
    pressures = np.empty((len(wavenumbers), len(points)), complex)
    for n, (response, *_) in enumerate(room.rir):
        time = np.arange(len(response)) / RATE
        pressures[:, n] = np.exp(-1j * np.outer(np.real(wavenumbers) * SOUND_SPEED, time)) @ response
    return pressures
