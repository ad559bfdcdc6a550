"""Training that collapses steps back once, with half the learning rate, and then gives up."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from runs import BARE, train_here
from test_resume import RUN, rows, state, through
from torch import Tensor

from nsm.io.checkpoint import load_morph
from nsm.losses import WeightedSum
from nsm.train.tasks import MorphTask

#: A learning rate that is far too high, and nothing else.
WILD = (*BARE, "steps=24", "validations=3", "optimizer=adam", "scheduler=constant", "optimizer.lr=3")


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def test_a_collapse_goes_back_to_the_last_good_checkpoint_with_half_the_step(tmp_path: Path, at_step: Any) -> None:
    sound = WeightedSum.__call__
    with pytest.MonkeyPatch.context() as patch:

        def ill() -> None:
            def once(self: WeightedSum, evaluation: Any) -> Any:
                patch.setattr(WeightedSum, "__call__", sound)
                total, terms = sound(self, evaluation)
                return total * torch.nan, {**terms, "eikonal": terms["eikonal"] * torch.nan}

            patch.setattr(WeightedSum, "__call__", once)

        at_step(13, ill)
        assert train_here(*RUN, "scheduler=constant", f"hydra.run.dir={tmp_path}") == 0
    told = (tmp_path / "train.log").read_text()
    assert "the loss eikonal is not finite at step 13. Going back to the last good checkpoint with 0.5 of" in told
    assert state(tmp_path)["global_step"] == 24
    assert state(tmp_path)["lr_schedulers"][0]["base_lrs"] == [0.5e-4]
    assert state(tmp_path)["optimizer_states"][0]["param_groups"][0]["lr"] == 0.5e-4
    assert [r["step"] for r in rows(tmp_path) if r["train/loss"]] == [str(i) for i in range(24)]
    assert "val/error" in json.loads((tmp_path / "summary.json").read_text())


def test_a_second_collapse_ends_with_a_sentence_and_leaves_the_last_good_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    undisturbed = MorphTask.training_step

    def blown_up(self: MorphTask, batch: Any, index: int) -> Tensor:
        if self.global_step >= 10:
            with torch.no_grad():
                next(self.parameters()).mul_(torch.nan)
        return undisturbed(self, batch, index)

    monkeypatch.setattr(MorphTask, "training_step", blown_up)
    assert train_here(*RUN, f"hydra.run.dir={tmp_path}") == 2
    said = capsys.readouterr().err
    assert "nsm: Training must stay stable, got two collapses (the loss level_set, dirichlet" in said
    assert "Try a quarter of `optimizer.lr`, or a larger `sampler.size`." in said
    assert "Traceback" not in said
    assert state(tmp_path)["global_step"] == 8
    assert all(value.isfinite().all() for value in load_morph(tmp_path).state_dict().values())


def test_a_shape_that_vanishes_is_noticed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train_here(*WILD, f"hydra.run.dir={tmp_path}") == 2
    assert "nsm: Training must stay stable, got two collapses (the " in capsys.readouterr().err
    assert "Going back to the beginning with 0.5 of the learning rate" in (tmp_path / "train.log").read_text()
    assert not (tmp_path / "checkpoints" / "last.ckpt").exists()


def test_a_collapse_does_not_go_back_to_the_checkpoint_of_an_older_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at_step: Any
) -> None:
    through(tmp_path, *RUN, "seed=5", "steps=2", "validations=1")
    assert train_here(*WILD, f"hydra.run.dir={tmp_path}") == 2
    assert "Going back to the beginning" in (tmp_path / "train.log").read_text()


def test_a_surface_of_random_weights_may_vanish_before_the_shape_appears(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    slow = ("method=lipmlp", "network=small", "sampler.size=100", "sampler.pool=500", "task.volume_resolution=16")
    short = ("steps=45", "validations=3", "callbacks=none", "threads=1", f"hydra.run.dir={tmp_path}")
    assert train_here("+experiment=cylinders_torus", *slow, *short) == 2
    assert "got two collapses (f has no surface at t = 0.00 after all 45 steps)" in capsys.readouterr().err
    assert "vanished" not in (tmp_path / "train.log").read_text()
