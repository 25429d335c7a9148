"""A frame of a run, cited by what stands after # in the address of a replay: "step=12&microphone=9&modes=1-20".

step, sweep, stage  the first state of the run with this number; stages count from 1, as on the page
microphone          whose map is shown, from 0, or "none"
modes               of the map, as "1-20", or "solver" for those in use
view                "top", "3d", "close", or azimuth and elevation, degrees, which stand for "3d"
map, trails         "on" or "off"
zoom, theme         are accepted; they are of a window, which a lesson leaves alone
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import parse_qsl

from ..model.validation import InputError, shown

UNITS = ("step", "sweep", "stage")
ANGLES = re.compile(r"-?\d+(\.\d+)?,-?\d+(\.\d+)?")
ON_OFF = {"on": True, "off": False}


@dataclass(frozen=True)
class Frame:
    """A moment of a run, and how it is looked at; None and "" leave a control as it is."""

    unit: str = ""  # one of UNITS, or "" for the state that is shown
    number: int = 0  # of the step or sweep, from 0; of the stage, from 1
    microphone: int | None = None  # from 0
    modes: str | None = None  # of the map, as `fdcal.model.texts.parse_modes` reads them, or "solver"
    view: str | None = None  # "top", "3d" or "close"
    # map, trails: whether they are shown
    map: bool | None = None
    trails: bool | None = None


def parse_frame(text: str) -> Frame:
    """Return the frame that the address of a replay names, with or without its "#".

    `text`: as "#step=12&microphone=9&modes=1-20&view=top". Raises InputError: a part that a frame does not have, or a
    value that it cannot have.

    Examples
    --------
    >>> parse_frame("#step=12&microphone=9").number
    12
    """
    parts = parse_qsl(text.strip().removeprefix("#"), keep_blank_values=True)
    named = [unit for unit, _ in parts if unit in UNITS]
    if not parts or len(named) > 1 or len(dict(parts)) < len(parts):
        remedy = 'write as the address of a replay after #, "step=12&microphone=9", with one step, sweep or stage'
        raise InputError(f'"{shown(text)}" names no frame', remedy, key="frame", value=text)
    values: dict = {}
    for name, value in parts:
        values |= _part(name, value)
    return Frame(**values)


def _part(name: str, value: str) -> dict:
    """The fields of a Frame that one part of an address sets."""
    if name in UNITS and re.fullmatch(r"\d{1,6}", value) and int(value) >= (name == "stage"):
        return {"unit": name, "number": int(value)}
    if name == "microphone" and re.fullmatch(r"\d{1,6}", value):
        return {"microphone": int(value)}
    if name == "modes" and value:
        return {"modes": value}
    if name == "view" and (value in ("top", "3d", "close") or ANGLES.fullmatch(value)):
        return {"view": value if value in ("top", "3d", "close") else "3d"}
    if name in ("map", "trails") and value in ON_OFF:
        return {name: ON_OFF[value]}
    if name in ("zoom", "theme") or (name, value) == ("microphone", "none"):
        return {}
    remedy = "use step, sweep or stage, microphone, modes, view, map and trails, as a replay writes them"
    raise InputError(f'"{shown(name)}={shown(value)}" is not of a frame', remedy, key="frame", value=value)
