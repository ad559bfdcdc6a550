"""Trackers: loggers that take pictures, curves, surfaces, and checkpoints besides numbers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.loggers import Logger

from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import Frame

#: Prefixes of the figures of a validation, and of those of the checkpoint that a run ends with.
_VALIDATION, _BEST = "val/", "best/"


class Tracker(ABC):
    """A logger of an experiment tracker.

    Steps count from 0, as in the rows of a log: what belongs to the state after n steps has the step n − 1.
    """

    @abstractmethod
    def begin(self, config: Mapping[str, Any], group: str | None) -> None:
        """Open the run, or continue it; Lightning's trainer requires that it is open.

        Args:
            config: Resolved configuration of the run.
            group: Name of the group of runs that this one belongs to; None for a single run.

        Raises:
            InputError: If the run cannot be opened.
        """

    @abstractmethod
    def rewind(self, step: int) -> None:
        """Forget what was logged at this step and later ones, where possible, because training repeats them."""

    @abstractmethod
    def picture(self, name: str, file: Path, step: int) -> None:
        """Log a PNG file."""

    @abstractmethod
    def curve(self, name: str, curve: VolumeCurve, step: int) -> None:
        """Log a volume curve as a table of time, volume, and deviation, V / V(0) − 1."""

    @abstractmethod
    def surface(self, name: str, frame: Frame, step: int) -> None:
        """Log a surface in 3D."""

    @abstractmethod
    def outcome(self, figures: Mapping[str, float], checkpoint: Path, step: int) -> None:
        """Log the figures of the checkpoint that the run ends with, and the checkpoint itself where possible.

        Args:
            figures: Figures by name.
            checkpoint: File of the checkpoint; it may be missing.
            step: Last step of the run.
        """

    @abstractmethod
    def close(self, status: int) -> None:
        """End the run with an exit status, 0 for success."""


class Trackers:
    """The trackers among the loggers of a run, at one step.

    Args:
        loggers: Loggers of the run.
        step: Step to log at.
    """

    def __init__(self, loggers: Iterable[Logger], step: int) -> None:
        self._trackers = [logger for logger in loggers if isinstance(logger, Tracker)]
        self.step = step

    @classmethod
    def of(cls, trainer: L.Trainer) -> Trackers:
        """The trackers of a trainer at its last step; none on all processes but the first."""
        return cls(trainer.loggers if trainer.is_global_zero else (), max(trainer.global_step - 1, 0))

    def __iter__(self) -> Iterator[Tracker]:
        return iter(self._trackers)

    def __bool__(self) -> bool:
        return bool(self._trackers)

    def picture(self, name: str, file: Path) -> None:
        """Log a PNG file with every tracker."""
        for tracker in self:
            tracker.picture(name, file, self.step)

    def curve(self, name: str, curve: VolumeCurve) -> None:
        """Log a volume curve with every tracker."""
        for tracker in self:
            tracker.curve(name, curve, self.step)

    def surface(self, name: str, frame: Frame) -> None:
        """Log a surface in 3D with every tracker."""
        for tracker in self:
            tracker.surface(name, frame, self.step)

    def outcome(self, figures: Mapping[str, float], checkpoint: Path) -> None:
        """Log the figures and the checkpoint that the run ends with; ``val/error`` becomes ``best/error``."""
        named = {_BEST + name.removeprefix(_VALIDATION): value for name, value in figures.items()}
        for tracker in self:
            tracker.outcome(named, checkpoint, self.step)


class Rewind(L.Callback):
    """Rewinds the trackers of a run to the step at which training begins, resumes, or steps back."""

    def on_train_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        """Rewind to the current step."""
        for tracker in Trackers.of(trainer):
            tracker.rewind(trainer.global_step)


def opened(loggers: Iterable[Logger], config: Mapping[str, Any], group: str | None) -> list[Logger]:
    """Open the run in the trackers among some loggers, and return all of these.

    Args:
        loggers: Loggers of the run.
        config: Resolved configuration of the run.
        group: Name of the group of runs; None for a single run.
    """
    found = list(loggers)
    for tracker in Trackers(found, step=0):
        tracker.begin(config, group)
    return found


@contextmanager
def closing(loggers: Iterable[Logger]) -> Iterator[None]:
    """End the run in every tracker when the block ends, with the status that the process will exit with."""
    status = 1
    try:
        yield
        status = 0
    except SystemExit as end:
        status = int(end.code or 0)
        raise
    finally:
        for tracker in Trackers(loggers, step=0):
            tracker.close(status)
