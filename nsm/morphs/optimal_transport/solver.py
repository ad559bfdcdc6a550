"""Morphs by optimal transport: every point of one shape moves straight to a point of the other, at least total cost.

This is a method that the paper compares with: GeomLoss between points drawn in both shapes, displacement interpolation
x(t) = (1 − t) x + t T(x), kernel density, and a threshold. GeomLoss without KeOps holds whole matrices, which do not
fit into memory for as many points as a surface needs. The problem is therefore solved between some of the points, the
anchors, and the resulting potentials move all points (`nsm.morphs.optimal_transport.entropic`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from nsm.cli.settings import between, invalid, whole_number
from nsm.morphs.optimal_transport.density import points_inside
from nsm.morphs.optimal_transport.entropic import entropic_maps
from nsm.morphs.optimal_transport.morph import TransportMorph
from nsm.shapes import FieldShape


@dataclass(frozen=True)
class OptimalTransport:
    """Settings of optimal transport, which turn two shapes into a `TransportMorph`.

    Attributes:
        points: Number of points drawn in each shape.
        anchors: Number of points between which optimal transport is solved; memory grows with its square.
        blur: Width below which the plan does not resolve places, no smaller than the distance between anchors.
        scaling: Ratio of successive widths down to ``blur``; values nearer to 1 take more iterations.
        kernel: Width of the Gaussian that turns points into a density; details smaller than it are lost.
        resolution: Cells of the grid of densities along the box.

    Raises:
        InputError: If a setting is out of range.
    """

    points: int
    anchors: int
    blur: float
    scaling: float
    kernel: float
    resolution: int

    def __post_init__(self) -> None:
        for name, least, example in (("points", 1, 300000), ("anchors", 1, 5000), ("resolution", 8, 200)):
            whole_number(f"task.transport.{name}", getattr(self, name), least, example)
        for name, width in (("blur", 0.05), ("scaling", 0.8), ("kernel", 0.02)):
            between(f"task.transport.{name}", getattr(self, name), 0, 1, width)
        if self.anchors > self.points:
            requirement = f"at most `task.transport.points`, {self.points}"
            raise invalid("task.transport.anchors", requirement, self.anchors, self.points)

    def morph(
        self,
        source: FieldShape,
        target: FieldShape,
        seed: int,
        progress: Callable[[str], None] = lambda stage: None,
    ) -> TransportMorph:
        """Draw points in both shapes, find where each one moves, and choose the threshold of density.

        Args:
            source: Shape at t = 0.
            target: Shape at t = 1, of the same dimension.
            seed: Seed of the points.
            progress: Called with the name of each stage when it begins.

        Raises:
            InputError: If a shape cannot be filled with points, or no threshold gives the volume of the source.
        """
        volumes = (source.volume(), target.volume())
        morph = TransportMorph(source, target, self.points, self.kernel, self.resolution, volumes)
        progress(f"drawing {self.points} points in each shape")
        x, y = points_inside(source, self.points, seed), points_inside(target, self.points, seed + 1)
        progress(f"optimal transport between {self.anchors} anchors")
        forth, back = entropic_maps(x[: self.anchors], y[: self.anchors], self.blur, self.scaling)
        progress("moving points of the source")
        there = forth(x)
        progress("moving points of the target")
        morph.starts.copy_(torch.stack([x, back(y)]))
        morph.stops.copy_(torch.stack([there, y]))
        progress("choosing the threshold")
        morph.calibrate()
        return morph

    def model(self, morph: TransportMorph) -> dict[str, Any]:
        """Config from which `nsm.io.build.build` makes the morph again, without its points."""
        return {
            "_target_": "nsm.morphs.optimal_transport.TransportMorph",
            "source": morph.source.config(),
            "target": morph.target.config(),
            "points": self.points,
            "kernel": self.kernel,
            "resolution": self.resolution,
            "volumes": list(morph.volumes),
        }
