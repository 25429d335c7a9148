"""The tab Record: takes from a sound card or a file, their channels while they last, and what they say together.

It belongs to the page, not to a session: a take goes on while another scene is opened. It is there only on a page that
this machine alone can reach, since it reads and writes files here, and listens.

The files are those of the folder in which fdcal was started, and a take is written there under the first free name: a
page reads and writes nowhere else. A browser uploads nothing: its parts of 512 kB are larger than any message that the
server accepts, and viser holds a whole upload in memory.
"""

import collections
import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import viser

from ...model.validation import InputError
from ...session.sources import OpenRequest, measurement_request
from ...session.worker import Delivery
from ..background.prepare import Same, Threads
from ..gui import html
from ..gui.binding import Due, bind

if TYPE_CHECKING:
    from ...recordings.take import Moment, Take
    from ...session.takes import Day, TakesResult

LISTED = 2.0  # s between two looks at the folder
MAX_FILES = 200  # of each kind that are listed
MAX_NAME = 200  # characters of a file's name that is listed
LISTS = (".csv", ".xml")


@dataclass(frozen=True)
class Given:
    """What is given beside the sound."""

    positions: str = ""  # name of a list of the positions, "" for none
    temperature: float | None = None  # degrees Celsius


@dataclass(frozen=True)
class Job:
    """A take to record."""

    number: int  # counts the takes
    source: str  # name of the file that is replayed, "" for the sound card
    channels: int | None  # how many, the first ones; all for None
    seconds: float
    given: Given


@dataclass(frozen=True)
class Folder:
    """What there is to record and to open."""

    recordings: tuple[str, ...] = ()  # names of files
    lists: tuple[str, ...] = ()  # of positions


@dataclass(frozen=True)
class Card:
    """The sound card, as of the last look."""

    name: str = ""  # in words, "" without one
    missing: str = ""  # why there is none, and what to do


@dataclass(frozen=True)
class Progress:
    """A take while it is recorded, and afterwards."""

    names: tuple[str, ...] = ()  # of the channels
    moment: "Moment | None" = None
    said: str = ""  # what the check of its first seconds found


