"""How long a page waits while another sends 30,000 updates at once, or drags a microphone 200 times in a row."""

import contextlib
import itertools
import threading
import time

import msgspec
from websockets.exceptions import ConnectionClosed

from .pages import Served
from .protocol import ProtocolPage
from .report import Figure

ALONE = True  # only when named
SCENE, DRAWN, LONGEST = "tiny", "LineSegmentsMessage", 2.0  # LONGEST: longest wait allowed for another page, s
UPDATES, DRAGS, MOVES = 30_000, 200, 10
DRAG = {
    "type": "SceneNodeDragMessage", "name": "/picking/0", "instance_index": 9, "start_position": [0.6, 0.5, 0.1],
    "start_screen_pos": [0.5, 0.5], "end_screen_pos": [0.5, 0.5], "button": "left", "modifier": None,
}  # fmt: skip


def run() -> list[Figure]:
    with Served(SCENE, {}) as served, ProtocolPage(served.url) as other:
        other.wait_for(lambda: {"Dark page", "Microphone"} <= other.controls.keys())
        time.sleep(3.0)
        figures = [Figure("another page's wait while nothing happens, worst of 10", max(waits(other, 10)), "s")]
        for name, sent in (("30,000 updates at once", _updates), ("200 drags in a row", _drags)):
            worst, count = _worst_wait(served, other, sent)
            title = f"its wait during {name}, worst of {count}"
            figures.append(Figure(title, worst, "s", "at most 2", worst <= LONGEST))
    return figures


def waits(page: ProtocolPage, count: int | None, stop: threading.Event | None = None) -> list[float]:
    """Change the colours of the scene `count` times, or until `stop` is set; return how long each change takes, s."""
    found = []
    for n in itertools.count() if count is None else range(count):
        if stop is not None and stop.is_set() and found:
            break
        before = page.received.get(DRAWN, 0)
        page.set("Dark page", n % 2 == 0)
        found.append(page.wait_for(lambda before=before: page.received.get(DRAWN, 0) > before))
    page.set("Dark page", False)
    return found


def _worst_wait(served: Served, other: ProtocolPage, sent) -> tuple[float, int]:
    """Return the longest wait of a page while another one sends, and how often it was measured."""
    ended = threading.Event()

    def flood() -> None:
        with contextlib.suppress(ConnectionClosed, TimeoutError), ProtocolPage(served.url) as page:
            page.wait_for(lambda: "Microphone" in page.controls)
            for message in sent(page):
                page.connection.send(msgspec.msgpack.encode(message))
        ended.set()

    thread = threading.Thread(target=flood, daemon=True)
    thread.start()
    found = waits(other, None, ended)
    thread.join()
    return max(found), len(found)


def _updates(page: ProtocolPage):
    uuid = page.controls["Microphone"]
    return ({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": n % 9}} for n in range(UPDATES))


def _drags(page: ProtocolPage):
    phases = ["start", *["update"] * MOVES, "end"]
    return (
        {**DRAG, "phase": phase, "end_position": [0.6 + 0.001 * n, 0.5, 0.1]}
        for n in range(DRAGS)
        for phase in phases
    )  # fmt: skip
