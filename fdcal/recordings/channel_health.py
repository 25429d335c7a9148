"""Faulty channels of a recording: silent, clipped, or recorded twice.

inspect_channels         look at every channel, all of its samples
require_usable_channels  refuse a recording with faulty channels, by name
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from ..model.validation import InputError
from .recording import Recording, time_blocks


@dataclass(frozen=True)
class ClippingThresholds:
    """When a channel counts as silent or clipped."""

    silent: float = 1e-7  # level relative to the loudest channel at which a channel is silent
    run: int = 3  # neighbouring samples at the greatest magnitude of a channel: no wave stays there for so long
    full_scale: float = 0.999  # share of full scale from which a sample counts as being there
    full_scale_run: int = 2  # neighbouring samples at full scale
    full_scale_count: int = 3  # samples at full scale anywhere; a recording that was normalised has one
    # edge_count, edge_ratio: samples at the greatest value, and how many times more they are than those at the next
    # smaller value
    edge_count: int = 8
    edge_ratio: int = 4
    full_scale_ratio: int = 2  # the same ratio for a recording that reaches full scale


LIMITS = ClippingThresholds()


@dataclass(frozen=True)
class ChannelHealth:
    """State of every channel of a recording."""

    level: np.ndarray  # (N,) float64, root mean square
    peak: np.ndarray  # (N,) float64, greatest magnitude
    # silent, clipped: (N,) bool
    silent: np.ndarray
    clipped: np.ndarray
    copy_of: np.ndarray  # (N,) int64, the earlier channel with the same samples, or -1

    @property
    def bad(self) -> np.ndarray:
        """Indices (n,) int64 of the channels that cannot be used."""
        return np.flatnonzero(self.silent | self.clipped | (self.copy_of >= 0))

    def fault(self, n: int, names) -> str:
        """Return what is wrong with a bad channel."""
        if self.silent[n]:
            return "silent"
        return "clipped" if self.clipped[n] else f"a copy of {names[self.copy_of[n]]}"


def inspect_channels(recording: Recording) -> ChannelHealth:
    """Return the state of every channel, after one pass over all samples, a block at a time.

    Raises InputError: a sample is not finite.
    """
    count = recording.count
    square, peak, longest = np.zeros(count), np.zeros(count), np.zeros(count, int)
    edges = [(Extremes(), Extremes()) for _ in range(count)]  # greatest and least values
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
    silent = level <= LIMITS.silent * level.max() if level.max() > 0 else np.ones(count, bool)
    copies = np.array([first[digest] if first[digest] < n else -1 for n, digest in enumerate(digests)])
    full = (peak >= LIMITS.full_scale * recording.full_scale) if recording.full_scale else np.zeros(count, bool)
    cut = np.array([_is_clipped(pair, recording.full_scale) for pair in edges])
    clipped = ((longest >= LIMITS.run) | full & (longest >= LIMITS.full_scale_run) | cut) & ~silent
    return ChannelHealth(level, peak, silent, clipped, np.where(silent, -1, copies))


@dataclass(frozen=True)
class Extremes:
    """The two greatest values of some samples, and how often each occurs."""

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
    """Return the extremes of samples (t,)."""
    top = samples.max()
    below = samples[samples < top]
    second = below.max(initial=-np.inf)
    return Extremes(float(top), len(samples) - len(below), float(second), int(np.sum(below == second)))


def _is_clipped(pair: tuple[Extremes, Extremes], full_scale: float | None) -> bool:
    """Return whether many samples of a channel have its greatest (or least) value, and few the next one to it.

    The values of sound become rarer towards the greatest one, however coarse the quantisation; clipping collects them
    there.
    """
    if full_scale:
        at_full = [edge for edge in pair if edge.top >= LIMITS.full_scale * full_scale]
        if sum(edge.times for edge in at_full) >= LIMITS.full_scale_count and all(
            edge.times >= LIMITS.full_scale_ratio * edge.next_times for edge in at_full
        ):
            return True
    return any(e.times >= LIMITS.edge_count and e.times >= LIMITS.edge_ratio * e.next_times for e in pair)


def _longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return int(np.max(edges[1::2] - edges[::2], initial=0))


def require_usable_channels(recording: Recording, health: ChannelHealth) -> None:
    """Raise InputError if a channel is silent, clipped or a copy of another."""
    for words, flags in (("silent", health.silent), ("clipped", health.clipped), ("copied", health.copy_of >= 0)):
        if not np.any(flags):
            continue
        names = [recording.names[n] for n in np.flatnonzero(flags)]
        listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        if words == "copied":
            n = int(np.flatnonzero(flags)[0])
            listed += f" (the first is the same as channel {recording.names[health.copy_of[n]]})"
        raise InputError(
            f"{recording.path}: {'channel' if len(names) == 1 else 'channels'} {listed}"
            f" {'is' if len(names) == 1 else 'are'} {words}",
            "record again, or leave out the faulty channels: <leave_out> bad",
            key="leave_out",
        )
