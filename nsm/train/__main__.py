"""``nsm train``: from two shapes to a morph, or from one shape to its signed distance network."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from lightning.pytorch.loggers import Logger
from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.errors import InputError
from nsm.cli.locks import only_writer_of_folder
from nsm.cli.runtime import keep_freed_memory
from nsm.cli.settings import use_threads
from nsm.train.callbacks import (
    Checkpoints,
    MorphWriter,
    Rewind,
    StopOnSignal,
    Trackers,
    TrainingClock,
    closing,
    opened,
)
from nsm.train.checkpoint_files import WholeCheckpoints
from nsm.train.consistency import require_consistent
from nsm.train.optimal_transport import transport_run
from nsm.train.preparation import (
    instantiate,
    make_trainer,
    prepare_morph,
    prepare_sdf,
    read_fit,
    read_keys,
    read_shapes,
)
from nsm.train.processes import processes_to_start, training_together
from nsm.train.recovery import begun_checkpoint, fit_with_recovery, is_finished, is_first_process, write_results
from nsm.train.summary import Summary
from nsm.train.tasks import FieldData, FieldTask

log = logging.getLogger(__name__)


def main(cfg: DictConfig) -> None:
    """Train as configured, and write everything into the folder of the run."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    kinds: dict[str, Callable[..., Summary | None]] = {
        "morph": partial(_train, prepare_morph),
        "sdf": partial(_train, prepare_sdf),
        "ot": _transport,
    }
    hydra = HydraConfig.get()
    require_consistent(cfg, hydra.runtime.choices, hydra.overrides.task)
    if not is_first_process():  # another process of the same run, for another device
        _run(kinds[cfg.task.kind], cfg, config, folder)
        return
    with only_writer_of_folder(folder):
        _run(kinds[cfg.task.kind], cfg, config, folder)


def _run(
    kind: Callable[[DictConfig, dict[str, Any], Path], Summary | None],
    cfg: DictConfig,
    config: dict[str, Any],
    folder: Path,
) -> None:
    hydra = HydraConfig.get()
    if not _names_shapes(hydra.overrides.task):
        ends = [hydra.runtime.choices[f"shape@{end}"] for end in ("source", "target")]
        log.info(
            "No shapes were given, so this run %s. See `nsm train --help` to choose shapes.",
            f"fits a network to the source of the demo, {ends[0]}"
            if cfg.task.kind == "sdf"
            else f"trains the demo, {ends[0]} into {ends[1]}",
        )
    keep_freed_memory()
    use_threads(config)
    L.seed_everything(cfg.seed, verbose=False)
    with training_together(_processes(cfg), cfg.trainer.num_nodes, HydraConfig.get().overrides.task, folder):
        if summary := kind(cfg, config, folder):
            summary.write(folder)
            summary.report(folder)


def _processes(cfg: DictConfig) -> int:
    """Number of processes that train together on this machine, if this one has to start the others."""
    if cfg.trainer.devices == 1 or cfg.task.kind == "ot":
        return 1
    return processes_to_start(make_trainer(cfg, logger=False, enable_checkpointing=False))


def _names_shapes(overrides: Sequence[str]) -> bool:
    """Whether a command line chooses or changes a shape."""
    return any(override.lstrip("+").startswith(("shape@", "source", "target", "experiment")) for override in overrides)


def _train(
    prepare: Callable[[DictConfig, dict[str, Any]], tuple[FieldTask, FieldData, int]],
    cfg: DictConfig,
    config: dict[str, Any],
    folder: Path,
) -> Summary | None:
    checkpoint = begun_checkpoint(folder, config, bool(cfg.resume))
    begin = time.monotonic()
    task, data, steps = prepare(cfg, config)
    clock = TrainingClock()
    preparing = time.monotonic() - begin
    stop = StopOnSignal()
    loggers: list[Logger] = []

    def trainer() -> L.Trainer:
        callbacks = [Rewind(), *instantiate(cfg.callbacks).values(), stop, clock]
        loggers[:] = opened(instantiate(cfg.logger).values(), config, _group())
        every = max(1, steps // cfg.validations)
        return make_trainer(
            cfg,
            max_steps=steps,
            val_check_interval=every,
            callbacks=callbacks,
            logger=loggers,
            plugins=[WholeCheckpoints()],
        )

    with closing(loggers):
        done = fit_with_recovery(trainer, task, data, folder / "checkpoints" / "last.ckpt", checkpoint)
        if not is_first_process():  # the first one says how training ended
            return None
        if stop.received:
            log.warning(
                "Training stopped at step %d of %d. Repeat the command with `hydra.run.dir=%s resume=true` "
                "to continue.",
                done.global_step, steps, folder,
            )  # fmt: skip
            raise SystemExit(128 + stop.received)
        if not done.callback_metrics:  # all steps were made before
            if is_finished(folder):
                log.info("The run in %s has already finished its %d steps.", folder, steps)
                return None
            write_results(done, task)
        figures, best = _best_figures(done)
        Trackers.of(done).outcome(figures, _best(folder))
    return Summary(done.global_step, clock.seconds, figures, preparing, best)


def _group() -> str | None:
    """Group of the run in trackers: the folder of its multirun, if it belongs to one."""
    hydra = HydraConfig.get()
    return Path(hydra.sweep.dir).name if hydra.mode == RunMode.MULTIRUN else None


def _best(folder: Path) -> Path:
    return folder / "checkpoints" / "best.ckpt"


def _transport(cfg: DictConfig, config: dict[str, Any], folder: Path) -> Summary | None:
    if begun_checkpoint(folder, config, bool(cfg.resume)) is not None and is_finished(folder):
        log.info("The run in %s has already finished; optimal transport has no steps.", folder)
        return None
    begin = time.monotonic()
    method = instantiate(cfg.task.transport)
    if cfg.between:
        raise InputError(
            f"`between` must be empty for optimal transport, which morphs between two shapes, got {len(cfg.between)} "
            "more. Try `method=adadiv`."
        )
    ends = read_keys(cfg, read_shapes(cfg), read_fit(cfg, config))
    prepared = time.monotonic() - begin
    writers = [callback for callback in instantiate(cfg.callbacks).values() if isinstance(callback, MorphWriter)]
    loggers = opened(instantiate(cfg.logger).values(), config, _group())
    trackers = Trackers(loggers, step=0)
    with closing(loggers):
        summary = transport_run(method, ends, config, writers, trackers, folder)
        for logger in loggers:
            logger.log_metrics(dict(summary.figures), step=0)
            logger.finalize("success")
        trackers.outcome(summary.figures, _best(folder))
    return replace(summary, preparing=prepared)


def _best_figures(trainer: L.Trainer) -> tuple[dict[str, float], int]:
    """Figures of validation at the best step, and that step; those of the last if the run keeps no checkpoints."""
    checkpoints = trainer.checkpoint_callback
    if isinstance(checkpoints, Checkpoints) and checkpoints.best_step is not None:
        return checkpoints.best_figures, checkpoints.best_step
    figures = {name: float(v) for name, v in trainer.callback_metrics.items() if name.startswith("val/")}
    return figures, trainer.global_step


if __name__ == "__main__":
    entry.run(main, "train")
