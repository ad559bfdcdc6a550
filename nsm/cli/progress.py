"""Progress of long work: a live bar on a terminal, plain lines anywhere else."""

from __future__ import annotations

import threading
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as RichProgress

#: Seconds between two lines where stderr is not a terminal.
LINE_INTERVAL = 30.0
#: Seconds of recent work from which the time left is estimated; validations and checkpoints are part of it.
_ESTIMATE_PERIOD = 300.0


class Progress:
    """Shows on stderr how far some work is, as long as the context is open.

    On a terminal, each stage is a live bar. Otherwise each stage prints a plain line every half minute and one when it
    ends, also while a single call blocks, so that logs of remote jobs show that the work goes on.

    Example:
        >>> with Progress("extracting", total=3, unit="frames") as progress:
        ...     for _ in range(3):
        ...         progress.advance()

    Args:
        description: Name of the first stage; empty to begin one later with `stage`.
        total: Amount of work in it; None while unknown.
        completed: Amount done already, for work that resumes.
        unit: Plural noun for the amounts, such as ``steps``.
    """

    def __init__(self, description: str = "", total: float | None = None, completed: float = 0, unit: str = "") -> None:
        self.unit = unit
        self._console = Console(stderr=True, soft_wrap=True)
        columns = (
            SpinnerColumn(finished_text="✓"),
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.fields[amount]}"),
            TextColumn("{task.fields[detail]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        self._bars = RichProgress(*columns, console=Console(stderr=True), speed_estimate_period=_ESTIMATE_PERIOD)
        self._task: Task | None = None
        self._closing = threading.Event()
        self._clock = threading.Thread(target=self._print_lines, daemon=True)
        if description:
            self.stage(description, total, completed)

    def __enter__(self) -> Progress:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            self.finish()
        else:
            self.close()

    def open(self) -> None:
        """Begin to show; prefer the context."""
        if self._console.is_terminal:
            self._bars.start()
        else:
            self._clock.start()

    def finish(self) -> None:
        """Show the last stage as done, and end; prefer the context."""
        self._finish_stage()
        self.close()

    def close(self) -> None:
        """End without a last line, as after an error."""
        self._task = None
        self._closing.set()
        if self._console.is_terminal:
            self._bars.stop()
        if self._clock.is_alive():
            self._clock.join()

    def stage(self, description: str, total: float | None = None, completed: float = 0) -> None:
        """Finish the current stage and begin another.

        Args:
            description: Name of the stage.
            total: Amount of work in it; None while unknown.
            completed: Amount done already.
        """
        self._finish_stage()
        self._bars.add_task(escape(description), total=total, amount="", detail="")
        self._task = self._bars.tasks[-1]
        self.update(completed=completed)

    def update(
        self,
        completed: float | None = None,
        total: float | None = None,
        description: str | None = None,
        detail: str | None = None,
    ) -> None:
        """Change what is shown of the current stage; None leaves a value as it is.

        Args:
            completed: Amount of work done.
            total: Amount of work in the stage.
            description: Name of the stage.
            detail: Text behind the amount, such as figures of the work so far.
        """
        task = self._task
        if task is None:
            return
        texts = {"description": description, "detail": detail}
        fields = {name: escape(text) for name, text in texts.items() if text is not None}
        self._bars.update(task.id, completed=completed, total=total, **fields)  # type: ignore[arg-type]
        self._bars.update(task.id, amount=self._amount(task))

    def advance(self, amount: float = 1) -> None:
        """Add to the work done in the current stage."""
        if self._task is not None:
            self.update(completed=self._task.completed + amount)

    def _amount(self, task: Task) -> str:
        if task.total is None:
            return ""
        return f"{int(task.completed)} of {int(task.total)} {self.unit}".rstrip()

    def _finish_stage(self) -> None:
        task, self._task = self._task, None
        if task is None:
            return
        if task.total is None:
            self._bars.update(task.id, total=task.completed)
        self._bars.stop_task(task.id)
        if self._clock.is_alive():
            self._print_line(task)

    def _print_lines(self) -> None:
        while not self._closing.wait(LINE_INTERVAL):
            task = self._task
            if task is not None:
                self._print_line(task)

    def _print_line(self, task: Task) -> None:
        left = None if task.stop_time is not None else task.time_remaining
        times = f"{duration(task.elapsed or 0.0)} elapsed" + (f", {duration(left)} left" if left else "")
        parts = [part for part in (task.fields["amount"], times, task.fields["detail"]) if part]
        self._console.print(f"{task.description}: {', '.join(parts)}", highlight=False)


def duration(seconds: float) -> str:
    """A length of time in words.

    >>> duration(42.3), duration(200), duration(7500)
    ('42 s', '3 min 20 s', '2 h 5 min')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
