"""A morph by optimal transport: every point of one shape goes straight to one of the other, the least far on the whole.

The method that the paper compares with: GeomLoss between points drawn in both shapes, displacement interpolation
x(t) = (1 − t) x + t T(x), kernel density and a threshold. GeomLoss without KeOps holds whole matrices, and with as many
points as a surface needs these fit into no memory; so it solves between some of the points, the anchors, and the
potentials that it finds carry all points (`nsm.morphs.optimal_transport.entropic`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch

from nsm.cli.errors import InputError
from nsm.morphs.optimal_transport.density import points_inside
from nsm.morphs.optimal_transport.entropic import entropic_maps
from nsm.morphs.optimal_transport.morph import TransportMorph
from nsm.shapes import FieldShape


@dataclass(frozen=True)
class OptimalTransport:
    """How two shapes become a `TransportMorph`.

    Attributes:
        points: drawn in each shape.
        anchors: the first of them, between which the transport is solved; memory grows with their square.
        blur: width below which the plan does not resolve places; no smaller than the distance between anchors.
        scaling: between 0 and 1; the nearer to 1, the more iterations.
        kernel: width of the Gaussian that makes a density of points; details smaller than it are lost.
        resolution: cells of the grid of densities along the box.

    Raises:
        InputError: for a setting out of its range.
    """

    points: int
    anchors: int
    blur: float
    scaling: float
    kernel: float
    resolution: int

    def __post_init__(self) -> None:
        for name, least in (("points", 1), ("anchors", 1), ("resolution", 8)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InputError(f"task.transport.{name}={value} cannot be: give a whole number of at least {least}")
        for name in ("blur", "kernel"):
            if not 0 < getattr(self, name) < 1:
                raise InputError(
                    f"task.transport.{name}={getattr(self, name)} is no width in the box [−1, 1]^d: give a number "
                    "between 0 and 1, such as 0.03"
                )
        if not 0 < self.scaling < 1:
            raise InputError(
                f"task.transport.scaling={self.scaling} never comes from the size of the box to blur: give a number "
                "between 0 and 1, such as 0.8"
            )
        if self.anchors > self.points:
            raise InputError(
                f"task.transport.anchors={self.anchors} are more than the points they are taken from: give at most "
                f"task.transport.points, which is {self.points}"
            )

    def morph(
        self,
        source: FieldShape,
        target: FieldShape,
        seed: int,
        progress: Callable[[str], None] = lambda stage: None,
    ) -> TransportMorph:
        """Draw points in both shapes, find where each goes, and choose the threshold.

        Args:
            source, target: shapes of one dimension.
            seed: of the points.
            progress: is told the name of each stage as it begins.
        """
        volumes = (source.volume(), target.volume())
        morph = TransportMorph(source, target, self.points, self.kernel, self.resolution, volumes)
        progress(f"drawing {self.points} points in each shape")
        x, y = points_inside(source, self.points, seed), points_inside(target, self.points, seed + 1)
        progress(f"transport between {self.anchors} of them")
        forth, back = entropic_maps(x[: self.anchors], y[: self.anchors], self.blur, self.scaling)
        progress("where the points of the source go")
        there = forth(x)
        progress("where those of the target come from")
        morph.starts.copy_(torch.stack([x, back(y)]))
        morph.stops.copy_(torch.stack([there, y]))
        progress("the threshold")
        morph.calibrate()
        return morph

    def model(self, morph: TransportMorph) -> dict[str, Any]:
        """How to build a morph again, for a checkpoint (`nsm.io.checkpoint.describe`)."""
        return {
            "_target_": "nsm.morphs.optimal_transport.TransportMorph",
            "source": morph.source.config(),
            "target": morph.target.config(),
            "points": self.points,
            "kernel": self.kernel,
            "resolution": self.resolution,
            "volumes": list(morph.volumes),
        }
