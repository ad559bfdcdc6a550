"""One line that tells how far a study is, whoever carries out its runs."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from nsm.compare.plan import Job
from nsm.compare.record import DONE, FAILED, INTERRUPTED, MEASURING, TRAINING, read_record

#: Seconds between two looks at the folders of the runs.
_INTERVAL = 1.0
#: Bytes at the end of a log that hold its last row.
_TAIL = 4096


class StudyProgress:
    """Shows how many of some runs are over and where the others are, as read from their folders.

    A context: the line is there while it is open.
    """

    def __init__(self, jobs: Sequence[Job]) -> None:
        self.jobs = jobs
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[over]} of {task.total:.0f} runs"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        self._bar = Progress(*columns, console=Console(stderr=True))
        self._task = self._bar.add_task("", total=len(jobs), over=0)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> StudyProgress:
        self._bar.start()
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing.set()
        self._thread.join()
        self._bar.stop()

    def _watch(self) -> None:
        closing = False
        while not closing:
            closing = self._closing.wait(_INTERVAL)
            self._look()

    def _look(self) -> None:
        over, parts, active = 0, 0.0, []
        for job in self.jobs:
            record = read_record(job.folder)
            if record is None:
                continue
            if record.state in (DONE, FAILED, INTERRUPTED):
                over += 1
            elif record.state == MEASURING:
                active.append(f"{job.name}: time of a step")
            elif record.state == TRAINING:
                step = _last_step(job.folder / "log" / "metrics.csv")
                active.append(f"{job.name}: step {step} of {record.steps}" if record.steps else job.name)
                parts += step / record.steps if record.steps else 0.0
        description = ", ".join(active[:3]) + (f" and {len(active) - 3} more" if len(active) > 3 else "")
        self._bar.update(self._task, completed=over + parts, over=over, description=description.replace("[", r"\["))


def _last_step(log: Path) -> int:
    """The step of the last row of a ``metrics.csv``; 0 while there is none."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - _TAIL))
            rows = file.read().decode(errors="replace").splitlines()
    except OSError:
        return 0
    cells = rows[-1].split(",") if len(rows) > 1 else []
    return int(cells[1]) + 1 if len(cells) > 1 and cells[1].isdigit() else 0
