"""From a WAV of 60 s of a source that plays unknown noise to positions: a two-dimensional and a three-dimensional room.

The plane: 32 microphones over 0.8 m in a room of 6 x 5 m with absorbing walls, simulated on a grid. The space: 64
microphones in a ball of 0.5 m, image sources (bench_meshrir). 48 kHz, sensor noise 30 dB below the sound in the band
from 20 to 500 Hz and white beyond; four microphones known in the plane, five in space.
"""

import tempfile
from pathlib import Path

import numpy as np
import soundfile
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from fdcal.acoustics.fdtd import simulate
from fdcal.model.scene import Room, Source

from . import bench_meshrir
from .report import Figure

RATE, SECONDS, SNR_DB = 48_000, 60.0, 30.0


def plane_responses(places: np.ndarray) -> np.ndarray:
    """Return impulse responses (N, T) at 48 kHz in a room of 6 x 5 m, simulated at half this rate."""
    room = Room(outline=((0.0, 0.0), (6.0, 0.0), (6.0, 5.0), (0.0, 5.0)), walls="absorbing", admittance=0.05,
                sound_speed=bench_meshrir.SPEED, cell=0.025)  # fmt: skip
    source = Source(position=(5.4, 4.4), low=15.0, high=800.0, sample_rate=RATE / 2, duration=2.0)
    slow = simulate(room, source, places)
    return irfft(2 * rfft(slow, 2 * slow.shape[1]), 4 * slow.shape[1])[:, : 2 * slow.shape[1]]


def write_wav(path: Path, responses: np.ndarray, seed: int = 0) -> None:
    """Write what the microphones record while the source plays noise; the noise itself is not kept."""
    rng = np.random.default_rng(seed)
    samples = int(SECONDS * RATE)
    played = rng.standard_normal(samples + responses.shape[1])
    size = next_fast_len(len(played), real=True)
    spectrum, f = rfft(played, size), rfftfreq(size, 1 / RATE)
    band = (f > 20) & (f < 500)
    recorded = np.empty((samples, len(responses)), dtype=np.float32)
    for n, h in enumerate(responses):
        X = rfft(h, size) * spectrum
        quiet = np.sqrt(np.mean(np.abs(X[band]) ** 2) / size * 10 ** (-SNR_DB / 10))
        sound = irfft(X, size)[responses.shape[1] :][:samples]  # without the part that wraps round
        recorded[:, n] = sound + quiet * rng.standard_normal(samples)
    soundfile.write(path, recorded / np.abs(recorded).max() * 0.5, RATE, subtype="PCM_24")


def plane(count: int = 32, seed: int = 0) -> np.ndarray:
    """Return microphones over 0.8 m, the first four near the corners, on cells of the simulation (N, 2), metres."""
    rng = np.random.default_rng(seed)
    corners = np.array([[-0.4, -0.4], [0.4, -0.4], [-0.4, 0.4], [0.4, 0.4]])
    places = np.concatenate([corners, rng.uniform(-0.4, 0.4, (count - 4, 2))]) + [2.5, 2.1]
    return (np.floor(places / 0.025) + 0.5) * 0.025


def ball(count: int = 64, radius: float = 0.5, seed: int = 0) -> np.ndarray:
    """Return microphones in a ball, the first five far out (N, 3), metres."""
    rng = np.random.default_rng(seed)
    far = radius * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 0, 0]]) / np.sqrt(3)
    inside = rng.normal(size=(count - 5, 3))
    inside *= radius * rng.uniform(size=(count - 5, 1)) ** (1 / 3) / np.linalg.norm(inside, axis=1, keepdims=True)
    return np.concatenate([far, inside]) + bench_meshrir.CENTRE


def run() -> list[Figure]:
    figures = []
    with tempfile.TemporaryDirectory() as temporary:
        for words, places, known, respond, limit, options in (
            ("plane, 32 channels", plane(), 4, plane_responses, 10.0, ("--dimension", "2")),
            ("space, 64 channels", ball(), 5, bench_meshrir.responses, 20.0, ()),
        ):
            wav, table = Path(temporary) / "work.wav", Path(temporary) / "known.csv"
            write_wav(wav, respond(places))
            head = "name,x,y,z"[: 4 + 2 * places.shape[1]]
            rows = [",".join([str(n), *map(repr, places[n].tolist())]) for n in range(known)]
            table.write_text("\n".join([head, *rows]) + "\n")
            taken = ("--known", str(table), "--sound-speed", str(bench_meshrir.SPEED), *options)
            seconds, megabytes, error = bench_meshrir.from_folder(wav, taken, Path(temporary), places)
            figures += [
                Figure(
                    f"{words}, {known} known: RMS error", 1e3 * error, "mm", f"at most {limit:g}", 1e3 * error <= limit
                ),
                Figure(f"{words}: WAV to positions", seconds, "s"),
                Figure(f"{words}: memory at most", megabytes, "MB", "below 1000", megabytes < 1000),
            ]
    return figures
