"""Settings of threads and memory for long-running processes."""

from __future__ import annotations

import ctypes
import os
import sys

# glibc's malloc.h
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


#: Number of times that a thread polls for work before it sleeps, which takes about as long as waking it. The default of
#: GNU OpenMP, 300 000, occupies a core for milliseconds.
_POLLS = 3000


def share_cores() -> None:
    """Let waiting threads of GNU OpenMP, which torch uses on Linux, yield their core early.

    Every operation of a training step ends with threads that wait for the last of them. By default they wait at full
    load; on a machine with other work they then take time from the last thread, and a step slows down several fold
    (``tools/bench_shared.py``). OpenMP reads the setting when torch is imported, so call this function before. The
    environment variables ``OMP_WAIT_POLICY`` and ``GOMP_SPINCOUNT`` take precedence.
    """
    if not {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT"} & os.environ.keys():
        os.environ["GOMP_SPINCOUNT"] = str(_POLLS)


def keep_freed_memory() -> None:
    """Ask glibc to keep freed memory for the next step instead of returning it to the system.

    A training step on a CPU allocates and frees the same large arrays every time. Without this setting, each of their
    pages causes a fault, and together the faults take more than a third of the step. With another C library, this does
    nothing.
    """
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 1 << 25)  # the maximum
        mallopt(_M_TRIM_THRESHOLD, (1 << 31) - 1)
