"""Takes that are recorded beside the page, what they say together, and files of its folder that it opens.

The files are those of the folder in which fdcal was started, and a take is written there under the first free name: a
page reads and writes nowhere else. A browser uploads nothing: its parts of 512 kB are larger than any message that the
server accepts, and viser holds a whole upload in memory.
"""

import os
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ...model.validation import InputError
from ...session.sources import OpenRequest, measurement_request
from ..gui.html import CONTROLS
from .threads import Threads

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

        modified, before = self._folder.stat().st_mtime_ns, self._modified
        self._modified = modified, *before[:1]
        if before == (modified, modified):  # listed twice since: no file of the same tick of the clock is missing
            return self._listed
        kinds, found = (tuple(formats.suffixes("read")), LISTS), ([], [])
        for name in sorted(os.listdir(self._folder)):
            for kind, names in zip(kinds, found, strict=True):
                if name.lower().endswith(kind) and len(names) < MAX_FILES and self._is_offered(name):
                    names.append(name)
        self._listed = Folder(*map(tuple, found))
        return self._listed

    def _is_offered(self, name: str) -> bool:
        plain = len(name) <= MAX_NAME and name.isprintable() and not name.startswith(".")
        return plain and (self._folder / name).is_file()

    def _find_card(self, _look: int) -> Card:
        from ...recordings.take import sound_card

        try:
            stream = sound_card()
        except InputError as error:
            return Card(missing=error.worded(CONTROLS))
        return Card(f"{stream.name}, {len(stream.names)} inputs, {stream.sample_rate:g} Hz")

    def _day(self, given: Given) -> "Day":
        from ...recordings.import_options import ImportOptions
        from ...session.takes import Day

        options = ImportOptions(leave_out="bad", files="takes", temperature=given.temperature)
        return Day(str(self._folder / given.positions) if given.positions else None, options, CONTROLS)

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
