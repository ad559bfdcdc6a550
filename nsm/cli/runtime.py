"""What a long-running process asks of the machine."""

from __future__ import annotations

import ctypes
import os
import sys

# glibc's malloc.h
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


#: Times that a thread looks for work before it sleeps: about as long as waking it would take. GNU OpenMP's own number,
#: 300 000, holds a core for milliseconds.
_LOOKS = 3000


def share_cores() -> None:
    """Let threads that wait for each other give their core away soon, where GNU OpenMP runs them (torch on Linux).

    Every operation of a training step ends with threads waiting for the last of them. By default they do so at full
    load; where the machine has other work, they then take the time that the last one needs, and a step slows down
    several fold (``tools/bench_shared.py``). OpenMP reads this when torch is imported, so it must be called before.
    ``OMP_WAIT_POLICY`` and ``GOMP_SPINCOUNT`` of the environment win.
    """
    if not {"OMP_WAIT_POLICY", "GOMP_SPINCOUNT"} & os.environ.keys():
        os.environ["GOMP_SPINCOUNT"] = str(_LOOKS)


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