class Recorder:
    """Owns the threads, and what they have recorded.

    `folder`: of the files; `pace`: waits for the length of a block that is replayed, s; `show`: shows a session.
    """

    def __init__(
        self,
        threads: Threads,
        folder: Path,
        show: Callable[[OpenRequest], None],
        pace: Callable[[float], object] = time.sleep,
    ):
        self._folder, self._show, self._pace = folder, show, pace
        self._looks, self._listed, self._modified = 0, Folder(), tuple[int, ...]()
        self.progress, self.takes = Progress(), tuple["Take", ...]()
        self.recording = threads.start(self._record, "fdcal-record")
        self._results = threads.start(self._calibrate, "fdcal-takes", awaited=False)
        self._files = threads.start(self._list, "fdcal-files", awaited=False)
        self._cards = threads.start(self._find_card, "fdcal-cards", awaited=False)
        self.opening = threads.start(self._open, "fdcal-open", awaited=False)

    @property
    def running(self) -> bool:
        """Whether a take is being recorded."""
        return self.recording.busy

    def files(self, now: float) -> Folder | None:
        """Return what the folder holds, at the time `now`, s; None before it was looked at."""
        latest = self._files.newest(int(now / LISTED))
        return None if latest is None else latest.result

    @property
    def card(self) -> Card | None:
        """The sound card; None before it was looked for."""
        latest = self._cards.newest(self._looks)
        return None if latest is None else latest.result

    @property
    def looking(self) -> bool:
        """Whether it is looking for a sound card, which ends every stream of one."""
        return self._cards.busy

    def look_for_card(self) -> None:
        """Look for a sound card again, unless a take is being recorded."""
        if not self.running:
            self._looks += 1
            self._cards.newest(self._looks)

    def start(self, job: Job) -> None:
        """Record a take, unless one is being recorded."""
        if not (self.running or self.looking):
            self.progress = Progress()
            self.recording.newest(job)

    def stop(self) -> None:
        """End the take; what was recorded is kept."""
        self.recording.cancel()

    def leave_out_last(self) -> None:
        """Leave the last take out of the result; its file stays."""
        if not self.running:
            self.takes = self.takes[:-1]

    def result(self, given: Given) -> "tuple[TakesResult | None, Exception | None, bool]":
        """Return the newest result of the takes, why there is none, and whether another one is on its way."""
        if not self.takes:
            self._results.cancel()
            return None, None, False
        self._results.newest(tuple(take.path for take in self.takes), given)
        found = self._results.current
        return (None, None, True) if found is None else (found.result, found.cause, False)

    def open_takes(self) -> None:
        """Show the takes as a session, once there is their result."""
        found = self._results.current
        if found is not None and found.result is not None:
            self._show(measurement_request(found.result.inputs))

    # Below: the threads.

    def _list(self, _turn: int) -> Folder:
        from ...recordings import formats
        from ...session.sources import is_recording

        modified, before = self._folder.stat().st_mtime_ns, self._modified
        self._modified = modified, *before[:1]
        if before == (modified, modified):  # listed twice since: no file of the same tick of the clock is missing
            return self._listed
        kinds, found = (tuple(formats.suffixes("read")), LISTS), ([], [])
        for name in sorted(os.listdir(self._folder)):
            for kind, names in zip(kinds, found, strict=True):
                if name.lower().endswith(kind) and len(names) < MAX_FILES and self._is_offered(name):
                    # a .npz may also be a measurement, which cannot be replayed
                    if kind is LISTS or is_recording(str(self._folder / name)):
                        names.append(name)
        self._listed = Folder(*map(tuple, found))
        return self._listed

    def _is_offered(self, name: str) -> bool:
        plain = len(name) <= MAX_NAME and name.isprintable() and not name.startswith(".")
        return plain and (self._folder / name).is_file()

    def _find_card(self, _look: int) -> Card:
        from ...recordings.take import REPLAY, sound_card

        try:
            stream = sound_card()
        except InputError as error:
            remedy = error.remedy.removesuffix(REPLAY).rstrip(",; ")  # the tab has said that before
            return Card(missing=InputError(error.problem, remedy).worded(html.CONTROLS))
        return Card(f"{stream.name}, {len(stream.names)} inputs, {stream.sample_rate:g} Hz")

    def _day(self, given: Given) -> "Day":
        from ...recordings.import_options import ImportOptions
        from ...session.takes import Day

        options = ImportOptions(leave_out="bad", files="takes", temperature=given.temperature)
        return Day(str(self._folder / given.positions) if given.positions else None, options, html.CONTROLS)

    def _record(self, job: Job) -> "Take":
        from ...recordings.take import fits_wav, next_take, record_take, replayed, sound_card
        from ...session.takes import EarlyCheck

        day = self._day(job.given)
        if job.source:
            stream = replayed(self._folder / job.source, job.channels, self._pace)
        else:
            stream = sound_card(job.channels)
        suffix = ".wav" if fits_wav(stream, job.seconds) else ".w64"
        path = next_take(self._folder / f"take0{suffix}")
        with closing(EarlyCheck(day, stream)) as early:

            def watch(moment: "Moment") -> bool:
                said = early.add(moment) or self.progress.said
                self.progress = Progress(stream.names, moment, said)
                return self.recording.wants(job)

            take = record_take(stream, path, job.seconds, watch)
        self.takes = (*self.takes, take)
        return take

    def _calibrate(self, paths: tuple[Path, ...], given: Given) -> "TakesResult":
        from ...session.takes import takes_result

        return takes_result(paths, self._day(given))

    def _open(self, job: Job) -> str:
        """Show a file as a session, and return the report of its import."""
        from ...recordings.importer import import_recording, import_summary
        from ...session.sources import compared_with_file, measurement_input

        day = self._day(job.given)
        measurement, report = import_recording(self._folder / job.source, day.options)
        inputs = measurement_input(measurement, Path(job.source).stem, excluded=())
        if day.positions is not None:
            inputs = compared_with_file(inputs, day.positions, tuple(report.left_out))
        self._show(measurement_request(inputs))
        return import_summary(measurement, report, day.wording)


