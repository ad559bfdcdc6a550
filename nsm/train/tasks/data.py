"""Batches for Lightning: an endless stream in which batch i of rank r is the same in every run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

import lightning as L
import torch
from torch.utils.data import DataLoader, IterableDataset

from nsm.sampling import Batch

#: Rank from whose stream validation draws, far above any rank of training.
_VALIDATION = 1 << 20


@runtime_checkable
class Sampler(Protocol):
    """Draws one batch."""

    def draw(self, generator: torch.Generator) -> Batch:
        """Draw one batch, which depends only on the state of the generator."""
        ...


class FieldData(L.LightningDataModule):
    """Provides fresh batches for training, and one fixed batch for validation.

    Training batch i depends on the seed, the rank, and i alone. A run that stops and resumes therefore sees the same
    batches, and every rank sees different ones.

    Args:
        sampler: Sampler of training batches.
        validation: Sampler of the batch for validation.
        seed: Seed of the run.
    """

    def __init__(self, sampler: Sampler, validation: Sampler, seed: int = 0) -> None:
        super().__init__()
        self.sampler, self.validation, self.seed = sampler, validation, seed

    def train_dataloader(self) -> DataLoader:
        """Return the stream of batches from the current step."""
        assert self.trainer is not None
        return DataLoader(_Stream(self.sampler, self.seed, self.trainer), batch_size=None)

    def val_dataloader(self) -> DataLoader:
        """Return the batch for validation."""
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
    """Seed a generator for one batch by a hash, so that neighboring batches are unrelated."""
    key = hash((seed, rank, step)) & ((1 << 63) - 1)
    return torch.Generator().manual_seed(key)
