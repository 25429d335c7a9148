"""Applies what a lesson's step sets, through the page's own controls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..model.texts import parse_modes
from ..session.lesson import IN_USE, Setting, run_goal
from ..session.lesson_frame import Frame, parse_frame
from ..session.session import Session
from .gui.choices import BASINS, FLOOR, NOTHING, RELIEF, SHAPE, VOLUME, Choices
from .main_panel import MainPanel
from .tabs.map import EQ7, LINEAR, LOG, OBJECTIVE

KINDS = {"flat": FLOOR, "relief": RELIEF, "shape": SHAPE, "basins": BASINS, "volume": VOLUME, "none": NOTHING}
QUANTITIES = {"eq7": EQ7, "objective": OBJECTIVE}
OF_THE_PAGE = ("microphone", "dark", "lecture")  # choices that a lesson does not begin with
SCALES = {"log": LOG, "linear": LINEAR}


def plain_choices() -> dict[str, Any]:
    """Return the choices that a page begins with, for an OpenRequest, without OF_THE_PAGE."""
    return {key: value for key, value in Choices(microphone=0).to_save().items() if key not in OF_THE_PAGE}


def apply_setting(setting: Setting, panel: MainPanel, place_all: Callable[[str], None], restarted: bool) -> None:
    """Set the controls of a session that shows the scene of `setting` already.

    `setting`: Setting; what it leaves out stays; `panel`: MainPanel of the session; `place_all`: function that moves
    the cameras of all browsers to a view; `restarted`: whether the session is at its start, or will be when it has
    executed its queued commands. Raises InputError: the setting names modes that were not measured.
    """
    setting = setting.unfolded()
    _drive(setting, panel, restarted)
    if setting.microphone is not None:
        panel.map.pick(setting.microphone)
    if setting.follow is not None:
        panel.map.follow_solver(setting.follow)
    if setting.map is not None:
        panel.map.show_as(KINDS[setting.map])
    if setting.map_modes is not None:
        text = setting.map_modes
        panel.map.choose_modes(None if text == IN_USE else parse_modes(text, panel.binding.modes))
    if setting.quantity is not None:
        panel.map.show_quantity(QUANTITIES[setting.quantity])
    if setting.order_offset is not None:
        panel.map.set_order(setting.order_offset)
    if setting.scale is not None:
        panel.map.scale_as(SCALES[setting.scale])
    if setting.minima is not None:
        panel.map.mark_minima(setting.minima)
    drawn = {name: getattr(setting, name) for name in ("trails", "ellipses")}
    panel.view.draw(**{name: value for name, value in drawn.items() if value is not None})
    if setting.view is not None:
        place_all(setting.view)


def _drive(setting: Setting, panel: MainPanel, restarted: bool) -> None:
    """Apply what concerns the solver: the modes in use, and how far it runs."""
    session = panel.binding.session
    state = session.view.history[0] if restarted else session.view.state
    modes = range(state.first, state.last + 1)
    if setting.modes is not None:
        modes = parse_modes(setting.modes, panel.binding.modes)
    automatic = state.automatic if setting.automatic is None else setting.automatic
    if setting.modes is not None or setting.automatic is not None:
        session.use_modes(modes[0], modes[-1], automatic)
    if setting.run is not None:
        what, count = run_goal(setting.run)
        if what == "end":
            session.play()
        else:
            {"step": session.step, "sweep": session.sweep, "stage": session.stage}[what](count)
    if setting.frame is not None:
        show_frame(session, parse_frame(setting.frame), session.view.history[: 1 if restarted else None])


def show_frame(session: Session, frame: Frame, states: list) -> None:
    """Show a frame of a run; one that the run has not come to is run to, from its last state.

    `frame`: Frame; without a unit, the state that is shown stays; `states`: of the run so far.
    """
    if not frame.unit:
        return
    wanted = frame.number - (frame.unit == "stage")  # a state counts its stages from 0
    reached = [getattr(state, frame.unit) for state in states]
    session.pause()
    if max(reached) >= wanted:
        session.seek(next(index for index, number in enumerate(reached) if number >= wanted))
        return
    session.seek(len(states) - 1)
    {"step": session.step, "sweep": session.sweep, "stage": session.stage}[frame.unit](wanted - reached[-1])
