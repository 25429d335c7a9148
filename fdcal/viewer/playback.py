"""Plays the maps of a sweep, one after the other, at a rate that can change; it waits for maps that are not ready."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

OPENING_RATE = 2.5  # maps per second of the sweep with which a page opens
FIRST_TIME, LAST_TIME = 1.2, 1.5  # s that its first and its last map stay


@dataclass
class Playback:
    """A sweep that plays."""

    rate: float  # maps per second
    opening: bool = False  # whether it is the one with which the page opens, which ends where it began
    before: tuple[int, ...] | None = None  # modes of the map before it began, None for those of the solver
    next: int = 0  # which map is next, counted from 0
    due: float = float("-inf")  # when that is, s; at once unless given
    shown: tuple[int, ...] | None = None  # modes that the playback showed last

    def ended(self, stops: Sequence[int], now: float) -> bool:
        """Whether the last of all maps has been shown long enough."""
        return self.next >= len(stops) and now >= self.due

    def advance(self, stops: Sequence[int], ready: int, now: float) -> int | None:
        """Return the number of modes to be summed now; None where the present map stays.

        `stops`: numbers of modes of all maps of the sweep; `ready`: number of its maps that are computed; `now`: time,
        s.
        """
        if self.next >= min(ready, len(stops)) or now < self.due:
            return None
        time = 1 / self.rate
        if self.opening and self.next in (0, len(stops) - 1):
            time = FIRST_TIME if self.next == 0 else LAST_TIME
        self.next, self.due = self.next + 1, now + time
        return stops[self.next - 1]

    def continue_from(self, summed: int, stops: Sequence[int]) -> None:
        """Go on after the map of so many modes; from the beginning after the last one."""
        after = bisect_right(stops, summed)
        self.next = after if after < len(stops) else 0
