"""Training that survives: resumed after a stop, set back after a collapse."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lightning as L

from nsm.cli.errors import InputError
from nsm.io.checkpoint import read_checkpoint
from nsm.train.tasks import Collapse, FieldData, FieldTask

log = logging.getLogger(__name__)

#: What the learning rate is multiplied by after a collapse.
SMALLER_STEP = 0.5


def fit_with_recovery(
    trainer: Callable[[], L.Trainer], task: FieldTask, data: FieldData, last: Path, resume: bool
) -> L.Trainer:
    """Train; after a collapse go back to the last good checkpoint and go on with half the step, once.

    A checkpoint is good because it is written only after a validation that found a shape and finite losses.

    Args:
        trainer: makes a fresh trainer.
        task, data: what to train.
        last: where the last good checkpoint is written.
        resume: whether to begin from it, if it is there.

    Returns:
        The trainer that finished.

    Raises:
        InputError: if training collapses again.
    """
    start = copy.deepcopy(task.state_dict())
    begun = resume and last.is_file()
    stale = None if begun else _written(last)
    try:
        return _fit(trainer(), task, data, last if begun else None)
    except Collapse as collapse:
        task.step_scale *= SMALLER_STEP
        good = last if _written(last) != stale else None
        where = "the last good checkpoint" if good else "the beginning"
        log.warning("%s: going back to %s with %g of the learning rate", collapse, where, SMALLER_STEP)
        if good is None:
            task.load_state_dict(start)
        task.train()  # a validation may have broken off
    try:
        return _fit(trainer(), task, data, good)
    except Collapse as collapse:
        raise InputError(
            f"training collapsed twice ({collapse}), the second time with half the learning rate: lower "
            "optimizer.lr fourfold, or raise sampler.size"
        ) from collapse


def require_same_run(last: Path, config: dict[str, Any]) -> None:
    """Raise an `InputError` unless a checkpoint to go on from was written by a run of this very configuration."""
    if not last.is_file():
        return
    before = read_checkpoint(last)["nsm"]["config"]
    changed = sorted(_differences(before, config, "") - {"resume", "threads"})
    if changed:
        raise InputError(
            f"{last} was written with another {', '.join(changed[:3])}: repeat the command it was started with, plus "
            "resume=true, or choose another hydra.run.dir"
        )


def _written(file: Path) -> int | None:
    """When a file was written, in ns, or None if it is not there; a folder may hold the last one of an older run."""
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
