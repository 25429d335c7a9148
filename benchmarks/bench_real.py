"""From WAV files to positions: a measured array, and simulations of what a person records in a room.

frl         ../shared/data/frl_array, or frl_array in the folder FDCAL_REAL_DATA: seven microphones on a sphere of 5 cm
            and at its centre, impulse responses in a laboratory with 0, 50 and 100 % of absorbing panels; error to the
            nominal places
dirha       six microphones below a ceiling, LA and KA of SHINE-FBK/DIRHA_English_wsj (`Training_IRs`), impulse
            responses of three places of a loudspeaker in a living room; true positions to centimetres
ami         eight microphones in a circle of 0.1 m on a table, `data/AMI_WSJ20*` of fgnt/nara_wpe: 8 s of a speaker
living      a living room of 5 x 4 x 2.6 m, 0.4 s: 16 and 32 microphones in a ball of 0.4 m, none given, and 32 in a
            plane, four given; noise and a sound with the spectrum and pauses of speech, 60 s in one take or in four,
            sensor noise 30 dB below it in the band from 20 to 500 Hz
dead        small arrays in a room of 6 x 5 x 2.8 m, 0.2 to 0.5 s: impulses of a cardioid source, sensor noise 60 dB
            below the peak

The folder FDCAL_REAL_DATA holds the measured arrays, each under the name of its repository; one that is absent is
skipped. Only frl_array has a licence, so the others are not in this repository.

Rooms are simulated by image sources (pyroomacoustics) at 8 kHz. FDCAL_BENCH_FAMILIES names some of the families,
separated by commas; FDCAL_BENCH_DRAWS sets the draws of array, source and noise in a line, of takes for the measured
array. Each line has the RMS error after the best rigid motion (with positions given: without any motion) as mean and
worst of the draws, the size of the array found over the true one, the sigma claimed, the RMS of error over claim, rows,
the seconds of the processor from file to positions, and the verdicts.
"""

import os
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path

import numpy as np
import soundfile
from scipy import io
from scipy.fft import rfft, rfftfreq
from scipy.signal import oaconvolve

import fdcal
from fdcal.model.gauge import align
from fdcal.model.validation import InputError
from fdcal_bench.rooms import FAR, RATE, SPEED, draw_array, draw_source, responses, speech_like

