"""What all parts of the panels share: the choices made on the page, and how handles are heard and told.

A callback bounds its value, then gives the session a command or changes a choice. Callbacks are `async`: viser runs
those in order, on its own loop. None of them waits for anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import viser

from ...model.validation import InputError
from ...session.request import OpenRequest
from ..background.cost_maps import MapStyle
from ..background.prepare import PreparedRun

FLOOR, RELIEF, SHAPE, NOTHING = "Flat map", "Relief", "Shape of the last mode", "No map"
PICTURE = "Picture (PNG)"  # first of the files that can be saved


@dataclass(frozen=True)
class Choices:
    """What the page's controls say, apart from what is the session's."""

    microphone: int  # whose map is shown
    follow: bool = True  # after a step, show the microphone that it moved
    shown: bool = True  # a map at all
    modes: tuple[int, ...] | None = None  # of the map, chosen by hand; None: those in use
    look: MapStyle = field(default_factory=MapStyle)
    trails: bool = False  # the way that each microphone has come
    ellipses: bool = False  # how far each may be from where it is supposed
    complaint: str = ""  # about what was written into a field
    export_kind: str = PICTURE
    export_view: str = "top"
    export_size: tuple[int, int] = (1280, 800)
    seed: int = 0


KEPT = ("trails", "ellipses", "export_kind", "export_view", "export_size")  # when another scene is opened
SWITCHES = ("follow", "shown", "trails", "ellipses", "log", "relief", "shared", "dark", "shape")


def first_choices(work: PreparedRun, modes: int, before: Choices | None) -> Choices:
    """What the controls say when a session opens: what its opening says, and the looks of the page before.

    Raises InputError for what the opening's `choices` must not be.
    """
    measurement, session = work.measurement, work.session
    free = [n for n in range(measurement.count) if n not in measurement.known]
    choices = Choices(microphone=free[0] if free else 0, seed=session.view.state.seed)
    if before is not None:
        look = replace(before.look, shape=False)
        choices = replace(choices, look=look, **{name: getattr(before, name) for name in KEPT})
    for key, value in work.opening.choices.items():
        value = _read(key, value, measurement.count, modes)
        if hasattr(choices.look, key):
            choices = replace(choices, look=replace(choices.look, **{key: value}))
        else:
            choices = replace(choices, **{key: value})
    return choices


def choices_told(choices: Choices) -> dict[str, object]:
    """What an opening has to say for the controls to say the same."""
    keys = ("microphone", "modes", "opacity", *SWITCHES)
    return {key: getattr(choices.look if hasattr(choices.look, key) else choices, key) for key in keys}


def _read(key: str, value, count: int, modes: int):
    """A value of an opening's choices, which may come out of a file."""
    if key in SWITCHES and isinstance(value, bool):
        return value
    if key == "opacity" and isinstance(value, (int, float)) and 0.1 <= value <= 1:
        return float(value)
    if key == "microphone" and isinstance(value, int) and 0 <= value < count:
        return value
    if key == "modes" and value is None:
        return None
    if key == "modes" and isinstance(value, (list, tuple)) and value:
        if all(isinstance(mode, int) and 1 <= mode <= modes for mode in value):
            return tuple(sorted(set(value)))
    raise InputError(
        f"choices.{key} = {value!r} cannot be; there are microphone (0 to {count - 1}), modes (of 1 to {modes}),"
        f" opacity (0.1 to 1) and, true or false, {', '.join(SWITCHES)}"
    )


class Binding:
    """Choices, session and handles. `choices` is replaced whole by the callbacks, and read by the main loop.

    `open(opening)` has another session take this one's place as soon as it is ready; it may refuse, and tells so on the
    page. `hasten()` brings the screen up to date sooner than by itself. Whoever stays longer than a session asks the
    page for its binding each time (`page.Page.binding`).
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        work: PreparedRun,
        modes: int,
        open_other: Callable[[OpenRequest], None] = lambda opening: None,
        before: Choices | None = None,
        hasten: Callable[[], None] = lambda: None,
    ):
        self.gui, self.work, self.session, self.measurement = gui, work, work.session, work.measurement
        self.modes, self.weights, self.open = modes, work.scene.solver.weights, open_other
        self.choices, self._hasten = first_choices(work, modes, before), hasten
        self.sent: dict[str, object] = {}  # what the handles were last told by `send`

    def on(self, handle, act: Callable) -> None:
        """Call `act(value)` when a client, and not this program, has changed a handle."""

        async def hear(event) -> None:
            if event.client is not None:
                self.session.yield_to_ui()
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
        self._hasten()

    def look(self, **changes) -> None:
        """Draw maps in another way."""
        self.choose(look=replace(self.choices.look, **changes))

    def send(self, key: str, value, handle, name: str = "value") -> None:
        """Send a value when it differs from the last one sent: a slider that a hand holds is not pulled back."""
        if key not in self.sent or self.sent[key] != value:
            self.sent[key] = value
            setattr(handle, name, value)
