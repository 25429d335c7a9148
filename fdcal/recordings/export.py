"""A calibration in files of other programs, and a recording corrected by it.

A recording is corrected by the differences of its channels as a calibration found them,

    H_n(f) = g_n exp(j phi_n) exp(-j 2 pi f tau_n) / (1 - j f_n / f)

g gain and phi phase against the median channel, tau delay and f_n corner of a high-pass, where a fault names one
(`fdcal.cost.likelihood`). The spectrum of a channel is divided by H. Channels that are exchanged change places.
"""

import xml.etree.ElementTree as tree
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np

from ..assessment.calibration import Calibration, placed_in_frame
from ..assessment.result_file import channel_table
from ..model.storage import write_atomically
from ..model.validation import InputError, require_choice
from . import formats
from .formats.sound import open_for_writing
from .recording import GROUP_SAMPLES, Recording, ranges, read_samples


def export(
    self: Calibration,
    path: str | PathLike[str],
    *,
    frame: str | None = None,
    table: str = "positions",
    force: bool = False,
) -> None:
    """Write the positions, or the gains of the channels, for another program; the suffix selects the format.

    Parameters
    ----------
    path : str or path
        Ends in .csv (a table), .json, .xml (Acoular), .sofa or .npy (pyroomacoustics).
    frame : str, optional
        Other coordinate axes than those of `Calibration.positions`: "known", "minimal" or "axes" (`Calibration.frame`).
    table : str
        "positions", or "gains" of the channels, of solver "robust": a .csv table, or factors for Acoular (.xml).
    force : bool
        Whether an existing file is overwritten.

    Raises
    ------
    InputError
        No format has this suffix, the frame does not exist, or the file exists and `force` is not set.
    StorageError
        The file cannot be written.

    Examples
    --------
    >>> import tempfile, fdcal
    >>> from pathlib import Path
    >>> found = fdcal.calibrate(fdcal.load("tiny"), modes=12)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     found.export(f"{folder}/tiny.csv")
    ...     Path(f"{folder}/tiny.csv").read_text().splitlines()[0]
    'name,x,y,z,uncertainty'
    """
    path, allowed = Path(path), GAIN_TEXTS if table == "gains" else formats.suffixes("write")
    require_choice("table", table, ("positions", "gains"))
    suffix = path.suffix.lower()
    if suffix not in allowed:
        raise InputError(f'"{path}" is no file of {table}', f"use one of {', '.join(allowed)}", key="output")
    if table == "positions":
        placed = placed_in_frame(self, frame)
        write_atomically(path, lambda file: formats.write(file, placed), force)
        return
    if frame is not None:
        raise InputError("a table of gains has no frame", "leave out <frame>", key="frame")
    text = GAIN_TEXTS[suffix](self)
    write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"), force)


def acoular_factors(result: Calibration) -> str:
    """Return the XML of Acoular's `Calib`: a factor for each channel, negative if it is inverted, 0 if it is dead.

    Acoular takes it for pascal per unit; here it is relative to the median channel.
    """
    channel_table(result)  # refuses a result without gains
    channels = result.channels
    assert channels is not None
    factors = np.copysign(10 ** (-channels.gain_db / 20), np.cos(np.radians(channels.phase_deg)))
    dead = {fault.name for fault in channels.faults if fault.kind == "dead"}
    root = tree.Element("Calib", name="relative to the median channel")
    for name, factor in zip(result.names, factors, strict=True):
        tree.SubElement(root, "pos", Name=name, factor=repr(0.0 if name in dead else float(factor)))
    tree.indent(root)
    return tree.tostring(root, "unicode", xml_declaration=True) + "\n"


GAIN_TEXTS = {".csv": channel_table, ".xml": acoular_factors}


RESOLUTION = 2.0  # Hz, of the filters: half a second of impulse response
MAX_AMPLIFICATION = 10.0  # greatest gain for bass that a channel has lost; weaker bass counts as noise


@dataclass(frozen=True)
class Correction:
    """What is done to each channel of a recording, in the order of its channels."""

    source: np.ndarray  # (N,) int64, number of the channel whose samples are used
    gain: np.ndarray  # (N,) complex128, by which the channel is to be divided
    delay: np.ndarray  # (N,) float64, s, by which the channel is late
    # (N,) float64, Hz, corner of the high-pass of a channel; negative if all other channels have it; 0 without one
    corner: np.ndarray
    dead: tuple[str, ...]  # channels that hold no sound: written as they are
    unknown: tuple[str, ...]  # channels that the calibration does not know: written as they are


