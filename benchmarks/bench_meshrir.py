"""Calibrate a folder like MeshRIR's S1-M3969: 200 positions, none of them known, and a plane with four known ones.

The folder is made by image sources (Allen and Berkley 1979), which share nothing with fdcal: a room of 7.0 x 6.4 x
2.7 m whose walls reflect 0.72 of the pressure, 48 kHz, 32768 samples, sound up to 1.5 kHz, and noise 40 dB below.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numba
import numpy as np
from scipy.fft import irfft, rfft

from fdcal.model.gauge import align
from fdcal.model.measurement import load_measurement

from .report import Figure

ROOM = 7.0, 6.4, 2.7  # m
REFLECTION = 0.72  # of the pressure at every wall: 0.38 s to fall by 60 dB, as in the true data set
SPEED = 343.2  # m/s
RATE, SAMPLES = 48_000, 32_768
FEWER = 12  # factor by which the sampling rate of the sum over images is lower
TAPS, FINE = 64, 512  # of the pulse that stands for an image, and its points per sample
# A small process runs the command, because the peak memory of a child of this process would include its own memory.
MEASURED = """
import resource, subprocess, sys
code = subprocess.run([sys.executable, "-m", "fdcal", *sys.argv[1:]], stdout=subprocess.DEVNULL).returncode
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""
CENTRE = 3.6, 2.9, 1.3  # m, of the mesh
SOURCE = 5.9, 5.1, 0.9  # m


def mesh(shape=(21, 21, 9), spacing=0.05) -> np.ndarray:
    """Return positions of the microphone about the origin (M, 3), metres, as MeshRIR numbers them: x slowest."""
    axes = [spacing * (np.arange(n) - (n - 1) / 2) for n in shape]
    return np.stack([c.ravel() for c in np.meshgrid(*axes, indexing="ij")], axis=1)


