"""The channels of a recording: which are faulty, which to use, and which microphones are known."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from ..assessment.calibration import ChannelFault
from ..assessment.words import fault_words
from ..model.validation import InputError
from .formats.positions import read_table
from .recording import BLOCK_SAMPLES, Recording, number_in, ranges, read_samples, select_channels


@dataclass(frozen=True)
class ClippingThresholds:
    """When a channel counts as silent or clipped."""

    silent: float = 1e-7  # level relative to the loudest channel at which a channel is silent
    run: int = 3  # neighbouring samples at the greatest magnitude of a channel: no wave stays there for so long
    full_scale: float = 0.999  # fraction of full scale from which a sample counts as being there
    full_scale_run: int = 2  # neighbouring samples at full scale
    full_scale_count: int = 3  # samples at full scale anywhere; a recording that was normalised has one
    # edge_count, edge_ratio: samples at the greatest value, and how many times more they are than those at the next
    # smaller value
    edge_count: int = 8
    edge_ratio: int = 4
    full_scale_ratio: int = 2  # the same ratio for a recording that reaches full scale


CLIPPING = ClippingThresholds()
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
    """The state of every channel of a recording that is read, or recorded, a block at a time."""

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
                edges = np.flatnonzero(np.diff(np.concatenate([[False], np.abs(samples) >= top[n], [False]])))
                run = int(np.max(edges[1::2] - edges[::2]))
            self._longest[n] = run if top[n] > self._peak[n] else max(self._longest[n], run)
            high, low = self._edges[n]
            self._edges[n] = _edge(samples, high), _edge(-samples, low)
        self._peak = np.maximum(self._peak, top)

    def health(self, full_scale: float | None) -> ChannelHealth:
        """Return the state by all samples so far; `full_scale`: greatest value that a sample can take."""
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
    """Return the state of every channel, after one pass over all samples, a block at a time."""
    watch = ChannelWatch(recording.count)
    for start, stop in ranges(recording.samples, BLOCK_SAMPLES // recording.count):
        watch.add(read_samples(recording, start, stop))
    return watch.health(recording.full_scale)


def _edge(samples: np.ndarray, before: Edge) -> Edge:
    """Return the edge of samples (t,) and of those before."""
    times = Counter(before)
    for _ in range(2):
        if len(samples):
            top, count = samples.max(), len(samples)
            samples = samples[samples < top]
            times[float(top)] += count - len(samples)
    return dict(sorted(times.items(), reverse=True)[:2])


def _is_clipped(pair: tuple[Edge, Edge], full_scale: float | None) -> bool:
    """Return whether many samples of a channel have its greatest (or least) value, and few the next one to it.

    The values of sound become rarer towards the greatest one, however coarse the quantisation; clipping does not.
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
    for words, flags in (("silent", health.silent), ("clipped", health.clipped), ("copied", health.copy_of >= 0)):
        if not np.any(flags):
            continue
        names = [recording.names[n] for n in np.flatnonzero(flags)]
        listed = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
        if words == "copied":
            n = int(np.flatnonzero(flags)[0])
            listed += f" (the first is the same as channel {recording.names[health.copy_of[n]]})"
        who, verb = ("channel", "is") if len(names) == 1 else ("channels", "are")
        problem = f"{recording.path}: {who} {listed} {verb} {words}"
        others = ", or leave out the faulty channels: <leave_out> bad" if len(health.bad) < recording.count else ""
        raise InputError(problem, f"record again{others}", key="leave_out")


PLANE_TOLERANCE = 1e-3  # m: microphones this close to a plane lie in it
CORNERS = "corners"


