"""How quickly the page answers, seen by a real browser while the solver runs: a slider's effect, states and frames.

A slider's effect is timed from the key that moves it to the text that tells of it, in the browser; the server's share
is less. States are counted by the time slider's changes, frames by the browser's own animation frames.
"""

from __future__ import annotations

import re
import statistics
import time

from .pages import Served, chromium, open_page, slider
from .report import Figure

SECONDS, MOVES = 8.0, 12

COUNT = """seconds => new Promise(resolve => {
    const start = performance.now(), seen = {frames: 0, changes: 0};
    const watch = new MutationObserver(() => { seen.dirty = true; });
    watch.observe(document.body, {subtree: true, childList: true, characterData: true});
    const tick = now => {
        seen.frames += 1;
        seen.changes += seen.dirty ? 1 : 0;
        seen.dirty = false;
        if (now - start < 1000 * seconds) return requestAnimationFrame(tick);
        watch.disconnect();
        resolve([seen.frames / seconds, seen.changes / seconds]);
    };
    requestAnimationFrame(tick);
})"""


def run() -> list[Figure]:
    start = time.perf_counter()
    with Served("array1_circle", {"name": "descent"}) as served, chromium() as browser:
        page = open_page(browser, served.url)
        first = time.perf_counter() - start
        page.get_by_role("button", name="Run", exact=True).click()
        page.get_by_text("Running").wait_for()
        frames, changes = page.evaluate(COUNT, SECONDS)
        answers = [_answer(page, 20 + i) for i in range(MOVES)]
    median = 1e3 * statistics.median(answers)
    return [
        Figure("first picture of array1_circle, browser's start included", first, "s", "below 5 (warm)", first < 5),
        Figure("page while the solver runs: its texts change", changes, "1/s"),
        Figure("its own frames, software WebGL", frames, "1/s"),
        Figure("slider to text, in the browser, median", median, "ms", "below 100 (server)"),
        Figure("Ctrl-C to the end, one page open", served.stopped_in, "s", "below 2", served.stopped_in < 2),
    ]


def _answer(page, mode: int) -> float:
    """Seconds from a key on the slider of the last mode to the text that tells of it."""
    handle = slider(page, "Last mode")
    handle.focus()
    before = int(handle.get_attribute("aria-valuenow"))
    start = time.perf_counter()
    handle.press("ArrowRight")
    page.get_by_text(re.compile(rf"modes? 1 to {before + 1},")).first.wait_for()
    return time.perf_counter() - start
