"""Combinations of settings that would not do what they say, refused before a run begins."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from omegaconf import OmegaConf

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.fields.init import FieldInit
from nsm.io.build import build
from nsm.losses import BatchEvaluation, WeightedSum
from nsm.sampling import Batch
from nsm.shapes import Ball, LandmarkPairs
from nsm.types import Key

#: Parts of the configuration that a task does not read, with what it reads instead.
_UNREAD: dict[str, dict[str, str]] = {
    "sdf": {
        "target": "", "between": "", "times": "", "align": "", "equal_volume": "",
        "velocity": "", "beta": "", "field": "", "init": "",
        "landmarks": "", "method": "",
        "loss": "sdf.loss", "steps": "sdf.steps", "optimizer": "sdf.optimizer", "scheduler": "sdf.scheduler",
    },
    "ot": {
        "velocity": "", "beta": "", "field": "", "init": "", "landmarks": "", "loss": "", "optimizer": "",
        "scheduler": "", "steps": "", "validations": "",
    },
}  # fmt: skip
#: Groups whose files change other parts, by which they are judged.
_PATCHES = ("ablation",)
#: Points at which the losses are evaluated once: on the end shapes, around them, and between them.
_POINTS = 8


def require_consistent(cfg: Any, choices: Mapping[str, str], overrides: Sequence[str]) -> None:
    """Refuse a method that is no longer itself, what the task does not use, and terms without a class.

    Args:
        cfg: Composed configuration.
        choices: Chosen option of each group.
        overrides: Overrides as they were typed.

    Raises:
        InputError: If there is such a combination.
    """
    if cfg.symmetry and cfg.task.kind != "morph":
        raise InputError(
            f"`symmetry` must come with a morph that is trained, got task={choices['task']}. Try `symmetry=none`, or "
            "`method=adadiv`."
        )
    if cfg.landmarks and not (cfg.velocity and cfg.task.kind == "morph"):
        raise InputError(
            "`landmarks` must come with a morph whose velocity carries them, got "
            f"{' and '.join(f'{name}={choices[name]}' for name in ('task', 'velocity'))}. Try `method=adadiv`, or "
            "`landmarks=none`."
        )
    if any(_parts(override)[0] == "method" for override in overrides):
        _require_method(choices)
    for place, terms in (("loss", cfg.loss.terms), ("sdf.loss", cfg.sdf.loss.terms)):
        for name, term in terms.items():
            if "_target_" not in term:
                known = [other for other, each in terms.items() if "_target_" in each]
                raise InputError(
                    f"`{place}.terms.{name}` must be a term of the loss, {', '.join(known)}, got settings of another "
                    f"one ({', '.join(term)}). Try `~{place}.terms.{name}`, or another `loss=`."
                )
    if "beta" not in (cfg.velocity or {}) and "beta" in _patched(choices):
        raise InputError(
            f"`+ablation={choices['ablation']}` must come with a velocity that contains β, got "
            f"{choices['velocity']}. Try `method=adadiv`."
        )
    unread = _UNREAD.get(cfg.task.kind, {})
    for override in overrides:
        name, value = _parts(override)
        touched = _patched(choices) if name in _PATCHES else {name.partition(".")[0]}
        if touched and touched <= set(unread):
            raise InputError(
                f"`{override.partition('=')[0]}` must be left out with `task={cfg.task.kind}`, which does not use it, "
                f"got {value}. Try {_instead(override, name, value, unread[min(touched)])}."
            )


def _instead(override: str, name: str, value: str, read: str) -> str:
    """What to type in place of a setting that a task does not read."""
    if not read:
        return f"the command without `{override}`"
    inner = name.partition(".")[2]
    if inner or read == "sdf.steps":
        return f"`{'.'.join(filter(None, (read, inner)))}={value}`"
    return f"`{name}@{read}={value}`"


def effective(overrides: Sequence[str], kind: str) -> list[str]:
    """The overrides that a task reads, where one list serves several tasks, as in a study.

    Args:
        overrides: Overrides of the training command.
        kind: Kind of the task.
    """
    unread = set(_UNREAD.get(kind, {}))
    return [override for override in overrides if _parts(override)[0].partition(".")[0] not in unread]


def require_losses(loss: WeightedSum, config: Mapping[str, Any], init: FieldInit, dim: int) -> None:
    """Evaluate a loss once with fresh networks between two balls, before shapes are fitted to networks.

    Args:
        loss: Weighted terms.
        config: Resolved configuration of the run.
        init: Rule for the initial weights of f.
        dim: Dimension of the shapes.

    Raises:
        InputError: If a term needs a velocity, landmarks, or derivatives that there are not, or f cannot be
            initialized so.
    """
    with torch.random.fork_rng(devices=[]):
        field = build({**config["field"], "in_features": dim + 1})
        init.require(field)
        velocity = build({**config["velocity"], "dim": dim}) if config["velocity"] else None
        ball = Ball(0.5, [0.0] * dim)
        landmarks = LandmarkPairs(torch.zeros(1, dim), torch.zeros(1, dim)) if config["landmarks"] else None
        keys = [Key(0.0, ball), Key(1.0, ball)]
        if velocity is not None:
            velocity.attach(field, keys)
        normals = torch.nn.functional.normalize(torch.randn(_POINTS, dim), dim=1)
        space = torch.cat([0.5 * normals, torch.rand(2 * _POINTS, dim)])
        times = torch.arange(len(space)).remainder(2)
        points = torch.cat([space, times[:, None].to(space)], 1)
        batch = Batch(points, torch.cat([torch.zeros(_POINTS), ball(space[_POINTS : 2 * _POINTS])]), normals)
        loss(BatchEvaluation(batch, field, velocity, landmarks, 1.0, keys))


def _require_method(choices: Mapping[str, str]) -> None:
    """Require that the parts of a method are those that its file chooses."""
    method = choices["method"]
    chosen = dict(overridden("method", method))
    for group, option in chosen.items():
        if choices.get(group) != option:
            parts = " ".join(f"{each}={choices[each]}" for each in chosen)
            raise InputError(
                f"`{group}` must be {option} with `method={method}`, got {choices.get(group)}. "
                f"Try `{parts}` without `method`."
            )


def _patched(choices: Mapping[str, str]) -> set[str]:
    """Parts of the configuration that the chosen ablation changes."""
    ablation = choices.get("ablation")
    if ablation is None:
        return set()
    keys = {str(key) for key in OmegaConf.load(CONF / "ablation" / f"{ablation}.yaml") if key != "defaults"}
    return keys | {group for group, _ in overridden("ablation", ablation)}


def overridden(group: str, option: str) -> Iterator[tuple[str, str]]:
    """Groups and options that a file overrides in its list of defaults."""
    content: Any = OmegaConf.to_container(OmegaConf.load(CONF / group / f"{option}.yaml")) or {}
    for entry in content.get("defaults", ()):
        for key, value in entry.items() if isinstance(entry, Mapping) else ():
            if key.startswith("override /"):
                yield key.removeprefix("override /"), str(value)


def _parts(override: str) -> tuple[str, str]:
    """Name and value of an override; the name of a group that fills a part is that of the part."""
    typed, _, value = override.lstrip("+~").partition("=")
    group, _, package = typed.partition("@")
    return package or group, value
