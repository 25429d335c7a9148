"""What all parts of the panels share: the choices made on the page, and how handles are heard and told.

A callback bounds its value, then gives the session a command or changes a choice. Callbacks are `async`: viser runs
those in order, on its own loop. None of them waits for anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import viser

from ..measurement import Measurement
from ..session import Session
from .maps import Look

FLOOR, RELIEF, SHAPE, NOTHING = "Flat map", "Relief", "Shape of the last mode", "No map"


@dataclass(frozen=True)
class Choices:
    """What the page's controls say, apart from what is the session's."""

    microphone: int  # whose map is shown
    follow: bool = True  # after a step, show the microphone that it moved
    shown: bool = True  # a map at all
    modes: tuple[int, ...] | None = None  # of the map, chosen by hand; None: those in use
    look: Look = field(default_factory=Look)
    trails: bool = False  # the way that each microphone has come
    ellipses: bool = False  # how far each may be from where it is supposed
    complaint: str = ""  # about what was written into a field
    export_view: str = "top"
    export_size: tuple[int, int] = (1280, 800)
    seed: int = 0


class Desk:
    """Choices, session and handles. `choices` is replaced whole by the callbacks, and read by the main loop."""

    def __init__(self, gui: viser.GuiApi, session: Session, measurement: Measurement, modes: int, weights: str):
        self.gui, self.session, self.measurement = gui, session, measurement
        self.modes, self.weights = modes, weights
        free = [n for n in range(measurement.count) if n not in measurement.known]
        self.choices = Choices(microphone=free[0] if free else 0, seed=session.view.state.seed)
        self.shown: dict[str, object] = {}  # what the handles were last told by `tell`

    def on(self, handle, act: Callable) -> None:
        """Call `act(value)` when a client, and not this program, has changed a handle."""

        async def hear(event) -> None:
            if event.client is not None:
                act(event.target.value)

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(hear)

    def on_page(self, handle, act: Callable) -> None:
        """Call `act(client, value)` when a client has pressed a button."""

        @handle.on_click
        async def _(event) -> None:
            if event.client is not None:
                act(event.client, event.target.value)

    def choose(self, **changes) -> None:
        self.choices = replace(self.choices, **changes)

    def look(self, **changes) -> None:
        """Draw maps in another way."""
        self.choose(look=replace(self.choices.look, **changes))

    def tell(self, key: str, value, handle, name: str = "value") -> None:
        """Send a value when it differs from the last one sent: a slider that a hand holds is not pulled back."""
        if key not in self.shown or self.shown[key] != value:
            self.shown[key] = value
            setattr(handle, name, value)
