"""What a lesson does to the page: each step sets its controls, and what it showed before comes back at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import viser

from ..model.validation import parse_modes
from ..session.lesson import IN_USE, Frame, LessonSetting, parse_frame, run_target
from ..session.session import Session
from ..session.sources import OpenRequest
from .gui.binding import BASINS, FLOOR, NOTHING, RELIEF, SHAPE, VOLUME, Choices
from .panels import Tabs
from .scene3d.cameras import Cameras, KeptView
from .server.client_values import fits
from .tabs.map import EQ7, LINEAR, LOG, OBJECTIVE

if TYPE_CHECKING:
    from ..session.session import SessionView
    from .background.prepare import PreparedRun
    from .session_view import Viewer

KINDS = {"flat": FLOOR, "relief": RELIEF, "shape": SHAPE, "basins": BASINS, "volume": VOLUME, "none": NOTHING}
QUANTITIES = {"eq7": EQ7, "objective": OBJECTIVE}
OF_THE_PAGE = ("microphone", "dark", "lecture")  # choices that a lesson does not begin with
SCALES = {"log": LOG, "linear": LINEAR}


def plain_choices() -> dict[str, Any]:
    """Return the choices that a page begins with, for an OpenRequest, without OF_THE_PAGE."""
    return {key: value for key, value in Choices(microphone=0).to_save().items() if key not in OF_THE_PAGE}


def apply_setting(setting: LessonSetting, tabs: Tabs, place_all: Callable[[str], None], restarted: bool) -> None:
    """Set the controls of a session that shows the scene of `setting` already.

    `setting`: what it leaves out stays; `tabs`: of the session; `place_all`: function that moves
    the cameras of all browsers to a view; `restarted`: whether the session is at its start, or will be when it has
    executed its queued commands. Raises InputError: the setting names modes that were not measured.
    """
    setting, modes = setting.unfolded(), tabs.binding.modes
    _drive(setting, tabs, restarted)
    effects: dict[str, Callable[[Any], object]] = {
        "microphone": tabs.map.pick,
        "follow": tabs.map.follow_solver,
        "map": lambda name: tabs.map.show_as(KINDS[name]),
        "map_modes": lambda text: tabs.map.choose_modes(None if text == IN_USE else parse_modes(text, modes)),
        "quantity": lambda name: tabs.map.show_quantity(QUANTITIES[name]),
        "order_offset": tabs.map.set_order,
        "scale": lambda name: tabs.map.scale_as(SCALES[name]),
        "minima": tabs.map.mark_minima,
        "trails": lambda drawn: tabs.view.draw(trails=drawn),
        "ellipses": lambda drawn: tabs.view.draw(ellipses=drawn),
        "view": place_all,
    }
    for name, act in effects.items():
        if getattr(setting, name) is not None:
            act(getattr(setting, name))


def _drive(setting: LessonSetting, tabs: Tabs, restarted: bool) -> None:
    """Apply what concerns the solver: the modes in use, and how far it runs."""
    session = tabs.binding.session
    state = session.view.history[0] if restarted else session.view.state
    modes = range(state.first, state.last + 1)
    if setting.modes is not None:
        modes = parse_modes(setting.modes, tabs.binding.modes)
    automatic = state.automatic if setting.automatic is None else setting.automatic
    if setting.modes is not None or setting.automatic is not None:
        session.use_modes(modes[0], modes[-1], automatic)
    if setting.run is not None:
        what, count = run_target(setting.run)
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


@dataclass(frozen=True)
class PageBefore:
    """The page as it was before a lesson."""

    run: PreparedRun
    view: SessionView  # the states of its run
    choices: Choices
    # of the controls of each tab that a user can set, by the name of the tab and of the control
    values: Mapping[str, Mapping[str, Any]]
    cameras: Mapping[int, KeptView]  # KeptView of each browser

    @classmethod
    def of(cls, viewer: Viewer, cameras: Cameras) -> PageBefore:
        """Return the page as it is, and pause its run."""
        viewer.run.session.pause()
        values = {name: control_values(tab) for name, tab in _tabs(viewer).items()}
        view = viewer.run.session.view
        return cls(viewer.run, view, viewer.binding.choices, values, cameras.kept_views())

    def request(self) -> OpenRequest:
        """Return the request that opens the session again, with all its states."""
        run, view = self.run, self.view
        scene = replace(run.scene, solver=view.state.settings)
        choices = self.choices.to_save()
        return OpenRequest(scene, view.state.seed, run.measurement, tuple(view.history), view.index, choices)

    def put_back(self, viewer: Viewer, cameras: Cameras) -> None:
        """Set the controls of the viewer that shows the session again; on viser's event loop."""
        viewer.binding.choose(**vars(self.choices))
        for name, tab in _tabs(viewer).items():
            values = self.values.get(name, {})
            if name == "scene" and "name" in values:
                viewer.tabs.scene.choose(values["name"])
            set_values(tab, values)
        viewer.tabs.refresh()
        cameras.request_kept(self.cameras)


def _tabs(viewer: Viewer) -> dict[str, Any]:
    """Whatever has controls in the two panels, by name."""
    owners = {**vars(viewer.tabs), "slice": viewer.tabs.map.slice}
    return {name: owner for name, owner in owners.items() if any(map(_is_control, vars(owner).values()))}


def control_values(tab) -> dict[str, Any]:
    """Return the values of the controls of a tab that a user sets, by the names of their handles."""
    handles = {name: handle for name, handle in vars(tab).items() if _is_control(handle)}
    return {name: handle.value for name, handle in handles.items()}


def set_values(tab, values: Mapping[str, Any]) -> None:
    """Set the controls of a tab to values of `control_values` that they can have."""
    for name, value in values.items():
        handle = vars(tab).get(name)
        if _is_control(handle) and handle.value != value and fits(handle, value):
            handle.value = value


def _is_control(handle) -> bool:
    """Whether a handle is of a control that keeps a value, unlike a button."""
    return isinstance(handle, viser.GuiInputHandle)
