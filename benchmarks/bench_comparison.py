"""fdcal beside arrival times, the coherence of a diffuse field and a tape measure, on the same recordings.

Each row of the table is one kind of array, room, sound and number of takes; rooms are made by image sources
(pyroomacoustics) at 8 kHz. Every method is blind: it knows neither microphones nor sources. The other methods are
given whether an array is plane; fdcal detects it. The benchmark prints a table in Markdown: the median over the draws
of the RMS position error after the best rigid motion, in millimetres, with the largest in brackets, and the seconds of
processor time.
`python -m benchmarks.bench_comparison ROW...` computes some rows alone.
"""

import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import oaconvolve

import fdcal
from fdcal.model.gauge import align
from fdcal.model.validation import InputError
from fdcal_bench.methods import (
    blind_positions_of_arrivals,
    by_coherence,
    first_arrivals,
    time_differences,
)
from fdcal_bench.rooms import RATE, SPEED, draw_array, draw_source, responses, speech_like

ALONE = True
LIVING, OFFICE, HALL = (5.6, 4.4, 2.6), (6.8, 5.6, 3.1), (9.0, 7.0, 4.0)  # m
ORDER = 40  # largest order of reflections
TAPE = 0.005  # m, of each coordinate
SNR_DB, PEAK_DB = 35.0, 60.0  # sensor noise below a sound, and below the peak of an impulse response
DRAWS = 8
TIME_LIMIT = 900.0  # s, of processor time, so that no verdict depends on the speed of the machine


def circle(rng: np.random.Generator) -> np.ndarray:
    """Return eight microphones on a circle of 0.1 m, not quite evenly spaced (8, 3), metres."""
    angle = 2 * np.pi * np.arange(8) / 8 + rng.normal(0, 0.05, 8)
    return 0.1 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(8)])


def table(rng: np.random.Generator) -> np.ndarray:
    """Return eight microphones on a table, up to 0.2 m from its middle (8, 3), metres."""
    angle = 2 * np.pi * np.arange(8) / 8 + rng.normal(0, 0.15, 8)
    radius = 0.2 * np.sqrt(rng.uniform(0.3, 1, 8))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(8)])


def panel(rng: np.random.Generator) -> np.ndarray:
    """Return sixteen microphones, 42 mm apart, in an upright panel that is turned (16, 3), metres."""
    across, up = (0.042 * (part.ravel() - 1.5) for part in np.meshgrid(np.arange(4), np.arange(4)))
    turn = rng.uniform(0, np.pi)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), up]) + rng.normal(0, 5e-4, (16, 3))


def sphere(rng: np.random.Generator) -> np.ndarray:
    """Return 24 microphones on an open sphere of 0.3 m (24, 3), metres."""
    z = 1 - 2 * (np.arange(24) + 0.5) / 24
    angle = 2.39996 * np.arange(24)
    return np.column_stack([0.3 * np.sqrt(1 - z**2) * f(angle) for f in (np.cos, np.sin)] + [0.3 * z]) + rng.normal(
        0, 3e-3, (24, 3)
    )


def spiral(rng: np.random.Generator) -> np.ndarray:
    """Return 64 microphones on an upright spiral of 0.5 m that is turned (64, 3), metres."""
    radius, angle, turn = 0.5 * np.sqrt((np.arange(64) + 0.5) / 64), 2.39996 * np.arange(64), rng.uniform(0, np.pi)
    across, up = radius * np.cos(angle), radius * np.sin(angle)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), up]) + rng.normal(0, 2e-3, (64, 3))


def box(rng: np.random.Generator) -> np.ndarray:
    """Return 32 microphones in a box of 2 x 2 x 1 m (32, 3), metres."""
    return rng.uniform([-1, -1, -0.5], [1, 1, 0.5], (32, 3))


def ball(count: int, radius: float) -> Callable[[np.random.Generator], np.ndarray]:
    """Return a function that draws microphones in a ball."""
    return lambda rng: draw_array(rng, count, radius)