if TYPE_CHECKING:
    from ...recordings.take import Moment, Take
    from ...session.takes import TakesResult

CARD, NONE = "Sound card", "None"
NOTHING: list[str] = [NONE]  # to choose from
REMOTE = (
    "This page can be reached from other machines, so that it neither records here nor opens files. Start fdcal view"
    " for this machine alone, or use fdcal record."
)
OPEN = (
    'Choose a file of the folder {folder} in the list "Sound from": "Open file" shows it as a session, "Record" replays'
    " it. Nothing leaves this machine."
)
EMPTY = 'The folder {folder} has no recordings. Put one there: the list "Sound from" then offers it.'
LOWEST_DB = -60.0  # level at which a bar begins


class RecordTab:
    """Owns the controls of the tab; `recorder`: what they act on, None on a page that other machines can reach."""

    def __init__(self, gui: viser.GuiApi, recorder: Recorder | None, folder: str):
        self._recorder, self._folder, self._number = recorder, folder, 0
        self._offered: tuple[Folder, Card] | None = None
        self._due = collections.defaultdict[int, Due](Due)  # by the place of a text
        if recorder is None:
            gui.add_html(html.remark(REMOTE))
            return
        self.card = gui.add_html("")
        self.look = bind(
            gui.add_button("Look for a sound card", hint="After one has been connected"),
            lambda _: recorder.look_for_card(),
        )
        self.source = gui.add_dropdown("Sound from", NOTHING, hint="The sound card, or a file")
        self.channels = gui.add_number(
            "Channels", 0, min=0, max=1024, step=1, hint="The first ones; 0 takes all of them"
        )
        self.seconds = gui.add_number("Seconds", 30, min=2, max=600, step=1, hint="Length of a take")
        self.celsius = gui.add_number("Temperature (°C)", 20.0, min=-60.0, max=80.0, step=0.5, hint="Of the air")
        self.positions = gui.add_dropdown(
            "List", NOTHING, hint="Positions of the microphones, which show swapped channels"
        )
        self.record = bind(gui.add_button("Record", icon=viser.Icon.MICROPHONE), lambda _: self.press())
        self.levels = gui.add_html("")
        self.takes = gui.add_html("")
        self.last = bind(
            gui.add_button("Leave out last take", hint="Of the result; its file stays", visible=False),
            lambda _: recorder.leave_out_last(),
        )
        self.show_takes = bind(
            gui.add_button("Open takes", hint="Show them as a session: run, look, export", visible=False),
            lambda _: recorder.open_takes(),
        )
        self.open_file = bind(
            gui.add_button("Open file", hint="Import the file chosen above and show it as a session", visible=False),
            lambda _: recorder.opening.newest(self._job()),
        )
        self.report = gui.add_html("")

    @property
    def usable(self) -> bool:
        """Whether the page may record, and open files."""
        return self._recorder is not None

    def _job(self) -> Job:
        """Return what the controls ask for."""
        self._number += 1
        source, channels = self.source.value, int(self.channels.value) or None
        return Job(self._number, "" if source == CARD else source, channels, float(self.seconds.value), self._given())

    def _given(self) -> Given:
        positions = self.positions.value
        return Given("" if positions == NONE else positions, float(self.celsius.value))

    def press(self) -> None:
        """Record a take, or end it."""
        recorder = self._recorder
        if recorder is None:
            return
        if recorder.running:
            recorder.stop()
        elif self.source.value != NONE:
            recorder.start(self._job())

    def show(self, now: float) -> None:
        """Bring the tab up to date at the time `now`, s; called by the main loop."""
        recorder = self._recorder
        if recorder is None:
            return
        files, card = recorder.files(now), recorder.card
        if files is not None and card is not None and (files, card) != self._offered:
            self._offered = files, card
            self._offer(files, card)
        running, source = recorder.running, self.source.value
        self.look.disabled = running or recorder.looking
        self.record.label = "Stop" if running else "Record"
        self.record.icon = viser.Icon.PLAYER_STOP if running else viser.Icon.MICROPHONE
        self.record.disabled = (source == NONE or recorder.looking) and not running
        self.open_file.visible = source not in (CARD, NONE)
        self.last.visible = bool(recorder.takes) and not running
        progress, latest, opened = recorder.progress, recorder.recording.latest, recorder.opening.latest
        failed = latest.cause if latest is not None and not running else None
        self._put(self.levels, (running, progress, failed), lambda: _progress_html(progress, running, failed))
        result, error, busy = recorder.result(self._given())
        self.show_takes.visible = result is not None and not running
        state = recorder.takes, result, error, busy
        self._put(self.takes, state, lambda: _takes_html(*state))
        reading = recorder.opening.busy
        self._put(self.report, (opened, reading), lambda: _report_html(opened, reading))

    def _put(self, place: viser.GuiHtmlHandle, state: tuple, text: Callable[[], str]) -> None:
        """Put a text into its place where what it says has changed."""
        if self._due[id(place)](0.0, *map(Same, state)):
            place.content = text()

    def _offer(self, files: Folder, card: Card) -> None:
        """Offer the files of the folder, and the sound card where there is one."""
        sources = (*([CARD] if card.name else []), *files.recordings) or (NONE,)
        for control, options in ((self.source, sources), (self.positions, (NONE, *files.lists))):
            chosen = control.value
            control.options = options
            control.value = chosen if chosen in options else options[0]
        said = (OPEN if files.recordings else EMPTY).format(folder=self._folder)
        missing = f'{card.missing[:1].upper()}{card.missing[1:]}, then press "Look for a sound card".'
        about = f"Sound card: {card.name}." if card.name else missing
        self.card.content = html.remark(said) + html.remark(about)


