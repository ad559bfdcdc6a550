"""Types and ranges of the settings of training, by patterns of dotted names (`nsm.cli.schema`)."""

from __future__ import annotations

from functools import partial

from nsm.cli import settings
from nsm.cli.checks import (
    Check,
    any_text,
    betas,
    devices,
    entries,
    filled,
    frequencies,
    labels,
    optional,
    points,
    rising,
    rotation,
    section,
)
from nsm.cli.settings import (
    at_least,
    between,
    choice,
    fraction,
    moments,
    number,
    numbers,
    positive,
    switch,
    text,
    whole_number,
)

#: Most cells along the box, and pixels along a picture.
_MOST_CELLS, _MOST_PIXELS = 4096, 16384
#: Most points in memory, and most steps.
_MOST_POINTS, _MOST_STEPS = 10**8, 10**9
#: Largest seed of numpy, which Lightning seeds as well.
_MOST_SEED = 2**32 - 1


_count = partial(whole_number, most=_MOST_POINTS)
_steps = partial(whole_number, most=_MOST_STEPS, example=1000)
_cells = partial(whole_number, least=2, most=_MOST_CELLS, example=96)
_pixels = partial(whole_number, least=16, most=_MOST_PIXELS, example=400)
_times = partial(whole_number, least=2, most=100_000, example=11)
_weight = partial(at_least, least=0.0, example=1.0)
_vector = partial(numbers, lengths=(2, 3), example="[0,0,0]")
_seed = partial(whole_number, least=0, most=_MOST_SEED)

#: Checks of the settings of training, by patterns of dotted names.
TRAINING: dict[str, Check] = {
    "name": text,
    "seed": _seed,
    "sdf.seed": _seed,
    "steps": _steps,
    "validations": _steps,
    "equal_volume": switch,
    "resume": switch,
    "task": section,
    "task.kind": partial(choice, known=("morph", "sdf", "ot")),
    "task.volume_resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=64),
    "task.volume_times": _times,
    "task.transport": section,
    "task.transport.points": _count,
    "task.transport.anchors": partial(whole_number, most=10**5),
    "task.transport.blur": partial(between, low=0, high=10, example=0.05),
    "task.transport.scaling": partial(between, low=0, high=1, example=0.8),
    "task.transport.kernel": partial(between, low=0, high=10, example=0.02),
    "task.transport.resolution": partial(whole_number, least=8, most=_MOST_CELLS, example=200),
    # shapes
    "source": section,
    "target": section,
    "**.pose": optional(section),
    "**.pose.rotation": optional(rotation),
    "**.pose.translation": optional(_vector),
    "**.pose.scale": positive,
    "**.path": text,
    "**.fit": optional(partial(settings.up_to, most=1.0, example=0.8)),
    "**.up": optional(_vector),
    "**.label": optional(labels),
    "**.spacing": optional(partial(numbers, lengths=(3,), example="[1,1,1]")),
    "**.threshold": optional(partial(between, low=0, high=1, example=0.5)),
    "source.omega": optional(partial(positive, example=60.0)),
    "target.omega": optional(partial(positive, example=60.0)),
    "between": section,
    "between.*": section,
    "between.*.omega": optional(partial(positive, example=60.0)),
    "between.*.size": _vector,
    "times": optional(rising),
    "**.center": _vector,
    "**.radius": positive,
    "**.height": positive,
    "**.major": positive,
    "**.minor": positive,
    "source.size": _vector,
    "target.size": _vector,
    "**.vertices": partial(points, lengths=(2,)),
    "**.shapes": entries,
    "landmarks": optional(section),
    "landmarks.source": points,
    "landmarks.target": points,
    "landmarks.source_mesh": text,
    "landmarks.target_mesh": text,
    "landmarks.source_vertices": optional(entries),
    "landmarks.target_vertices": optional(entries),
    # networks
    "velocity": optional(section),
    "velocity.scale": number,
    "velocity.decay": _weight,
    "velocity.network": section,
    "velocity.beta": section,
    "beta.alpha": partial(positive, example=0.1),
    "beta.width": positive,
    "network.field": section,
    "network.velocity": section,
    "**.hidden_features": partial(whole_number, most=8192, example=128),
    "**.hidden_layers": partial(whole_number, most=64, example=6),
    "**.omega": frequencies,
    "**.first_omega": optional(positive),
    "init.factor": positive,
    # losses
    "**.terms": filled,
    "**.terms.**.weight": _weight,
    "**.terms.**.power": partial(between, low=0, high=100, example=2.0),
    "**.terms.**.alpha": _weight,
    "**.terms.**.start": fraction,
    "**.terms.**.stop": fraction,
    "**.terms.**.steps": partial(whole_number, most=10**4),
    "**.terms.**.count": _count,
    "**.terms.*": section,
    "**.term": section,
    # points
    "**.fractions": section,
    "**.surface": fraction,
    "**.ambient": fraction,
    "sampler.box": section,
    "sampler.near": section,
    "sampler.ends": section,
    "sampler.time": section,
    "sampler.size": partial(whole_number, most=10**7, example=5000),
    "sdf.size": partial(whole_number, most=10**7, example=5000),
    "**.pool": partial(whole_number, most=_MOST_POINTS, example=200_000),
    "**.half_width": partial(settings.up_to, most=100.0, example=1.5),
    "sampler.near.fraction": fraction,
    "sampler.ends.own": fraction,
    "sampler.ends.visitors": fraction,
    "sampler.*.width": positive,
    "sampler.*.reach": positive,
    "sampler.time.start": number,
    "sampler.time.stop": number,
    # optimization
    "**.lr": partial(between, low=0, high=1e3, example=1e-3),
    "**.betas": betas,
    "**.weight_decay": _weight,
    "**.precondition_frequency": _steps,
    "**.warmup": fraction,
    "**.floor": fraction,
    "sdf.network": section,
    "sdf.loss": section,
    "sdf.optimizer": section,
    "sdf.scheduler": section,
    "sdf.steps": _steps,
    "sdf.tolerance": positive,
    # Lightning
    "trainer.accelerator": partial(choice, known=("auto", "cpu", "gpu", "cuda", "mps", "tpu")),
    "trainer.devices": devices,
    "trainer.num_nodes": partial(whole_number, most=_MOST_POINTS),
    "trainer.strategy": text,
    "trainer.precision": partial(choice, known=("32-true", "64-true")),
    "trainer.enable_model_summary": switch,
    "trainer.num_sanity_val_steps": partial(whole_number, least=0, most=1000),
    "trainer.check_val_every_n_epoch": optional(_steps),
    "trainer.max_epochs": partial(whole_number, least=-1, most=_MOST_STEPS),
    "trainer.accumulate_grad_batches": partial(whole_number, most=_MOST_STEPS),
    "trainer.gradient_clip_val": optional(positive),
    "trainer.log_every_n_steps": _steps,
    "callbacks.*.times": optional(moments),
    "callbacks.*.resolution": _cells,
    "callbacks.*.every": _steps,
    "callbacks.*.size": _pixels,
    "**.folder": text,
    "**.save_dir": text,
    "logger.*.version": any_text,
    "logger.*.name": any_text,
    "logger.wandb.project": text,
    "logger.wandb.offline": switch,
    "logger.*": section,
    "callbacks.*": section,
}