@dataclass(frozen=True)
class Row:
    """One kind of array, room, sound, and takes."""

    microphones: str
    draw: Callable[[np.random.Generator], np.ndarray]
    room: tuple[float, float, float]  # m
    reverberation: float  # s, by Sabine's formula
    sound: str  # impulse, noise or speech
    takes: int
    flat: bool = False

    @property
    def seconds(self) -> float:
        """Length of a take of noise or speech."""
        return 60.0 if self.takes == 1 else 20.0


ROWS = (
    Row("8, circle of 0.1 m", circle, LIVING, 0.45, "impulse", 1, True),
    Row("8, circle of 0.1 m", circle, LIVING, 0.45, "impulse", 6, True),
    Row("8 on a table, 0.2 m", table, LIVING, 0.4, "noise", 1, True),
    Row("8 on a table, 0.2 m", table, LIVING, 0.4, "noise", 4, True),
    Row("16 in a panel of 0.13 m", panel, LIVING, 0.5, "noise", 4, True),
    Row("16 in a ball of 0.3 m", ball(16, 0.3), OFFICE, 0.4, "noise", 1),
    Row("16 in a ball of 0.3 m", ball(16, 0.3), OFFICE, 0.4, "noise", 4),
    Row("24 on a sphere of 0.3 m", sphere, LIVING, 0.45, "speech", 1),
    Row("24 on a sphere of 0.3 m", sphere, LIVING, 0.45, "speech", 4),
    Row("32 in a ball of 0.4 m", ball(32, 0.4), HALL, 0.2, "noise", 1),
    Row("32 in a ball of 0.4 m", ball(32, 0.4), HALL, 0.2, "impulse", 8),
    Row("32 in a ball of 0.4 m", ball(32, 0.4), HALL, 0.8, "noise", 1),
    Row("32 in a ball of 0.4 m", ball(32, 0.4), HALL, 0.8, "noise", 8),
    Row("32 in a ball of 0.8 m", ball(32, 0.8), HALL, 0.4, "noise", 1),
    Row("32 in a box of 2 x 2 x 1 m", box, OFFICE, 0.8, "impulse", 3),
    Row("64 on a spiral of 0.5 m", spiral, OFFICE, 0.2, "noise", 1, True),
)


