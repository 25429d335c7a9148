"""Files that a user uploads with the form below the list of scenes (`server/page.js`).

They arrive in parts, in viser's messages for uploads, and are kept in a private temporary folder until the server ends.
The page accepts files only if no other machine can reach it.
"""

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any, BinaryIO

import viser
from viser import _messages

from ..graphics.replay import filled
from ..model.validation import InputError, require_choice
from ..recordings.recording import ImportOptions, number_in
from ..session import session_file, sources
from ..session.worker import LatestWorker
from . import html
from .server import content

MAX_BYTES = 500_000_000  # of all files that a page accepts
MAX_FILES, MAX_NAME = 1000, 100  # of one request, and characters of a name
NO_ROOM = f"a page takes {MAX_BYTES // 1_000_000} MB and {MAX_FILES} files at most: use fdcal view FILE"
RECORDING, LIST = "recording", "positions"  # purpose of a file, as the fields of the form are called
KINDS = "auto", "impulse", "stationary"
FORM = Path(__file__).with_name("own_files.html")


@dataclass
class Delivered:
    """The files of one browser, with their purposes; `uploaded` shows it the number of bytes that have arrived."""

    folder: Path
    uploaded: viser.GuiHtmlHandle
    files: list[tuple[str, Path]] = field(default_factory=list)
    open: BinaryIO | None = None
    count: int = 0  # bytes


class OwnFiles:
    """Owns the folder and the thread that reads its files; `show` shows a session, `wake` updates the page."""

    def __init__(
        self, server: viser.ViserServer, show: Callable[[sources.OpenRequest], None], wake: Callable[[], None]
    ):
        self._server, self._show, self._delivered, self._bytes = server, show, dict[int, Delivered](), 0
        self._wake, self._folder = wake, tempfile.TemporaryDirectory(prefix="fdcal-", ignore_cleanup_errors=True)
        self.worker, self._complaint = LatestWorker(self._open, "fdcal-open", notify=wake), ""
        self._closed = False
        server._websock_server.register_handler(_messages.FileTransferStartUpload, self._begin)
        server._websock_server.register_handler(_messages.FileTransferPart, self._take)

    def close(self) -> None:
        """End the thread, and delete the files."""
        self.worker.close(0.5)
        self._closed = True
        for client in list(self._delivered):
            self.forget(client)
        for _ in range(3):  # a file may be added to the folder while it is deleted
            self._folder.cleanup()

    def forget(self, client: int) -> None:
        """Forget the files of a browser that were not opened."""
        if (delivered := self._delivered.pop(client, None)) is not None and delivered.open is not None:
            delivered.open.close()

    def _begin(self, client: int, message: Any) -> None:
        """Begin the next file with its name and size, on viser's event loop."""
        handle, delivered = self._server.get_clients().get(client), self._delivered.get(client)
        if self._closed or handle is None or message.source_component_uuid not in (RECORDING, LIST):
            return
        if delivered is None:
            uploaded = handle.gui.add_html(content("upload"), visible=False)
            delivered = self._delivered[client] = Delivered(Path(tempfile.mkdtemp(dir=self._folder.name)), uploaded)
        if self._bytes + message.size_bytes > MAX_BYTES or len(delivered.files) == MAX_FILES:
            self._refuse(client, delivered)
            return
        if delivered.open is not None:
            delivered.open.close()
        name = re.sub(r"[^\w .()+-]", "_", re.split(r"[/\\]", message.filename)[-1])[-MAX_NAME:].lstrip(". ") or "file"
        place = delivered.folder / message.source_component_uuid
        place.mkdir(exist_ok=True)
        delivered.files.append((message.source_component_uuid, place / name))
        delivered.open = (place / name).open("wb")

    def _take(self, client: int, message: Any) -> None:
        """Write a part of the last file that was begun, on viser's event loop."""
        delivered, size = self._delivered.get(client), len(message.content)
        if delivered is None or delivered.open is None:
            return
        if self._bytes + size > MAX_BYTES:  # more than the size in its first message
            self._refuse(client, delivered)
            return
        delivered.open.write(message.content)
        delivered.count += size
        self._bytes += size
        delivered.uploaded.content = content("upload", str(delivered.count))

    def _refuse(self, client: int, delivered: Delivered) -> None:
        self.forget(client)
        self._complaint, delivered.uploaded.content = NO_ROOM, content("upload", "refused")
        self._wake()

    def open(self, client: viser.ClientHandle, value: str) -> None:
        """Open the files of a browser; `value`: kind and temperature, degrees Celsius, such as "auto 20"."""
        delivered = self._delivered.get(client.client_id)
        if delivered is None:
            return
        self.forget(client.client_id)
        kind, _, celsius = value.partition(" ")
        require_choice("kind", kind, KINDS)
        self._complaint = ""
        self.worker.request(delivered.files, kind, number_in(celsius))

    def html(self) -> str:
        """Return the form, with the report on the file that was opened last, or why it could not be opened."""
        latest = self.worker.latest
        report = f"<pre>{escape(latest.result or '')}</pre>" if latest is not None else ""
        report += html.complaint(self._complaint or (html.error_message(latest.error) if latest is not None else ""))
        report = "<p>Reading ...</p>" if self.worker.busy else report
        report = re.sub(rf"{re.escape(self._folder.name)}/\w+/\w+/", "", report)  # names as the user knows them
        parts = {"LIMIT": str(MAX_BYTES), "MEGABYTES": str(MAX_BYTES // 1_000_000), "REPORT": report}
        return filled(FORM.read_text(encoding="utf-8"), parts)

    def _open(self, files: list[tuple[str, Path]], kind: Any, temperature: float) -> str:
        """On the thread: show files as a session, and return the report of their import."""
        from ..recordings.importer import import_recording, import_summary

        paths, lists = ([path for role, path in files if role == wanted] for wanted in (RECORDING, LIST))
        if not paths:
            raise InputError("no recording was chosen", "choose a file")
        first, report, left_out = paths[0], "", ()
        if first.suffix.lower() == ".zip":
            self._show(session_file.read(str(first)))
            return f"{first.name} is shown."
        if first.suffix.lower() == ".npz" and not sources.is_recording(str(first)):
            inputs, report = sources.load_input([str(path) for path in paths]), f"{first.name} is shown."
        else:
            options = ImportOptions(leave_out="bad", kind=kind, temperature=temperature)
            measurement, found = import_recording(paths, options)
            inputs, left_out = sources.measurement_input(measurement, first.stem), tuple(found.left_out)
            report = import_summary(measurement, found, html.CONTROLS)
        if lists:
            inputs = sources.compared_with_file(inputs, str(lists[0]), left_out)
        self._show(sources.measurement_request(inputs))
        return report
