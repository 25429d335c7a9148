"""Where faults are written while a page is served: a file beside the cache, and one line each on the terminal."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
from collections.abc import Iterator

from ...model.storage import cache_folder

NAME, BYTES = "view.log", 1_000_000  # of the file; one older one is kept
ROOT = "fdcal"  # of this project's loggers


class _Line(logging.Formatter):
    """A message without its traceback, which the file has."""

    def format(self, record) -> str:
        return f"{record.getMessage()} (more in {place()})" if record.exc_info else record.getMessage()


@contextlib.contextmanager
def log_kept() -> Iterator[None]:
    """Keep a log while inside; without a file where none can be written."""
    logger, terminal = logging.getLogger(ROOT), logging.StreamHandler()
    terminal.setFormatter(_Line())
    handlers: list[logging.Handler] = [terminal]
    with contextlib.suppress(OSError):
        cache_folder().mkdir(parents=True, exist_ok=True)
        file = logging.handlers.RotatingFileHandler(
            cache_folder() / NAME, maxBytes=BYTES, backupCount=1, encoding="utf-8", delay=True
        )
        file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        handlers.append(file)
    for handler in handlers:
        handler.setLevel(logging.WARNING)
        logger.addHandler(handler)
    try:
        yield
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
            handler.close()


def place() -> str:
    """Where the log is, in words: the file's path, or the terminal."""
    for handler in logging.getLogger(ROOT).handlers:
        if isinstance(handler, logging.handlers.RotatingFileHandler):
            return handler.baseFilename
    return "the terminal's log"
