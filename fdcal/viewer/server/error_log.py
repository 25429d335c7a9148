"""The log of errors while a page is served: a file in the cache folder, and one line each on the terminal."""

from __future__ import annotations

import contextlib
import logging
import logging.handlers
from collections.abc import Iterator

from ...model.storage import cache_folder

LOG_NAME, MAX_LOG_BYTES = "view.log", 1_000_000  # one older file is kept
ROOT = "fdcal"  # root of this project's loggers


class _OneLine(logging.Formatter):
    """A message without its traceback, which is in the file."""

    def format(self, record) -> str:
        return f"{record.getMessage()} (details in {log_location()})" if record.exc_info else record.getMessage()


@contextlib.contextmanager
def error_log() -> Iterator[None]:
    """Log warnings and errors of fdcal meanwhile; on the terminal alone where the file cannot be written."""
    logger, terminal = logging.getLogger(ROOT), logging.StreamHandler()
    terminal.setFormatter(_OneLine())
    handlers: list[logging.Handler] = [terminal]
    with contextlib.suppress(OSError):
        cache_folder().mkdir(parents=True, exist_ok=True)
        file = logging.handlers.RotatingFileHandler(
            cache_folder() / LOG_NAME, maxBytes=MAX_LOG_BYTES, backupCount=1, encoding="utf-8", delay=True
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


def log_location() -> str:
    """Return where the log is, in words: the file's path, or the terminal."""
    for handler in logging.getLogger(ROOT).handlers:
        if isinstance(handler, logging.handlers.RotatingFileHandler):
            return handler.baseFilename
    return "the terminal's log"
