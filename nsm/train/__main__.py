"""``python -m nsm.train``: from two shapes to a morph, or from one shape to its signed distance network."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import lightning as L
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate as hydra_instantiate
from lightning.pytorch.loggers import Logger, WandbLogger
from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry
from nsm.cli.files import whole_file
from nsm.cli.runtime import keep_freed_memory
from nsm.cli.settings import choice, use_threads, whole_number
from nsm.io.build import build
from nsm.io.checkpoint import describe
from nsm.sampling import Fractions, MorphSampler
from nsm.train.callbacks import Checkpoints, ExitOnSignal, Progress, StopOnSignal
from nsm.train.optimal_transport import transport_run
from nsm.train.recovery import fit_with_recovery, require_same_run
from nsm.train.tasks import FieldData, FieldTask, MorphTask, draw_pools, prepare_ends, starting_network

log = logging.getLogger(__name__)

#: Points by which validation judges a morph, half of them on each end shape.
VALIDATION_POINTS = 8000
#: An error of volume at the ends that is told.
VOLUME_WARNING = 0.05
#: Makes what a config names, from plain lists and dicts: nothing of the configuration ends up in a checkpoint.
instantiate = partial(hydra_instantiate, _convert_="all")


def main(cfg: DictConfig) -> None:
    """Train as configured, and write everything into the run's folder."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    config: Any = OmegaConf.to_container(cfg, resolve=True)
    kinds: dict[str, Callable[..., None]] = {
        "morph": partial(_train, _prepare_morph),
        "sdf": partial(_train, _prepare_sdf),
        "ot": _transport,
    }
    _require_sensible(cfg, tuple(kinds))
    if cfg.resume:
        require_same_run(_last(folder), config)
    keep_freed_memory()
    use_threads(config)
    L.seed_everything(cfg.seed, verbose=False)
    kinds[cfg.task.kind](cfg, config, folder)


