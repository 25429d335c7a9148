"""What the page showed before a lesson, and how all of it comes back: the session, the controls, cameras and race."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import viser

from ..session.request import OpenRequest
from .background.comparison import ComparisonWorker
from .gui.choices import Choices
from .scene3d.cameras import Cameras, KeptView
from .server.client_values import fits

if TYPE_CHECKING:
    from ..session.history import SessionView
    from .background.prepare import PreparedRun
    from .session_view import Viewer


@dataclass(frozen=True)
class PageBefore:
    """The page as it was before a lesson."""

    run: PreparedRun
    view: SessionView  # the states of its run
    choices: Choices
    # of the controls of each tab that a user can set, by the name of the tab and of the control
    values: Mapping[str, Mapping[str, Any]]
    cameras: Mapping[int, KeptView]  # KeptView of each browser
    race: ComparisonWorker  # ComparisonWorker that keeps the race, paused
    has_race: bool  # whether there was a race

    @classmethod
    def of(cls, viewer: Viewer, cameras: Cameras) -> PageBefore:
        """Return the page as it is, and pause its run and its race."""
        viewer.run.session.pause()
        has_race = viewer.comparison.button_label != "Start"
        viewer.comparison.release()
        values = {name: control_values(tab) for name, tab in _tabs(viewer).items()}
        view = viewer.run.session.view
        return cls(viewer.run, view, viewer.binding.choices, values, cameras.kept_views(), viewer.comparison, has_race)

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
            if name == "scene":
                viewer.main_panel.scene.choose(values.get("name"))
            set_values(tab, values)
        viewer.main_panel.refresh()
        viewer.comparison.adopt(self.race)
        cameras.request_kept(self.cameras)

    def close(self) -> None:
        """End the threads of the race, which nothing shows any longer."""
        if self.race.released is not None:
            self.race.released.comparison.close(0.0)


def _tabs(viewer: Viewer) -> dict[str, Any]:
    """Whatever has controls in the two panels, by name."""
    main, side = viewer.main_panel, viewer.side_panel
    owners = {**vars(main), **vars(side), "slice": main.map.slice}
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