def record(row: Row, seed: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return an array (N, 3), metres, and what it records of each take, a list of (N, T) at RATE."""
    rng = np.random.default_rng([seed, 15])
    centre = np.array(row.room) * rng.uniform([0.35, 0.35, 0.3], [0.55, 0.55, 0.5])
    places, recordings = row.draw(rng) + centre, []
    for _ in range(row.takes):
        h = responses(places, draw_source(rng, row.room, centre), row.reverberation, ORDER, row.room)
        if row.sound == "impulse":
            recordings.append(h + np.abs(h).max() * 10 ** (-PEAK_DB / 20) * rng.standard_normal(h.shape))
            continue
        played = rng.standard_normal(int(RATE * row.seconds) + h.shape[1])
        played = speech_like(played, rng) if row.sound == "speech" else played
        sound = oaconvolve(played[None], h, axes=1)[:, h.shape[1] : len(played)]
        floor = np.sqrt(np.mean(sound**2)) * 10 ** (-SNR_DB / 20)
        recordings.append(sound + floor * rng.standard_normal(sound.shape))
    return places, recordings


def by_fdcal(row: Row, recordings: list[np.ndarray]) -> tuple[np.ndarray | None, str]:
    """Return positions (N, 3) from WAV files, one for each take, and the verdict."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"take{n}.wav" for n in range(len(recordings))]
        for path, samples in zip(paths, recordings, strict=True):
            soundfile.write(path, 0.5 * samples.T / np.abs(samples).max(), RATE, subtype="FLOAT")
        kind = "impulse" if row.sound == "impulse" else "stationary"
        try:
            measurement = fdcal.load(paths, kind=kind, sound_speed=SPEED)
            found = fdcal.calibrate(measurement, known="none", time_limit=TIME_LIMIT)
        except InputError:
            return None, "refused"
    x = np.asarray(found.positions)
    return np.pad(x, ((0, 0), (0, 3 - x.shape[1]))), str(found.verdict)


def by_arrivals(row: Row, recordings: list[np.ndarray], rng: np.random.Generator) -> np.ndarray | None:
    """Return positions (N, 3) from the arrival times of all takes; None where these are too few."""
    longest = 2 * max(np.ptp(row.draw(np.random.default_rng(0)), axis=0)) / SPEED
    impulse = row.sound == "impulse"
    times = [first_arrivals(one, RATE) if impulse else time_differences(one, RATE, longest) for one in recordings]
    x = blind_positions_of_arrivals(np.array(times), SPEED, 2 if row.flat else 3, rng)
    return None if x is None else np.pad(x, ((0, 0), (0, 3 - x.shape[1])))


def error_mm(found: np.ndarray | None, truth: np.ndarray) -> float:
    """Return the RMS error after the best rigid motion, a mirror image allowed; NaN without an array."""
    if found is None or not np.isfinite(found).all():
        return np.nan
    return 1e3 * float(np.sqrt(np.mean(np.sum((align(found, truth) - truth) ** 2, axis=1))))


def errors(row: Row, seed: int) -> tuple[list[float], list[float], str]:
    """Return the error of each method, millimetres, the seconds it took, and fdcal's verdict."""
    truth, recordings = record(row, seed)
    rng, verdicts = np.random.default_rng([seed, 16]), []

    def own() -> np.ndarray | None:
        found, verdict = by_fdcal(row, recordings)
        verdicts.append(verdict)
        return found

    def coherent() -> np.ndarray:
        D = 2 if row.flat else 3
        found = by_coherence(recordings, RATE, kind=row.sound, speed=SPEED, sources=None, dimension=D)[0]
        return np.pad(found, ((0, 0), (0, 3 - found.shape[1])))

    found, seconds = [], []
    for method in (
        own,
        lambda: by_arrivals(row, recordings, rng),
        coherent,
        lambda: truth + TAPE * rng.standard_normal(truth.shape),
    ):
        start = time.process_time()
        positions = method()
        seconds.append(time.process_time() - start)
        found.append(error_mm(positions, truth))
    return found, seconds, verdicts[0]


def run(chosen: tuple[int, ...] = tuple(range(len(ROWS)))) -> Iterator[str]:
    methods = ("fdcal", "arrival times", "coherence", "tape measure")
    yield "| microphones | reverberation | sound | takes | " + " | ".join(methods) + " | verdicts of fdcal |"
    yield "|---" * (len(methods) + 5) + "|"
    taken = []
    for row in (ROWS[number] for number in chosen):
        results = [errors(row, seed) for seed in range(DRAWS)]
        taken += [seconds for _, seconds, _ in results]
        cells = []
        for n in range(len(methods)):
            each = np.array([found[n] for found, _, _ in results])
            lost = np.where(np.isnan(each), np.inf, each)  # a method that finds no array in a draw has lost it
            cells.append("" if np.isinf(lost).all() else f"{np.median(lost):.1f} ({lost.max():.0f})")
        verdicts = Counter(verdict for _, _, verdict in results)
        counts = [f"{verdicts.pop('good', 0)} of {DRAWS} `good`"]
        counts += [f"{count} `{code}`" for code, count in verdicts.most_common()]
        where = f"{row.microphones} | {row.reverberation:g} s | {row.sound} | {row.takes}"
        yield f"| {where} | " + " | ".join(cells) + f" | {', '.join(counts)} |"
    yield "| seconds | | | | " + " | ".join(f"{s:.1f}" for s in np.mean(taken, axis=0)) + " | |"


if __name__ == "__main__":
    for line in run(tuple(int(number) for number in sys.argv[1:]) or tuple(range(len(ROWS)))):
        print(line, flush=True)
