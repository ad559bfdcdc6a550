"""Run of optimal transport: no steps, and the files that a run of training writes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from nsm.cli.progress import Progress
from nsm.io.checkpoint import describe, save_morph
from nsm.metrics import even_times, volume_curve
from nsm.morphs.optimal_transport.solver import OptimalTransport
from nsm.train.callbacks import MorphWriter, Trackers
from nsm.train.summary import Summary
from nsm.train.tasks import Keys


def transport_run(
    method: OptimalTransport,
    ends: Keys,
    config: Mapping[str, Any],
    writers: Sequence[MorphWriter],
    trackers: Trackers,
    folder: Path,
) -> Summary:
    """Compute a morph, and write its checkpoints and the files of the run's callbacks.

    Args:
        method: Solver of the transport problem.
        ends: Posed and scaled shapes.
        config: Resolved configuration of the run.
        writers: Callbacks of the run that write files of a finished morph.
        trackers: Trackers of the run.
        folder: Folder of the run.

    Returns:
        The outcome, with the figures of validation that need no training.
    """
    begin = time.monotonic()
    with Progress("optimal transport") as progress:

        def show(stage: str) -> None:
            progress.update(detail=stage)

        morph = method.morph(ends.source, ends.target, config["seed"], show)
        computing = time.monotonic() - begin
        entry = describe(method.model(morph), config, ends.provenance)
        for name in ("best", "last"):
            save_morph(folder / "checkpoints" / f"{name}.ckpt", morph, entry)
        show("volume over time")
        curve = volume_curve(morph, even_times(config["task"]["volume_times"]), config["task"]["volume_resolution"])
        show("files")
        for writer in writers:
            writer.write(morph, curve, "optimal transport", trackers)
    expected = torch.tensor(morph.volumes, dtype=torch.double)
    figures = {
        "val/volume_std": curve.relative_std,
        "val/volume_max": curve.maximum_deviation,
        "val/volume_error": float((curve.volumes[[0, -1]] / expected - 1).abs().max()),
    }
    return Summary(steps=0, training=computing, figures=figures)
