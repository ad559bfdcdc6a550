"""Entry of the commands: names of checkpoints, and training without shapes."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig
from runs import train_here

from nsm.cli import entry
from nsm.train import __main__ as train


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Values of ``checkpoint`` that a command receives for a command line."""
    monkeypatch.chdir(tmp_path)

    def run(*typed: str) -> list[object]:
        got: list[object] = []

        def main(cfg: DictConfig) -> None:
            got.append(cfg.checkpoint)

        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["nsm.evaluate", *typed])
            entry.run(main, "evaluate")
        return got

    return run


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("checkpoint=outputs/a", "outputs/a"),
        ("checkpoint=outputs/a,b.ckpt", ["outputs/a", "b.ckpt"]),
        ("checkpoint=[a,b]", ["a", "b"]),
        ("checkpoint='a,b'", "a,b"),
    ],
)
def test_several_names_need_no_brackets(seen, typed: str, expected: object) -> None:
    assert seen(typed) == [expected]


def test_a_multirun_goes_through_the_names_one_by_one(seen, tmp_path: Path) -> None:
    assert seen("-m", f"hydra.sweep.dir={tmp_path}", "checkpoint=a,b") == ["a", "b"]


def test_training_without_shapes_says_that_it_trains_the_demo(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train, "_train", lambda *arguments: None)
    demo = "No shapes were given, so this run trains the demo, cylinders into torus. See `nsm train --help`"
    assert train_here(f"hydra.run.dir={tmp_path}") == 0
    assert demo in capsys.readouterr().out
    for chosen in ("shape@target=ball", "+experiment=bust_max", "source.pose.rotation=[0,0,90]"):
        assert train_here(chosen, f"hydra.run.dir={tmp_path}") == 0
        assert "demo" not in capsys.readouterr().out
