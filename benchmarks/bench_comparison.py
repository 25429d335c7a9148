"""fdcal beside a diffuse field's coherence, arrival times and a tape measure, on the same recordings of four rooms.

32 microphones in a ball of 0.4 m, blind, in a room of 9 x 7 x 4 m by image sources (pyroomacoustics); eight positions
of one source, which plays noise or an impulse; 8 kHz. fdcal and the coherence hear the first position or all, the
arrival times need all of them. Prints a table in Markdown: RMS position errors of each draw after the best rigid
motion, in millimetres, and the seconds of the processor.
"""

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import oaconvolve

import fdcal
from fdcal.model.gauge import align
from fdcal.model.validation import InputError
from fdcal_bench.methods import (
    coherence,
    cross_spectra,
    distances_of_coherence,
    first_arrivals,
    positions_of_arrivals,
    robust_scaling,
    time_differences,
)
from fdcal_bench.rooms import RATE, SPEED, responses

ALONE = True
ROOM, CENTRE = (9.0, 7.0, 4.0), (4.1, 3.3, 1.7)  # m
REVERBERATION = (0.2, 0.5, 1.0, 2.0)  # s, by Sabine's formula
ORDER, ORDER_OTHERS = 60, 40  # of reflections, of the first source and of the others
COUNT, RADIUS, APART = 32, 0.4, 0.08  # microphones; m; m
SOURCES, SOURCE_SIGMA = 8, 0.05  # positions of the source; m, how well they are measured
TAPE = 0.005  # m, of each coordinate
LONG, SHORT = 30.0, 4.0  # s of noise, of the first source and of each other one
SNR_DB, PEAK_DB = 30.0, 60.0  # sensor noise below the noise, and below the peak of an impulse
BAND = (50.0, 2000.0)  # Hz, of the coherence
SEGMENT = {"noise": 512, "impulse": 128}  # samples, of the coherence
TAIL = 0.005  # s after the direct sound, where the coherence of a response begins
DRAWS = 2
METHODS = ("fdcal", "fdcal, 8 takes", "coherence, 1 source", "coherence, 8 sources", "arrival times", "tape measure")


@dataclass(frozen=True)
class Recorded:
    """An array (N, 3), sources (S, 3), and what was recorded of each source, a list of (N, T)."""

    places: np.ndarray
    sources: np.ndarray
    recordings: list[np.ndarray]


