"""What is wrong with the channels of a recording: silence, clipping, one recorded twice.

inspect          every channel, all of its samples
require_usable_channels   refuse what cannot be used, by name
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from ..model.validation import InputError
from .recording import Recording, time_blocks

CLIPPED_RUN = 3  # neighbouring samples at the greatest value that a channel reaches: no wave does that
AT_FULL = 3  # samples at full scale, wherever they are: a recording that was scaled to it has one
AT_EDGE = 8, 4  # samples at the greatest value of all, and how many times those at the next


@dataclass(frozen=True)
class ChannelHealth:
    """Of every channel (N,): `level`, root mean square; `peak`; `silent`, `clipped` bool; `copy_of`, the number of the
    earlier channel that holds the same samples, or -1."""

    level: np.ndarray
    peak: np.ndarray
    silent: np.ndarray
    clipped: np.ndarray
    copy_of: np.ndarray

    @property
    def bad(self) -> np.ndarray:
        """(n,) int64, the channels that cannot be used."""
        return np.flatnonzero(self.silent | self.clipped | (self.copy_of >= 0))

    def fault(self, n: int, names) -> str:
        """What is wrong with a bad channel."""
        if self.silent[n]:
            return "silent"
        return "clipped" if self.clipped[n] else f"a copy of {names[self.copy_of[n]]}"


def inspect_channels(recording: Recording) -> ChannelHealth:
    """Go through all samples once, a stretch at a time. Raises InputError for one that is not finite."""
    count = recording.count
    square, peak, longest, digests = np.zeros(count), np.zeros(count), np.zeros(count, int), [None] * count
    edges = [(Extremes(), Extremes()) for _ in range(count)]  # above and below
    hashes = [hashlib.blake2b(digest_size=16) for _ in range(count)]
    for block in time_blocks(recording):
        square += np.sum(block**2, axis=1)
        top = np.abs(block).max(axis=1)
        for n in range(count):
            hashes[n].update(block[n])
            run = _longest_run(np.abs(block[n]) >= top[n]) if top[n] > 0 and top[n] >= peak[n] else 0
            longest[n] = run if top[n] > peak[n] else max(longest[n], run)
            edges[n] = edges[n][0] + extremes_of(block[n]), edges[n][1] + extremes_of(-block[n])
        peak = np.maximum(peak, top)
    level = np.sqrt(square / recording.samples)
    digests = [h.digest() for h in hashes]
    first = {digest: n for n, digest in reversed(list(enumerate(digests)))}
    silent = level <= 1e-7 * level.max() if level.max() > 0 else np.ones(count, bool)
    copies = np.array([first[digest] if first[digest] < n else -1 for n, digest in enumerate(digests)])
    full = (peak >= 0.999 * recording.full_scale) if recording.full_scale else np.zeros(count, bool)
    cut = np.array([_cut(pair, recording.full_scale) for pair in edges])
    clipped = ((longest >= CLIPPED_RUN) | full & (longest >= 2) | cut) & ~silent
    return ChannelHealth(level, peak, silent, clipped, np.where(silent, -1, copies))


@dataclass(frozen=True)
class Extremes:
    """The greatest two values of some samples and how often each is there."""

    top: float = -np.inf
    times: int = 0
    next: float = -np.inf
    next_times: int = 0

    def __add__(self, other: Extremes) -> Extremes:
        times: dict[float, int] = {}
        for edge in (self, other):
            for value, number in ((edge.top, edge.times), (edge.next, edge.next_times)):
                times[value] = times.get(value, 0) + number
        first, second = sorted({*times, -np.inf}, reverse=True)[:2] if len(times) > 1 else (*times, -np.inf)
        return Extremes(first, times[first], second, times.get(second, 0))


def extremes_of(samples: np.ndarray) -> Extremes:
    """Extremes of samples (t,)."""
    top = samples.max()
    below = samples[samples < top]
    second = below.max(initial=-np.inf)
    return Extremes(float(top), len(samples) - len(below), float(second), int(np.sum(below == second)))


def _cut(pair: tuple[Extremes, Extremes], full_scale: float | None) -> bool:
    """Whether a channel stops at a value again and again, and hardly ever just before it.

    Sound thins out towards its greatest value, however coarsely it is told; where it has been cut, it gathers there.
    """
    if full_scale:
        at_full = [edge for edge in pair if edge.top >= 0.999 * full_scale]
        if sum(edge.times for edge in at_full) >= AT_FULL and all(e.times >= 2 * e.next_times for e in at_full):
            return True
    return any(edge.times >= AT_EDGE[0] and edge.times >= AT_EDGE[1] * edge.next_times for edge in pair)


def _longest_run(flags: np.ndarray) -> int:
    """Length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def require_usable_channels(recording: Recording, health: ChannelHealth) -> None:
    """Raise InputError for a channel that is silent, clipped or the copy of another."""
    for words, flags in (("silent", health.silent), ("clipped", health.clipped), ("copied", health.copy_of >= 0)):
        if not np.any(flags):
            continue
        names = [recording.names[n] for n in np.flatnonzero(flags)]
        told = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        if words == "copied":
            n = int(np.flatnonzero(flags)[0])
            told += f" (the first is the same as channel {recording.names[health.copy_of[n]]})"
        raise InputError(
            f"{recording.path}: {'channel' if len(names) == 1 else 'channels'} {told}"
            f" {'is' if len(names) == 1 else 'are'} {words}; record again, or leave out what is bad: --leave-out bad"
        )
