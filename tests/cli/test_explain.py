"""Command lines that Hydra rejects are explained in the form of all other errors."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from nsm.cli import entry

TEMPLATE = re.compile(r"^`[^`]+` must .+, got .+\. Try `.+")


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path):
    """The sentence with which a command line is refused; the command itself does nothing but resolve."""
    monkeypatch.chdir(tmp_path)

    def run(*typed: str, command: str = "train") -> str:
        def main(cfg: DictConfig) -> None:
            OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)

        monkeypatch.setattr(sys, "argv", [f"nsm {command}", *typed])
        with pytest.raises(SystemExit) as end:
            entry.run(main, command)
        assert end.value.code == 2
        said = capsys.readouterr().err.strip().removeprefix("nsm: ")
        assert TEMPLATE.match(said), said
        assert "\n" not in said
        return said

    return run


@pytest.mark.parametrize(
    ("typed", "suggestion"),
    [
        ("stepps=3", "steps=3"),
        ("sampler.sizes=3", "sampler.size=3"),
        ("loss.terms.eikonal.wait=1", "loss.terms.eikonal.weight=1"),
        ("metod=nise", "method=nise"),
        ("volume_times=5", "task.volume_times=5"),
        ("source.path=a.obj", "shape@source=file source.path=a.obj"),
        ("experiment=bust_max", "+experiment=bust_max"),
        ("~stepps", "steps=VALUE"),
        ("xyzzy=3", "nsm train --help"),
    ],
)
def test_an_unknown_setting_suggests_the_nearest(refused, typed: str, suggestion: str) -> None:
    said = refused(typed)
    assert f"Try `{suggestion}`." in said
    assert said.startswith(f"`{typed.partition('=')[0].lstrip('~')}` must ")


@pytest.mark.parametrize(
    ("typed", "suggestion"),
    [
        ("method=adadif", "method=adadiv"),
        ("shape@source=mush", "shape@source=mesh"),
        ("shape@target=a.stl", "shape@target=file target.path=a.stl"),
        ("+experiment=bustmax", "+experiment=bust_max"),
        ("hydra/launcher=wrkers", "hydra/launcher=workers"),
    ],
)
def test_an_unknown_option_suggests_the_nearest(refused, typed: str, suggestion: str) -> None:
    assert f"Try `{suggestion}`." in refused(typed)


def test_an_unknown_option_lists_the_known_ones(refused) -> None:
    said = refused("beta=cubic")
    assert said.startswith("`beta` must be one of gaussian, quadratic, quartic, rational, got cubic.")


@pytest.mark.parametrize(
    ("typed", "suggestions"),
    [
        (["a.obj"], ["shape@source=file source.path=a.obj"]),
        (["shape@source=ball", "b.xyz"], ["shape@source=file source.path=b.xyz"]),
        (["net.pth"], ["shape@source=file source.path=net.pth"]),
        (["source=ball"], ["shape@source=ball"]),
        (["target=a.obj"], ["shape@target=file target.path=a.obj"]),
        (["shape=mesh"], ["shape@source=mesh"]),
        (["shape@sorce=mesh"], ["shape@source=mesh"]),
    ],
)
def test_a_shape_without_its_group(refused, typed: list[str], suggestions: list[str]) -> None:
    said = refused(*typed)
    assert all(f"Try `{suggestion}`." in said for suggestion in suggestions), said


def test_a_bare_checkpoint(refused) -> None:
    assert "Try `checkpoint=run.ckpt`." in refused("run.ckpt", command="evaluate")


def test_a_path_that_was_not_given(refused) -> None:
    assert refused("shape@source=mesh") == "`source.path` must be given, got nothing. Try `source.path=FILE`."


@pytest.mark.parametrize(
    ("typed", "suggestion"),
    [
        (["steps"], "steps=4000"),
        (["--steps", "100"], "steps=100"),
        (["--optimizer.lr=1e-3"], "optimizer.lr=1e-3"),
        (["name=a=b"], "\"name='a=b'\""),
        (["seed=1,2"], "seed=[1,2]"),
        (["+seed=1"], "seed=1"),
        (["seed=${sed}"], "nsm train --help"),
    ],
)
def test_a_malformed_override(refused, typed: list[str], suggestion: str) -> None:
    assert f"Try `{suggestion}`" in refused(*typed)