def placed(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return microphones (N, 3) in a ball and sources (S, 3) on all sides of it, metres."""
    kept: list[np.ndarray] = []
    while len(kept) < COUNT:
        x = rng.uniform(-RADIUS, RADIUS, 3)
        if np.linalg.norm(x) < RADIUS and all(np.linalg.norm(x - y) > APART for y in kept):
            kept.append(x)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sources = CENTRE + corners * rng.uniform([1.5, 1.5, 0.4], [3.2, 2.6, 1.4], (SOURCES, 3))
    return np.array(kept) + CENTRE, sources[rng.permutation(SOURCES)]


def record(reverberation: float, seed: int) -> dict[str, Recorded]:
    """Return what the array records of the noise and of the impulse, with sensor noise."""
    rng = np.random.default_rng([seed, 15])
    places, sources = placed(rng)
    noise, impulse = [], []
    for s, source in enumerate(sources):
        h = responses(places, source, reverberation, ORDER if s == 0 else ORDER_OTHERS, ROOM)
        floor = np.abs(h).max() * 10 ** (-PEAK_DB / 20)
        impulse.append(h + floor * rng.standard_normal(h.shape))
        played = rng.standard_normal(int(RATE * (LONG if s == 0 else SHORT)) + h.shape[1])
        sound = oaconvolve(played[None], h, axes=1)[:, h.shape[1] : len(played)]
        floor = np.sqrt(np.mean(sound**2)) * 10 ** (-SNR_DB / 20)
        noise.append(sound + floor * rng.standard_normal(sound.shape))
    return {"noise": Recorded(places, sources, noise), "impulse": Recorded(places, sources, impulse)}


def by_fdcal(recorded: Recorded, kind: str, sources: int) -> tuple[np.ndarray, str]:
    """Positions (N, 3) from WAV files of the first sources, one each, and the verdict."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"source{s}.wav" for s in range(sources)]
        for path, samples in zip(paths, recorded.recordings, strict=False):
            soundfile.write(path, 0.5 * samples.T / np.abs(samples).max(), RATE, subtype="FLOAT")
        kinds = {"noise": "stationary", "impulse": "impulse"}
        measurement = fdcal.load(paths, kind=kinds[kind], sound_speed=SPEED)
    found = fdcal.calibrate(measurement, known="none")
    return np.asarray(found.positions), str(found.verdict)


def by_coherence(recorded: Recorded, kind: str, sources: int) -> np.ndarray:
    """Positions (N, 3) from the noise, or from the responses after the direct sound."""
    total: np.ndarray | float = 0.0
    f = np.zeros(0)
    for samples in recorded.recordings[:sources]:
        if kind == "impulse":
            samples = samples[:, int(RATE * (first_arrivals(samples, RATE).max() + TAIL)) :]
        f, spectra = cross_spectra(samples, RATE, SEGMENT[kind], kind == "impulse")
        total = total + spectra / np.real(np.einsum("nnf->f", spectra))
    used = (f >= BAND[0]) & (f <= BAND[1])
    return robust_scaling(distances_of_coherence(coherence(total)[..., used], f[used], SPEED))


def by_arrivals(recorded: Recorded, kind: str, rng: np.random.Generator) -> np.ndarray:
    """Positions (N, 3) from the arrival times of all sources, whose positions were measured roughly."""
    if kind == "impulse":
        times = [first_arrivals(samples, RATE) for samples in recorded.recordings]
    else:
        times = [time_differences(samples, RATE, 2 * RADIUS / SPEED) for samples in recorded.recordings]
    measured = recorded.sources + SOURCE_SIGMA * rng.standard_normal(recorded.sources.shape)
    return positions_of_arrivals(np.array(times), measured, SPEED, SOURCE_SIGMA, np.array(CENTRE))


def error_mm(found: np.ndarray, truth: np.ndarray) -> float:
    """RMS error after the best rigid motion, a mirror image allowed."""
    return 1e3 * float(np.sqrt(np.mean(np.sum((align(found, truth) - truth) ** 2, axis=1))))


def errors(recorded: Recorded, kind: str, seed: int) -> tuple[list[float], list[float], list[str]]:
    """Return the error of each of METHODS, millimetres, the seconds it took, and fdcal's verdicts, of 1 and 8 takes."""
    rng, verdicts, truth = np.random.default_rng([seed, 16]), [], recorded.places

    def fdcal_positions(sources: int):
        try:
            found, verdict = by_fdcal(recorded, kind, sources)
        except InputError as error:
            print(f"    fdcal refused: {error}")
            found, verdict = np.full(truth.shape, np.nan), "refused"
        verdicts.append(verdict)
        return found

    found, seconds = [], []
    for method in (
        lambda: fdcal_positions(1),
        lambda: fdcal_positions(SOURCES),
        lambda: by_coherence(recorded, kind, 1),
        lambda: by_coherence(recorded, kind, SOURCES),
        lambda: by_arrivals(recorded, kind, rng),
        lambda: truth + TAPE * rng.standard_normal(truth.shape),
    ):
        start = time.process_time()
        positions = method()
        seconds.append(time.process_time() - start)
        found.append(error_mm(positions, truth) if np.isfinite(positions).all() else np.nan)
    return found, seconds, verdicts


def run() -> Iterator[str]:
    yield "| reverberation | source | " + " | ".join((*METHODS, "verdicts of fdcal, 1 and 8 takes")) + " |"
    yield "|---" * (len(METHODS) + 3) + "|"
    taken = []
    for reverberation in REVERBERATION:
        drawn = [record(reverberation, seed) for seed in range(DRAWS)]
        for kind in ("noise", "impulse"):
            results = [errors(one[kind], kind, seed) for seed, one in enumerate(drawn)]
            taken += [seconds for _, seconds, _ in results]
            cells = [" / ".join(f"{found[n]:.1f}" for found, _, _ in results) for n in range(len(METHODS))]
            verdicts = "; ".join(" / ".join(f"`{both[n]}`" for _, _, both in results) for n in range(2))
            yield f"| {reverberation:g} s | {kind} | " + " | ".join((*cells, verdicts)) + " |"
    yield "| all | seconds | " + " | ".join(f"{s:.1f}" for s in np.mean(taken, axis=0)) + " | |"
