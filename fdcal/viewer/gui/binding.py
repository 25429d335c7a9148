"""Binds the controls of the panels to a session: callbacks from the browser, and values sent to it.

A callback bounds the value that it receives, and then gives the session a command or changes a choice. Callbacks are
`async`, so that viser runs them in order on its own event loop. None of them blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import viser

from ...graphics.units import row_word
from ...session.request import OpenRequest
from ..background.prepare import PreparedRun
from .choices import Choices, initial_choices


class Binding:
    """The session that is shown, the choices made for it, and what was last sent to its controls.

    The callbacks replace `choices` as a whole; the main loop reads it. An object that outlives the session asks the
    page for the present binding each time (`Page.binding`).

    `modes`: number of modes that can be in use; `open_other`: function that opens another session in place of this one
    as soon as that is ready; `before`: Choices of the session that was shown before, or None; `wake`: function that
    makes the main loop update the page at once. `row`: what the page calls a row of the measurement: "mode", or "row"
    where there are several takes; `sent`: what `send` has sent last, by its key; `touches`: how many times a user has
    changed or pressed anything.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        run: PreparedRun,
        modes: int,
        open_other: Callable[[OpenRequest], None] = lambda request: None,
        before: Choices | None = None,
        wake: Callable[[], None] = lambda: None,
    ):
        self.gui, self.run, self.session, self.measurement = gui, run, run.session, run.measurement
        self.modes, self.weights, self.open = modes, run.scene.solver.weights, open_other
        self.row = row_word(run.measurement)
        self.choices, self._wake = initial_choices(run, modes, before), wake
        self.sent: dict[str, object] = {}
        self.touches = 0

    def touch(self) -> None:
        """Note that a user has changed or pressed something."""
        self.touches += 1

    def on(self, handle, act: Callable[[Any], object]) -> None:
        """Call `act(value)` when a client, and not this program, has changed a control."""

        async def respond(event) -> None:
            if event.client is not None:
                self.touch()
                self.session.yield_to_ui()
                act(event.target.value)

        (handle.on_click if hasattr(handle, "on_click") else handle.on_update)(respond)

    def on_client(self, handle, act: Callable[[viser.ClientHandle, Any], object]) -> None:
        """Call `act(client, value)` when a client has pressed a button."""

        @handle.on_click
        async def _(event) -> None:
            if event.client is not None:
                self.touch()
                act(event.client, event.target.value)

    def choose(self, **changes) -> None:
        """Change some of the choices."""
        self.choices = replace(self.choices, **changes)
        self._wake()

    def place(self, microphone: int, place, gesture: int) -> None:
        """Move a microphone to a place, (2,), metres: its estimate, or where the plan has it while that is shown."""
        if self.choices.plan.shown:
            self.choose(plan=self.choices.plan.with_moved(microphone, place))
        else:
            self.session.place(microphone, place, gesture)

    def choose_style(self, **changes) -> None:
        """Change the style of the maps and of the page."""
        self.choose(style=replace(self.choices.style, **changes))

    def send(self, key: str, value, handle, name: str = "value") -> None:
        """Set an attribute of a control where the value differs from the one sent last under `key`.

        A slider that the user is dragging is therefore not pulled back by the main loop.
        """
        if key not in self.sent or self.sent[key] != value:
            self.sent[key] = value
            setattr(handle, name, value)
