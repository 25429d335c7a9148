"""What the page shows first, without a click: why one frequency is not enough.

The map of one mode that has several local minima, then the sum with more and more modes. It begins once, after the
first browser has opened the page, and ends where it began, or as soon as a user touches anything: a control, a key, a
microphone, or the camera.
"""

from __future__ import annotations

from .session_view import Viewer

DELAY = 2.5  # s from a browser's connection and the first map, in which it draws both


class Opening:
    """Decides when the first sweep begins and ends; called by the main loop.

    It begins and ends on viser's event loop, as all that users do: in between nobody can have pressed anything.
    """

    def __init__(self):
        self._due: float | None = None
        self._viewer: Viewer | None = None  # in which it plays, or is about to
        self._began = False
        self.done = False

    def tick(self, viewer: Viewer, watched: bool, busy: bool, now: float) -> None:
        """Begin when it is time, and stop for the user.

        `viewer`: of the session that is shown; `watched`: whether a browser shows the page, and its first map is there;
        `busy`: whether the page does something else: a lesson, or a compilation; `now`: time, s.
        """
        if self.done:
            return
        if self._viewer is not None:
            ended = self._began and not viewer.side_panel.sweep.playing
            if touched(viewer) or ended or viewer is not self._viewer:
                self.done = True
                viewer.call(self._viewer.side_panel.sweep.end_opening)
                self._viewer = None  # another session may take its place
            return
        if touched(viewer) or not suitable(viewer):
            self.done = True
        elif watched and not busy:
            self._due = now + DELAY if self._due is None else self._due
            if now >= self._due:
                self._viewer = viewer
                viewer.call(lambda: self._begin(viewer))

    def _begin(self, viewer: Viewer) -> None:
        """Begin, unless a user has touched something meanwhile."""
        if not touched(viewer):
            viewer.side_panel.sweep.open()
        self._began = True


def touched(viewer: Viewer) -> bool:
    """Whether a user has changed, pressed or moved anything."""
    return viewer.binding.touches + viewer.nodes.cameras.user_moves > 0


def suitable(viewer: Viewer) -> bool:
    """Whether a session begins with the sweep: one that nobody has begun or set up, with more than one mode."""
    run, opening = viewer.run, viewer.run.opening
    plain = not (opening.play or opening.states or opening.choices)
    return plain and run.problem.search is not None and viewer.binding.modes > 1
