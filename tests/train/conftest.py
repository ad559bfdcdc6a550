"""Disturbances of training."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from torch import Tensor

from nsm.train.tasks import FieldTask, MorphTask


@pytest.fixture
def at_step(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Do something in the middle of a step, once."""

    def arrange(step: int, act: Callable[[], Any], task: type[FieldTask] = MorphTask) -> None:
        undisturbed, done = task.training_step, []

        def disturbed(self: FieldTask, batch: Any, index: int) -> Tensor:
            if self.global_step == step and not done:
                done.append(step)
                act()
            return undisturbed(self, batch, index)

        monkeypatch.setattr(task, "training_step", disturbed)

    return arrange
