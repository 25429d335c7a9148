"""A recording with the differences of its channels taken out, as a calibration found them.

    H_n(f) = g_n exp(j phi_n) exp(-j 2 pi f tau_n) / (1 - j f_n / f)

g gain and phi phase against the median channel, tau delay and f_n corner of a high-pass, where a fault names one
(`fdcal.cost.likelihood`). The spectrum of a channel is divided by H. Channels that are exchanged change places.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

from ..assessment.calibration import Calibration
from ..model.storage import write_atomically
from ..model.validation import InputError
from .formats.sound import SUFFIXES, open_for_writing
from .recording import GROUP_SAMPLES, Recording, read_samples

RESOLUTION = 2.0  # Hz, of the filters: half a second of impulse response
MAX_AMPLIFICATION = 10.0  # of bass that a channel has lost: what is below is noise


@dataclass(frozen=True)
class Correction:
    """What is done to each channel of a recording, in the order of its channels."""

    source: np.ndarray  # (N,) int64, the channel whose samples it takes
    gain: np.ndarray  # (N,) complex128, by which the channel is to be divided
    delay: np.ndarray  # (N,) float64, s, likewise
    corner: np.ndarray  # (N,) float64, Hz, of a high-pass; below 0 of one that all others have; 0 of none
    dead: tuple[str, ...]  # channels that hold no sound: written as they are
    unknown: tuple[str, ...]  # channels that the calibration does not know: written as they are

    def filters(self, rate: float) -> np.ndarray:
        """Return the impulse responses (N, L) float64 at a sampling rate, Hz; zero time is in the middle."""
        half = int(np.ceil(rate / RESOLUTION / 2))
        f = np.fft.rfftfreq(4 * half, 1 / rate)
        f_held = np.maximum(f, np.abs(self.corner[:, None]) / MAX_AMPLIFICATION)
        f_held[:, 0] = np.maximum(f_held[:, 0], f[1])
        cut = (1 - 1j * np.abs(self.corner[:, None]) / f_held) ** np.sign(self.corner[:, None])
        inverse = cut * np.exp(2j * np.pi * f * self.delay[:, None]) / self.gain[:, None]
        response = np.roll(np.fft.irfft(inverse, axis=1), half, axis=1)[:, : 2 * half + 1]
        return response * np.hanning(2 * half + 3)[1:-1]


def correction_of(result: Calibration, recording: Recording) -> Correction:
    """Return the correction of a recording by the calibration of one with the same channels.

    Channels are matched by name. InputError where no name is in both, or the calibration sought no gains.
    """
    channels = result.channels
    if channels is None or not channels.gains_sought:
        problem = f"the result of solver {result.solver} holds no gains of the channels"
        raise InputError(problem, "calibrate with <solver> robust", key="result")
    row = {name: n for n, name in enumerate(recording.names)}
    rows = [row.get(name) for name in result.names]
    if all(n is None for n in rows):
        problem = f'{recording.path} has channels such as "{recording.names[0]}", the result "{result.names[0]}"'
        raise InputError(
            problem, "give the recording that was calibrated, or one of the same channels", key="recording"
        )
    N = recording.count
    source, gain, delay, corner = np.arange(N), np.ones(N, complex), np.zeros(N), np.zeros(N)
    exchanged = set[tuple[int, int]]()
    for n, value in zip(rows, channels.correction.gains, strict=True):
        if n is not None:
            gain[n] = value
    for fault in channels.faults:
        n, partner = row.get(fault.name), row.get(fault.partner or "")
        if n is None:
            continue
        if fault.kind == "delayed":
            delay[n] = fault.value or 0.0
        elif fault.kind == "high_pass":
            corner[n] = fault.value or 0.0
        elif fault.kind == "dead":
            gain[n] = 1.0
        elif fault.kind == "exchanged" and partner is not None:
            exchanged.add((n, partner))
    for n, partner in exchanged:
        if (partner, n) in exchanged:  # else no channel is left for the partner
            source[n] = partner
    dead = tuple(fault.name for fault in channels.faults if fault.kind == "dead")
    unknown = tuple(name for name in recording.names if name not in result.names)
    return Correction(source, gain[source], delay[source], corner[source], dead, unknown)


def corrected_blocks(recording: Recording, correction: Correction) -> Iterator[np.ndarray]:
    """Yield the corrected samples of all channels, a block (N, t) float64 at a time, in order; as long as before."""
    filters = correction.filters(recording.sample_rate)
    reach = filters.shape[1] // 2
    step = max(reach, GROUP_SAMPLES // 8 // recording.count)
    for start in range(0, recording.samples, step):
        stop = min(start + step, recording.samples)
        first, last = max(start - reach, 0), min(stop + reach, recording.samples)
        padding = (0, 0), (first - start + reach, stop + reach - last)
        samples = np.pad(read_samples(recording, first, last)[correction.source], padding)
        yield fftconvolve(samples, filters, mode="valid", axes=1)


def write_corrected(path: str | Path, recording: Recording, correction: Correction, force: bool = False) -> None:
    """Write the corrected recording as a sound file of 32-bit floats, whose samples may exceed full scale."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        problem = f'"{path}" ends in no suffix of a sound file that holds floats'
        raise InputError(problem, f"use one of {', '.join(SUFFIXES)}", key="output", value=str(path))

    def write(temporary: Path) -> None:
        with open_for_writing(temporary, recording.sample_rate, recording.count) as file:
            for block in corrected_blocks(recording, correction):
                file.write(block.T.astype(np.float32))

    write_atomically(path, write, force)


def correction_summary(correction: Correction, names: tuple[str, ...]) -> str:
    """Return what is done to the channels, in a few lines."""
    decibels = -20 * np.log10(np.abs(correction.gain))
    lines = [
        f"gains   {decibels.min():+.2f} to {decibels.max():+.2f} dB, phases up to {_turn(correction.gain):.1f} degrees"
    ]
    inverted = [name for name, gain in zip(names, correction.gain, strict=True) if gain.real < 0]
    changed = [f"{name} from {names[n]}" for n, name in zip(correction.source, names, strict=True) if names[n] != name]
    delayed = [f"{name} by {1e3 * d:.3g} ms" for name, d in zip(names, correction.delay, strict=True) if d]
    cut = [f"{name} at {abs(f):.3g} Hz" for name, f in zip(names, correction.corner, strict=True) if f]
    for word, listed in (
        ("turned", inverted), ("moved", changed), ("advanced", delayed), ("bass", cut),
        ("dead", correction.dead), ("as is", correction.unknown),
    ):  # fmt: skip
        if listed:
            lines.append(f"{word:7s} {', '.join(listed)}")
    return "\n".join(lines)


def _turn(gains: np.ndarray) -> float:
    """Return the largest phase of some gains, degrees; 180 counts as a change of sign."""
    phases = np.abs(np.angle(gains))
    return float(np.degrees(np.minimum(phases, np.pi - phases).max()))
