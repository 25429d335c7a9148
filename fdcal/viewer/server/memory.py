"""The memory of a page that is served for days.

glibc gives every thread a heap of its own and returns little of it to the system. A page has some twenty threads, each
of which has large arrays for a moment, so the process would keep many times what it uses. viser keeps the removal of
every control in its buffer until another browser connects. A session that was replaced is a cycle of references, by the
callbacks of its controls: few objects and large arrays, which Python's collector finds late.
"""

from __future__ import annotations

import ctypes
import gc
import logging

import viser

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
