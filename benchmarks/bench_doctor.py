"""Whether `fdcal doctor` names what is wrong with a recording: injected faults, and recordings without faults.

living      noise in a living room, 16 microphones in a ball of 0.4 m, four takes of 12 s, 30 dB
dead        impulses in a dead room, 16 in a ball of 0.3 m, four takes, 60 dB below the peak
rendered    the measured room of scene `listening_lab`, 16 in a ball of 0.4 m, turned between four takes
measured    the measured array of seven microphones, four takes of ../shared/data/frl_array, else examples/frl_array

A fault of a channel is named if its finding lists the channel, and another fault if its finding reports anything.
Whether the fault has its right name is counted separately. A channel of noise may be called dead or noisy.
Each draw has an array, a source, a list with an error of 2 mm in each coordinate, and a faulty channel of its own.

FDCAL_BENCH_DRAWS sets the draws of each fault, 12 unless given, half as many of each set without a fault.
FDCAL_BENCH_FAULTS names some faults, separated by commas, and "sound" the sets without one. 240 frequencies of each
simulated set are used, which saves half of the time.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import lfilter, oaconvolve, resample_poly

from fdcal.acoustics.plane_waves import load_sdm_response, plane_wave_responses
from fdcal.assessment.findings import Answer
from fdcal.model.validation import InputError
from fdcal.recordings.formats import read
from fdcal.recordings.recording import ImportOptions, read_samples
from fdcal.session import doctor
from fdcal.session.doctor import examine
from fdcal_bench.rooms import RATE, SPEED, draw_array, draw_source, responses

from .bench_real import DEAD, FRL, LIVING, NOMINAL

ALONE = True
DRAWS = int(os.environ.get("FDCAL_BENCH_DRAWS", "12"))
WANTED = os.environ.get("FDCAL_BENCH_FAULTS", "")
ROOM = Path(__file__).parents[1] / "rooms"
ROWS = 240  # of all takes
LIST_ERROR = 2e-3  # m, of each coordinate


@dataclass(frozen=True)
class DataSet:
    """Takes (N, T) of one array, and a list of its positions (N, 3), metres."""

    name: str
    takes: tuple[np.ndarray, ...]
    rate: int
    places: np.ndarray
    kind: str
    speed: float | None = SPEED
    max_rows: int | None = ROWS

    @property
    def options(self) -> ImportOptions:
        """Options with which the files are read."""
        return ImportOptions(kind=self.kind, sound_speed=self.speed, max_rows=self.max_rows)

    def examined(self, question: str = "") -> tuple[Answer, ...]:
        """Return the answers on files and list, up to that to `question`, or all."""
        with tempfile.TemporaryDirectory() as folder:
            paths = [str(Path(folder) / f"take{n}.wav") for n in range(len(self.takes))]
            for path, samples in zip(paths, self.takes, strict=True):
                soundfile.write(path, samples.T, self.rate, subtype="FLOAT")
            table = Path(folder) / "list.csv"
            rows = [",".join([str(n), *map(repr, x)]) for n, x in enumerate(self.places.tolist())]
            table.write_text("\n".join(["name,x,y,z", *rows]) + "\n")
            findings = []
            for one in examine(paths, str(table), self.options):
                findings.append(one)
                if one.question == question:
                    break
            return tuple(findings)


def _listed(places: np.ndarray, rng) -> np.ndarray:
    return places - places.mean(axis=0) + LIST_ERROR * rng.standard_normal(places.shape)


@cache
def living_room(seed: int) -> DataSet:
    rng, takes = np.random.default_rng([seed, 28]), []
    places = draw_array(rng, 16, 0.4) + np.array(LIVING) * (0.44, 0.47, 0.5)
    for _ in range(4):
        h = responses(places, draw_source(rng, LIVING, places.mean(axis=0)), 0.4, 80, LIVING)
        played = rng.standard_normal(12 * RATE + h.shape[1])
        sound = oaconvolve(played[None], h, axes=1)[:, h.shape[1] : len(played)]
        sound += np.sqrt(np.mean(sound**2)) * 10 ** (-30 / 20) * rng.standard_normal(sound.shape)
        takes.append(0.5 * sound / np.abs(sound).max())
    return DataSet("living room, noise", tuple(takes), RATE, _listed(places, rng), "stationary")


@cache
def dead_room(seed: int) -> DataSet:
    rng, takes = np.random.default_rng([seed, 29]), []
    places = draw_array(rng, 16, 0.3) + np.array(DEAD) * (0.44, 0.47, 0.5)
    for _ in range(4):
        source = draw_source(rng, DEAD, places.mean(axis=0))
        h = responses(places, source, 0.35, 80, DEAD, places.mean(axis=0) - source)
        h = h + np.abs(h).max() * 1e-3 * rng.standard_normal(h.shape)
        takes.append(0.5 * h / np.abs(h).max())
    return DataSet("dead room, impulses", tuple(takes), RATE, _listed(places, rng), "impulse")


@cache
def rendered_room(seed: int) -> DataSet:
    rng = np.random.default_rng([seed, 30])
    places = draw_array(rng, 16, 0.4)
    response, takes = load_sdm_response(next(ROOM.glob("*.mat"))), []
    for _ in range(4):  # another direction of the source: the array is turned in the field
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        h, rate = plane_wave_responses(response, places @ turn, SPEED), int(response.sample_rate)
        h = np.pad(h / np.abs(h).max(), ((0, 0), (0, int(0.2 * rate))))
        takes.append(0.5 * (h + 1e-4 * rng.standard_normal(h.shape)))
    return DataSet("rendered room", tuple(takes), rate, _listed(places, rng), "impulse")


@cache
def measured_array(seed: int) -> DataSet:
    truth = np.loadtxt(NOMINAL, delimiter=",", skiprows=1)[:, 1:]
    folders = sorted(path for path in FRL.glob("*") if path.is_dir())
    files = sorted(folders[seed % len(folders)].glob("*.wav"))[seed // len(folders) % 3 :: 3] if folders else []
    files = files or sorted((NOMINAL.parent).glob("*.flac"))
    read_takes = [read(path) for path in files]
    takes = [read_samples(one, 0, one.samples) for one in read_takes]
    return DataSet("measured array", tuple(takes), int(read_takes[0].sample_rate), truth, "impulse", None, None)


SETS: dict[str, Callable[[int], DataSet]] = {
    "living": living_room, "dead": dead_room, "rendered": rendered_room, "measured": measured_array
}  # fmt: skip


@dataclass(frozen=True)
class Fault:
    """What is done to a data set, and which finding must name it."""

    question: str
    kinds: tuple[str, ...]  # names that count as right for it
    injected: Callable[[DataSet, int, np.random.Generator], DataSet]
    sets: tuple[str, ...]
    channel: bool = True  # whether it is a fault of a channel, which must be named


def _one(change: Callable[[np.ndarray, int, np.random.Generator], np.ndarray], fixed: bool = False):
    """Return a fault that changes the samples (T,) of one channel in every take; if `fixed`, in the same way in all."""

    def injected(data: DataSet, n: int, rng) -> DataSet:
        takes = [np.array(samples) for samples in data.takes]
        seed = int(rng.integers(2**32)) if fixed else 0
        for samples in takes:
            samples[n] = change(samples[n], data.rate, np.random.default_rng(seed) if fixed else rng)
        return replace(data, takes=tuple(takes))

    return injected


def _clipped(x, rate, rng):
    top = np.quantile(np.abs(x), 0.997)
    return np.clip(x, -top, top)


def _drifting(x, rate, rng):
    ppm = rng.choice([-1, 1]) * rng.uniform(10, 80)
    return np.interp(16 * np.arange(len(x)) * (1 + 1e-6 * ppm), np.arange(16 * len(x)), resample_poly(x, 16, 1))


def _losing(x, rate, rng):
    lost, at = int(rng.integers(8, 400)), int(len(x) * rng.uniform(0.3, 0.7))
    return np.concatenate([x[:at], x[at + lost :], 1e-3 * np.std(x) * rng.standard_normal(lost)])


def _high_pass(x, rate, rng):
    corner = rng.uniform(60, 150)
    a = np.exp(-2 * np.pi * corner / rate)
    return lfilter([1.0, -1.0], [1.0, -a], x)


def _copied(data, n, rng):
    other = (n + 1) % len(data.places)
    takes = [np.array(samples) for samples in data.takes]
    for samples in takes:
        samples[max(n, other)] = samples[min(n, other)]
    return replace(data, takes=tuple(takes))


def _wrapped(data, n, rng):
    late = int(np.argmax(np.abs(data.takes[0]).max(axis=0))) + int(0.004 * data.rate)
    return replace(data, takes=tuple(np.roll(samples, -late, axis=1) for samples in data.takes))


def _by_rays(data, n, rng):
    """Return direct sound and early reflections at their times, then decaying noise, independent at each microphone."""
    places, takes = data.places - data.places.mean(axis=0) + np.array(DEAD) * (0.44, 0.47, 0.5), []
    for _ in range(4):
        source = draw_source(rng, DEAD, places.mean(axis=0))
        h = responses(places, source, 0.35, 2, DEAD)
        t = np.arange(h.shape[1]) / data.rate
        tail = rng.standard_normal(h.shape) * 10 ** (-3 * t / 0.35) * (t > 0.02)
        h = h + tail * np.sqrt(np.sum(h**2) / np.sum(tail**2))
        takes.append(0.5 * h / np.abs(h).max())
    return replace(data, takes=tuple(takes))


def _no_field(data, n, rng):
    """Return channels that were recorded one after the other, each with the source at another place."""
    takes = []
    for samples in data.takes:
        places = data.places - data.places.mean(axis=0) + np.array(LIVING) * (0.44, 0.47, 0.5)
        h, rows = responses(places, draw_source(rng, LIVING, places.mean(axis=0)), 0.4, 10, LIVING), []
        for one in h:
            rows.append(oaconvolve(rng.standard_normal(samples.shape[1]), one)[: samples.shape[1]])
        takes.append(0.5 * np.array(rows) / np.abs(rows).max())
    return replace(data, takes=tuple(takes))


def _swapped(data, n, rng):
    apart = np.linalg.norm(data.places - data.places[n], axis=1)
    other = int(rng.choice(np.flatnonzero(apart > 0.5 * apart.max())))
    places = data.places.copy()
    places[[n, other]] = places[[other, n]]
    return replace(data, places=places)


def _scaled(data, n, rng):
    return replace(data, places=data.places * (1 + rng.choice([-1, 1]) * 0.05))


def _misplaced(data, n, rng):
    places, away = data.places.copy(), rng.standard_normal(3)
    places[n] += 0.25 * away / np.linalg.norm(away)
    return replace(data, places=places)


STATIONARY, ALL, WIDE = ("living",), ("living", "dead", "rendered", "measured"), ("living", "dead", "rendered")
FAULTS = {
    "silent": Fault("samples", ("silent",), _one(lambda x, rate, rng: 0 * x), ALL),
    "clipped": Fault("samples", ("clipped",), _one(_clipped), ALL),
    "a copy of another": Fault("samples", ("copy",), _copied, ALL, False),
    "wrapped": Fault("wrapped", ("wrapped",), _wrapped, ("dead", "rendered", "measured"), False),
    "clock drifts by 10 to 80 ppm": Fault("synchronous", ("drift",), _one(_drifting), STATIONARY),
    "8 to 400 samples lost": Fault("synchronous", ("jump",), _one(_losing), STATIONARY),
    "no common field": Fault("field", ("field",), _no_field, STATIONARY, False),
    "simulated by rays": Fault("measured", ("rays",), _by_rays, ("dead",), False),
    "inverted": Fault("channels", ("inverted",), _one(lambda x, rate, rng: -x), ALL),
    "6 dB": Fault(
        "channels", ("gain",), _one(lambda x, rate, rng: x * 10 ** (rng.choice([-1, 1]) * 6 / 20), True), ALL
    ),
    "late by 0.5 to 2 ms": Fault(
        "channels",
        ("delayed",),
        _one(lambda x, rate, rng: np.roll(x, round(rate * rng.uniform(5e-4, 2e-3))), True),
        ALL,
    ),
    "high-pass at 60 to 150 Hz": Fault("channels", ("high_pass",), _one(_high_pass, True), WIDE),
    "noise only": Fault(
        "channels",
        ("dead", "noisy"),
        _one(lambda x, rate, rng: np.sqrt(np.mean(x**2)) * rng.standard_normal(len(x))),
        ALL,
    ),
    "noise of 0 dB": Fault(
        "channels",
        ("dead", "noisy"),
        _one(lambda x, rate, rng: x + np.sqrt(np.mean(x**2)) * rng.standard_normal(len(x))),
        STATIONARY,
    ),
    "list: two swapped": Fault("list", ("swapped",), _swapped, ALL),
    "list: 5 % off": Fault("list", ("size",), _scaled, ALL, False),
    "list: one 25 cm off": Fault("list", ("misplaced",), _misplaced, ALL),
}


def kinds_of(findings: tuple[Answer, ...], fault: Fault, n: int) -> set[str]:
    """Return the names that the answers give to a fault; for a fault of a channel, only those given to channel `n`."""
    found = [one for finding in findings if finding.question == fault.question for one in finding.found]
    return {kind for kind, name in found if not fault.channel or name == str(n)}


def solved_once() -> None:
    """Make `examine` calibrate each measurement once, because some cases differ only in the list, which is not used."""
    solve, known = doctor.solve, {}

    def cached(inputs, *arguments, **others):
        key = inputs.measurement.pressures.tobytes(), len(inputs.measurement.known)
        if key[1] or key not in known:
            known[key] = solve(inputs, *arguments, **others)
        return known[key]

    doctor.solve = cached


def run() -> Iterator[str]:
    solved_once()
    yield f"{'':<28} {'named':>10}  {'of its kind':>11}  and what was said of the others"
    named = right = count = 0
    wanted = WANTED.split(",") if WANTED else [*FAULTS, "sound"]
    for name in (name for name in wanted if name in FAULTS):
        fault, found, same, notes, start = FAULTS[name], 0, 0, [], time.process_time()
        for draw in range(DRAWS):
            rng = np.random.default_rng([draw, 31])
            data = SETS[fault.sets[draw % len(fault.sets)]](draw // len(fault.sets))
            n = int(rng.integers(len(data.places) - (len(data.places) == 7)))  # the seventh has a response of its own
            try:
                findings = fault.injected(data, n, rng).examined(fault.question)
            except InputError as error:
                findings = (Answer("refused", "unknown", str(error)),)
            kinds = kinds_of(findings, fault, n)
            found += bool(kinds)
            same += not kinds.isdisjoint(fault.kinds)
            if kinds.isdisjoint(fault.kinds):
                said = "; ".join(one.line for one in findings if one.state != "fine")
                notes.append(f"draw {draw}, {data.name}, channel {n}: {said or 'all fine'}")
        named, right, count = named + found, right + same, count + DRAWS
        yield f"{name:<28} {found:4d} of {DRAWS:3d}  {same:4d} of {DRAWS:3d}  {time.process_time() - start:.0f} s"
        yield from (f"    {note}" for note in notes)
    if count:
        yield f"{'all':<28} {named:4d} of {count:3d}  {right:4d} of {count:3d}  {100 * named / count:.1f} %"
    if "sound" in wanted:
        yield from _sound_sets()


def _sound_sets() -> Iterator[str]:
    draws = -(-DRAWS // 2)
    for name, make in SETS.items():
        silent, notes = 0, []
        for draw in range(draws):
            findings = make(draw).examined()
            faults = [one.line for one in findings if one.state == "fault"]
            silent += not faults
            notes += [f"draw {draw}: {one.line}" for one in findings if one.state in ("fault", "differs")]
        yield f"{'no fault: ' + name:<28} {silent:4d} of {draws:3d}  silent"
        yield from (f"    {note}" for note in notes)