ALONE = True
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "3"))
DATA = Path(os.environ.get("FDCAL_REAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
FRL, DIRHA, AMI = DATA / "frl_array", DATA / "DIRHA_English_wsj" / "Training_IRs", DATA / "nara_wpe" / "data"
NOMINAL = Path(__file__).parents[1] / "examples" / "frl_array" / "nominal.csv"
CONDITIONS, ALL_TAKES = ("000", "050", "100"), 12

RECORDED, SNR_DB, BAND = 60.0, 30.0, (20.0, 500.0)  # of noise and speech: s of all takes together; dB in a band, Hz
PEAK_DB = 60.0  # of an impulse
HEAD = " " * 44 + f" {'mean':>6} {'worst':>6} mm  {'size':>5} {'claim':>6} mm error/claim  rows     s  verdicts"


@dataclass(frozen=True)
class Case:
    """Takes of one array: their files, the true positions (N, 3) or (N, 2), metres, and options of `fdcal.load`."""

    name: str
    takes: Callable[[Path], list[Path]]
    truth: np.ndarray
    given: int = 0
    options: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """RMS error and claim, metres, size over the true one, rows, seconds and verdict; NaN where refused."""

    error: float = np.nan
    claim: float = np.nan
    size: float = np.nan
    rows: int = 0
    seconds: float = np.nan
    verdict: str = "refused"
    positions: np.ndarray | None = None  # (N, D), metres, moved onto the truth where none are given


def calibrated(case: Case) -> Found:
    """Import and calibrate a case."""
    with tempfile.TemporaryDirectory() as temporary:
        folder, options = Path(temporary), dict(case.options)
        if case.given:
            lines = [",".join([str(n), *map(repr, case.truth[n].tolist())]) for n in range(case.given)]
            table = folder / "known.csv"
            table.write_text("\n".join(["name,x,y,z"[: 4 + 2 * case.truth.shape[1]], *lines]) + "\n")
            options["known"] = str(table)
        files, start = case.takes(folder), time.process_time()
        try:
            measurement = fdcal.load(files, **options)
            found = fdcal.calibrate(measurement, known="all" if case.given else "none")
        except InputError as error:
            print(f"    {case.name}: {error}")
            return Found()
        seconds = time.process_time() - start
    x, free = np.asarray(found.positions), slice(case.given, None)
    placed = x if case.given else align(x, case.truth)
    errors = np.linalg.norm(placed - case.truth, axis=1)[free]
    sigma = np.full(len(errors), np.nan) if found.uncertainty is None else found.uncertainty[free]
    size = np.linalg.norm(x - x.mean(axis=0)) / np.linalg.norm(case.truth - case.truth.mean(axis=0))
    rows, verdict = len(measurement.frequencies), str(found.verdict)
    return Found(_rms(errors), _rms(sigma), float(size), rows, seconds, verdict, placed)


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def measured() -> Iterator[Case]:
    """Yield cases of the measured array: takes of one, four and all loudspeaker places, evenly round the array."""
    truth = np.loadtxt(NOMINAL, delimiter=",", skiprows=1)[:, 1:]
    for condition in CONDITIONS:
        files = sorted((FRL / condition).glob("*.wav"))
        for count in (1, 4, ALL_TAKES):
            apart = ALL_TAKES // count
            for first in np.unique(np.linspace(0, apart, min(DRAWS, apart), endpoint=False).astype(int)):
                chosen = files[first::apart]
                yield Case(f"frl_array {condition}, {_takes(count)}", lambda _, chosen=chosen: chosen, truth)


def below_a_ceiling() -> Iterator[Case]:
    """Yield cases of each array of six below the ceiling: each loudspeaker place alone, and all three as takes."""
    places = sorted(DIRHA.glob("T*"))
    for array in ("LA", "KA"):
        texts = [(places[0] / f"{array}{n}.txt").read_text() for n in range(1, 7)]
        found = [re.search(r"xpos=([\d.]+),ypos=([\d.]+),zpos=([\d.]+)", text) for text in texts]
        truth = np.array([[float(value) / 100 for value in one.groups()] for one in found if one])  # from cm
        options = {"kind": "impulse", "array_radius": 0.3}
        for chosen in (*([place] for place in places), places):

            def write(folder, array=array, chosen=chosen):
                return [_sampled(folder / f"{place.name}.wav", place, array) for place in chosen]

            yield Case(f"DIRHA {array}, {_takes(len(chosen))}", write, truth, options=options)


def _sampled(path: Path, place: Path, array: str) -> Path:
    responses = [np.ravel(io.loadmat(place / f"{array}{n}.mat")["risp_imp"]) for n in range(1, 7)]
    samples = np.stack([one[: min(map(len, responses))] for one in responses], axis=1)
    soundfile.write(path, samples / np.abs(samples).max(), 48000, subtype="FLOAT")
    return path


def on_a_table() -> Iterator[Case]:
    """Yield the case of the circle of eight with a person who speaks."""
    files = sorted(AMI.glob("AMI_WSJ20-Array1-*.wav"))
    angle = 2 * np.pi * np.arange(8) / 8
    truth = 0.1 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    yield Case("AMI, 1 take", lambda _: files, truth, options={"kind": "stationary", "array_radius": 0.1})


@dataclass(frozen=True)
class Simulated:
    """A family of cases; `radius`: of the ball, metres, that contains the microphones; `flat`: at one height in it."""

    name: str
    room: tuple[float, float, float]
    reverberation: float
    kind: str
    count: int
    radius: float
    flat: bool = False

    def cases(self) -> Iterator[Case]:
        """Yield the cases of each draw, with one take and with four."""
        for takes in (1, 4):
            for seed in range(DRAWS):
                rng = np.random.default_rng([seed, 24, self.count])
                places = draw_array(rng, self.count, self.radius, self.flat) + np.array(self.room) * (0.44, 0.47, 0.5)
                sources = [draw_source(rng, self.room, places.mean(axis=0)) for _ in range(4)][:takes]
                options = {"sound_speed": SPEED, "kind": "impulse" if self.kind == "impulse" else "stationary"}

                def write(folder, places=places, sources=sources, seed=seed):
                    return [self.write(folder / f"{n}.wav", places, x, len(sources), [seed, n]) for n, x in
                            enumerate(sources)]  # fmt: skip

                truth, given = (places[:, :2], FAR) if self.flat else (places, 0)
                yield Case(f"{self.name}, {_takes(takes)}", write, truth, given, options)

    def write(self, path: Path, places, source, takes: int, seed: list[int]) -> Path:
        """Write what the array records of a source: a cardioid facing the array for impulses, else a point source."""
        rng, facing = np.random.default_rng(seed), places.mean(axis=0) - source
        impulse = self.kind == "impulse"
        h = responses(places, source, self.reverberation, 80, self.room, facing if impulse else None)
        sound, floor = h, np.abs(h).max() * 10 ** (-PEAK_DB / 20)
        if not impulse:
            played = rng.standard_normal(int(RATE * RECORDED / takes) + h.shape[1])
            played = speech_like(played, rng) if self.kind == "speech" else played
            sound = oaconvolve(played[None], h, axes=1)[:, h.shape[1] : len(played)]
            f, spectrum = rfftfreq(sound.shape[1], 1 / RATE), rfft(sound, axis=1)
            band = (f > BAND[0]) & (f < BAND[1])
            floor = np.sqrt(np.mean(np.abs(spectrum[:, band]) ** 2) / sound.shape[1]) * 10 ** (-SNR_DB / 20)
        samples = sound + floor * rng.standard_normal(sound.shape)
        soundfile.write(path, 0.5 * samples.T / np.abs(samples).max(), RATE, subtype="FLOAT")
        return path


def _takes(count: int) -> str:
    return "1 take" if count == 1 else f"{count} takes"


LIVING, DEAD = (5.0, 4.0, 2.6), (6.0, 5.0, 2.8)  # m
FAMILIES: dict[str, Callable[[], Iterator[Case]]] = {
    "frl": measured,
    "dirha": below_a_ceiling,
    "ami": on_a_table,
    "living": lambda: chain.from_iterable(
        Simulated(f"living room, {kind}, {count} in a {words}", LIVING, 0.4, kind, count, 0.4, flat).cases()
        for kind in ("noise", "speech")
        for count, words, flat in ((16, "ball", False), (32, "ball", False), (32, "plane", True))
    ),
    "dead": lambda: chain.from_iterable(
        Simulated(f"dead room {t60:g} s, {count} in {100 * radius:.0f} cm", DEAD, t60, "impulse", count, radius).cases()
        for count, radius, t60 in ((7, 0.05, 0.5), (8, 0.1, 0.35), (12, 0.2, 0.2), (16, 0.3, 0.35))
    ),
}


def run() -> Iterator[str]:
    wanted = [name for name in os.environ.get("FDCAL_BENCH_FAMILIES", "").split(",") if name] or list(FAMILIES)
    yield HEAD
    for family in wanted:
        needed = {"frl": FRL, "dirha": DIRHA, "ami": AMI}.get(family)
        if needed and not needed.is_dir():
            yield f"{family}: skipped, {needed} is absent; FDCAL_REAL_DATA names the folder of the measured arrays"
            continue
        independent: list[Found] = []
        for name, cases in groupby(FAMILIES[family](), key=lambda case: case.name):
            found = [calibrated(case) for case in cases]
            yield line(name, found)
            if name.startswith("frl_array") and name.endswith(" 4 takes"):
                independent += [one for one in found if one.positions is not None]
        if len(independent) > 1:
            yield _agreement(independent)


def _agreement(found: list[Found]) -> str:
    """Return in words the scatter of independent estimates, their claim, and the distance of their mean from the plan.

    The plan is some millimetres off itself, so that only the scatter can be compared with the claim.
    """
    truth, estimates = np.loadtxt(NOMINAL, delimiter=",", skiprows=1)[:, 1:], np.array([one.positions for one in found])
    mean = estimates.mean(axis=0)
    apart = [np.linalg.norm(align(one, mean) - mean, axis=1) for one in estimates]
    spread = _rms(apart) * np.sqrt(len(estimates) / (len(estimates) - 1))
    off, size = _rms(np.linalg.norm(align(mean, truth) - truth, axis=1)), np.sqrt(np.mean(np.sum(mean**2, axis=1)))
    return (
        f"frl_array: {len(estimates)} estimates of 4 takes each scatter by {1e3 * spread:.1f} mm and claim"
        f" {1e3 * _rms([one.claim for one in found]):.1f} mm; their mean is {1e3 * off:.1f} mm from the plan, of an"
        f" array of {1e3 * size:.0f} mm"
    )


def line(name: str, found: list[Found]) -> str:
    """Return one line of the table."""
    errors, claims = np.array([one.error for one in found]), np.array([one.claim for one in found])
    if not np.isfinite(errors).any():
        return f"{name:<44} refused"
    verdicts = ", ".join(f"{code} {n}" for code, n in Counter(one.verdict for one in found).most_common())
    mean = [float(np.nanmean([getattr(one, key) for one in found])) for key in ("size", "rows", "seconds")]
    return (
        f"{name:<44} {1e3 * np.nanmean(errors):6.1f} {1e3 * np.nanmax(errors):6.1f}     {mean[0]:5.2f}"
        f" {1e3 * np.nanmean(claims):6.1f}    {np.sqrt(np.nanmean((errors / claims) ** 2)):11.2f} {mean[1]:5.0f}"
        f" {mean[2]:5.1f}  {verdicts}"
    )
