"""Training of a morph: the networks of f and V together."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.cli.settings import invalid
from nsm.losses import BatchEvaluation, WeightedSum
from nsm.metrics import VolumeCurve
from nsm.morphs.neural import NeuralMorph
from nsm.sampling import Batch, Box, EndSurfaces, MovingSurface
from nsm.shapes import LandmarkPairs
from nsm.train.tasks.base import Collapse, FieldTask
from nsm.train.tasks.validation import Validator
from nsm.types import Key

#: Fraction of the volume of a shape below which a morph has lost its surface at the time of the shape.
_VANISHED = 0.02
#: Factor up to which a volume is like that of a shape.
_LIKE = 2.0
#: Mean ‖∇f‖ on the shapes above which f is noise, which distance and volume alone may not reveal.
_STEEP = 100.0


class MorphTask(FieldTask):
    """Trains f and V together; the shapes that the morph passes through stay fixed.

    Validation measures the extracted surface (`nsm.train.tasks.validation`), in units of length:

    - ``val/distance``, the mean of ``val/shape_to_morph`` and ``val/morph_to_shape``: |f|/‖∇f‖ at fixed points of the
      shapes, and |g| at points of the extracted surface of f at their times, which includes leftover pieces;
    - ``val/drift``, the displacement of the surface that causes the largest error of volume, r V^(1/d) / d with V the
      volume of the source and r the greater of ``val/volume_max`` (|V(t)/V(0) − 1|) and ``val/volume_error`` (the
      relative difference between the volumes of f and of the shapes), or ``val/volume_error`` alone for shapes of
      different volumes, between which none is wanted;
    - ``val/leftover``, the root mean square distance of the surface from its main components, as many as the shapes
      before and after have, at the time when it is greatest; ``val/leftover_volume`` is the share of volume of the
      others, and ``val/components`` the most components at any time.

    The best checkpoint is the one with the least ``val/error`` = distance + drift + leftover. Validation also puts
    ``morph.bounds`` around the moving shape; ``val/beyond`` is the share of volume beyond the training box.

    Args:
        morph: Networks and end shapes.
        near: Sampler of interior points near the moving surface.
        ends: Sampler of ambient points on the surface of f at the times of the shapes.
        box: Training box, in which all other points are drawn.
        loss: Weighted terms.
        optimizer: Factory of the optimizer, see `FieldTask`.
        scheduler: Factory of the schedule, see `FieldTask`.
        volume_resolution: Cells along the training box with which validation extracts the surface; up to five times as
            many for thin shapes.
        volume_times: Number of evenly spaced times at which validation measures, at least 2; it also measures at those
            of the shapes.
        landmarks: Corresponding points of the end shapes, for losses that need them.

    Raises:
        InputError: If ``volume_times`` is less than 2.
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
        if volume_times < 2:
            raise invalid("task.volume_times", "an integer of at least 2", volume_times, 11)
        self.validator = Validator(morph, box.half_width, volume_resolution, volume_times)
        self.landmarks = landmarks
        #: Whether there has been a surface at all keys, which must then stay; f with random weights has none at first.
        self._whole = False
        #: The curve of the last validation.
        self.volume_curve: VolumeCurve | None = None
        for key in morph.keys:
            key.shape.requires_grad_(False)

    def evaluation(self, batch: Batch) -> BatchEvaluation:
        """Evaluate f and V at the points of a batch."""
        morph = self.morph
        near = self.near.place(batch, self.box.half_width)
        distances = [Key(key.time, key.shape.true_distance) for key in morph.keys]
        placed = self.ends.place(near, self.near, self.box.half_width, distances)
        known = self.landmarks and LandmarkPairs(*(points.to(placed.points) for points in self.landmarks))
        progress = self.global_step / self.trainer.max_steps
        return BatchEvaluation(placed, morph.field, morph.velocity_field, known, progress, morph.keys)

    def learn_from(self, evaluation: BatchEvaluation) -> None:
        """Let the samplers follow the moving surface."""
        self.near.follow(evaluation.batch, evaluation.interior)
        self.ends.follow(evaluation.batch, evaluation.f)

    @torch.no_grad()
    def on_train_start(self) -> None:
        super().on_train_start()
        volumes = torch.tensor([self.validator.look(key.time).volume for key in self.morph.keys])
        self._whole = self._whole or self._is_whole(volumes)

    @torch.no_grad()
    def validation_step(self, batch: Batch, index: int) -> None:
        """Measure ends, volume curve, and components, and fit the box around the moving shape."""
        on = batch.points[batch.surface]
        jet = self.morph.field.jet(on)
        slope = jet.gradient[:, : self.morph.dim].norm(dim=1)
        if not slope.mean() < _STEEP:
            raise Collapse(f"the mean of ‖∇f‖ on the shapes has grown to {slope.mean():.3g} by step {self.global_step}")
        found = self.validator.validate(self.global_step)
        self._require_surface(found.curve)
        self.morph.enclose(found.box)
        self.volume_curve = found.curve
        shape_to_morph = float((jet.value.abs() / slope).mean())
        distance = (shape_to_morph + found.morph_to_shape) / 2
        self.log_dict(
            {
                "val/distance": distance,
                "val/shape_to_morph": shape_to_morph,
                "val/morph_to_shape": found.morph_to_shape,
                "val/slope": slope.mean(),
                "val/volume_std": found.volume_std,
                "val/volume_max": found.volume_max,
                "val/volume_error": found.volume_error,
                "val/drift": found.drift,
                "val/beyond": found.beyond,
                "val/components": float(found.components),
                "val/leftover": found.leftover.distance,
                "val/leftover_volume": found.leftover.share,
                "val/error": distance + found.drift + found.leftover.distance,
            },
            batch_size=len(on),
        )

    def _require_surface(self, curve: VolumeCurve) -> None:
        """Raise a `Collapse` if a surface that was there at a key is gone, or never came."""
        # between the keys, some baselines do lose the surface
        at_keys = self.validator.at_keys
        volumes = curve.volumes[at_keys]
        lost = curve.times[at_keys][~(volumes > _VANISHED * self.validator.key_volumes)]
        if len(lost) and self._whole:
            raise Collapse(f"the shape has vanished at t = {lost[0]:.2f} by step {self.global_step}")
        if len(lost) and self.global_step >= self.trainer.max_steps:
            raise Collapse(f"f has no surface at t = {lost[0]:.2f} after all {self.global_step} steps")
        self._whole = self._whole or self._is_whole(volumes)

    def _is_whole(self, volumes: Tensor) -> bool:
        """Whether volumes at the keys are like those of the shapes, as that of f with random weights is not."""
        ratio = volumes / self.validator.key_volumes
        return bool(((ratio > 1 / _LIKE) & (ratio < _LIKE)).all())
