"""What a long-running process asks of the machine."""

from __future__ import annotations

import ctypes
import sys

# glibc's malloc.h
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


def keep_freed_memory() -> None:
    """Ask the C library to keep freed memory for the next step, in place of handing it back to the system.

    A training step on a CPU allocates and frees the same large arrays every time; fetched afresh, each of their pages
    costs a fault, and together these cost more than a third of the step. Where the C library is not glibc, nothing
    happens.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 1 << 25)  # the most that it takes
        mallopt(_M_TRIM_THRESHOLD, (1 << 31) - 1)
