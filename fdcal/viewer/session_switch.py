"""From one session to another while the page stays: the next is prepared in the background, the old one goes on.

SessionSwitcher   asked from any thread (`open`, `cancel`); the main loop does what was asked and takes what is ready
StatusBar   how far it is, with Cancel; or in one line why it cannot be
"""

from __future__ import annotations

import collections
import logging

import viser

from ..model.measurement import Measurement
from ..model.validation import InputError, StorageError
from ..session.request import OpenRequest
from ..session.worker import LatestWorker
from .background.prepare import Cancelled, PreparationProgress, PreparedRun, prepare_run
from .gui import html
from .gui.layout import Panels
from .server.error_log import log_location

log = logging.getLogger(__name__)


class Job:
    """One opening on its way. Its thread sets `work` or `cause`, then `done`."""

    def __init__(self, opening: OpenRequest):
        self.opening, self.progress = opening, PreparationProgress()
        self.work: PreparedRun | None = None
        self.cause: Exception | None = None
        self.done = False

    def run(self) -> None:
        try:
            self.progress(0.0)
            self.work = prepare_run(self.opening, self.progress)
        except Cancelled:
            pass
        except Exception as error:
            self.cause = error
        self.done = True


class SessionSwitcher:
    """Prepares the newest opening asked for, on a thread of its own.

    `refusal` says in one line why the last one could not be, "" where it could; `cause` is the exception.
    """

    def __init__(self):
        self._asked: collections.deque[OpenRequest | None] = collections.deque()  # None: cancel
        self._worker = LatestWorker(Job.run, "fdcal-prepare")
        self._job: Job | None = None
        self._dropped: list[Job] = []  # given up, perhaps still under way
        self.cause: Exception | None = None
        self.refusal = ""

    def open(self, opening: OpenRequest) -> None:
        """Have `opening` prepared; one that is under way is given up. Any thread."""
        self._asked.append(opening)

    def cancel(self) -> None:
        """Give up what is under way, or take note of why it could not be. Any thread."""
        self._asked.append(None)

    # Below: the main loop alone.

    @property
    def idle(self) -> bool:
        """Whether nothing is asked for or under way."""
        return not self._asked and self._job is None

    @property
    def progress(self) -> PreparationProgress | None:
        """Of what is under way."""
        return None if self._job is None else self._job.progress

    @property
    def measured(self) -> tuple[OpenRequest, Measurement] | None:
        """What is under way, once it is measured or simulated."""
        measurement = None if self._job is None else self._job.progress.measurement
        return None if measurement is None else (self._job.opening, measurement)

    @property
    def title(self) -> str:
        """Of what is under way."""
        return "" if self._job is None else self._job.opening.scene.title

    def take(self) -> PreparedRun | None:
        """Do what was asked; the work that is ready, once, or None."""
        while self._asked:
            self._begin(self._asked.popleft())
        self._tidy()
        job = self._job
        if job is None or not job.done:
            return None
        self._job = None
        if job.cause is not None:
            self.refuse(job.cause)
        return job.work

    def refuse(self, error: Exception) -> None:
        """Tell that an opening cannot be."""
        known = isinstance(error, (InputError, StorageError))
        if not known:
            log.error("an opening failed", exc_info=error)
        self.cause, self.refusal = (
            error,
            str(error) if known else f"{type(error).__name__}: {error}; details in {log_location()}",
        )

    def close(self, timeout: float = 1.0) -> None:
        """End the thread, which may be writing the cache, and the sessions that nobody takes; not longer than that, s.

        What is written to the cache is moved into place once it is whole: a thread that is left behind harms nothing.
        """
        self._begin(None)
        self._worker.close(timeout)
        self._tidy()

    def _begin(self, opening: OpenRequest | None) -> None:
        if self._job is not None:
            self._job.progress.stop = True
            self._dropped.append(self._job)
        self._job, self.cause, self.refusal = None, None, ""
        if opening is not None:
            self._job = Job(opening)
            self._worker.request(self._job)

    def _tidy(self) -> None:
        """Close the sessions of what was given up too late to stop it."""
        for job in self._dropped:
            if job.done and job.work is not None:
                job.work.session.close(0.0)
        self._dropped = [job for job in self._dropped if not job.done]


class StatusBar:
    """What stands above everything while another session is prepared, or could not be."""

    def __init__(self, panels: Panels, switcher: SessionSwitcher):
        self._switcher, self._told, gui = switcher, (), panels.gui
        with panels.top:
            self.line = gui.add_html("", visible=False)
            self.bar = gui.add_progress_bar(0.0, visible=False)
            self.button = gui.add_button("Cancel", icon=viser.Icon.X, visible=False)

        @self.button.on_click
        async def _(event) -> None:
            if event.client is not None:
                switcher.cancel()

    def show(self, first: bool) -> None:
        """Called by the main loop; `first` where there is no session to go back to."""
        progress, refusal = self._switcher.progress, self._switcher.refusal
        text, share = ("", 0) if progress is None else (progress.text, round(100 * progress.done))
        if (told := (self._switcher.title, text, share, refusal, first)) == self._told:
            return
        self._told, busy = told, progress is not None
        self.line.content = html.waiting(self._switcher.title, text) if busy else html.complaint(refusal)
        self.line.visible = busy or bool(refusal)
        self.bar.value, self.bar.visible = float(share), busy
        self.button.label, self.button.visible = "Cancel" if busy else "Close", self.line.visible and not first
