"""Training of a morph: f and V together."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.geometry.volume import volume
from nsm.losses import Evaluation, WeightedSum
from nsm.metrics import VolumeCurve, even_times, volume_curve
from nsm.morph import NeuralMorph
from nsm.sampling import Batch, Box, EndSurfaces, MovingSurface
from nsm.shapes import LandmarkPairs
from nsm.tasks.base import Collapse, FieldTask

#: A morph whose volume at an end is below this part of its largest has lost its surface.
_VANISHED = 0.02
#: A mean ‖∇f‖ on the end shapes above which f is noise: by distance and volume alone, noise may pass for a good morph.
_STEEP = 100.0


class MorphTask(FieldTask):
    """One optimiser step moves f and V at once; the end shapes stay as they are.

    Validation measures what a user sees, all in units of length:
    ``val/distance``, the mean distance |f|/‖∇f‖ of f's surface from fixed points of the end shapes;
    ``val/drift``, the largest error of volume as the displacement of the surface that makes it, r V(0)^(1/d) / d with r
    the greatest of |V(t)/V(0) − 1| and of the same for f and the end shapes (a blob far from a shape shows only there);
    and their sum ``val/error``, by which the best checkpoint is chosen.

    Args:
        morph: the networks and the end shapes.
        near: draws interior points around the moving surface.
        ends: puts ambient points on f's own surface at both ends.
        box: where the others are drawn.
        loss: the terms.
        optimizer, scheduler: see `FieldTask`.
        volume_resolution: cells along the box at which validation measures volume.
        volume_times: at how many times.
        landmarks: points of the end shapes that belong together, for losses that ask for them.
    """

    def __init__(
        self,
        morph: NeuralMorph,
        near: MovingSurface,
        ends: EndSurfaces,
        box: Box,
        loss: WeightedSum,
        optimizer: Callable[..., Optimizer],
        scheduler: Callable[..., LRScheduler],
        volume_resolution: int = 64,
        volume_times: int = 11,
        landmarks: LandmarkPairs | None = None,
    ) -> None:
        super().__init__(loss, optimizer, scheduler)
        self.morph, self.near, self.ends, self.box = morph, near, ends, box
        self.volume_resolution, self.volume_times = volume_resolution, volume_times
        self.landmarks = landmarks
        #: Whether there has been a surface at both ends, which must then stay: f of random weights has none at first.
        self._whole = False
        #: The curve of the last validation.
        self.volume_curve: VolumeCurve | None = None
        morph.source.requires_grad_(False)
        morph.target.requires_grad_(False)

    def evaluation(self, batch: Batch) -> Evaluation:
        """f and V at the points of a batch."""
        morph = self.morph
        near = self.near.place(batch, self.box.half_width)
        shapes = morph.source.true_distance, morph.target.true_distance
        placed = self.ends.place(near, self.near, self.box.half_width, *shapes)
        known = self.landmarks and LandmarkPairs(*(points.to(placed.points) for points in self.landmarks))
        progress = self.global_step / self.trainer.max_steps
        ends = morph.source, morph.target
        return Evaluation(placed, morph.field, morph.velocity_field, known, progress, ends)

    def learn_from(self, evaluation: Evaluation) -> None:
        """Follow the surface."""
        self.near.follow(evaluation.batch, evaluation.interior)
        self.ends.follow(evaluation.batch, evaluation.f)

    @torch.no_grad()
    def on_train_start(self) -> None:
        super().on_train_start()
        self._whole = self._whole or not len(_lost(self._curve()))

    @torch.no_grad()
    def validation_step(self, batch: Batch, index: int) -> None:
        """Measure the ends and the volume curve."""
        on = batch.points[batch.surface]
        jet = self.morph.field.jet(on)
        slope = jet.gradient[:, : self.morph.dim].norm(dim=1)
        if not slope.mean() < _STEEP:
            raise Collapse(
                f"the mean of ‖∇f‖ on the end shapes has grown to {slope.mean():.3g} by step {self.global_step}"
            )
        distance = (jet.value.abs() / slope).mean()
        curve = self._measure_volume()
        off = (curve.volumes[[0, -1]] / self._end_volumes - 1).abs().max()
        drift = (
            max(curve.maximum_deviation, float(off)) * float(curve.volumes[0]) ** (1 / self.morph.dim) / self.morph.dim
        )
        self.log_dict(
            {
                "val/distance": distance,
                "val/slope": slope.mean(),
                "val/volume_std": curve.relative_std,
                "val/volume_max": curve.maximum_deviation,
                "val/volume_error": off,
                "val/drift": drift,
                "val/error": distance + drift,
            },
            batch_size=len(on),
        )

    @cached_property
    def _end_volumes(self) -> Tensor:
        """Volumes (2,) of the end shapes, measured as those of f are."""
        ends = (self.morph.source, self.morph.target)
        measured = [volume(shape, self.morph.bounds, self.volume_resolution) for shape in ends]
        return torch.tensor(measured, dtype=torch.double)

    def _measure_volume(self) -> VolumeCurve:
        curve = self._curve()
        lost = _lost(curve)
        if len(lost) and (self._whole or self.global_step >= self.trainer.max_steps):
            raise Collapse(f"the shape has vanished at t = {lost[0]:.2f} by step {self.global_step}")
        self._whole = self._whole or not len(lost)
        self.volume_curve = curve
        return curve

    def _curve(self) -> VolumeCurve:
        return volume_curve(self.morph, even_times(self.volume_times), self.volume_resolution)


def _lost(curve: VolumeCurve) -> Tensor:
    """Ends at which there is no shape to speak of; on the way between them, some methods do lose it."""
    return curve.times[[0, -1]][~(curve.volumes[[0, -1]] > _VANISHED * curve.volumes.max())]
