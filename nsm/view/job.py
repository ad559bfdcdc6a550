"""Commands of nsm that the page runs in processes of their own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: Beginning of the sentence with which a command refuses.
_REFUSAL = "nsm: "
#: Seconds that a process may take to end after it was asked to, before it is killed.
_PATIENCE = 30.0


class Job:
    """A command of nsm in another process, which a failure or a signal ends without the page.

    Args:
        command: Name of the command, such as ``train``.
        overrides: Its settings.
        log: File for what it prints.
    """

    def __init__(self, command: str, overrides: Sequence[str], log: Path) -> None:
        self.command, self.log = command, log
        log.parent.mkdir(parents=True, exist_ok=True)
        with log.open("wb") as output:
            # in a session of its own: Ctrl-C in the terminal reaches the page alone, which then stops the job
            self._process = subprocess.Popen(
                [sys.executable, "-m", f"nsm.{command}", *overrides],
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        self.stopped = False

    @property
    def running(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def wait(self, seconds: float) -> bool:
        """Wait for the process, but not longer than some seconds; returns whether it has ended."""
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def stop(self) -> None:
        """Ask the process to end; training then keeps its last step."""
        if self.running:
            self.stopped = True
            self._process.terminate()

    def close(self) -> None:
        """End the process, and wait until it has."""
        self.stop()
        if not self.wait(_PATIENCE):
            self._process.kill()
            self._process.wait()

    def error(self) -> str | None:
        """The sentence of a process that failed; None if it succeeded."""
        code = self._process.wait()
        if code == 0:
            return None
        lines = self.log.read_text(errors="replace").splitlines()
        sentences = [line.removeprefix(_REFUSAL) for line in lines if line.startswith(_REFUSAL)]
        if sentences:
            return sentences[-1]
        last = next((line.strip() for line in reversed(lines) if line.strip()), "no output")
        return f"`nsm {self.command}` must end with status 0, got {code} ({last}). Try to read {self.log}."

    def last_line(self) -> str:
        """The last line that the process has printed so far."""
        lines = self.log.read_text(errors="replace").splitlines()
        return next((line.strip() for line in reversed(lines) if line.strip()), "")