def correction_of(result: Calibration, recording: Recording) -> Correction:
    """Return the correction of a recording by the calibration of one with the same channels.

    Channels are matched by name. Channels that known positions or a list show to be exchanged change places.
    InputError where no name is in both, or the calibration sought no gains.
    """
    channels = result.channels
    if channels is None or not channels.gains_sought:
        raise InputError(f"a result of solver {result.solver} holds no gains", "use <solver> robust", key="result")
    row = {name: n for n, name in enumerate(recording.names)}
    rows = [row.get(name) for name in result.names]
    if all(n is None for n in rows):
        problem = f'{recording.path} has channels such as "{recording.names[0]}", the result "{result.names[0]}"'
        raise InputError(problem, "give a recording of the channels that were calibrated", key="recording")
    N = recording.count
    source, gain, delay, corner = np.arange(N), np.ones(N, complex), np.zeros(N), np.zeros(N)
    for n, value in zip(rows, channels.correction.gains, strict=True):
        if n is not None:
            gain[n] = value
    partners = {fault.name: fault.partner for fault in channels.faults if fault.kind == "exchanged"}
    for fault in channels.faults:
        n, partner = row.get(fault.name), row.get(partners.get(fault.name) or "")
        if n is None:
            continue
        if fault.kind == "delayed":
            delay[n] = fault.value or 0.0
        elif fault.kind == "high_pass":
            corner[n] = fault.value or 0.0
        elif fault.kind == "dead":
            gain[n] = 1.0
        elif fault.kind == "exchanged" and partner is not None and partners.get(fault.partner or "") == fault.name:
            source[n] = partner  # each fault names the other channel; otherwise one channel would be used twice
    own, places = source.copy(), [row.get(name) for name in result.order or ()]
    for n, place in zip(rows, places, strict=False):
        if n is not None and place is not None:
            source[place] = own[n]
    dead = tuple(fault.name for fault in channels.faults if fault.kind == "dead")
    unknown = tuple(name for name in recording.names if name not in result.names)
    return Correction(source, gain[source], delay[source], corner[source], dead, unknown)


def corrected_blocks(recording: Recording, correction: Correction) -> Iterator[np.ndarray]:
    """Yield the corrected samples of all channels in blocks (N, t) float64; the length of the recording is kept."""
    from scipy.signal import fftconvolve  # a library that the export of positions does not need

    reach = int(np.ceil(recording.sample_rate / RESOLUTION / 2))  # half the length of an impulse response
    f, corner = np.fft.rfftfreq(4 * reach, 1 / recording.sample_rate), correction.corner[:, None]
    f_held = np.maximum(f, np.abs(corner) / MAX_AMPLIFICATION)
    f_held[:, 0] = np.maximum(f_held[:, 0], f[1])
    cut = (1 - 1j * np.abs(corner) / f_held) ** np.sign(corner)
    inverse = cut * np.exp(2j * np.pi * f * correction.delay[:, None]) / correction.gain[:, None]
    filters = np.roll(np.fft.irfft(inverse, axis=1), reach, axis=1)[:, : 2 * reach + 1]  # zero time in the middle
    filters *= np.hanning(2 * reach + 3)[1:-1]
    for start, stop in ranges(recording.samples, max(reach, GROUP_SAMPLES // 8 // recording.count)):
        first, last = max(start - reach, 0), min(stop + reach, recording.samples)
        padding = (0, 0), (first - start + reach, stop + reach - last)
        samples = np.pad(read_samples(recording, first, last)[correction.source], padding)
        yield fftconvolve(samples, filters, mode="valid", axes=1)


def write_corrected(path: str | Path, recording: Recording, correction: Correction, force: bool = False) -> None:
    """Write the corrected recording as a sound file of 32-bit floats, whose samples may exceed full scale."""

    def write(temporary: Path) -> None:
        with open_for_writing(temporary, recording.sample_rate, recording.count) as file:
            for block in corrected_blocks(recording, correction):
                file.write(block.T.astype(np.float32))

    write_atomically(path, write, force)


def correction_summary(correction: Correction, names: tuple[str, ...]) -> str:
    """Describe in a few lines what is done to the channels."""
    decibels = -20 * np.log10(np.abs(correction.gain))
    phases = np.abs(np.angle(correction.gain))
    turn = np.degrees(np.minimum(phases, np.pi - phases).max())  # 180 degrees count as a change of sign
    lines = [f"gains   {decibels.min():+.2f} to {decibels.max():+.2f} dB, phases up to {turn:.1f} degrees"]
    inverted = [name for name, gain in zip(names, correction.gain, strict=True) if gain.real < 0]
    changed = [f"{name} from {names[n]}" for n, name in zip(correction.source, names, strict=True) if names[n] != name]
    delayed = [f"{name} by {1e3 * d:.3g} ms" for name, d in zip(names, correction.delay, strict=True) if d]
    cut = [f"{name} at {abs(f):.3g} Hz" for name, f in zip(names, correction.corner, strict=True) if f]
    all_listed = {"turned": inverted, "moved": changed, "advanced": delayed, "bass": cut}
    all_listed |= {"dead": correction.dead, "as is": correction.unknown}
    return "\n".join([*lines, *(f"{word:7s} {', '.join(listed)}" for word, listed in all_listed.items() if listed)])