def responses(places: np.ndarray, source=SOURCE, room=ROOM, reflection=REFLECTION, speed=SPEED) -> np.ndarray:
    """Return impulse responses (M, SAMPLES) float64 at `places` (M, 3) in the room, metres."""
    images, strength = _images(np.array(source), np.array(room), reflection, speed * SAMPLES / RATE)
    t = np.arange(-TAPS // 2 * FINE, TAPS // 2 * FINE + 1) / FINE
    pulse = 0.6 * np.sinc(0.6 * t) * np.cos(np.pi * t / TAPS) ** 2
    slow = np.zeros((len(places), SAMPLES // FEWER + TAPS))
    _add(slow, places, images, strength, speed / (RATE / FEWER), pulse)
    slow = slow[:, TAPS // 2 :][:, : SAMPLES // FEWER]
    padded = np.pad(slow, ((0, 0), (0, slow.shape[1])))  # so that nothing wraps round
    fine = irfft(rfft(padded), FEWER * padded.shape[1])
    out = np.zeros((len(places), SAMPLES))
    kept = min(SAMPLES, fine.shape[1] // 2)
    out[:, :kept] = fine[:, :kept]
    return out


def _images(source, room, reflection, reach) -> tuple[np.ndarray, np.ndarray]:
    """Image sources (I, 3) within `reach` of the room, metres, and their strength (I,)."""
    axes, bounces = [], []
    for s, size in zip(source, room, strict=True):
        n = np.arange(-int(reach / size / 2) - 2, int(reach / size / 2) + 3)
        axes.append(np.concatenate([2 * n * size + s, 2 * n * size - s]))
        bounces.append(np.concatenate([2 * np.abs(n), np.abs(n) + np.abs(n - 1)]))
    grids = np.meshgrid(*axes, indexing="ij")
    near = sum(g**2 for g in grids) < (reach + max(room)) ** 2
    number = sum(b[near] for b in np.meshgrid(*bounces, indexing="ij"))
    return np.stack([g[near] for g in grids], axis=1), reflection ** number.astype(float)


@numba.njit(parallel=True)
def _add(out, places, images, strength, per_sample, pulse):
    for m in numba.prange(len(places)):
        for i in range(len(images)):
            r = np.sqrt(np.sum((images[i] - places[m]) ** 2))
            t = r / per_sample
            first = int(np.ceil(t))
            gain = strength[i] / (4 * np.pi * r)
            if first >= out.shape[1] - TAPS or gain < 1e-9:
                continue
            at = (first - t) * FINE
            low = int(at)
            part = at - low
            for k in range(TAPS):
                j = low + FINE * k
                out[m, first + k] += gain * ((1 - part) * pulse[j] + part * pulse[j + 1])


def write_folder(folder: Path, places: np.ndarray, simulated=None, snr_db: float = 40.0, seed: int = 0) -> None:
    """Write a MeshRIR folder. The noise is white, `snr_db` below the mean power from 20 to 500 Hz.

    Only the positions numbered in `simulated` are simulated (all unless given); the others hold noise, to save time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "pos_mic.npy", places)
    np.save(folder / "pos_src.npy", np.array([SOURCE]) - CENTRE)
    rng = np.random.default_rng(seed)
    f = np.arange(SAMPLES // 2 + 1) * RATE / SAMPLES
    simulated = np.arange(len(places)) if simulated is None else np.asarray(simulated)
    power = np.mean(np.abs(rfft(responses(places[simulated[:8]] + CENTRE))[:, (f > 20) & (f < 500)]) ** 2)
    noise = np.sqrt(power / SAMPLES * 10 ** (-snr_db / 10))
    for n in np.setdiff1d(np.arange(len(places)), simulated):
        np.save(folder / f"ir_{n}.npy", (noise * rng.standard_normal((1, SAMPLES))).astype(np.float32))
    for start in range(0, len(simulated), 64):
        numbers = simulated[start : start + 64]
        clean = responses(places[numbers] + CENTRE)
        for n, row in zip(numbers, clean + noise * rng.standard_normal(clean.shape), strict=True):
            np.save(folder / f"ir_{n}.npy", row[None].astype(np.float32))


def from_folder(folder: Path, options: tuple[str, ...], out: Path, truth=None) -> tuple[float, float, float]:
    """Return seconds, megabytes and RMS error, metres, from the folder to positions by the commands that a user types.

    `truth` (N, D), metres, if the folder does not contain it.
    """
    file, result = out / "taken.npz", out / "result.json"
    start, greatest = time.perf_counter(), 0.0
    for command in (
        ["import", str(folder), "-o", str(file), "--force", *options],
        ["calibrate", str(file), "--solver", "joint", "-o", str(result), "--force"],
    ):
        done = subprocess.run([sys.executable, "-c", MEASURED, *command], capture_output=True, text=True)
        if done.returncode not in (0, 4):  # 4: calibrated, but not to be trusted
            raise RuntimeError(done.stderr)
        greatest = max(greatest, int(done.stdout.split()[-1]) / 1024)
    return time.perf_counter() - start, greatest, _error(file, json.loads(result.read_text()), truth)


def _error(file: Path, result: dict, truth=None) -> float:
    """Return the RMS error, metres; after the best rigid motion if no microphone was known."""
    measurement, positions = load_measurement(file), np.array(result["positions"])
    truth = measurement.positions if truth is None else truth
    if not len(measurement.known):
        positions = align(positions, truth)
    return float(np.sqrt(np.mean(np.sum((positions - truth) ** 2, axis=1))))


def run() -> list[Figure]:
    places, figures = mesh(), []
    drawn = np.random.default_rng(0).choice(len(places), 200, replace=False)
    simulated = np.union1d(drawn, np.flatnonzero(np.abs(places[:, 2]) < 1e-6))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(os.environ.get("FDCAL_MESHRIR", f"{temporary}/S1-M3969"))  # to make it once and keep it
        if not (folder / f"ir_{simulated[-1]}.npy").exists():
            write_folder(folder, places, simulated)
        ends = np.flatnonzero((np.abs(places) == np.abs(places).max(axis=0))[:, :2].all(axis=1) & (places[:, 2] == 0))
        corners = ",".join(map(str, ends.tolist()))
        level = ",".join(map(str, np.flatnonzero(np.abs(places[:, 2]) < 1e-6).tolist()))
        for words, options, limit in (
            ("200 drawn at random, none known", ("--subset", ",".join(map(str, np.sort(drawn).tolist()))), 10.0),
            ("the plane z = 0, its corners known", ("--subset", level, "--known", corners), 15.0),
        ):
            seconds, megabytes, error = from_folder(folder, options, Path(temporary))
            figures += [
                Figure(f"{words}: RMS error", 1e3 * error, "mm", f"at most {limit:g}", 1e3 * error <= limit),
                Figure(f"{words}: folder to positions", seconds, "s", "at most 30", seconds <= 30),
                Figure(f"{words}: memory at most", megabytes, "MB", "below 1000", megabytes < 1000),
            ]
    return figures
