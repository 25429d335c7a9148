"""From one session to the next while the page stays: the next one is prepared in the background.

SessionSwitcher   takes requests from any thread; the main loop executes them and takes what is ready
StatusBar         the progress of the preparation, with Cancel, or in one line why a request was refused
"""

import collections
import logging
import time

import viser

from ..model.measurement import Measurement
from ..model.validation import InputError, StorageError
from ..session.sources import OpenRequest
from ..session.worker import LatestWorker
from .background.prepare import Cancelled, PreparationProgress, PreparedRun, prepare_run
from .gui import html
from .gui.binding import Same
from .panels import Panels

log = logging.getLogger(__name__)

COMPILE_TIMEOUT = 60.0  # s; the longest compilation takes 8 s of processor time


class Preparation:
    """One request while it is prepared. Its thread sets `run` or `error`, and then `done`."""

    def __init__(self, request: OpenRequest):
        self.request, self.progress = request, PreparationProgress()
        self.run: PreparedRun | None = None
        self.error: Exception | None = None
        self.done = False

    def execute(self) -> None:
        """Prepare the run; called on the thread."""
        try:
            self.progress(0.0)
            self.run = prepare_run(self.request, self.progress)
        except Cancelled:
            pass
        except Exception as error:
            self.error = error
        self.done = True


class SessionSwitcher:
    """Prepares the newest request on a thread of its own.

    `error`: exception for which the last request was refused, or None.
    """

    def __init__(self):
        self._commands: collections.deque[OpenRequest | None] = collections.deque()  # None: cancel
        self._worker = LatestWorker(Preparation.execute, "fdcal-prepare")
        self._current: Preparation | None = None
        self._cancelled: list[Preparation] = []  # some of which may still be in progress
        self._begun: list[PreparationProgress] = []  # whose compilations may still be in progress
        self.error: Exception | None = None

    def open(self, request: OpenRequest) -> None:
        """Prepare a request, and cancel the one in progress. Any thread."""
        self._commands.append(request)

    def cancel(self) -> None:
        """Cancel the request in progress, or dismiss the error of the last one. Any thread."""
        self._commands.append(None)

    # Below: the main loop alone.

    @property
    def idle(self) -> bool:
        """Whether no request waits or is in progress."""
        return not self._commands and self._current is None

    @property
    def progress(self) -> PreparationProgress | None:
        """The progress of the preparation; None where nothing is in progress."""
        return None if self._current is None else self._current.progress

    @property
    def measured(self) -> tuple[OpenRequest, Measurement] | None:
        """The request in progress and its measurement, once that is simulated or read."""
        if self._current is None or self._current.progress.measurement is None:
            return None
        return self._current.request, self._current.progress.measurement

    @property
    def title(self) -> str:
        """The title of the scene in progress, or ""."""
        return "" if self._current is None else self._current.request.scene.title

    @property
    def compiling(self) -> bool:
        """Whether a compilation is in progress, of a session that is shown or of one that nobody waits for."""
        return any(progress.warmup is not None and progress.warmup.busy for progress in self._begun)

    def poll(self, wait: bool = False) -> PreparedRun | None:
        """Execute the commands that wait; return the run that is ready, once, or None; None to `wait` with it."""
        while self._commands:
            self._begin(self._commands.popleft())
        self._close_cancelled()
        finished = self._current
        if finished is None or not finished.done or (wait and finished.error is None):
            return None
        self._current = None
        if finished.error is not None:
            self.refuse(finished.error)
        return finished.run

    def refuse(self, error: Exception) -> None:
        """Refuse the last request; log an exception that is not the user's."""
        if not isinstance(error, (InputError, StorageError)):
            log.error("a request could not be opened", exc_info=error)
        self.error = error

    def close(self, timeout: float = 1.0, compile_timeout: float = COMPILE_TIMEOUT) -> None:
        """End the threads and close the sessions that were not taken.

        The thread of a preparation may be writing to the cache. A file is moved into its place when it is complete, so
        a thread that is left behind does no harm. A compiler that is left behind can end the interpreter with an error.

        `timeout`: how long to wait for the preparation, s; `compile_timeout`: how long to wait for compilations, which
        cannot be interrupted, s.
        """
        self._begin(None)
        self._worker.close(timeout)
        self._close_cancelled()
        end = time.perf_counter() + compile_timeout
        for progress in self._begun:
            if progress.warmup is not None:
                progress.warmup.close(max(end - time.perf_counter(), 0.0))

    def _begin(self, request: OpenRequest | None) -> None:
        if self._current is not None:
            self._current.progress.stop = True
            self._cancelled.append(self._current)
        self._current, self.error = None, None
        if request is not None:
            self._current = Preparation(request)
            self._begun = [progress for progress in self._begun if not progress.ended]
            self._begun.append(self._current.progress)
            self._worker.request(self._current)

    def _close_cancelled(self) -> None:
        """Close the sessions of preparations that were cancelled too late."""
        for preparation in self._cancelled:
            if preparation.done and preparation.run is not None:
                preparation.run.close(0.0)
        self._cancelled = [preparation for preparation in self._cancelled if not preparation.done]


class StatusBar:
    """Owns the line above the panel while a session is prepared, or after a request was refused."""

    def __init__(self, panels: Panels, switcher: SessionSwitcher):
        self._switcher, self._shown, gui = switcher, (), panels.gui
        with panels.top:
            self.line = gui.add_html("", visible=False)
            self.bar = gui.add_progress_bar(0.0, visible=False)
            self.button = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)

        @self.button.on_click
        async def _(event) -> None:
            if event.client is not None:
                switcher.cancel()

    def show(self, first: bool) -> None:
        """Bring the line up to date; called by the main loop.

        `first`: whether there is no session yet, to which Cancel could return.
        """
        progress, error, title = self._switcher.progress, self._switcher.error, self._switcher.title
        text, percent = ("", 0) if progress is None else (progress.text, round(100 * progress.done))
        shown = title, text, percent, Same(error), first
        if shown == self._shown:
            return
        self._shown, busy = shown, progress is not None
        self.line.content = html.waiting(title, text) if busy else html.complaint(html.error_message(error))
        self.line.visible = busy or error is not None
        self.bar.value, self.bar.visible = float(percent), busy
        self.button.label, self.button.visible = "Cancel" if busy else "Close", self.line.visible and not first
