"""``python -m nsm.compare.child MODULE ARGUMENTS``: a command that does not outlive the process that started it.

Its standard input is a pipe that the other process holds open and never writes to. When it closes, the other process is
gone, and this one leaves at once: two would write into one folder if the study was begun again.
"""

from __future__ import annotations

import os
import runpy
import sys
import threading


def _leave_when_closed() -> None:
    # not by sys.stdin, whose lock this thread would hold while the interpreter ends
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_leave_when_closed, daemon=True).start()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
