"""Batches for Lightning: an endless stream in which batch i of rank r is the same in every run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import lightning as L
import torch
from torch.utils.data import DataLoader, IterableDataset

from nsm.sampling import Batch

#: Validation draws from a stream of its own, far away from any rank of training.
_VALIDATION = 1 << 20


@runtime_checkable
class Sampler(Protocol):
    """Draws one batch."""

    def draw(self, generator: torch.Generator) -> Batch:
        """One batch; the same for a generator in the same state."""
        ...


class FieldData(L.LightningDataModule):
    """Feeds a task with fresh batches, and validates on one that never changes.

    Training batch i depends on the seed, the rank and i alone, so a run that stops and resumes sees what it would
    have seen, and every rank sees something else.

    Args:
        sampler: draws training batches.
        validation: draws the one batch that training is judged by.
        seed: the seed of the run.
    """

    def __init__(self, sampler: Sampler, validation: Sampler, seed: int = 0) -> None:
        super().__init__()
        self.sampler, self.validation, self.seed = sampler, validation, seed

    def train_dataloader(self) -> DataLoader:
        """The stream, from the step that training stands at."""
        assert self.trainer is not None
        return DataLoader(_Stream(self.sampler, self.seed, self.trainer), batch_size=None)

    def val_dataloader(self) -> DataLoader:
        """One batch."""
        return DataLoader([self.validation.draw(_generator(self.seed, _VALIDATION, 0))], batch_size=None)  # type: ignore[arg-type]


class _Stream(IterableDataset):
    def __init__(self, sampler: Sampler, seed: int, trainer: L.Trainer) -> None:
        self.sampler, self.seed, self.trainer = sampler, seed, trainer

    def __iter__(self) -> Iterator[Batch]:
        step = self.trainer.global_step * self.trainer.accumulate_grad_batches
        while True:
            yield self.sampler.draw(_generator(self.seed, self.trainer.global_rank, step))
            step += 1


def _generator(seed: int, rank: int, step: int) -> torch.Generator:
    """A generator for one batch; the three numbers are hashed so that neighbours have nothing in common."""
    key = hash((seed, rank, step)) & ((1 << 63) - 1)
    return torch.Generator().manual_seed(key)
