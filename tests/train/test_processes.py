"""Processes that train together: they do what one process does with all their points, and end together."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
import torch
from hydra.core.global_hydra import GlobalHydra
from lightning.pytorch.utilities.rank_zero import rank_zero_only
from runs import BARE, same, state, train_here
from torch import Tensor

from nsm.sampling import Batch
from nsm.train.tasks import MorphTask, data

#: Two processes on the processor, which hand their gradients to each other by gloo.
TOGETHER = ("trainer.devices=2", "trainer.strategy=ddp")
#: Points that do not follow the surface, so that a batch depends on nothing but its step.
FIXED = (
    *BARE,
    "sampler.near.fraction=0",
    "sampler.ends.own=0",
    "sampler.ends.visitors=0",
    "sampler.size=100",
    "steps=4",
)
#: Steps along the gradient, as SOAP and Adam turn a gradient that vanishes up to rounding into a whole step, of the
#: terms that are means over points; the error of volume is a square of such a mean.
DESCENT = (
    *(o for o in FIXED if not o.startswith("optimizer.")),
    "loss.terms.volume.weight=0",
    "optimizer=adam",
    "optimizer._target_=torch.optim.SGD",
    "optimizer.lr=1e-7",
)


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        # shapes are fitted once, by one process
        assert train_here(*BARE, "steps=1", "validations=1", f"hydra.run.dir={tmp_path_factory.mktemp('first')}") == 0
        yield


def together(*overrides: str, prepare: Callable[[int], object] = lambda rank: None) -> list[int]:
    """Train in two copies of this process, as if something else had started both; returns their statuses."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    children = []
    for rank in range(2):
        child = os.fork()
        if child == 0:
            os.environ.update(
                LOCAL_RANK=str(rank), WORLD_SIZE="2", NODE_RANK="0", MASTER_ADDR="127.0.0.1", MASTER_PORT=port
            )
            rank_zero_only.rank = rank
            GlobalHydra.instance().clear()
            prepare(rank)
            try:
                status = train_here(*overrides, *TOGETHER)
            except BaseException as error:
                print(f"{rank}: {type(error).__name__}: {error}", file=sys.stderr)  # noqa: T201
                status = 1
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
        children.append(child)
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def joined(one: Batch, two: Batch) -> Batch:
    """The points of two batches as one batch."""
    parts = [
        torch.cat([one.points[place(one)], two.points[place(two)]])
        for place in (lambda b: b.surface, lambda b: b.ambient, lambda b: b.interior)
    ]
    distances = [
        torch.cat([one.distances[place(one)], two.distances[place(two)]])
        for place in (lambda b: b.surface, lambda b: b.ambient)
    ]
    return Batch(torch.cat(parts), torch.cat(distances), torch.cat([one.normals, two.normals]))


def test_two_processes_do_what_one_does_with_the_points_of_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert together(*DESCENT, f"hydra.run.dir={tmp_path / 'two'}") == [0, 0]

    def of_both(self: Any):
        step = self.trainer.global_step
        while True:
            yield joined(*(self.sampler.draw(data._generator(self.seed, rank, step)) for rank in range(2)))
            step += 1

    monkeypatch.setattr(data._Stream, "__iter__", of_both)
    assert train_here(*DESCENT, f"hydra.run.dir={tmp_path / 'one'}") == 0
    monkeypatch.undo()
    assert train_here(*DESCENT, f"hydra.run.dir={tmp_path / 'half'}") == 0
    one, two, half = (state(tmp_path / run)["state_dict"] for run in ("one", "two", "half"))
    weights = [name for name in one if name.startswith(("morph.field.", "morph.velocity_field."))]
    assert weights
    apart, rounding = (
        torch.cat([(run[name] - one[name]).double().flatten() for name in weights]).norm() for run in (half, two)
    )
    assert apart > 0, "half of the points alone lead elsewhere"
    assert rounding < 1e-3 * apart


def test_two_processes_resume_to_the_same_weights(tmp_path: Path) -> None:
    run = (*BARE, "steps=8", "validations=2", "optimizer.precondition_frequency=3")
    assert together(*run, f"hydra.run.dir={tmp_path / 'whole'}") == [0, 0]
    undisturbed = MorphTask.training_step

    def disturb(rank: int) -> None:
        def dying(self: MorphTask, batch: Any, index: int) -> Tensor:
            if self.global_step == 6:
                os.kill(os.getpid(), signal.SIGKILL)
            return undisturbed(self, batch, index)

        MorphTask.training_step = dying  # type: ignore[method-assign]

    folder = tmp_path / "killed"
    assert together(*run, f"hydra.run.dir={folder}", prepare=disturb) == [-signal.SIGKILL] * 2
    assert state(folder)["global_step"] == 4
    assert together(*run, f"hydra.run.dir={folder}", "resume=true") == [0, 0]
    for part in ("state_dict", "optimizer_states", "lr_schedulers", "global_step"):
        assert same(state(folder)[part], state(tmp_path / "whole")[part]), part


def test_two_processes_step_back_together_when_one_collapses(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    undisturbed = MorphTask.evaluation

    def disturb(rank: int) -> None:
        once: list[int] = []

        def broken(self: MorphTask, batch: Batch) -> Any:
            if rank == 1 and self.global_step == 2 and not once:
                once.append(2)
                batch = batch._replace(distances=batch.distances * torch.nan)
            return undisturbed(self, batch)

        MorphTask.evaluation = broken  # type: ignore[method-assign]

    assert together(*BARE, "steps=4", f"hydra.run.dir={tmp_path}", prepare=disturb) == [0, 0]
    said = capfd.readouterr().out
    assert "Collapse: the loss of another process is not finite at step 2" in said
    assert state(tmp_path)["global_step"] == 4


def test_the_first_process_keeps_its_own_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from nsm.cli.errors import InputError
    from nsm.train import processes

    child = subprocess.Popen([sys.executable, "-c", "raise SystemExit(2)"], stdin=subprocess.PIPE)
    with (
        mock.patch.object(processes, "_start", return_value=child),
        pytest.raises(InputError, match="mine"),
        processes.training_together(2, 1, (), tmp_path),
    ):
        raise InputError("`loss` must be mine, got another. Try `mine`.")
    assert "WORLD_SIZE" not in os.environ
