"""Learning-rate schedules."""

from __future__ import annotations

from math import cos, pi

from torch.optim import Optimizer
from torch.optim.lr_scheduler import LambdaLR


def warmup_cosine(optimizer: Optimizer, total_steps: int, warmup: float = 0.03, floor: float = 0.0) -> LambdaLR:
    """Raise the learning rate linearly at first, then lower it along half a cosine (https://arxiv.org/abs/1608.03983).

    Args:
        optimizer: Optimizer, whose learning rate is the peak.
        total_steps: Steps of the whole training.
        warmup: Fraction of the steps in which the learning rate rises.
        floor: Final learning rate relative to the peak.
    """
    rising = max(1, round(warmup * total_steps))

    def factor(step: int) -> float:
        if step < rising:
            return (step + 1) / rising
        progress = min(1.0, (step - rising) / max(1, total_steps - rising))
        return floor + (1 - floor) * (1 + cos(pi * progress)) / 2

    return LambdaLR(optimizer, factor)


def constant(optimizer: Optimizer, total_steps: int) -> LambdaLR:
    """Keep the learning rate constant, as in the paper.

    Args:
        optimizer: Optimizer.
        total_steps: Steps of the whole training.
    """
    return LambdaLR(optimizer, lambda step: 1.0)
