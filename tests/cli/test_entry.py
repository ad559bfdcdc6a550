"""What all commands have in common: how names are typed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig

from nsm.cli import entry


@pytest.fixture
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """What a command gets to see of ``checkpoint`` for what was typed."""
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
