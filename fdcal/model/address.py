"""The part of an address after #, which names a view: one grammar for the page, for lessons and for offline pages.

scene             name of a scene that comes with fdcal, or of the one that is shown
method            name of the solver
lesson, part      name of a lesson; number of its step, from 1, optionally with that of the answer given: "2" or "2,1"
step, sweep, stage  the first state of the run with this number; stages count from 1, as on the page
microphone        number, from 0, of the microphone whose map is shown, or "none"
modes             modes over which the map is summed, such as "1-20", or "solver" for those that the solver uses
map               "flat", "relief", "shape", "volume" or "none"
view              "top", "3d" or "close"; azimuth and elevation, degrees; or a camera: position, target and upward
                  direction, metres, and field of view, radians
trails            "on" or "off": whether the path of each estimate is drawn
zoom              magnification, and how far the picture is moved to the right and up, metres
theme             "light" or "dark"
embed             "on": the page has no curves and no table, so that it fits into a frame of another page
opening           "on": the page begins with an animation that adds modes to the map

Keys that a page does not use are ignored: only an offline page uses zoom, theme, embed and opening. Its script gets
ADDRESS as JSON (`fdcal/graphics/replay_page/address.js`).
"""

import re
from collections.abc import Mapping
from typing import Literal, get_args
from urllib.parse import parse_qsl

from .validation import InputError, shown

Map = Literal["flat", "relief", "shape", "volume", "none"]
View = Literal["top", "3d", "close"]
Unit = Literal["step", "sweep", "stage"]  # what the number of a state counts
UNITS: tuple[Unit, ...] = get_args(Unit)
SOLVER = "solver"  # the modes that the solver uses
NUMBER = r"-?\d{1,9}(\.\d{1,9})?(e[-+]?\d\d?)?"
ADDRESS = {  # key: regular expression of its values, as Python and JavaScript read it
    "scene": r".+",
    "method": r"[a-z]+",
    "lesson": r".+",
    "part": r"[1-9]\d?(,[1-9])?",
    "step": r"\d{1,6}",
    "sweep": r"\d{1,6}",
    "stage": r"[1-9]\d{0,5}",
    "microphone": r"\d{1,5}|none",
    "modes": rf"[\d, -]{{1,60}}|{SOLVER}",
    "map": "|".join(get_args(Map)),
    "view": rf"{'|'.join(get_args(View))}|{NUMBER},{NUMBER}|{NUMBER}(,{NUMBER}){{9}}",
    "trails": "on|off",
    "zoom": f"{NUMBER},{NUMBER},{NUMBER}",
    "theme": "light|dark",
    "embed": "on",
    "opening": "on",
}


def parse_address(text: str) -> dict[str, str]:
    """Return the parts of an address by their keys.

    Raises InputError for a key or a value that an address cannot have, or for a key that is given twice.
    """
    parts: dict[str, str] = {}
    for key, value in parse_qsl(text.strip().removeprefix("#"), keep_blank_values=True):
        again = key in parts or (key in UNITS and unit_of(parts))
        if again or key not in ADDRESS or not re.fullmatch(ADDRESS[key], value):
            remedy = f"use {', '.join(ADDRESS)} at most once, as a page writes them, and only one of step, sweep, stage"
            raise InputError(f'the address has "{shown(key)}={shown(value)}"', remedy, key=key)
        parts[key] = value
    return parts


def unit_of(parts: Mapping[str, str]) -> Unit | None:
    """Return the unit in which an address gives the number of a state; None if it gives no such number."""
    return next((unit for unit in UNITS if unit in parts), None)
