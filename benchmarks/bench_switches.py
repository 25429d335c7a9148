"""A page that shows one scene after the other: do threads remain, does memory grow?

FDCAL_SWITCHES says how many scenes are opened, 200 unless given. It runs only when it is named.
"""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass

from .pages import Served
from .protocol import TIMEOUT, ProtocolPage
from .report import Figure

ALONE = True  # only when named
SCENES = ("array1_circle", "tiny", "lshape")
RUN_EVERY, RUN_TIME = 3, 0.5  # the solver runs in every third scene, for RUN_TIME seconds
SETTLE_TIME = 8.0  # s, longest time until the maps of a scene are drawn and threads have ended
STILL_TIME = 2.0  # s without a change, longer than the page waits before it releases memory
MAX_GROWTH = 50e6  # bytes


@dataclass(frozen=True)
class Soak:
    """Memory, bytes, and threads of the server before the first switch, after each, and in the end."""

    start: int
    during: list[int]
    end: int
    threads: int
    threads_left: int
    errors: list[str]


def soak(count: int, scenes: Sequence[str] = SCENES, settle_time: float = SETTLE_TIME) -> Soak:
    """Open `count` scenes one after the other in a page."""
    with Served(scenes[-1], {}) as served, ProtocolPage(served.url) as page:
        page.wait_for(lambda: "Apply" in page.controls)
        switch(page, scenes[0], True)  # the first run starts the threads that all computations share
        settle(served, settle_time)
        threads, start, during = len(served.threads()), served.memory(), []
        for n in range(count):
            switch(page, scenes[n % len(scenes)], n % RUN_EVERY == 0)
            during.append(served.memory())
        settle(served, settle_time)
        return Soak(start, during, served.memory(), threads, len(served.threads()) - threads, served.complaints())


def settle(served: Served, longest: float) -> None:
    """Wait until neither threads nor memory, to a megabyte, have changed for STILL_TIME; `longest` at most, s."""
    now = time.perf_counter()
    end, since, before = now + longest, now, None
    while now < end and now - since < STILL_TIME:
        time.sleep(0.1)
        now, there = time.perf_counter(), (len(served.threads()), round(served.memory() / 1e6))
        since, before = (since, before) if there == before else (now, there)


def run() -> list[Figure]:
    count = int(os.environ.get("FDCAL_SWITCHES", "200"))
    seen = soak(count)
    grown, left, errors = seen.end - seen.start, seen.threads_left, len(seen.errors)
    return [
        Figure("resident memory of the server before the first switch", seen.start / 1e6, "MB"),
        Figure("largest memory just after a switch", max(seen.during) / 1e6, "MB"),
        Figure(f"growth of the memory in {count} switches", grown / 1e6, "MB", "at most 50", grown <= MAX_GROWTH),
        Figure(f"threads at the start {seen.threads}, and more at the end", left, "", "none", left <= 0),
        Figure("errors in the log", errors, "lines", "none", not errors),
    ]


def switch(page: ProtocolPage, scene: str, runs: bool, longest: float = TIMEOUT) -> None:
    """Open a scene as a user does, and wait until its controls are there, `longest` s at most."""
    before = page.controls["Apply"]
    page.set("Scene", scene)
    page.wait_for(lambda: page.controls["Apply"] != before, longest)
    if runs:
        page.set("Play", True)
        time.sleep(RUN_TIME)
