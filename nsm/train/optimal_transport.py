"""A run without training: the transport, and the files that any other run writes."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from nsm.cli.files import whole_file
from nsm.cli.progress import Progress
from nsm.io.checkpoint import describe, save_morph
from nsm.io.mesh import write_mesh
from nsm.metrics import even_times, volume_curve
from nsm.morphs.optimal_transport.solver import OptimalTransport
from nsm.morphs.surfaces import extract_frame
from nsm.plots.curves import plot_volume_curves, write_volume_curve
from nsm.plots.strip import try_strip
from nsm.shapes import FieldShape

log = logging.getLogger(__name__)

#: The format of a surface and of a curve.
_SUFFIXES = {3: ".ply", 2: ".obj"}


def transport_run(
    method: OptimalTransport,
    source: FieldShape,
    target: FieldShape,
    provenance: Mapping[str, Any],
    config: Mapping[str, Any],
    folder: Path,
) -> None:
    """Compute a morph and write it as a run of training does.

    Checkpoints first, then the volume curve, then the meshes and the strip if ``callbacks`` in the configuration has
    them, and ``summary.json`` last.

    Args:
        method: what to compute.
        source, target: posed and scaled shapes.
        provenance: where they come from.
        config: the resolved configuration of the run.
        folder: of the run.
    """
    begin = time.monotonic()
    with Progress("optimal transport") as progress:

        def tell(stage: str) -> None:
            progress.update(detail=stage)

        morph = method.morph(source, target, config["seed"], tell)
        computing = time.monotonic() - begin
        for name in ("best", "last"):
            entry = describe(method.model(morph), config, provenance)
            save_morph(folder / "checkpoints" / f"{name}.ckpt", morph, entry)

        tell("volume over time")
        curve = volume_curve(morph, even_times(config["task"]["volume_times"]), config["task"]["volume_resolution"])
        write_volume_curve(folder / "volume.csv", curve.times, curve.volumes)
        plot_volume_curves(folder / "volume.png", {"optimal transport": (curve.times, curve.volumes)})
        if meshes := config["callbacks"].get("meshes"):
            for when in meshes["times"]:
                tell(f"mesh at t = {when:g}")
                frame = extract_frame(morph, when, meshes["resolution"])
                write_mesh(folder / "meshes" / f"t_{when:.3f}{_SUFFIXES[morph.dim]}", frame.mesh, frame.normals)
        if strip := config["callbacks"].get("strip"):
            tell("strip")
            try_strip(folder / "strip.png", morph, strip["times"], size=strip["size"])
    expected = torch.tensor(morph.volumes, dtype=torch.double)
    summary = {
        "steps": 0,
        "training_s": computing,
        "val/volume_std": curve.relative_std,
        "val/volume_max": curve.maximum_deviation,
        "val/volume_error": float((curve.volumes[[0, -1]] / expected - 1).abs().max()),
    }
    with whole_file(folder / "summary.json") as temporary:
        temporary.write_text(json.dumps(summary, indent=2) + "\n")
    log.info("transport of %d points in %.0f s", method.points, computing)
