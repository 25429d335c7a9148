"""The process that serves the page: the log of errors, and its memory.

What happens on the event loop is written to the log file alone. The terminal may be a pipe that nobody reads, and an
event loop that waits for a reader serves no page.

Memory: 60 changes of the scene once grew the process by 363 MB, and grow it by 7 MB with `share_one_heap` and
`release_memory` (`python -m benchmarks switches`). glibc gives every thread a heap of its own and returns little of it
to the system; a page has some twenty threads, each of which has large arrays for a moment. viser keeps the removal of
every control in its buffer until another browser connects. A session that was replaced is a cycle of references, by the
callbacks of its controls: few objects and large arrays, which Python's collector finds late.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
import logging
import logging.handlers
from collections.abc import Iterator

import viser

from ...model.storage import cache_folder

LOG_NAME, MAX_LOG_BYTES = "view.log", 1_000_000  # one older file is kept
MAX_RECORD = 20_000  # characters of one record in the file
ROOT = "fdcal"  # root of this project's loggers
OTHERS = ("asyncio", "websockets", "py.warnings")  # loggers that would print to the terminal by themselves


def printable(text: str, limit: int = 200) -> str:
    """Return a text of a stranger, cut to `limit` characters and without control characters."""
    cut = text if len(text) <= limit else f"{text[:limit]}..."
    return "".join(x if x.isprintable() else x.encode("unicode_escape").decode("ascii") for x in cut)


class _OneLine(logging.Formatter):
    """A message without its traceback, which is in the file."""

    def format(self, record) -> str:
        return f"{record.getMessage()} (details in {log_location()})" if record.exc_info else record.getMessage()


class _Lines(logging.Formatter):
    """Date, level, name and message with its traceback, of bounded length."""

    def format(self, record) -> str:
        lines = super().format(record)[:MAX_RECORD].split("\n")
        return "\n".join(printable(line, MAX_RECORD) for line in lines)


def _off_the_event_loop(record: logging.LogRecord) -> bool:
    """Return whether the thread that logs runs no event loop of viser, which must never wait for the terminal."""
    if record.threadName == "MainThread":  # where viser has none, and a notebook has its own
        return True
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return True
    return False


@contextlib.contextmanager
def error_log() -> Iterator[None]:
    """Log warnings and errors meanwhile; on the terminal alone where the file cannot be written."""
    terminal = logging.StreamHandler()
    terminal.setFormatter(_OneLine())
    terminal.addFilter(_off_the_event_loop)
    handlers: list[logging.Handler] = [terminal]
    with contextlib.suppress(OSError):
        cache_folder().mkdir(parents=True, exist_ok=True)
        file = logging.handlers.RotatingFileHandler(
            cache_folder() / LOG_NAME, maxBytes=MAX_LOG_BYTES, backupCount=1, encoding="utf-8", delay=True
        )
        file.setFormatter(_Lines("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        handlers.append(file)
    loggers = [logging.getLogger(name) for name in (ROOT, *OTHERS)]
    for handler in handlers:
        handler.setLevel(logging.WARNING)
        for logger in loggers:
            logger.addHandler(handler)
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        for handler in handlers:
            for logger in loggers:
                logger.removeHandler(handler)
            handler.close()


def log_location() -> str:
    """Return where the log is, in words: the file's path, or the terminal."""
    for handler in logging.getLogger(ROOT).handlers:
        if isinstance(handler, logging.handlers.RotatingFileHandler):
            return handler.baseFilename
    return "the terminal's log"


log = logging.getLogger(__name__)

M_ARENA_MAX = -8  # of glibc's malloc.h


def share_one_heap() -> bool:
    """Let all threads of this process share one heap from now on; return False where malloc is not glibc's."""
    try:
        return ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1) == 1
    except (OSError, AttributeError):
        return False


def release_memory(server: viser.ViserServer) -> None:
    """Release what a session that was replaced has left; it takes about 0.1 s.

    That is viser's messages about controls that were removed, the objects of the session, and the pages of the heap.

    `server`: viser.ViserServer; its collector is private, which is why its version is pinned.
    """
    server._run_garbage_collector()
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (OSError, AttributeError):  # another libc
        log.debug("this libc has no malloc_trim")
