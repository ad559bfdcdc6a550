"""Pixels of rendered pictures, and a morph that is quick to render."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from problems import Ball, LinearMotion


def picture(path: Path) -> np.ndarray:
    """Read a picture as integers (height, width, 3)."""
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def colored(pixels: np.ndarray) -> np.ndarray:
    """Mask of the pixels that show the shape: paper and shadow are gray."""
    return pixels.max(-1) - pixels.min(-1) > 12


def middle(mask: np.ndarray) -> np.ndarray:
    """Mean row and column of the marked pixels."""
    return np.argwhere(mask).mean(0)


class Sliding(LinearMotion):
    """A ball that crosses the box, faster to compute than as a linear motion."""

    def __init__(self) -> None:
        super().__init__(Ball(3), drift=[0.6, 0.3, -0.2], start=[-0.3, -0.15, 0.1])

    def _back(self, x, t):
        return self._centered(x, t), torch.eye(3, dtype=x.dtype).expand(len(x), 3, 3)
