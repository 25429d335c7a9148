"""Two pages that press everything for a long time: do memory, files and threads grow, and does a run stop?

Every control that is shown gets random values: ends of sliders, all options, invalid texts, any button. The
clients speak viser's protocol, without a browser. FDCAL_SOAK_PRESSES says how often something is pressed, 3000 times
unless given, which takes about ten minutes. After each round the scene is opened again, so that the measurement is
that of one session, whatever was pressed before. It runs only when it is named.

Memory grows once for the compiled code of each solver and map and for the libraries of an export (VTK has 56 MB). It
varies with downloads and with the heap that malloc keeps between objects.
"""

import os
import random
import time
from collections.abc import Iterator
from contextlib import ExitStack

from .bench_switches import settle, switch
from .pages import Served
from .protocol import ProtocolPage
from .report import Figure

ALONE = True  # only when named
PAGES, SCENE, OTHER = 2, "tiny", "fig1_square"
PRESSES, ROUNDS = int(os.environ.get("FDCAL_SOAK_PRESSES", "3000")), 6
PAUSE, SETTLE = 0.3, 60.0  # s, longest time between two presses, and until all computations have ended
WAIT = 300.0  # s, longest time in which a page opens a scene
MOST_GROWTH, MOST_MORE = 150.0, 4  # MB, and files or threads, more than after the first round
TEXTS = ("", "1", "1, 2-5", "0", "-3", "1e999", "x", "9" * 400, "\u00e4\u2192\U0001f50a")
STOPPED = "stopped at state"


class Presser(ProtocolPage):
    """A page that presses its controls; `gui`: the properties of each; `stopped`: messages that the solver stopped."""

    def __init__(self, address: str):
        super().__init__(address)
        self.gui: dict[str, dict] = {}
        self.stopped: list[str] = []

    def read(self, message: dict) -> None:
        super().read(message)
        kind = message["type"]
        if kind.startswith("Gui") and "props" in message:
            self.gui[message["uuid"]] = {"type": kind, **message["props"]}
        elif kind == "GuiUpdateMessage" and message["uuid"] in self.gui:
            self.gui[message["uuid"]].update(message["updates"])
        elif kind == "GuiRemoveMessage":
            self.gui.pop(message["uuid"], None)
        if STOPPED in str(message.get("updates", message.get("props", ""))):
            self.stopped.append(str(message)[:300])

    def press(self, rng: random.Random) -> None:
        """Give one control that is shown and enabled a value."""
        shown = [one for one in list(self.gui.items()) if one[1].get("visible") and not one[1].get("disabled")]
        choices = [(uuid, value) for uuid, props in shown for value in _values(props, rng)]
        if choices:
            uuid = rng.choice(sorted({uuid for uuid, _ in choices}))
            self.update(uuid, rng.choice([value for one, value in choices if one == uuid]))


def _values(props: dict, rng: random.Random) -> list:
    """Return values that a person can give a control; [] for a control without a value."""
    kind = props["type"]
    if kind in ("GuiSliderMessage", "GuiNumberMessage"):
        low, high = props.get("min"), props.get("max")
        if low is None or high is None:
            return [0]
        between = low + props["step"] * rng.randint(0, max(0, round((min(high, low + 1e3) - low) / props["step"])))
        return [low, high, between, between, between]
    if kind in ("GuiDropdownMessage", "GuiButtonGroupMessage"):
        return list(props["options"])
    if kind == "GuiTextMessage":
        return list(TEXTS)
    return {"GuiCheckboxMessage": [True, False], "GuiButtonMessage": [True]}.get(kind, [])


def run() -> Iterator[Figure]:
    rng, during, rested = random.Random(0), [], []
    with Served(SCENE, {}, own_cache=True) as served, ExitStack() as stack:
        pages = [stack.enter_context(Presser(served.url)) for _ in range(PAGES)]
        for page in pages:
            page.wait_for(lambda page=page: {"Save", "Scene"} <= page.controls.keys(), WAIT)
        for _ in range(ROUNDS):
            for _ in range(max(1, PRESSES // ROUNDS)):
                rng.choice(pages).press(rng)
                time.sleep(rng.uniform(0, PAUSE))
                during.append(_taken(served))
            switch(pages[0], OTHER, False, WAIT)  # takes back what was typed in the fields of this scene
            switch(pages[0], SCENE, False, WAIT)
            settle(served, SETTLE)
            rested.append(_taken(served))
        errors = served.complaints()
        stopped = [line for page in pages for line in page.stopped]
    yield Figure(f"{PAGES} pages, something pressed", len(during), "times")
    for number, (what, unit, more) in enumerate(
        (("resident memory", "MB", MOST_GROWTH), ("open files", "", MOST_MORE), ("threads", "", MOST_MORE))
    ):
        every = [one[number] for one in rested]
        yield Figure(f"{what} of the server while pages press, largest", max(one[number] for one in during), unit)
        listed = ", ".join(f"{value:.0f}" for value in every[:-1])
        yield Figure(
            f"{what} after each round, scene {SCENE} opened again: {listed}, and in the end",
            every[-1], unit, f"{more:g} more than after the first at most", every[-1] <= every[0] + more,
        )  # fmt: skip
    yield _lines("times a page said that the solver stopped", stopped)
    yield _lines("errors in the log", errors)


def _taken(served: Served) -> tuple[float, int, int]:
    return served.memory() / 1e6, served.handles(), len(served.threads())


def _lines(title: str, lines: list[str]) -> Figure:
    return Figure(title + "".join(f"\n    {line}" for line in lines[:9]), len(lines), "", "none", not lines)
