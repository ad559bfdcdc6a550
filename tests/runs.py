"""Small runs: what the tests of configuration and training have in common."""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from hydra import compose, initialize_config_dir
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from torch import Tensor

from nsm.cli import entry
from nsm.cli.configuration import CONF
from nsm.train import __main__ as train

#: Networks, batches and grids so small that a run takes a second. The shapes come out rough.
TINY = (
    "init=source",  # f of random weights must first learn to have a surface
    "network.field.hidden_features=16",
    "network.field.hidden_layers=2",
    "network.field.omega=8",
    "network.velocity.hidden_features=16",
    "network.velocity.hidden_layers=2",
    "sampler.size=200",
    "sampler.pool=500",
    "sdf.size=200",
    "sdf.pool=500",
    "sdf.steps=120",
    "sdf.tolerance=10.0",
    "task.volume_resolution=16",
    "task.volume_times=3",
    "callbacks.meshes.resolution=12",
    "callbacks.strip.size=24",
    "trainer.accelerator=cpu",
    "threads=1",
)
#: A disk that moves to the right by a hair's breadth a step: nothing that can collapse.
DISK = (
    "+experiment=disk_translation",
    *TINY,
    "optimizer.lr=1e-4",
    "steps=12",
    "validations=2",
    "trainer.log_every_n_steps=1",
)
#: The same without pictures and meshes.
BARE = (*(o for o in DISK if not o.startswith("callbacks.")), "callbacks=none")
#: One still shape.
STILL = (*(o for o in BARE if not o.startswith(("task.", "init=", "optimizer.", "steps="))), "task=sdf")


@cache
def composed(*overrides: str, folder: str = "/nowhere") -> DictConfig:
    """The configuration of ``python -m nsm.train`` with some overrides, resolved, as the command sees it."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        cfg = compose("train", [*overrides, f"hydra.runtime.output_dir={folder}"], return_hydra_config=True)
    before = HydraConfig.instance().cfg
    HydraConfig.instance().set_config(cfg)
    try:
        plain = OmegaConf.to_container(OmegaConf.masked_copy(cfg, [key for key in cfg if key != "hydra"]), resolve=True)
    finally:
        HydraConfig.instance().cfg = before
    resolved = OmegaConf.create(plain)
    OmegaConf.set_readonly(resolved, True)
    return resolved


def train_here(*overrides: str) -> int:
    """Run the command in this process; returns its exit status."""
    with mock.patch.object(sys, "argv", ["nsm.train", *overrides]):
        try:
            entry.run(train.main, "train")
        except SystemExit as end:
            return int(end.code or 0)
    return 0


def files(folder: Path) -> set[str]:
    """Names of all files in a run's folder, without Hydra's own."""
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return {name for name in names if not name.startswith(".hydra/") and name != "train.log"}


def state(folder: Path) -> dict[str, Any]:
    """All that the last checkpoint of a run holds."""
    return torch.load(folder / "checkpoints" / "last.ckpt", weights_only=True)


def same(a: Any, b: Any) -> bool:
    """Whether nested values, tensors in them, are bitwise equal."""
    if isinstance(a, Tensor):
        return torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b
