"""The choices made on the page, apart from those that belong to the session; they are saved with a session."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from ...cost.yardstick import ORDER_OFFSET
from ...model.validation import InputError
from ...session.lesson import MAX_ORDER_OFFSET
from ..background.map_request import MapStyle
from ..background.prepare import PreparedRun

FLOOR, RELIEF, SHAPE, NOTHING = "Flat map", "Relief", "Mode shape (last mode)", "No map"  # kinds of map
PICTURE = "Picture (PNG)"  # the first kind of file to save
VIEWS = {"Top": "top", "3-D": "3d", "Close": "close"}  # label to view of a camera

KEPT = ("trails", "ellipses", "export_kind", "export_view", "export_size")  # choices that another scene keeps
SWITCHES = (
    "follow",
    "shown",
    "trails",
    "ellipses",
    "log",
    "relief",
    "shared",
    "dark",
    "shape",
    "objective",
    "minima",
    "release",
)


@dataclass(frozen=True)
class Choices:
    """What the controls of the page show, apart from what belongs to the session.

    Attributes
    ----------
    microphone : int, whose map is shown, counted from 0
    follow : whether the map is that of the microphone which the last step moved
    shown : whether a map is shown
    modes : of the map, counted from 1; None for those that the solver uses
    order_offset : of the map, added to ceil(k R) in the order of every mode
    objective : whether the map shows what the solver minimises, in place of Eq. 7
    style : MapStyle
    trails : whether the path of each estimate is drawn
    ellipses : whether the error ellipses are drawn
    release : whether known microphones can be dragged
    modes_error : why the text in the field "Mode numbers" was refused, "" if it was not
    export_kind : kind of file to save, a key of `exports.KINDS`
    export_view : view of a picture to save, a value of VIEWS
    export_size : of a picture to save, width and height in pixels
    seed : of the solver's next start
    """

    microphone: int
    follow: bool = True
    shown: bool = True
    modes: tuple[int, ...] | None = None
    order_offset: int = ORDER_OFFSET
    objective: bool = False
    style: MapStyle = field(default_factory=MapStyle)
    trails: bool = False
    ellipses: bool = False
    release: bool = False
    modes_error: str = ""
    export_kind: str = PICTURE
    export_view: str = "top"
    export_size: tuple[int, int] = (1280, 800)
    seed: int = 0

    def with_values(self, values: Mapping[str, Any]) -> Choices:
        """Return the choices with some values changed, by the names of the fields of Choices and of MapStyle."""
        style = {key: value for key, value in values.items() if hasattr(self.style, key)}
        own = {key: value for key, value in values.items() if key not in style}
        return replace(self, style=replace(self.style, **style), **own)

    def to_save(self) -> dict[str, Any]:
        """Return the values that an OpenRequest needs to restore these choices."""
        keys = ("microphone", "modes", "order_offset", "opacity", *SWITCHES)
        return {key: getattr(self.style if hasattr(self.style, key) else self, key) for key in keys}


def initial_choices(run: PreparedRun, modes: int, before: Choices | None) -> Choices:
    """Return the choices of a session that opens: those of its request, and the appearance of the page before.

    Parameters
    ----------
    run : PreparedRun
    modes : int, number of modes that can be in use
    before : Choices of the session that was shown before, or None

    Raises
    ------
    InputError
        The request's `choices` hold an unknown key or value.
    """
    measurement = run.measurement
    free = [n for n in range(measurement.count) if n not in measurement.known]
    choices = Choices(microphone=free[0] if free else 0, seed=run.session.view.state.seed)
    if before is not None:
        kept = {name: getattr(before, name) for name in KEPT}
        choices = replace(choices, style=replace(before.style, shape=False), **kept)
    wanted = run.opening.choices.items()
    return choices.with_values({key: _checked(key, value, measurement.count, modes) for key, value in wanted})


def _checked(key: str, value: Any, count: int, modes: int) -> Any:
    """Return a value of a request's choices, which may come from a file."""
    if key in SWITCHES and isinstance(value, bool):
        return value
    if key == "opacity" and isinstance(value, (int, float)) and 0.1 <= value <= 1:
        return float(value)
    if key == "microphone" and isinstance(value, int) and 0 <= value < count:
        return value
    if key == "order_offset" and isinstance(value, int) and 0 <= value <= MAX_ORDER_OFFSET:
        return value
    if key == "modes" and value is None:
        return None
    if key == "modes" and isinstance(value, (list, tuple)) and value:
        if all(isinstance(mode, int) and 1 <= mode <= modes for mode in value):
            return tuple(sorted(set(value)))
    raise InputError(
        f"choices.{key} = {value!r} is not possible",
        f"use microphone (0 to {count - 1}), modes (from 1 to {modes}), order_offset (0 to {MAX_ORDER_OFFSET}),"
        " opacity (0.1 to 1) or, true or false,"
        f" {', '.join(SWITCHES)}",
        key=f"choices.{key}",
        value=value,
    )