def select_plane(recording: Recording, plane: str) -> Recording:
    """Return the recording of the microphones in a plane as "z=0" or, the same, "0", metres, with two coordinates."""
    axis, _, value = plane.rpartition("=")
    axis = axis.strip().lower() or "z"
    positions = recording.positions
    if positions is None or positions.shape[1] != 3:
        problem = f"plane = {plane} needs positions in space, which {recording.path} does not contain"
        raise InputError(problem, "leave out <plane>", key="plane", value=plane)
    height = number_in(value)
    if axis not in "xyz" or len(axis) != 1 or not np.isfinite(height):
        raise InputError(f'plane = "{plane}" is no plane', "write <plane> as z=0.1, metres", key="plane", value=plane)
    along = positions[:, "xyz".index(axis)]
    inside = np.flatnonzero(np.abs(along - height) < PLANE_TOLERANCE)
    if not len(inside):
        near = along[np.argmin(np.abs(along - height))]
        problem = f"plane = {plane}: no microphone lies there; the nearest plane is {axis}={near:g}"
        raise InputError(problem, "give <plane> as that one", key="plane", value=plane)
    kept = [a for a in range(3) if a != "xyz".index(axis)]
    return replace(select_channels(recording, inside), positions=positions[inside][:, kept])


def select_subset(recording: Recording, text: str, seed: int) -> Recording:
    """Return the recording of some microphones: a list as "0,3,8:12", or how many are drawn at random, as "200"."""
    numbers: list[int] = []
    try:
        for part in text.split(","):
            first, colon, end = part.partition(":")
            numbers += range(int(first), min(int(end), recording.count + 1)) if colon else [int(part)]
    except ValueError:
        problem = f'subset = "{text}" is no number and no list'
        raise InputError(problem, "write <subset> as 200, or 0,3,8:12", key="subset", value=text) from None
    if len(numbers) == 1 and "," not in text and ":" not in text:
        number = numbers[0]
        if not 1 <= number <= recording.count:
            problem = f"subset = {number} cannot be drawn from {recording.count} microphones"
            raise InputError(problem, "give a smaller <subset>", key="subset", value=number)
        drawn = np.random.default_rng(seed).choice(recording.count, number, replace=False)
        return select_channels(recording, np.sort(drawn))
    wrong = [n for n in numbers if not 0 <= n < recording.count]
    if wrong or len(set(numbers)) < len(numbers) or not numbers:
        problem = f"subset = {text} must name microphones of 0 to {recording.count - 1}, each at most once"
        raise InputError(problem, key="subset", value=text)
    return select_channels(recording, numbers)


def exclude_channels(recording: Recording, text: str, bad: np.ndarray) -> Recording:
    """Return the recording without the channels that a list names; "bad" stands for all of `bad`, indices (n,)."""
    names = [part.strip() for part in text.split(",")]
    excluded = [_index_of(recording, name, "leave_out") for name in names if name != "bad"]
    left = np.setdiff1d(np.arange(recording.count), [*excluded, *bad] if "bad" in names else excluded)
    if not len(left):
        why = ": each is silent, clipped or a copy" if len(bad) == recording.count else ""
        raise InputError(f"leave_out = {text} leaves no channel{why}", "record again", key="leave_out", value=text)
    return select_channels(recording, left)


def known_microphones(recording: Recording, text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the indices (A,) and the positions (A, D), metres, of the known microphones.

    `text`: a list of channel names, whose positions the recording contains; "corners", those nearest to the corners of
    the bounding box; or the path of a table (.csv) with name,x,y or name,x,y,z.
    """
    if text.lower().endswith(".csv"):
        names, positions = read_table(text)
        return np.array([_index_of(recording, name, "known") for name in names]), positions
    if recording.positions is None:
        problem = f"known = {text}: {recording.path} contains no positions"
        raise InputError(problem, "give a table: <known> FILE.csv", key="known")
    if text == CORNERS:
        low, high = recording.positions.min(axis=0), recording.positions.max(axis=0)
        sides = [(a,) if a == b else (a, b) for a, b in zip(low, high, strict=True)]
        corners = np.stack([c.ravel() for c in np.meshgrid(*sides)], axis=1)
        distances = np.linalg.norm(recording.positions[None] - corners[:, None], axis=2)
        indices = np.unique(np.argmin(distances, axis=1))
    else:
        indices = np.array([_index_of(recording, part.strip(), "known") for part in text.split(",")])
    return indices, recording.positions[indices]


def _index_of(recording: Recording, name: str, key: str) -> int:
    names = recording.names
    if name in names:
        return names.index(name)
    few = ", ".join(names[:3])
    listed = f"the channels are {few} ... {names[-1]}" if len(names) > 4 else f"use {few}"
    raise InputError(f'{key}: there is no channel "{name}"', listed, key=key, value=name)