def _train(
    prepare: Callable[[DictConfig, dict[str, Any]], tuple[FieldTask, FieldData, int]],
    cfg: DictConfig,
    config: dict[str, Any],
    folder: Path,
) -> None:
    begin = time.monotonic()
    task, data, steps = prepare(cfg, config)
    prepared = time.monotonic()
    stop = StopOnSignal()
    loggers: list[Logger] = []

    def trainer() -> L.Trainer:
        callbacks = [*instantiate(cfg.callbacks).values(), stop]
        loggers[:] = instantiate(cfg.logger).values()
        every = max(1, steps // cfg.validations)
        return instantiate(cfg.trainer)(max_steps=steps, val_check_interval=every, callbacks=callbacks, logger=loggers)

    try:
        done = fit_with_recovery(trainer, task, data, _last(folder), resume=bool(cfg.resume))
    finally:
        _finish(loggers)
    if stop.received:
        log.warning("stopped at step %d of %d; to go on, repeat the command with hydra.run.dir=%s resume=true",
                    done.global_step, steps, folder)  # fmt: skip
        raise SystemExit(128 + stop.received)
    if not done.callback_metrics:
        log.info("the run in %s has made its %d steps already", folder, steps)
        return
    _summarise(done, folder, prepared - begin, time.monotonic() - prepared)


def _last(folder: Path) -> Path:
    return folder / "checkpoints" / "last.ckpt"


def _finish(loggers: list[Logger]) -> None:
    """Close a run of wandb, or the next one of a multirun would go on in it."""
    for logger in loggers:
        if isinstance(logger, WandbLogger):
            logger.experiment.finish()


def _require_sensible(cfg: DictConfig, kinds: tuple[str, ...]) -> None:
    """Raise an `InputError` for what would fail late or never end."""
    choice("task.kind", cfg.task.kind, kinds)
    for name in ("steps", "validations", "sampler.size", "sampler.pool", "sdf.steps", "sdf.size", "sdf.pool"):
        whole_number(name, OmegaConf.select(cfg, name))


def _transport(cfg: DictConfig, config: dict[str, Any], folder: Path) -> None:
    if cfg.resume and _last(folder).is_file():
        log.info("the run in %s has made its morph already, without any steps", folder)
        return
    method = instantiate(cfg.task.transport)
    ends = prepare_ends(instantiate(cfg.source), instantiate(cfg.target), _fit(cfg, config), equal=cfg.equal_volume)
    transport_run(method, ends.source, ends.target, ends.provenance, config, folder)
    _tell_files(folder)


def _prepare_morph(cfg: DictConfig, config: dict[str, Any]) -> tuple[FieldTask, FieldData, int]:
    source, target = instantiate(cfg.source), instantiate(cfg.target)
    fit = _fit(cfg, config)
    ends = prepare_ends(source, target, fit, equal=cfg.equal_volume)
    dim = ends.source.dim
    model = {
        "_target_": "nsm.morphs.neural.NeuralMorph",
        "field": {**config["field"], "in_features": dim + 1},
        "velocity": {**config["velocity"], "dim": dim} if config["velocity"] else None,
        "source": ends.source.config(),
        "target": ends.target.config(),
    }
    morph = build(model)
    morph.source.load_state_dict(ends.source.state_dict())
    morph.target.load_state_dict(ends.target.state_dict())
    init = instantiate(cfg.init)
    init(morph.field, starting_network(morph.field, ends.source, fit) if init.needs_source else None)

    sampler = instantiate(cfg.sampler)
    box = sampler["box"](dim=dim)
    pools = (
        draw_pools(ends.source, sampler["pool"], cfg.seed, box.half_width),
        draw_pools(ends.target, sampler["pool"], cfg.seed + 1, box.half_width),
    )
    _, ambient, interior = sampler["fractions"].counts(sampler["size"])
    data = FieldData(
        MorphSampler(*pools, box, sampler["time"], sampler["size"], sampler["fractions"]),
        MorphSampler(*pools, box, sampler["time"], VALIDATION_POINTS, Fractions(surface=1.0, ambient=0.0)),
        cfg.seed,
    )
    task = MorphTask(
        morph,
        sampler["near"](dim=dim, interior=interior),
        sampler["ends"](dim=dim, ambient=ambient),
        box,
        instantiate(cfg.loss),
        instantiate(cfg.optimizer),
        instantiate(cfg.scheduler),
        cfg.task.volume_resolution,
        cfg.task.volume_times,
        instantiate(cfg.landmarks).place(ends.source, ends.target) if cfg.landmarks else None,
    )
    task.description = describe(model, config, ends.provenance)
    return task, data, cfg.steps


def _prepare_sdf(cfg: DictConfig, config: dict[str, Any]) -> tuple[FieldTask, FieldData, int]:
    shape, fit = instantiate(cfg.source), _fit(cfg, config)
    task, data = fit.prepare(shape)
    task.description = describe(fit.as_shape(task, shape).config(), config, {"source": shape.provenance()})
    return task, data, fit.steps


def _fit(cfg: DictConfig, config: dict[str, Any]) -> Any:
    def trainer(**arguments: Any) -> L.Trainer:
        return instantiate(cfg.trainer)(callbacks=[Progress("fitting a shape"), ExitOnSignal()], **arguments)

    return instantiate(cfg.sdf)(settings=config["sdf"], trainer=trainer)


def _summarise(trainer: L.Trainer, folder: Path, preparing: float, training: float) -> None:
    """Write ``summary.json``, with the figures of the best step, and say where everything is."""
    figures, best = _best_figures(trainer)
    times = {"preparing_s": preparing, "training_s": training}
    summary = {"steps": trainer.global_step, "best_step": best, **times, **figures}
    with whole_file(folder / "summary.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=2) + "\n")
    if (off := figures.get("val/volume_error", 0.0)) > VOLUME_WARNING:
        log.warning(
            "the volume of the morph is %.0f %% off that of its end shapes: look at the strip for pieces that belong "
            "to neither, and train with half of optimizer.lr or more steps",
            100 * off,
        )
    log.info("%d steps in %.0f s, after %.0f s of preparation", trainer.global_step, training, preparing)
    if "val/error" in figures:
        log.info("best.ckpt and what is drawn of it are of step %d, with val/error %.3g", best, figures["val/error"])
    _tell_files(folder)


def _best_figures(trainer: L.Trainer) -> tuple[dict[str, float], int]:
    """What validation measured at the best step, and that step; at the last one, if the run keeps no checkpoints."""
    checkpoints = trainer.checkpoint_callback
    if isinstance(checkpoints, Checkpoints) and checkpoints.best_step is not None:
        return checkpoints.best_figures, checkpoints.best_step
    figures = {name: float(v) for name, v in trainer.callback_metrics.items() if name.startswith("val/")}
    return figures, trainer.global_step


def _tell_files(folder: Path) -> None:
    for file in sorted(
        p for p in folder.rglob("*") if p.is_file() and not p.relative_to(folder).parts[0].startswith(".")
    ):
        log.info("wrote %s", file)


if __name__ == "__main__":
    entry.run(main, "train")
