"""The channels of a recording: which are faulty, which are used, which microphones are known; copies of takes.

A copy of a channel has the same samples. A copy of a take may be scaled, cut, resampled or filtered: at each frequency
all its channels differ from the original by the same factor, which never holds for takes with the source at different
places or with different sounds. The coherence of a pair of channels depends mainly on their distance, so it is similar
in all takes of an array. Where a driver has rotated the channels of a take, its coherences are rotated.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..acoustics.spectrum import fast_length, irfft, rfft
from ..assessment.calibration import ChannelFault
from ..assessment.words import fault_words
from ..model.validation import InputError, refusal
from .formats.positions import READERS, read_places
from .recording import BLOCK_SAMPLES, Recording, ranges, read_samples, select_channels


@dataclass(frozen=True)
class ClippingThresholds:
    """Thresholds by which a channel counts as silent or clipped."""

    silent: float = 1e-7  # level relative to the loudest channel up to which a channel counts as silent
    run: int = 3  # successive samples at the greatest magnitude of a channel; an unclipped wave has fewer
    full_scale: float = 0.999  # fraction of full scale from which a sample counts as at full scale
    full_scale_run: int = 2  # successive samples at full scale
    full_scale_count: int = 3  # samples at full scale in the whole recording; a normalised recording has one
    # A channel may be clipped if at least edge_count samples have the greatest value, and edge_ratio times as many as
    # have the next smaller value
    edge_count: int = 8
    edge_ratio: int = 4
    full_scale_ratio: int = 2  # the same ratio for a recording that reaches full scale


CLIPPING = ClippingThresholds()
MAX_LISTED = 6  # largest number of faulty channels that a message names
Edge = dict[float, int]  # the two greatest values of some samples, the greatest first, and how often each occurs


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

    def kind(self, n: int) -> str:
        """Return what is wrong with a bad channel: "silent", "clipped" or "copy"."""
        return "silent" if self.silent[n] else "clipped" if self.clipped[n] else "copy"

    def fault(self, n: int, names) -> str:
        """Return what is wrong with a bad channel, in words."""
        return fault_words(ChannelFault(names[n], self.kind(n), partner=names[self.copy_of[n]]))


class ChannelWatch:
    """Collects the state of every channel while a recording is read or made, block by block."""

    def __init__(self, count: int):
        self._square, self._peak, self._longest = np.zeros(count), np.zeros(count), np.zeros(count, int)
        self._samples = 0
        self._edges: list[tuple[Edge, Edge]] = [({}, {}) for _ in range(count)]  # greatest and least values
        self._hashes = [hashlib.blake2b(digest_size=16) for _ in range(count)]

    def add(self, block: np.ndarray) -> None:
        """Add the next samples (N, t) of all channels."""
        self._samples += block.shape[1]
        self._square += np.sum(block**2, axis=1)
        top = np.abs(block).max(axis=1)
        for n, samples in enumerate(np.ascontiguousarray(block)):
            self._hashes[n].update(samples)
            greatest = top[n] > 0 and top[n] >= self._peak[n]
            run = 0
            if greatest:  # the longest run of samples at this magnitude
                gaps = np.diff(np.flatnonzero(np.abs(samples) >= top[n]), prepend=-2, append=block.shape[1] + 1) > 1
                run = int(np.max(np.diff(np.flatnonzero(gaps))))
            self._longest[n] = run if top[n] > self._peak[n] else max(self._longest[n], run)
            high, low = self._edges[n]
            self._edges[n] = _edge(samples, high), _edge(-samples, low)
        self._peak = np.maximum(self._peak, top)

    def health(self, full_scale: float | None) -> ChannelHealth:
        """Return the state of the channels so far; `full_scale`: greatest value that a sample can take."""
        peak, level = self._peak, np.sqrt(self._square / max(self._samples, 1))
        digests = [h.digest() for h in self._hashes]
        first = {digest: n for n, digest in reversed(list(enumerate(digests)))}
        silent = level <= CLIPPING.silent * level.max() if level.max() > 0 else np.ones(len(level), bool)
        copies = np.array([first[digest] if first[digest] < n else -1 for n, digest in enumerate(digests)])
        full = (peak >= CLIPPING.full_scale * full_scale) if full_scale else np.zeros(len(level), bool)
        cut = np.array([_is_clipped(pair, full_scale) for pair in self._edges])
        clipped = ((self._longest >= CLIPPING.run) | full & (self._longest >= CLIPPING.full_scale_run) | cut) & ~silent
        return ChannelHealth(level, peak, silent, clipped, np.where(silent, -1, copies))


def inspect_channels(recording: Recording) -> ChannelHealth:
    """Return the state of every channel; all samples are read once, one block after the other."""
    watch = ChannelWatch(recording.count)
    for start, stop in ranges(recording.samples, BLOCK_SAMPLES // recording.count):
        watch.add(read_samples(recording, start, stop))
    return watch.health(recording.full_scale)


def _edge(samples: np.ndarray, before: Edge) -> Edge:
    """Return the edge of (t,) samples and of all samples before them, whose edge is `before`."""
    times = Counter(before)
    for _ in range(2):
        if len(samples):
            top, count = samples.max(), len(samples)
            samples = samples[samples < top]
            times[float(top)] += count - len(samples)
    return dict(sorted(times.items(), reverse=True)[:2])


def _is_clipped(pair: tuple[Edge, Edge], full_scale: float | None) -> bool:
    """Return whether far more samples of a channel have its greatest (or least) value than the next value.

    The values of sound become rarer towards the greatest one, however coarse the quantisation; those of clipped sound
    do not.
    """
    edges = [(max(edge, default=-np.inf), *edge.values(), 0, 0)[:3] for edge in pair]
    if full_scale:
        at_full = [edge for edge in edges if edge[0] >= CLIPPING.full_scale * full_scale]
        rare = all(times >= CLIPPING.full_scale_ratio * next_times for _, times, next_times in at_full)
        if rare and sum(times for _, times, _ in at_full) >= CLIPPING.full_scale_count:
            return True
    return any(n >= CLIPPING.edge_count and n >= CLIPPING.edge_ratio * next_times for _, n, next_times in edges)


def require_usable_channels(recording: Recording, health: ChannelHealth) -> None:
    """Raise InputError if a channel is silent, clipped or a copy of another."""
    if len(health.bad):
        names, first = recording.names, health.bad[:MAX_LISTED].tolist()
        listed = ", ".join(f"channel {names[n]} is {health.fault(n, names)}" for n in first)
        more = f", and {len(health.bad) - len(first)} more" if len(health.bad) > len(first) else ""
        others = ", or leave out the faulty channels: <leave_out> bad" if len(health.bad) < recording.count else ""
        raise InputError(f"{recording.path}: {listed}{more}", f"record again{others}", key="leave_out")


@dataclass(frozen=True)
class TakeRules:
    """Thresholds by which takes count as copies of each other, or as takes with another channel order."""

    # Hz; two takes are aligned by one channel, whose samples are averaged down to this rate
    rate: float = 2000.0
    # least correlation of this channel for which the takes are compared at every frequency; copies have 0.36 to 1
    similar: float = 0.25
    stretch: int = 2**15  # number of samples that are compared
    level: float = 1e-4  # least power of a frequency that is compared, relative to the strongest
    # fraction of the power of a frequency that differs between two takes: at most 1e-7 in copies, about 0.7 otherwise
    different: float = 1e-4
    # low, high, segment: the coherence of channels is computed in this band, Hz, where most arrays are coherent, from
    # segments of this length, s
    low: float = 60.0
    high: float = 500.0
    segment: float = 0.1
    parts: int = 12  # parts of a take, of seven overlapping segments each, whose cross-spectra are added
    # Channels count as rotated if the coherences of two takes correlate by more than `rotated` in another order, and by
    # `better` more than in the same order. Grids and balls have 0.6 to 1 in the right order and 0 in another one; by
    # chance the difference is at most 0.06
    rotated: float = 0.5
    better: float = 0.3
    # correlation of the coherences of a take with its own in another order, above which the array is symmetric, so that
    # rotated channels cannot be distinguished from sound from another side: circles have 0.6 to 0.97
    symmetric: float = 0.4
    channels: int = 8  # least number of channels for which the correlation over their pairs is significant


TAKES = TakeRules()


def require_different_takes(takes: Sequence[Recording], health: Sequence[ChannelHealth]) -> None:
    """Raise InputError if two takes are copies, or if one has the channels of the first take in a rotated order."""
    first, silent, own = takes[0], health[0].silent, np.arange(takes[0].count)
    coherences = [_coherence(one) for one in takes]
    for take, state, coherence in zip(takes[1:], health[1:], coherences[1:], strict=True):
        orders = [np.roll(own, -shift) for shift in own]  # channel n of the first is orders[shift][n] of the other
        pairs = ~np.eye(len(own), dtype=bool) & ~(silent | silent[:, None])
        alike = [np.corrcoef(coherences[0][pairs], coherence[np.ix_(order, order)][pairs])[0, 1] for order in orders]
        shift = int(np.argmax(alike))
        itself = np.corrcoef(coherences[0][pairs], coherences[0][np.ix_(orders[shift], orders[shift])][pairs])[0, 1]
        significant = len(own) >= TAKES.channels and itself < TAKES.symmetric
        rotated = significant and alike[shift] > max(TAKES.rotated, alike[0] + TAKES.better)
        if silent.any() and not np.array_equal(silent, state.silent):
            moved = [n for n in own if np.array_equal(silent, state.silent[orders[n]])]
            shift, rotated = (moved[0], True) if moved else (shift, rotated)
        if rotated:
            problem = f"{take.path} has the channels of {first.path} rotated by {min(shift, len(own) - shift)}"
            remedy = "record it again, or put its channels in the same order"
            problem += f": its channel {take.names[shift]} is channel {first.names[0]} in that take"
            raise InputError(problem, remedy, key="names")
    factor, usable = max(1, int(first.sample_rate / TAKES.rate)), np.flatnonzero(~silent)
    channel = [int(usable[len(usable) // 2])] if len(usable) else [0]
    rows = [read_samples(one, 0, one.samples // factor * factor, channel).reshape(-1, factor) for one in takes]
    rows = [row.mean(axis=1) for row in rows]
    for a, b in itertools.combinations(range(len(rows)), 2):
        if _is_copy(takes[a], takes[b], rows[a], rows[b], factor):
            problem = f"{takes[b].path} is a copy of {takes[a].path}, or of a part of it"
            raise InputError(problem, "give each take once", key="source")


def _is_copy(one: Recording, other: Recording, x: np.ndarray, y: np.ndarray, factor: int) -> bool:
    """Return whether two takes contain the same sound; `x`, `y`: a channel of each, averaged over `factor` samples."""
    length = fast_length(len(x) + len(y))
    lag = int(np.argmax(np.abs(irfft(rfft(x, length) * rfft(y, length).conj(), length))))
    lag = lag if lag < len(x) else lag - length  # x[t + lag] belongs to y[t]
    x, y = x[max(lag, 0) :][: len(y) + min(lag, 0)], y[max(-lag, 0) :][: len(x) - max(lag, 0)]
    span = min(TAKES.stretch // factor, len(x))
    if not abs(np.vdot(x, y)) > TAKES.similar * np.linalg.norm(x) * np.linalg.norm(y):
        return False
    loud = np.cumsum(np.append(0.0, x**2))
    start = int(np.argmax(loud[span:] - loud[: len(x) - span + 1]))
    begin, span = np.array([start + max(lag, 0), start + max(-lag, 0)]) * factor, span * factor
    window, takes = np.hanning(span), zip((one, other), begin.tolist(), strict=True)
    X, Y = (rfft(window * read_samples(take, at, at + span)) for take, at in takes)
    powers = np.sum(np.abs(X) ** 2, axis=0), np.sum(np.abs(Y) ** 2, axis=0)
    loud = np.all([power > TAKES.level * power.max() for power in powers], axis=0)
    common = np.abs(np.sum(X.conj() * Y, axis=0)) ** 2 / np.maximum(powers[0] * powers[1], np.finfo(float).tiny)
    return bool(np.median(1 - common[loud]) < TAKES.different)


def _coherence(recording: Recording) -> np.ndarray:
    """Return the coherence of each pair of channels, averaged over a band of low frequencies : (N, N) float64."""
    fs, length = recording.sample_rate, max(16, int(TAKES.segment * recording.sample_rate))
    f = np.arange(length // 2 + 1) * fs / length
    used = (f > TAKES.low) & (f < TAKES.high)
    span = min(recording.samples, 4 * length)
    parts = TAKES.parts if recording.samples > span else 1
    total = np.zeros((int(np.sum(used)), recording.count, recording.count), complex)
    for start in np.linspace(0, recording.samples - span, parts).astype(int):
        samples = read_samples(recording, start, start + span)
        for at in range(0, span - length + 1, length // 2):
            X = rfft(np.hanning(length) * samples[:, at : at + length])[:, used].T
            total += X[:, :, None] * X[:, None].conj()
    power = np.real(np.einsum("fnn->fn", total))
    product = np.maximum(power[:, :, None] * power[:, None], np.finfo(float).tiny)
    return np.mean(np.abs(total) ** 2 / product, axis=0)


PLANE_TOLERANCE = 1e-3  # m; microphones whose heights differ by no more than this lie in one plane


def select_subset(recording: Recording, text: str) -> Recording:
    """Return the recording of the microphones in a list of numbers and slices, such as "0,3,8:12" or "::4"."""
    numbers, count = list[int](), recording.count
    try:
        for part in text.split(","):
            ends = [int(end) if end.strip() else None for end in part.split(":")]
            numbers += range(*slice(*ends).indices(count)) if len(ends) > 1 else [int(part)]
    except (TypeError, ValueError):
        numbers = []
    if not numbers or len(set(numbers)) < len(numbers) or not all(0 <= n < count for n in numbers):
        problem = f'subset = "{text}" must name some of the microphones 0 to {count - 1}, each at most once'
        raise InputError(problem, "write, for example, <subset> 0,3,8:12 or <subset> ::4", key="subset")
    return select_channels(recording, numbers)


def exclude_channels(recording: Recording, names: Sequence[str], bad: Sequence[int] | np.ndarray = ()) -> Recording:
    """Return the recording without the channels of these names and the `bad` ones, indices (n,).

    Raises InputError for a name that no channel has, or if no channel is left.
    """
    excluded = [_index_of(recording, name, "leave_out") for name in names]
    left = np.setdiff1d(np.arange(recording.count), [*excluded, *bad])
    if not len(left):
        why = ": each is silent, clipped or a copy" if len(bad) == recording.count else ""
        raise InputError(f"leave_out leaves no channel{why}", "record again" if why else "name fewer", key="leave_out")
    return select_channels(recording, left)


def known_microphones(recording: Recording, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices (A,) and the positions (A, D), metres, of the known microphones.

    `text`: a list of channel names, whose positions the recording contains, or the path of a file of positions.
    """
    if Path(text).suffix.lower() in READERS:
        names, positions = read_places(text)
        return np.array([_index_of(recording, name, "known") for name in names]), positions
    if recording.positions is None:
        if Path(text).suffix and os.path.isfile(text):
            raise refusal("known", text, "is not a list of positions", f"give a file {', '.join(sorted(READERS))}")
        raise InputError(f"known = {text}: {recording.path} contains no positions", "give <known> FILE", key="known")
    indices = np.array([_index_of(recording, part.strip(), "known") for part in text.split(",")])
    return indices, recording.positions[indices]


def _index_of(recording: Recording, name: str, key: str) -> int:
    names = recording.names
    if name in names:
        return names.index(name)
    few = ", ".join(names[:3])
    listed = f"the channels are {few} ... {names[-1]}" if len(names) > 3 else f"use {few}"
    raise InputError(f'{key}: there is no channel "{name}"', listed, key=key)
