"""What a lesson's step sets, done with the page's own controls."""

from __future__ import annotations

from collections.abc import Callable

from ..model import mode_ranges
from ..session.lesson import IN_USE, Setting, run_goal
from .gui.binding import FLOOR, NOTHING, RELIEF, SHAPE
from .main_panel import MainPanel
from .tabs.map import LINEAR, LOG

KINDS = {"flat": FLOOR, "relief": RELIEF, "shape": SHAPE, "none": NOTHING}
SCALES = {"log": LOG, "linear": LINEAR}


def carry_out(setting: Setting, controls: MainPanel, place_all: Callable[[str], None], anew: bool) -> None:
    """Set the controls of a session that shows the scene of `setting` already.

    `anew` says that the session stands at its start, or will when it has done what it was told.
    Raises InputError for modes that were not measured.
    """
    _drive(setting, controls, anew)
    if setting.microphone is not None:
        controls.map.pick(setting.microphone)
    if setting.follow is not None:
        controls.map.follow_solver(setting.follow)
    if setting.map is not None:
        controls.map.show_as(KINDS[setting.map])
    if setting.map_modes is not None:
        text = setting.map_modes
        controls.map.choose_modes(None if text == IN_USE else mode_ranges.parse(text, controls.binding.modes))
    if setting.scale is not None:
        controls.map.scale_as(SCALES[setting.scale])
    wanted = {name: getattr(setting, name) for name in ("trails", "ellipses")}
    controls.draw(**{name: value for name, value in wanted.items() if value is not None})
    if setting.view is not None:
        place_all(setting.view)


def _drive(setting: Setting, controls: MainPanel, anew: bool) -> None:
    """What of a setting is the solver's: the modes in use, and how far it runs."""
    binding, session = controls.binding, controls.binding.session
    state = session.view.history[0] if anew else session.view.state
    modes = range(state.first, state.last + 1)
    if setting.modes is not None:
        modes = mode_ranges.parse(setting.modes, binding.modes)
    automatic = state.automatic if setting.automatic is None else setting.automatic
    if setting.modes is not None or setting.automatic is not None:
        session.use_modes(modes[0], modes[-1], automatic)
    if setting.run is not None:
        what, count = run_goal(setting.run)
        if what == "end":
            session.play()
        else:
            {"step": session.step, "sweep": session.sweep, "stage": session.stage}[what](count)
