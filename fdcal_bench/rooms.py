"""Arrays, sources and rooms by image sources (pyroomacoustics), independent of fdcal's own simulations."""

import numpy as np

RATE, SPEED = 8000, 343.0  # Hz, m/s
FAR = 4  # microphones of an array that come first and are far out, about a right angle apart seen from above


def draw_array(rng: np.random.Generator, count: int, radius: float, flat: bool = False) -> np.ndarray:
    """Return microphones (N, 3), metres, not too close together, in a ball or a disc about the origin, FAR first."""
    kept: list[np.ndarray] = []
    while len(kept) < count:
        x = rng.uniform(-radius, radius, 3) * (1, 1, not flat)
        apart = radius * 0.65 / np.cbrt(count)
        if np.linalg.norm(x) < radius and all(np.linalg.norm(x - y) > apart for y in kept):
            kept.append(x)
    places = np.array(kept)
    far = [int(np.argmax(places @ (np.cos(a), np.sin(a), 0))) for a in np.pi / 2 * np.arange(FAR) + np.pi / 4]
    return places[list(dict.fromkeys([*far, *range(count)]))]


def draw_source(rng: np.random.Generator, room, centre) -> np.ndarray:
    """Return a place (3,), metres, at least 0.3 m from the walls and 1.2 m from the middle of the array."""
    while True:
        place = rng.uniform(0.3, np.array(room) - 0.3)
        if np.linalg.norm(place - centre) > 1.2:
            return place


def responses(places, source, reverberation: float, order: int, size, facing=None) -> np.ndarray:
    """Return impulse responses (N, T) of a shoebox by image sources up to an order, at RATE.

    The source is a cardioid that faces the direction `facing` (3,), or radiates equally in all directions.
    """
    import pyroomacoustics

    pyroomacoustics.constants.set("c", SPEED)
    absorption, enough = pyroomacoustics.inverse_sabine(reverberation, size, c=SPEED)
    material = pyroomacoustics.Material(absorption)
    room = pyroomacoustics.ShoeBox(size, fs=RATE, materials=material, max_order=min(order, enough))
    room.add_source(source, directivity=None if facing is None else _cardioid(facing))
    room.add_microphone_array(places.T)
    room.compute_rir()
    rows = [np.asarray(row[0], float) for row in room.rir or ()]
    out = np.zeros((len(rows), max(map(len, rows)) + RATE // 2))  # half a second of silence follows
    for row, h in zip(out, rows, strict=True):
        row[: len(h)] = h
    return out


def _cardioid(facing):
    """Return a cardioid whose axis is a direction (3,)."""
    from pyroomacoustics.directivities import Cardioid, DirectionVector

    azimuth, colatitude = np.arctan2(facing[1], facing[0]), np.arccos(facing[2] / np.linalg.norm(facing))
    return Cardioid(DirectionVector(azimuth, colatitude, degrees=False))


def speech_like(noise: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return `noise` (T,) that falls by 9 dB per octave above 200 Hz and below 80 Hz, in syllables and pauses."""
    f = np.maximum(np.fft.rfftfreq(len(noise), 1 / RATE), 1e-3)
    voice = np.fft.irfft(np.fft.rfft(noise) / (1 + (f / 200) ** 1.5) / (1 + (80 / f) ** 1.5), len(noise))
    syllables, phrases = (
        np.fft.irfft(np.fft.rfft(rng.standard_normal(len(noise))) * (f < highest), len(noise)) for highest in (4.0, 0.5)
    )
    return voice * np.maximum(syllables / syllables.std() + 0.5, 0) * (phrases / phrases.std() > -0.5)
