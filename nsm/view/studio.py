"""The studio: one page on which a user chooses two files, trains a morph between them, and sees it."""

from __future__ import annotations

import logging
import tempfile
import threading
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

import viser

from nsm.io.checkpoint import find_checkpoint
from nsm.io.loading import load_run
from nsm.view.result_page import ResultPage, Viewing
from nsm.view.setup import Setup
from nsm.view.training_page import TrainingPage
from nsm.view.training_run import Choices, TrainingRun

log = logging.getLogger(__name__)

_NOTHING = "Training must make a step before it keeps anything, got a stop before that. Try `Start training` again."


class Workplace(NamedTuple):
    """Where and how the studio trains.

    Attributes:
        runs: Folder of the runs.
        limit: Greatest size of a file that the browser sends, in bytes.
        overrides: Further settings of ``nsm train``.
    """

    runs: Path
    limit: int
    overrides: Sequence[str] = ()


class Studio:
    """Page with three parts that follow each other: two files, a training, and the morph.

    Args:
        server: Server of the page, which stays open when the studio is closed.
        viewing: How morphs are shown.
        workplace: Where and how they are trained.
    """

    def __init__(self, server: viser.ViserServer, viewing: Viewing, workplace: Workplace) -> None:
        self.server, self._viewing, self._workplace = server, viewing, workplace
        self._temporary = tempfile.TemporaryDirectory(prefix="nsm-view-")
        self._lock = threading.RLock()
        self.setup = Setup(server, Path(self._temporary.name), workplace.limit, self.start)
        self.training: TrainingPage | None = None
        self.result: ResultPage | None = None
        self.setup.show()

    def start(self, choices: Choices) -> None:
        """Train, unless a training or a morph is on the page already."""
        with self._lock:
            if self.training is not None or self.result is not None:
                return
            name = f"{stem(choices.source)}_{stem(choices.target)}"
            folder = self._workplace.runs / name / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
            run = TrainingRun(folder, choices, self._workplace.overrides)
            self.setup.leave()
            self.training = TrainingPage(self.server, run, self._show)
            log.info("training in %s", run.folder)

    def again(self, error: str = "") -> None:
        """Return to the two files, with the reason if something has failed."""
        with self._lock:
            if self.result is not None:
                self.result.close()
            self.training = self.result = None
            self.setup.show(error)

    def wait(self, timeout: float | None = None) -> bool:
        """Raise the failure of a background thread of the viewer, after a time in seconds at most.

        Raises:
            Exception: The exception that ended a background thread, if one failed.
        """
        result = self.result
        return result is not None and result.viewer.wait(timeout)

    def close(self) -> None:
        """End training, which keeps its last step, and remove the files that the browser has sent."""
        with self._lock:
            if self.training is not None:
                self.training.close()
            if self.result is not None:
                self.result.close()
            self.training = self.result = None
            self._temporary.cleanup()

    def _show(self) -> None:
        """Show the morph of the training that has ended, or why there is none."""
        with self._lock:
            if self.training is None:  # the studio has been closed meanwhile
                return
            run, self.training = self.training.run, None
            try:
                error = run.job.error()
                if error is not None and not run.job.stopped:
                    self.again(error)
                elif run.latest() is None:
                    self.again(_NOTHING)
                else:
                    done = "Training was stopped." if error else "Training has finished."
                    loaded = load_run(run.folder.parent.name, find_checkpoint(run.folder), "exact")
                    hint = f"{done} Its run is in {run.folder}."
                    self.result = ResultPage(self.server, loaded, self._viewing, self.again, hint)
            except Exception as failure:
                log.exception("the morph cannot be shown")
                self.again(f"The morph in `{run.folder}` must be readable, got {failure}. Try `nsm view checkpoint=…`.")


def stem(path: Path) -> str:
    """Name of a file before its first dot.

    >>> stem(Path("brain.nii.gz"))
    'brain'
    """
    return path.name.split(".")[0]
