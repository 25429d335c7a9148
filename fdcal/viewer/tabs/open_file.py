"""The tab Open: a file of the folder in which fdcal was started, shown as a session.

It belongs to the page, not to a session, and is there only on a page that this machine alone can reach, because it
reads files here: recordings, measurements (.npz) and sessions (.zip). The page reads no other folder.
"""

import os
import time
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Literal

import viser

from ...recordings.recording import KINDS
from ...session.sources import OpenRequest, compared_with_file, is_recording, load_input, measurement_request
from ...session.worker import LatestWorker
from .. import html

SETTLED = 5e9  # ns after a change of the folder for which each look lists it: times of files are coarse
MAX_FILES, MAX_NAME = 200, 200  # of each list, and characters of a name that is listed
LISTS = (".csv", ".xml")  # tables of positions
NONE = "None"
REMOTE = "Other machines can reach this page, so that it opens no files. Start fdcal view for this machine alone."


class OpenFile:
    """Owns the controls, and what reads the file.

    `folder`: of the files; `show`: function that shows a session.
    """

    def __init__(self, gui: viser.GuiApi, folder: Path, show: Callable[[OpenRequest], None]):
        self._folder, self._show, self._modified = folder, show, 0
        self.worker = LatestWorker(self._open, "fdcal-open", notify=self._report)
        gui.add_html(html.remark(f"Recordings, measurements and sessions in {folder}"))
        self.file = gui.add_dropdown("File name", [NONE])
        self.positions = gui.add_dropdown("List", [NONE], hint="Positions to compare the result with")
        self.kind = gui.add_dropdown(
            "Kind", ("auto", *KINDS), hint="Of a recording: an impulse response, or a continuous sound"
        )
        self.celsius = gui.add_number("Temperature (°C)", 20.0, min=-60.0, max=80.0, step=0.5, hint="Of the air")
        self.button = gui.add_button("Open file", icon=viser.Icon.FOLDER_OPEN)
        self.report = gui.add_html("")

        @self.button.on_click
        async def _(event) -> None:
            if event.client is not None:
                self.press()

    def press(self) -> None:
        """Open the file that is chosen."""
        if self.file.value != NONE:
            self.button.disabled, self.report.content = True, html.remark("Opening ...")
            self.worker.request(self.file.value, self.positions.value, self.kind.value, float(self.celsius.value))

    def _report(self) -> None:
        """Say what was found in the last file, or why it could not be opened."""
        if (latest := self.worker.latest) is None:
            return
        text = f"<div style='{html.CARD} white-space: pre-wrap'>{escape(latest.result or '')}</div>"
        self.report.content = html.complaint(latest.cause) if latest.cause else text
        self.button.disabled = False

    def list_folder(self) -> None:
        """Offer the files of the folder where it has changed; called by the main loop now and then."""
        modified = self._folder.stat().st_mtime_ns
        if modified == self._modified and time.time_ns() - modified > SETTLED:
            return
        self._modified, files, lists = modified, [], []
        for name in sorted(os.listdir(self._folder)):
            plain = len(name) <= MAX_NAME and name.isprintable() and not name.startswith(".")
            path = self._folder / name
            if plain and path.is_file():
                if name.lower().endswith(LISTS):
                    lists.append(name)
                elif name.lower().endswith((".npz", ".zip")) or is_recording(str(path)):
                    files.append(name)
        for control, names in ((self.file, files[:MAX_FILES] or [NONE]), (self.positions, [NONE, *lists[:MAX_FILES]])):
            if list(control.options) != names:
                chosen = control.value
                control.options = names
                control.value = chosen if chosen in names else names[0]

    def _open(
        self, name: str, positions: str, kind: Literal["auto", "impulse", "stationary"], temperature: float
    ) -> str:
        """On the thread: show a file as a session, and return the report of its import.

        `positions`: name of the list that the result is compared with, or NONE; `kind`, `temperature` (degrees
        Celsius): of a recording.
        """
        from ...recordings.importer import import_recording, import_summary
        from ...recordings.recording import ImportOptions
        from ...session import session_file
        from ...session.sources import measurement_input

        path, report, left_out = self._folder / name, "", ()
        if path.suffix.lower() == ".zip":
            self._show(session_file.read(str(path)))
            return report
        if is_recording(str(path)):
            options = ImportOptions(leave_out="bad", files="takes", kind=kind, temperature=temperature)
            measurement, found = import_recording(path, options)
            inputs, left_out = measurement_input(measurement, path.stem), tuple(found.left_out)
            report = import_summary(measurement, found, html.CONTROLS)
        else:
            inputs = load_input(str(path))
        if positions != NONE:
            inputs = compared_with_file(inputs, str(self._folder / positions), left_out)
        self._show(measurement_request(inputs))
        return report
