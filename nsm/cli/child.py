"""``python -m nsm.cli.child MODULE ARGUMENTS``: a command that does not outlive the process that started it.

Standard input is a pipe that the parent holds open and never writes to. When it closes, the parent is gone and the
child exits at once, so that no two processes write into one folder if the parent is started again.
"""

from __future__ import annotations

import os
import runpy
import sys
import threading

#: Name of this module, which follows ``python -m``.
MODULE = "nsm.cli.child"


def _leave_when_closed() -> None:
    # sys.stdin has a lock that this thread would still hold while the interpreter exits
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_leave_when_closed, daemon=True).start()
    sys.argv = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
