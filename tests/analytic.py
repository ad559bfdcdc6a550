"""Morphs whose networks have known weights instead of trained ones, as objects and as checkpoints."""

from __future__ import annotations

import math
import sys
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest import mock

import torch

from nsm.cli import entry
from nsm.fields import Free, ScalarSiren, VectorSiren
from nsm.io.checkpoint import describe, save_morph
from nsm.morphs.neural import NeuralMorph
from nsm.shapes import Ball, FieldShape

#: ω of the networks, an arbitrary value.
OMEGA = 2.0
#: Frequency of the cosines: their sum then falls from the middle of the box to its faces.
FREQUENCY = 1.5


@torch.no_grad()
def bowl(dim: int, level: float, rise: float | None = None) -> ScalarSiren:
    """f = level − Σ cos(k x_i), whose zero set is a rounded ball where d − 1 + cos(k) < level < d.

    With ``rise`` there is time as a last input, and rise · sin(πt/2) is added: the ball shrinks, and vanishes when
    level + rise sin(πt/2) reaches d.
    """
    timed = rise is not None
    network = ScalarSiren(dim + timed, dim + 1, 1, OMEGA)
    hidden, last = network.linears
    hidden.weight.zero_()
    hidden.weight[:dim, :dim] = torch.eye(dim) * FREQUENCY / OMEGA
    hidden.bias.fill_(math.pi / 2 / OMEGA)
    hidden.bias[dim] = 0.0
    last.weight.fill_(-1.0)
    last.weight[0, dim] = rise or 0.0
    last.bias.fill_(level)
    if timed:
        hidden.weight[dim, dim] = math.pi / 2 / OMEGA
    return network


def shrinking(dim: int, rise: float, source: FieldShape | None = None) -> NeuralMorph:
    """A morph without a velocity whose volume decreases; its end shapes are arbitrary balls."""
    middle = [0.0] * dim
    morph = NeuralMorph(bowl(dim, dim - 0.5, rise), None, source or Ball(0.65, middle), Ball(0.4, middle))
    return morph.requires_grad_(False)


def turning(dim: int, spin: float, source: FieldShape | None = None) -> NeuralMorph:
    """A ball at rest, with a velocity that rotates it about the last axis (the center in 2D) by an angle."""
    velocity = Free(dim, partial(VectorSiren, hidden_features=dim, hidden_layers=1, omega=1.0))
    hidden, last = velocity.network.linear_layers
    with torch.no_grad():
        hidden.weight.zero_()
        hidden.bias.zero_()
        hidden.weight[:, :dim] = 1e-3 * torch.eye(dim)  # sin is linear there
        last.bias.zero_()
        last.weight.zero_()
        last.weight[0, 1], last.weight[1, 0] = -1e3 * spin, 1e3 * spin
    middle = [0.0] * dim
    morph = NeuralMorph(bowl(dim, dim - 0.5, 0.0), velocity, source or Ball(0.4, middle), Ball(0.4, middle))
    return morph.requires_grad_(False)


def save(morph: NeuralMorph, file: Path, **entry_values: Any) -> Path:
    """Write a morph as a checkpoint; ``entry_values`` replace values of its entry ``nsm``."""
    field = morph.field
    model = {
        "_target_": "nsm.morphs.neural.NeuralMorph",
        "field": {
            "_target_": "nsm.fields.ScalarSiren",
            "in_features": field.in_features,
            "hidden_features": field.hidden_features,
            "hidden_layers": field.hidden_layers,
            "omega": list(field.omegas),
        },
        "velocity": None if morph.velocity_field is None else _free(morph.velocity_field),
        "source": morph.source.config(),
        "target": morph.target.config(),
    }
    save_morph(file, morph, describe(model, {}, morph.provenance) | entry_values)
    return file


def _free(velocity: Free) -> dict[str, Any]:
    network = velocity.network
    sizes = {"hidden_features": network.hidden_features, "hidden_layers": network.hidden_layers}
    described = {"_target_": "nsm.fields.VectorSiren", "_partial_": True, **sizes, "omega": network.omegas[0]}
    return {"_target_": "nsm.fields.Free", "dim": velocity.dim, "network": described}


def unreadable(folder: Path) -> dict[str, tuple[Path, str]]:
    """Files that are not valid checkpoints by their defect, with words that the error message must contain."""
    good = save(shrinking(2, 0.1), folder / "good.ckpt")
    (folder / "cut.ckpt").write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    (folder / "text.ckpt").write_text("hello")
    torch.save({"weights": torch.zeros(2)}, folder / "other.ckpt")
    save(shrinking(2, 0.1), folder / "format.ckpt", format=99)
    (folder / "empty_run").mkdir()
    return {
        "missing": (folder / "nowhere.ckpt", "must be an existing file or folder"),
        "cut": (folder / "cut.ckpt", "cut.ckpt` must be a complete checkpoint"),
        "text": (folder / "text.ckpt", "text.ckpt` must be a complete checkpoint"),
        "not ours": (folder / "other.ckpt", "other.ckpt` must be a checkpoint of nsm"),
        "format": (folder / "format.ckpt", "got format 99"),
        "no run": (folder / "empty_run", "which has no checkpoints/best.ckpt"),
    }


def run_here(module: ModuleType, *overrides: str) -> int:
    """Run a command in this process and return its exit status."""
    with mock.patch.object(sys, "argv", [module.__name__, *overrides]):
        try:
            entry.run(module.main, module.__name__.split(".")[1])
        except SystemExit as end:
            return int(end.code or 0)
    return 0


def sentence(text: str) -> str:
    """Text of a command on stderr, on one line."""
    return " ".join(text.split())
