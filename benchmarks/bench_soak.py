"""Four pages, the solver in a loop and random slider moves for a long time: does memory grow, does a thread die?

FDCAL_SOAK_SECONDS says for how long, 600 unless given. Not part of a run of all benchmarks: name it, `soak`.
"""

import contextlib
import os
import random
import time

from .pages import Served, chromium, open_page, slider
from .report import Figure

ALONE = True  # only when named
PAGES, SCENE = 4, "tiny"
ENDED = "() => [...document.querySelectorAll('button')].some(b => b.textContent.trim() === 'Run' && b.disabled)"
SLIDERS = ("Microphone", "Modes summed", "First mode", "Last mode", "Steps per second")


def run() -> list[Figure]:
    seconds = float(os.environ.get("FDCAL_SOAK_SECONDS", "600"))
    rng, memory, worst = random.Random(0), [], set()
    with Served(SCENE, {"name": "descent"}) as served, chromium() as browser:
        pages = [open_page(browser, served.url) for _ in range(PAGES)]
        for page in pages:
            page.get_by_text("Settings", exact=True).click()
        start, before = time.perf_counter(), served.threads()
        while (elapsed := time.perf_counter() - start) < seconds:
            _do_something(rng, rng.choice(pages))
            memory.append((elapsed, served.memory()))
            worst |= before - served.threads()
        warm = [size for at, size in memory if at > min(60.0, seconds / 2)]
        grown = (max(warm[-5:]) - warm[0]) / 1e6
        lost, errors = sorted(worst - served.threads()), served.complaints()
    return [
        Figure(f"{PAGES} pages, solver on a loop, random sliders, for", seconds, "s"),
        Figure("resident memory of the server in the end", memory[-1][1] / 1e6, "MB"),
        Figure("its growth after the first minute", grown, "MB", "at most 50", grown <= 50),
        Figure("threads gone: " + (", ".join(lost) or "none"), len(lost), "", "none", not lost),
        Figure(
            "errors in the log" + "".join(f"\n    {line}" for line in errors[:9]),
            len(errors),
            "lines",
            "none",
            not errors,
        ),
    ]


def _press(page, button: str) -> None:
    """Press a button, unless another page has pressed it meanwhile and it is another one now."""
    from playwright.sync_api import TimeoutError

    with contextlib.suppress(TimeoutError):
        page.get_by_role("button", name=button, exact=True).click(timeout=1000)


def _do_something(rng: random.Random, page) -> None:
    """Restart the solver if it has ended, or move a slider by some steps."""
    _press(page, "Reset" if page.evaluate(ENDED) else "Run")
    handle = slider(page, rng.choice(SLIDERS))
    handle.focus()
    for _ in range(rng.randint(1, 4)):
        handle.press(rng.choice(["ArrowLeft", "ArrowRight", "Home", "End"]))
