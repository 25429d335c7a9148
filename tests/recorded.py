"""Recordings of a room by image sources (pyroomacoustics), independent of fdcal."""

from functools import cache
from pathlib import Path

import numpy as np

from fdcal.model.validation import InputError

FS, SPEED = 4000, 343.0  # Hz, m/s
ROOM, SOURCE, CENTRE = (5.0, 4.0, 3.0), (4.3, 3.4, 0.8), (2.2, 1.8, 1.5)  # m


def too_large() -> None:
    """A reader that reports any error as damage of the file; its process imports this module."""
    try:
        bytearray(10**12)
    except MemoryError as error:
        raise InputError("the file is damaged") from error


def places(count: int = 24, radius: float = 0.5, seed: int = 0) -> np.ndarray:
    """Microphones in a ball about the origin (N, 3), metres, none close to another."""
    rng, kept = np.random.default_rng(seed), []
    while len(kept) < count:
        x = rng.uniform(-radius, radius, 3)
        if np.linalg.norm(x) < radius and all(np.linalg.norm(x - y) > 0.12 for y in kept):
            kept.append(x)
    return np.array(kept)


def write_places(path: Path, positions, names=None) -> Path:
    """Write a table of positions (N, 2 or 3), metres; the names are numbers from 0 unless given."""
    rows = zip(range(len(positions)) if names is None else names, np.asarray(positions).tolist(), strict=True)
    head = ["name", *"xyz"[: len(positions[0])]]
    path.write_text("".join(",".join(map(str, row)) + "\n" for row in (head, *((name, *x) for name, x in rows))))
    return path


@cache
def responses(count: int = 24, source: tuple[float, ...] = SOURCE) -> np.ndarray:
    """Impulse responses at `places` (N, 2400), 0.6 s; the room falls by 60 dB in about 0.3 s."""
    import pyroomacoustics

    pyroomacoustics.constants.set("c", SPEED)
    room = pyroomacoustics.ShoeBox(ROOM, fs=FS, materials=pyroomacoustics.Material(0.45), max_order=22)
    room.add_source(source)
    room.add_microphone_array((places(count) + CENTRE).T)
    room.compute_rir()
    rows = [np.asarray(row[0], dtype=float) for row in room.rir]
    return np.array([np.pad(row, (0, max(0, 2400 - len(row))))[:2400] for row in rows])


def noisy(samples: np.ndarray, snr_db: float, seed: int = 1) -> np.ndarray:
    """Return `samples` (N, T) with white noise at an SNR, dB, in the band from 20 to 400 Hz."""
    rng, f = np.random.default_rng(seed), np.fft.rfftfreq(samples.shape[1], 1 / FS)
    power = np.mean(np.abs(np.fft.rfft(samples)[:, (f > 20) & (f < 400)]) ** 2) / samples.shape[1]
    return samples + np.sqrt(power * 10 ** (-snr_db / 10)) * rng.standard_normal(samples.shape)


def stationary_source(
    seconds: float, snr_db: float, count: int = 24, seed: int = 2, source: tuple[float, ...] = SOURCE
) -> tuple[np.ndarray, np.ndarray]:
    """Recordings (N, T) of a stationary source, and its unknown signal (T,), which is noise."""
    # The import takes seconds, and a process that calls `too_large` does not need it.
    from scipy.signal import fftconvolve

    signal = np.random.default_rng(seed).standard_normal(int(seconds * FS) + 2400)
    recorded = np.array([fftconvolve(signal, h, mode="valid") for h in responses(count, source)])
    return noisy(recorded, snr_db), signal[2399:]


def mismatch_db(pressures: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """How far pressures (M, N) are from the truth, each frequency up to one factor : (M,) dB."""
    factor = np.sum(truth.conj() * pressures, axis=1) / np.sum(np.abs(truth) ** 2, axis=1)
    rest = np.sum(np.abs(pressures - factor[:, None] * truth) ** 2, axis=1)
    return 10 * np.log10(rest / np.sum(np.abs(pressures) ** 2, axis=1))


def exact(frequencies: np.ndarray, s: float = 0.0, count: int = 24) -> np.ndarray:
    """The transform of the responses without noise : (M, N) complex."""
    t = np.arange(2400) / FS
    return np.exp(-(s + 2j * np.pi * np.asarray(frequencies)[:, None]) * t) @ responses(count).T
