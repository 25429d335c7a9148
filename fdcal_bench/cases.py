"""The cases: simulated families and one measured array."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .rooms import RATE, SPEED, draw_array, draw_source, responses, speech_like

TAKES, SECONDS = 4, 8.0  # takes of a case with noise or speech, and their length, s
SNR_DB, PEAK_DB = 30.0, 60.0  # over sensor noise: of noise and speech from 20 to 500 Hz; of the peak of an impulse
SOURCE_SIGMA = 0.05  # m, standard deviation of each measured coordinate of a source
ORDER = 40  # largest order of the image sources


@dataclass(frozen=True)
class Case:
    """Recordings of an array whose positions are known."""

    name: str
    draw: int  # number of the draw; 0 for the measured array
    recordings: tuple[np.ndarray, ...]  # (N, T) float64 of each take
    rate: int  # Hz
    kind: str  # "noise", "speech" or "impulse"
    truth: np.ndarray  # (N, 3) float64, metres; for the measured array, the positions in its plan
    sources: np.ndarray | None  # (S, 3) float64, metres, as measured
    speed: float = SPEED  # m/s


@dataclass(frozen=True)
class Family:
    """Draws of one kind of array, room and sound."""

    name: str
    room: tuple[float, float, float]  # m
    reverberation: float  # s, by Sabine's formula; all walls absorb alike
    kind: str
    count: int
    radius: float  # m

    def _generator(self, seed: int) -> np.random.Generator:
        return np.random.default_rng([seed, 285, self.count, round(1e3 * self.radius)])

    def places(self, seed: int, rng: np.random.Generator | None = None) -> np.ndarray:
        """Return the microphones of a case (N, 3), metres."""
        found = draw_array(rng or self._generator(seed), self.count, self.radius)
        return found + np.array(self.room) * (0.44, 0.47, 0.5)

    def draw(self, seed: int) -> Case:
        """Return a case."""
        rng = self._generator(seed)
        truth = self.places(seed, rng)
        sources = np.array([draw_source(rng, self.room, truth.mean(axis=0)) for _ in range(TAKES)])
        recordings = tuple(self._recorded(truth, source, rng) for source in sources)
        measured = sources + SOURCE_SIGMA * rng.standard_normal(sources.shape)
        return Case(self.name, seed, recordings, RATE, self.kind, truth, measured)

    def _recorded(self, places: np.ndarray, source: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        h = responses(places, source, self.reverberation, ORDER, self.room)
        if self.kind == "impulse":
            return h + np.abs(h).max() * 10 ** (-PEAK_DB / 20) * rng.standard_normal(h.shape)
        length = int(RATE * SECONDS)
        played = rng.standard_normal(length + h.shape[1])
        played = speech_like(played, rng) if self.kind == "speech" else played
        total = len(played) + h.shape[1]
        sound = np.array([np.fft.irfft(np.fft.rfft(played, total) * np.fft.rfft(row, total), total) for row in h])
        sound = sound[:, h.shape[1] : h.shape[1] + length]
        f, spectrum = np.fft.rfftfreq(length, 1 / RATE), np.fft.rfft(sound, axis=1)
        band = (f > 20) & (f < 500)
        floor = np.sqrt(np.mean(np.abs(spectrum[:, band]) ** 2) / length) * 10 ** (-SNR_DB / 20)
        return sound + floor * rng.standard_normal(sound.shape)


LIVING, HALL, STUDIO = (5.0, 4.0, 2.6), (9.0, 7.0, 4.0), (6.0, 5.0, 2.8)  # m
FAMILIES = (
    Family("living room 0.4 s, noise, 16 in 0.4 m", LIVING, 0.4, "noise", 16, 0.4),
    Family("living room 0.4 s, noise, 32 in 0.4 m", LIVING, 0.4, "noise", 32, 0.4),
    Family("living room 0.4 s, speech, 32 in 0.4 m", LIVING, 0.4, "speech", 32, 0.4),
    Family("living room 0.4 s, impulses, 16 in 0.4 m", LIVING, 0.4, "impulse", 16, 0.4),
    Family("hall 1 s, noise, 32 in 0.4 m", HALL, 1.0, "noise", 32, 0.4),
    Family("studio 0.2 s, noise, 16 in 0.3 m", STUDIO, 0.2, "noise", 16, 0.3),
    Family("studio 0.2 s, impulses, 12 in 0.2 m", STUDIO, 0.2, "impulse", 12, 0.2),
    Family("studio 0.35 s, impulses, 8 in 0.1 m", STUDIO, 0.35, "impulse", 8, 0.1),
)
MEASURED = "laboratory, measured, impulses, 7 in 0.05 m"
NAMES = (*(family.name for family in FAMILIES), MEASURED)


def cases(draws: int = 1, only: str = "") -> Iterator[Case]:
    """Yield the cases whose name contains a text: `draws` of each family, then the measured array."""
    for family in FAMILIES:
        if only in family.name:
            yield from map(family.draw, range(draws))
    if only in MEASURED:
        yield measured_array()


@functools.cache
def measured_array() -> Case:
    """Return the measured array: R3VIVAL, Meta Platforms, CC BY 4.0 (the licence is in its folder)."""
    import soundfile

    own = Path(__file__).parent / "frl_array"  # where it is installed
    folder = own if own.is_dir() else Path(__file__).parents[1] / "examples" / "frl_array"
    read = [soundfile.read(path) for path in sorted(folder.glob("*.flac"))]
    truth = np.loadtxt(folder / "nominal.csv", delimiter=",", skiprows=1)[:, 1:]
    return Case(MEASURED, 0, tuple(samples.T for samples, _ in read), read[0][1], "impulse", truth, None, 343.2)
