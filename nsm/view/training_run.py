"""A training that the page has started: its settings, and how far it is."""

from __future__ import annotations

import csv
import shutil
import time
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from omegaconf import OmegaConf

from nsm.cli.overrides import literal, shape_overrides
from nsm.view.job import Job

#: Settings of each budget on the page, by dimension.
BUDGETS = {
    2: {"fast": ["budget=plane", "network=small"], "full": ["budget=full", "network=small"]},
    3: {"fast": ["budget=fast"], "full": ["budget=full"]},
}
#: So many steps pass from one row of the log to the next, and validations make so many pictures of the morph.
_LIVE = ("trainer.log_every_n_steps=10", "+logger.csv.flush_logs_every_n_steps=1", "validations=10")
#: Number of the latest rows of the log from which the time left is estimated.
_RECENT = 30


class Choices(NamedTuple):
    """What to train.

    Attributes:
        source, target: Files of the shapes.
        dim: Dimension of the shapes.
        budget: Name of a budget, a key of `BUDGETS`.
        align: How the target is moved to the source, a file in ``conf/align``.
        landmarks: Landmarks as CSV, or None.
    """

    source: Path
    target: Path
    dim: int
    budget: str
    align: str
    landmarks: str | None


class TrainingProgress(NamedTuple):
    """How far a training is.

    Attributes:
        step: Number of steps made.
        steps: Number of steps in all.
        loss: Loss at that step.
        figures: Figures of the last validation, by the names of the log.
        left: Seconds left, None while unknown.
    """

    step: int
    steps: int
    loss: float
    figures: dict[str, float]
    left: float | None


class TrainingRun:
    """A training in another process, in a folder that keeps all that belongs to it.

    Args:
        folder: Folder of the run, a new one.
        choices: What to train.
        overrides: Further settings of ``nsm train``.
    """

    def __init__(self, folder: Path, choices: Choices, overrides: Sequence[str]) -> None:
        self.folder = folder = folder.resolve()
        files = []
        for side, path in (("source", choices.source), ("target", choices.target)):
            kept = folder / "shapes" / side / path.name
            kept.parent.mkdir(parents=True)
            shutil.copyfile(path, kept)
            files += shape_overrides(side, str(kept))
        landmarks = []
        if choices.landmarks is not None:
            table = folder / "landmarks.csv"
            table.write_text(choices.landmarks)
            landmarks = ["landmarks=table", f"landmarks.path={literal(str(table))}"]
        settings = [*BUDGETS[choices.dim][choices.budget], f"align={choices.align}", *landmarks, *_LIVE]
        place = f"hydra.run.dir={literal(str(folder))}"
        self.job = Job("train", [*files, *settings, place, *overrides], folder / "output.log")
        self._seen: deque[tuple[float, int]] = deque(maxlen=_RECENT)

    def progress(self) -> TrainingProgress | None:
        """Read how far training is; None before its first step is logged."""
        progress = read_progress(self.folder)
        if progress is None:
            return None
        if not self._seen or self._seen[-1][1] != progress.step:
            self._seen.append((time.monotonic(), progress.step))
        (begin, first), (end, last) = self._seen[0], self._seen[-1]
        if last <= first:
            return progress
        return progress._replace(left=(progress.steps - last) * (end - begin) / (last - first))

    def latest(self) -> Path | None:
        """The checkpoint of the latest validation, if there has been one."""
        file = self.folder / "checkpoints" / "last.ckpt"
        return file if file.is_file() else None


def read_progress(folder: Path) -> TrainingProgress | None:
    """Read how far the training in a folder is from its configuration and its log; None before its first row."""
    config, log = folder / ".hydra" / "config.yaml", folder / "log" / "metrics.csv"
    if not config.is_file() or not log.is_file():
        return None
    complete = log.read_text().rpartition("\n")[0]  # the last row may be half written
    rows = [row for row in csv.DictReader(complete.splitlines()) if None not in row.values()]
    trained = [row for row in rows if row.get("train/loss")]
    if not trained:
        return None
    validated: dict[str, str] = next((row for row in reversed(rows) if row.get("val/error")), {})
    figures = {name: float(value) for name, value in validated.items() if name.startswith("val/") and value}
    last = trained[-1]
    steps = int(OmegaConf.select(OmegaConf.load(config), "steps"))
    return TrainingProgress(int(last["step"]) + 1, steps, float(last["train/loss"]), figures, None)
