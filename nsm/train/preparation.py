"""From a configuration to what is trained: shapes, networks, points, and the task that holds them."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any

import lightning as L
from hydra.utils import instantiate as hydra_instantiate
from omegaconf import DictConfig

from nsm.cli.errors import InputError
from nsm.fields import Mirror
from nsm.io.build import build
from nsm.io.checkpoint import describe
from nsm.sampling import Fractions, MorphSampler
from nsm.shapes import Shape
from nsm.shapes.asymmetry import asymmetry
from nsm.shapes.landmarks import warn_of_distant
from nsm.train.callbacks import ExitOnSignal, Progress
from nsm.train.consistency import require_losses
from nsm.train.tasks import FieldData, FieldTask, Keys, MorphTask, SdfFit, draw_pools, prepare_keys, starting_network

log = logging.getLogger(__name__)

#: Points on the shapes, equally many on each, at which validation measures a morph.
VALIDATION_POINTS = 8000
#: Mean distance of an end shape from its mirror image above which training warns of an asymmetry.
ASYMMETRY_WARNING = 0.005
#: Instantiates ``_target_`` from plain lists and dicts: no part of the configuration object may enter a checkpoint.
instantiate = partial(hydra_instantiate, _convert_="all")


def prepare_morph(cfg: DictConfig, config: dict[str, Any]) -> tuple[FieldTask, FieldData, int]:
    """Prepare the training of a morph.

    Args:
        cfg: Composed configuration.
        config: The same as plain dicts and lists, with all references resolved.

    Returns:
        The task, its points, and the number of steps.

    Raises:
        InputError: If a shape cannot be read, or settings contradict each other.
    """
    shapes = read_shapes(cfg)
    landmarks = instantiate(cfg.landmarks).read(shapes[0].dim) if cfg.landmarks else None
    loss, init = instantiate(cfg.loss), instantiate(cfg.init)
    require_losses(loss, config, init, shapes[0].dim)
    fit = read_fit(cfg, config)
    found = read_keys(cfg, shapes, fit)
    dim, provenance, placed = found.source.dim, found.provenance, None
    if landmarks is not None:
        placed = landmarks.place(found.source, found.target)
        warn_of_distant(placed, found.source, found.target)
        provenance = provenance | {"landmarks": landmarks.provenance()}
    model = _model(found, config)
    if cfg.symmetry:
        model = symmetric(instantiate(cfg.symmetry), model, found)
    morph = build(model)
    for key, prepared in zip(morph.keys, found.keys, strict=True):
        key.shape.load_state_dict(prepared.shape.state_dict())
    network = morph.field.core
    init(network, starting_network(network, found.source, fit) if init.needs_source else None)

    sampler = instantiate(cfg.sampler)
    box = sampler["box"](dim=dim)
    pools = {
        key.time: draw_pools(key.shape, sampler["pool"], cfg.seed + number, box.half_width)
        for number, key in enumerate(found.keys)
    }
    _, ambient, interior = sampler["fractions"].counts(sampler["size"])
    data = FieldData(
        MorphSampler(pools, box, sampler["time"], sampler["size"], sampler["fractions"]),
        MorphSampler(pools, box, sampler["time"], VALIDATION_POINTS, Fractions(surface=1.0, ambient=0.0)),
        cfg.seed,
    )
    task = MorphTask(
        morph,
        sampler["near"](dim=dim, interior=interior),
        sampler["ends"](dim=dim, ambient=ambient),
        box,
        loss,
        instantiate(cfg.optimizer),
        instantiate(cfg.scheduler),
        cfg.task.volume_resolution,
        cfg.task.volume_times,
        placed,
    )
    task.description = describe(model, config, provenance)
    return task, data, cfg.steps


def prepare_sdf(cfg: DictConfig, config: dict[str, Any]) -> tuple[FieldTask, FieldData, int]:
    """Prepare the fit of a network to the source.

    Args:
        cfg: Composed configuration.
        config: The same as plain dicts and lists, with all references resolved.

    Returns:
        The task, its points, and the number of steps.

    Raises:
        InputError: If the shape cannot be read.
    """
    shape, fit = instantiate(cfg.source), read_fit(cfg, config)
    task, data = fit.prepare(shape)
    task.description = describe(fit.as_shape(task, shape).config(), config, {"source": shape.provenance()})
    return task, data, fit.steps


def read_shapes(cfg: DictConfig) -> list[Shape]:
    """Read the shapes of a configuration, in order of time.

    Raises:
        InputError: If a shape cannot be read.
    """
    return [instantiate(shape) for shape in (cfg.source, *cfg.between.values(), cfg.target)]


def read_keys(cfg: DictConfig, shapes: list[Shape], fit: SdfFit) -> Keys:
    """Make shapes ready for a morph: fitted, placed, and aligned as the configuration asks for.

    Args:
        cfg: Composed configuration.
        shapes: Its shapes, as `read_shapes` returns them.
        fit: How networks are fitted to them, as `read_fit` returns it.

    Raises:
        InputError: If a shape has no volume, or the shapes cannot be morphed into each other.
    """
    return prepare_keys(shapes, fit, equal=cfg.equal_volume, align=instantiate(cfg.align), times=cfg.times)


def read_fit(cfg: DictConfig, config: dict[str, Any]) -> SdfFit:
    """Read how networks are fitted to shapes.

    Args:
        cfg: Composed configuration.
        config: The same as plain dicts and lists, with all references resolved.
    """

    def trainer(**arguments: Any) -> L.Trainer:
        return make_trainer(cfg, callbacks=[Progress("fitting a shape"), ExitOnSignal()], **arguments)

    fit: SdfFit = instantiate(cfg.sdf)(settings=config["sdf"], trainer=trainer)
    return fit


def make_trainer(cfg: DictConfig, **arguments: Any) -> L.Trainer:
    """Make Lightning's trainer.

    Args:
        cfg: Composed configuration.
        **arguments: Further arguments of the trainer, which the configuration does not have.

    Raises:
        InputError: If this machine or Lightning cannot do what its options ask for.
    """
    try:
        trainer: L.Trainer = instantiate(cfg.trainer)(**arguments)
    except Exception as error:  # Lightning and what it imports raise many types of exceptions
        given = ", ".join(f"{name}={cfg.trainer[name]}" for name in ("accelerator", "devices", "strategy"))
        raise InputError(
            f"`trainer` must have options that fit together and this machine, got {given} "
            f"({' '.join(str(error).split()).rstrip('.')}). Try `trainer.accelerator=auto trainer.devices=1`."
        ) from error
    return trainer


def symmetric(mirror: Mirror, model: dict[str, Any], keys: Keys) -> dict[str, Any]:
    """Make f and V of a model symmetric, and warn where the shapes are far from that.

    Args:
        mirror: The plane of symmetry.
        model: Configuration of the morph, with the entries ``field`` and ``velocity``.
        keys: Shapes of the morph, whose mean distance from their mirror images is a length of its coordinates.

    Returns:
        The configuration of the symmetric morph.
    """
    dim = keys.source.dim
    away = [asymmetry(key.shape, mirror.reflection(dim)) for key in keys.keys]
    said = ", ".join(f"{distance:.2g}" for distance in away)
    log.info("mean distances of the shapes from their mirror images: %s", said)
    if max(away) > ASYMMETRY_WARNING:
        log.warning(
            "The shapes deviate from `symmetry` by %s on average, in order of time, so the networks learn the mean of "
            "each shape and its mirror image. Try another plane, `align=rigid`, or `symmetry=none`.",
            said,
        )
    velocity = model["velocity"] and mirror.velocity(model["velocity"], dim)
    return model | {"field": mirror.field(model["field"], dim), "velocity": velocity}


def _model(keys: Keys, config: dict[str, Any]) -> dict[str, Any]:
    """Configuration of the morph through some keys."""
    dim = keys.source.dim
    return {
        "_target_": "nsm.morphs.neural.NeuralMorph",
        "field": {**config["field"], "in_features": dim + 1},
        "velocity": {**config["velocity"], "dim": dim} if config["velocity"] else None,
        "source": keys.source.config(),
        "target": keys.target.config(),
        "between": [key.shape.config() for key in keys.keys[1:-1]],
        "times": [key.time for key in keys.keys],
    }
