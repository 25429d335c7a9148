"""Positions of the measured array from arrival times: how far its nominal positions can be trusted.

frl_array (see bench_real). Three sounds are cut out of each response: the direct one and the reflections from floor
and ceiling, which come first. Each is taken as a plane wave that passes the six equal microphones on the sphere. Its
delays follow from the slope of phase over frequency. Robust least squares gives positions and directions from them, up
to a rotation. Neither the model of a sound field nor a position of a loudspeaker is used.
"""

from collections.abc import Iterator

import numpy as np
import soundfile
from scipy.optimize import least_squares

from fdcal.model.gauge import align

from .bench_real import CONDITIONS, FRL, NOMINAL

ALONE = True
SPEED = 343.2  # m/s
BAND, HALF = (600.0, 3300.0), 0.6e-3  # Hz; half the length of the window round a sound, s
SOUNDS = {"direct": (0.0, 0.0), "floor": (3.4e-3, 3.95e-3), "ceiling": (4.15e-3, 4.7e-3)}  # s after the direct sound
COHERENT, ELEVATED, NEAR = 0.93, np.deg2rad(30), 0.01  # least coherence; least elevation, rad; m from nominal
FINE, ROUNDS = 16, 30  # samples of the envelope; iterations


def delays(spectra, f, length: int, rate: float, middle: float) -> tuple[np.ndarray, float]:
    """Return the delays (N,), s, of a sound at a time against their mean, and its least coherence with the mean."""
    t, found = np.arange(length) / rate, np.zeros(len(spectra))
    window = np.where(np.abs(t - middle) < HALF, np.cos(np.pi * (t - middle) / 2 / HALF) ** 2, 0)
    fine = np.fft.rfftfreq(4096, 1 / rate)
    band = (fine > BAND[0]) & (fine < BAND[1])
    coherence = 0.0
    for _ in range(ROUNDS):  # the window follows the sound along the array
        moved = np.fft.irfft(spectra * np.exp(2j * np.pi * f * found[:, None]), 4 * length)[:, :length] * window
        y = np.fft.rfft(moved, 4096)[:, band]
        cross = y * y.mean(axis=0).conj()
        weight, g = np.abs(cross), fine[band]
        step = -np.sum(weight * np.angle(cross) * g, axis=1) / np.sum(weight * g**2, axis=1) / (2 * np.pi)
        found = found + 0.7 * (step - step.mean())
        norms = np.sqrt(np.sum(np.abs(y) ** 2, axis=1) * np.sum(np.abs(y.mean(axis=0)) ** 2))
        coherence = float((np.abs(cross.sum(axis=1)) / norms).min())
    return found, coherence


def unit(angles: np.ndarray) -> np.ndarray:
    """Return the directions (S, 3) of azimuth and elevation (S, 2), rad."""
    flat = np.cos(angles[:, 1])
    return np.stack([flat * np.cos(angles[:, 0]), flat * np.sin(angles[:, 0]), np.sin(angles[:, 1])], axis=1)


def sounds_of(condition: str, x: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield delays (6,), s, and direction (2,), rad, of each sound of a condition that roughly fits `x` (6, 3), m."""
    for path in sorted((FRL / condition).glob("*.wav")):
        samples, rate = soundfile.read(path)
        p = samples[:400, :6].T
        f, spectra = np.fft.rfftfreq(1600, 1 / rate), np.fft.rfft(p, 1600)
        envelope = np.abs(np.fft.irfft(np.fft.rfft(p), FINE * 400)).mean(axis=0)
        times = np.arange(len(envelope)) / rate / FINE
        first = times[np.argmax(envelope)]
        for sound, (begin, end) in SOUNDS.items():
            part = np.flatnonzero((times >= first + begin) & (times <= first + end))
            d, coherence = delays(spectra, f, 400, rate, times[part[np.argmax(envelope[part])]])
            along = np.linalg.lstsq(x, -SPEED * d, rcond=None)[0]
            start = [np.arctan2(along[1], along[0]), {"direct": 0.0, "floor": -0.8, "ceiling": 0.8}[sound]]
            fit = least_squares(lambda a, d=d: x @ unit(a[None])[0] + SPEED * d, start, x_scale=0.1)
            elevated = sound == "direct" or abs(fit.x[1]) > ELEVATED
            if coherence > COHERENT and elevated and np.sqrt(np.mean(fit.fun**2)) < NEAR:
                yield d, fit.x


def positions(sounds: list[tuple[np.ndarray, np.ndarray]], x: np.ndarray) -> np.ndarray:
    """Return the positions (6, 3), metres, by delays and rough directions, from places `x`."""
    d, angles = np.array([one for one, _ in sounds]), np.array([one for _, one in sounds])

    def residuals(v):
        q = v[: x.size].reshape(x.shape)
        return 1e3 * ((q - q.mean(axis=0)) @ unit(v[x.size :].reshape(-1, 2)).T + SPEED * d.T).ravel()

    found = least_squares(residuals, np.r_[x.ravel(), angles.ravel()], loss="soft_l1", f_scale=1.5).x
    return found[: x.size].reshape(x.shape)


def run() -> Iterator[str]:
    if not FRL.is_dir():
        yield f"frl_array: skipped, {FRL} is absent; FDCAL_REAL_DATA names the folder that it is in"
        return
    nominal = np.loadtxt(NOMINAL, delimiter=",", skiprows=1)[:6, 1:]
    nominal = nominal - nominal.mean(axis=0)
    every = {condition: list(sounds_of(condition, nominal)) for condition in CONDITIONS}
    for name, sounds in {**every, "all": [one for part in every.values() for one in part]}.items():
        q = align(positions(sounds, nominal), nominal)
        size = np.linalg.norm(q - q.mean(axis=0)) / np.linalg.norm(nominal)
        rms = 1e3 * np.sqrt(np.mean(np.sum((q - nominal) ** 2, axis=1)))
        heights = ", ".join(f"{1e3 * z:+.0f}" for z in (q - nominal)[:, 2])
        yield f"{name}: {len(sounds)} sounds, {rms:.1f} mm RMS from nominal, size {size:.2f}, higher by {heights} mm"
