"""Fitting of networks to the signed distances of shapes, with a cache of finished fits."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch.optim import Optimizer
from torch.optim.lr_scheduler import LRScheduler

from nsm.cli.cache import cache_folder, require_writable_cache, writing_to_cache
from nsm.cli.errors import InputError
from nsm.fields import ScalarSiren
from nsm.io.checkpoint import FORMAT, load_shape, save_shape
from nsm.losses import WeightedSum
from nsm.sampling import Box, Fractions, Pools, SdfSampler
from nsm.shapes import FieldShape, Shape, Similarity, SirenShape, working_box
from nsm.shapes.normalize import HALF_SIDE
from nsm.train.tasks.base import Collapse
from nsm.train.tasks.data import FieldData
from nsm.train.tasks.sdf import SdfTask

log = logging.getLogger(__name__)

#: Version of the fits; raise it whenever a change makes fits in the cache obsolete.
_VERSION = 2
#: Points on the surface at which validation measures a fit.
_VALIDATION_POINTS = 8000


class SdfFit:
    """Recipe that fits a network g to the signed distance of a shape.

    Args:
        network: Factory of g, called with ``in_features``.
        loss: Loss terms.
        optimizer: Factory of the optimizer, see `nsm.train.tasks.FieldTask`.
        scheduler: Factory of the schedule, see `nsm.train.tasks.FieldTask`.
        steps: Number of optimizer steps.
        size: Points in a batch.
        fractions: Fractions of a batch on the surface and around it.
        pool: Points on and around the shape whose targets are computed once.
        half_width: Half the edge h of the box [−h, h]^d in which g is fitted, since f may start from it there.
        tolerance: Mean distance of the surface of g from the shape above which a fit has failed.
        seed: Seed of the weights, the pools, and the batches.
        settings: All of the above as plain values; with the content of the shape, they identify the fit in the cache.
        trainer: Factory of the trainer of a fit, called with ``max_steps``.
    """

    def __init__(
        self,
        network: Callable[..., ScalarSiren],
        loss: WeightedSum,
        optimizer: Callable[..., Optimizer],
        scheduler: Callable[..., LRScheduler],
        steps: int,
        size: int,
        fractions: Fractions,
        pool: int,
        half_width: float,
        tolerance: float,
        seed: int,
        settings: Mapping[str, Any],
        trainer: Callable[..., L.Trainer],
    ) -> None:
        self.network, self.loss = network, loss
        self.optimizer, self.scheduler = optimizer, scheduler
        self.steps, self.size, self.fractions, self.pool, self.seed = steps, size, fractions, pool, seed
        self.half_width, self.tolerance = half_width, tolerance
        self.settings, self.trainer = dict(settings), trainer

    def prepare(self, shape: Shape) -> tuple[SdfTask, FieldData]:
        """Prepare the task and the data that fit a shape.

        Raises:
            InputError: If the shape leaves the box [-1, 1]^d.
        """
        _require_in_box(shape)
        box = Box(shape.dim, self.half_width)
        pools = draw_pools(shape, self.pool, self.seed, self.half_width)
        data = FieldData(
            SdfSampler(pools, box, self.size, self.fractions),
            SdfSampler(pools, box, _VALIDATION_POINTS, Fractions(surface=1.0, ambient=0.0)),
            self.seed,
        )
        with torch.random.fork_rng():
            torch.manual_seed(self.seed)
            network = self.network(in_features=shape.dim)
        return SdfTask(network, self.loss, self.optimizer, self.scheduler), data

    def __call__(self, shape: Shape) -> SirenShape:
        """Return the network of a shape in the box, from the cache if the same fit was made before.

        Raises:
            InputError: If the fit fails twice.
        """
        with torch.random.fork_rng():  # later draws must not depend on whether the fit was in the cache
            return self._loaded_or_fitted(shape)

    def _loaded_or_fitted(self, shape: Shape) -> SirenShape:
        file = cache_folder() / "sdf" / f"{self._key(shape)}.ckpt"
        if file.is_file() and (cached := _cached(file)) is not None:
            return cached
        require_writable_cache()
        kind = shape.provenance()["kind"]
        log.info("Fitting a network to the %s in %d steps, once; it is kept in %s", kind, self.steps, file.parent)
        fitted = self.as_shape(self._fitted(shape), shape)
        with writing_to_cache():
            save_shape(file, fitted)
        return fitted

    def _fitted(self, shape: Shape) -> SdfTask:
        """Fit; after a collapse, or if the surface stays far from the shape, once more with half the learning rate."""
        for scale in (1.0, 0.5):
            task, data = self.prepare(shape)
            task.step_scale = scale
            trainer = self.trainer(
                max_steps=self.steps, val_check_interval=self.steps, logger=False, enable_checkpointing=False
            )
            try:
                trainer.fit(task, data)
                error = float(trainer.callback_metrics["val/error"])
                if error < self.tolerance:
                    return task
                problem = f"its surface is {error:.2g} away from the shape on average"
            except Collapse as collapse:
                problem = str(collapse)
            log.warning("The fit failed with %g of the learning rate: %s.", scale, problem)
        raise InputError(
            f"The fit of a network to the {shape.provenance()['kind']} must succeed, got two failures ({problem}). "
            "Try a quarter of `sdf.optimizer.lr`, or more `sdf.steps`."
        )

    def as_shape(self, task: SdfTask, shape: Shape) -> SirenShape:
        """Return the network of a finished fit as a shape with the pose and origin of the one it was fitted to."""
        provenance = shape.provenance()
        pose = Similarity.read(provenance["similarity"], shape.dim)
        origin = {key: value for key, value in provenance.items() if key != "similarity"}
        domain = (self.half_width * working_box(shape.dim)).tolist()
        return SirenShape.from_network(task.network, pose, origin, domain)

    def _key(self, shape: Shape) -> str:
        settings = json.dumps([FORMAT, _VERSION, shape.content_key(), self.settings], sort_keys=True)
        return hashlib.sha256(settings.encode()).hexdigest()[:32]


def draw_pools(shape: Shape, count: int, seed: int, half_width: float = 1.0) -> Pools:
    """Draw points on a shape, and around it in the box [−h, h]^d, with their targets."""
    generator = torch.Generator().manual_seed(seed)
    box = half_width * working_box(shape.dim)
    return Pools(shape.surface_samples(count, generator), shape.distance_samples(count, generator, box))


def realize(shape: Shape, fit: SdfFit) -> FieldShape:
    """Return a shape as a field: itself if it is one already, otherwise the network fitted to it.

    The fit is made where the shape fills the box, and the network is then moved back to where the shape is.
    """
    if isinstance(shape, FieldShape):
        return shape
    place = Similarity.centering(shape.exact_bounds(), HALF_SIDE)
    return fit(shape.transformed(place)).transformed(place.inverse())


def _require_in_box(shape: Shape) -> None:
    low, high = shape.exact_bounds()
    excess = float(torch.cat([-1 - low, high - 1]).max())
    if excess > 1e-6:
        corners = [", ".join(f"{v:.3g}" for v in corner.tolist()) for corner in (low, high)]
        raise InputError(
            f"The {shape.provenance()['kind']} must lie in [-1, 1]^{shape.dim} to be fitted, got one from "
            f"({corners[0]}) to ({corners[1]}). Try `source.fit=0.8`, or another `source.pose`."
        )


def _cached(file: Path) -> SirenShape | None:
    """Load a cached fit; one that is cut or has weights that are not finite causes a warning."""
    try:
        shape = load_shape(file)
    except InputError:
        log.warning("The cached fit %s cannot be read and is made again.", file)
        return None
    if not all(bool(value.isfinite().all()) for value in shape.state_dict().values()):
        log.warning("The cached fit %s has weights that are not finite and is made again.", file)
        return None
    return shape
