"""The process that serves the page: the log of errors, and its memory.

Errors on viser's event loop are written only to the log file. The terminal may be a pipe that nobody reads, and an
event loop that waits for a reader serves no page.

Memory: 60 changes of the scene increase the memory by 363 MB, but only by 7 MB with `share_one_heap` and
`release_memory` (`python -m benchmarks switches`). glibc gives every thread its own heap and returns little of it to
the system; a page has some twenty threads, each of which uses large arrays for a short time. viser keeps the removal of
every control in its buffer until another browser connects. A session that was replaced is a cycle of references through
the callbacks of its controls, with few objects and large arrays, which Python's collector finds late.
"""

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
MAX_RECORD = 20_000  # largest number of characters of one record in the file
ROOT = "fdcal"  # root of this project's loggers
OTHERS = ("asyncio", "websockets", "py.warnings")  # loggers that would otherwise print to the terminal


def printable(text: str, limit: int = 200) -> str:
    """Return a text from outside, cut to `limit` characters and without control characters."""
    cut = text if len(text) <= limit else f"{text[:limit]}..."
    return "".join(x if x.isprintable() else x.encode("unicode_escape").decode("ascii") for x in cut)


class _OneLine(logging.Formatter):
    """Formats a message without its traceback, which is in the file."""

    def format(self, record) -> str:
        return f"{record.getMessage()} (details in {log_location()})" if record.exc_info else record.getMessage()


class _Lines(logging.Formatter):
    """Formats date, level, name and message with its traceback, up to MAX_RECORD characters."""

    def format(self, record) -> str:
        return "\n".join(printable(line, MAX_RECORD) for line in super().format(record)[:MAX_RECORD].split("\n"))


def _off_the_event_loop(record: logging.LogRecord) -> bool:
    """Return whether a record may go to the terminal, for which an event loop of viser must never wait."""
    if record.threadName == "MainThread":  # on which viser has no event loop, but a notebook has one
        return True
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return True
    return False


@contextlib.contextmanager
def error_log() -> Iterator[None]:
    """Log warnings and errors in the block; only on the terminal if the file cannot be written."""
    terminal, lines = logging.StreamHandler(), _Lines("%(asctime)s %(levelname)s %(name)s: %(message)s")
    terminal.addFilter(_off_the_event_loop)
    handlers: list[logging.Handler] = [terminal]
    with contextlib.suppress(OSError):
        cache_folder().mkdir(parents=True, exist_ok=True)
        file = logging.handlers.RotatingFileHandler(
            cache_folder() / LOG_NAME, maxBytes=MAX_LOG_BYTES, backupCount=1, encoding="utf-8", delay=True
        )
        file.setFormatter(lines)
        handlers.append(file)
    terminal.setFormatter(_OneLine() if len(handlers) > 1 else lines)  # without a file the terminal has the details
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
    """Return the path of the log file, or "the terminal"."""
    for handler in logging.getLogger(ROOT).handlers:
        if isinstance(handler, logging.handlers.RotatingFileHandler):
            return handler.baseFilename
    return "the terminal"


M_ARENA_MAX = -8  # parameter of mallopt, in glibc's malloc.h


def share_one_heap() -> None:
    """Make all threads of this process share one heap from now on, if malloc is glibc's."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


def release_memory(server: viser.ViserServer) -> None:
    """Release the memory of a session that was replaced, in about 0.1 s.

    This memory is held by viser's messages about removed controls, the objects of the session, and pages of the heap.
    viser's collector is private; therefore viser's version is bounded.
    """
    server._run_garbage_collector()
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # another libc
        ctypes.CDLL(None).malloc_trim(0)
