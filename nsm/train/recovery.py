"""Recovery of training: resuming after a stop, and stepping back after a collapse."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L
from lightning.pytorch.utilities.rank_zero import rank_zero_only

from nsm.cli.errors import InputError
from nsm.io.checkpoint import ENTRY, Checkpoint, readable_checkpoint
from nsm.train.callbacks import MorphWriter, StepTimes
from nsm.train.summary import SUMMARY
from nsm.train.tasks import Collapse, FieldData, FieldTask

log = logging.getLogger(__name__)

#: Factor of the learning rate after a collapse.
SMALLER_STEP = 0.5


def fit_with_recovery(
    trainer: Callable[[], L.Trainer], task: FieldTask, data: FieldData, last: Path, begun: Path | None
) -> L.Trainer:
    """Train; after a first collapse, continue from the last good checkpoint with half the learning rate.

    Every checkpoint is good, because it is written only after a validation that found a surface and finite losses.

    Args:
        trainer: Factory of trainers.
        task: Networks and loss to train.
        data: Batches for training and validation.
        last: File of the last checkpoint.
        begun: Checkpoint to resume from; None to begin.

    Returns:
        The trainer that finished.

    Raises:
        InputError: If training collapses a second time.
    """
    start = copy.deepcopy(task.state_dict())
    stale = _written(last)
    try:
        return _fit(trainer(), task, data, begun)
    except Collapse as collapse:
        task.step_scale *= SMALLER_STEP
        good = last if _written(last) != stale else begun
        where = "the last good checkpoint" if good else "the beginning"
        log.warning("Collapse: %s. Going back to %s with %g of the learning rate.", collapse, where, SMALLER_STEP)
        if good is None:
            task.load_state_dict(start)
        task.train()  # the collapse may have interrupted a validation
    try:
        return _fit(trainer(), task, data, good)
    except Collapse as collapse:
        raise InputError(
            f"Training must stay stable, got two collapses ({collapse}), the second with half the learning rate. Try a "
            "quarter of `optimizer.lr`, or a larger `sampler.size`."
        ) from collapse


def is_first_process() -> bool:
    """Whether this process is the first of those that train together, one per device, which alone writes files."""
    return not getattr(rank_zero_only, "rank", 0)


def begun_checkpoint(folder: Path, config: dict[str, Any], resume: bool) -> Path | None:
    """Find the checkpoint from which a run resumes; for a run that begins, remove what an older one concluded.

    Args:
        folder: Folder of the run.
        config: Resolved configuration of this run.
        resume: Whether the run resumes if there is a checkpoint, the best one if the last one cannot be read.

    Raises:
        InputError: If no checkpoint can be read, or it is of a run with another configuration.
    """
    checkpoint = readable_checkpoint(folder / "checkpoints", ("last", "best")) if resume else None
    if checkpoint is not None:
        require_same_run(checkpoint, config)
    elif is_first_process():
        (folder / SUMMARY).unlink(missing_ok=True)
    return None if checkpoint is None else checkpoint.file


def is_finished(folder: Path) -> bool:
    """Whether a run has ended, since the summary is its last file."""
    return (folder / SUMMARY).is_file()


def write_results(trainer: L.Trainer, task: FieldTask) -> None:
    """Write what a run that was killed after its last validation could not write, except its summary."""
    for callback in trainer.callbacks:  # type: ignore[attr-defined]
        if isinstance(callback, MorphWriter | StepTimes):
            callback.on_train_end(trainer, task)


def require_same_run(checkpoint: Checkpoint, config: dict[str, Any]) -> None:
    """Require that the checkpoint to resume from was written with the same configuration.

    Args:
        checkpoint: Checkpoint of the run.
        config: Resolved configuration of this run.

    Raises:
        InputError: If a setting other than ``resume`` and ``threads`` differs.
    """
    before = checkpoint.content[ENTRY]["config"]
    changed = sorted(_differences(before, config, "") - {"resume", "threads"})
    if changed:
        raise InputError(
            f"`resume=true` must repeat the settings of the run in {checkpoint.file.parent.parent}, got another "
            f"{', '.join(changed[:3])}. Try the command that started the run, or another `hydra.run.dir`."
        )


def _written(file: Path) -> int | None:
    """Time of the last change of a file in ns, None if it does not exist; it may be left from an older run."""
    return file.stat().st_mtime_ns if file.is_file() else None


def _fit(trainer: L.Trainer, task: FieldTask, data: FieldData, checkpoint: Path | None) -> L.Trainer:
    trainer.fit(task, data, ckpt_path=checkpoint, weights_only=True)
    return trainer


def _differences(a: Any, b: Any, prefix: str) -> set[str]:
    """Dotted names of the entries in which two nested configurations differ."""
    if isinstance(a, dict) and isinstance(b, dict):
        keys = set(a) | set(b)
        return set().union(*(_differences(a.get(k), b.get(k), f"{prefix}{k}.") for k in keys))
    return set() if a == b else {prefix.rstrip(".")}
