"""Learning-rate schedules."""

from __future__ import annotations

from math import cos, pi

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


def warmup_cosine(optimizer: Optimizer, total_steps: int, warmup: float = 0.03, floor: float = 0.0) -> LambdaLR:
    """A linear rise over the first part of training, then half a cosine down.

    Args:
        optimizer: whose learning rate is the highest one.
        total_steps: steps of the whole training.
        warmup: part of the steps spent rising.
        floor: the last learning rate, relative to the highest.
    """
    rising = max(1, round(warmup * total_steps))

    def factor(step: int) -> float:
        if step < rising:
            return (step + 1) / rising
        progress = min(1.0, (step - rising) / max(1, total_steps - rising))
        return floor + (1 - floor) * (1 + cos(pi * progress)) / 2

    return LambdaLR(optimizer, factor)


def constant(optimizer: Optimizer, total_steps: int) -> LambdaLR:
    """The same learning rate throughout, as in the paper."""
    return LambdaLR(optimizer, lambda step: 1.0)