def _progress_html(progress: Progress, running: bool, failed: Exception | None) -> str:
    if progress.moment is None or not running:
        return html.complaint(failed) if failed else ""
    said = html.remark(progress.said) if progress.said else ""
    return levels_html(progress.names, progress.moment) + said


def _takes_html(takes: "tuple[Take, ...]", result: "TakesResult | None", error: Exception | None, busy: bool) -> str:
    lines = [f"take {number}: {_short(take)}" for number, take in enumerate(takes, 1)]
    if error is not None:
        return _lines(lines) + html.complaint(error)
    waits = ["Calibrating ..."] if busy else []
    if result is None:
        return _lines([*lines, *waits])
    return _lines([*lines, *waits, *result.lines]) + _lines(result.table, TABLE)


def _report_html(opened: Delivery | None, reading: bool) -> str:
    if reading:
        return html.remark("Opening ...")
    if opened is None or opened.cause is not None:
        return html.complaint(opened.cause) if opened and opened.cause else ""
    return _lines(str(opened.result).splitlines())


def _short(take: "Take") -> str:
    """Return a take in words, its file by its name alone."""
    return take.text.replace(str(take.path), take.path.name, 1)


TEXT = "white-space: pre-wrap;"
TABLE = "white-space: pre; overflow-x: auto; font-family: monospace; font-size: 0.75em;"


def _lines(lines: list[str], style: str = TEXT) -> str:
    """Return lines as HTML, with columns as they are in a TABLE."""
    text = escape("\n".join(lines))
    return f"<div style='{html.CARD} {style}'>{text}</div>" if lines else ""


def levels_html(names: tuple[str, ...], moment: "Moment") -> str:
    """Return a bar for each channel, its level in decibels of full scale, and what is wrong with it."""
    health, rows = moment.health, []
    bad = set(health.bad.tolist())
    for n, (name, level) in enumerate(zip(names, moment.level_db, strict=True)):
        share = 100 * min(max(1 - level / LOWEST_DB, 0.0), 1.0)
        fault = f"<b style='color: {html.RED}'>{escape(health.fault(n, names))}</b>" if n in bad else ""
        bar = f"<div style='width: {share:.0f}%; height: 0.5em; background: currentColor; opacity: 0.6'></div>"
        rows.append(
            f"<tr><td>{escape(name)}</td><td style='width: 45%'>{bar}</td><td>{level:.0f} dB</td><td>{fault}</td></tr>"
        )
    head = f"<div>{moment.seconds:.0f} s</div>"
    return f"<div style='{html.CARD}'>{head}<table style='width: 100%'>{''.join(rows)}</table></div>"
