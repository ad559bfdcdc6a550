"""What the README tells people to type works."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from analytic import save, turning
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from runs import composed

from nsm.cli.configuration import CONF
from nsm.compare.plan import read_study

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
TEXTS = README + (ROOT / "docs" / "methods.md").read_text()
BLOCKS = re.findall(r"```(\w*)\n(.*?)```", TEXTS, re.DOTALL)
COMMANDS = [
    shlex.split(line, comments=True)[2:]
    for kind, block in BLOCKS
    if kind != "python"
    for line in block.splitlines()
    if line.startswith("python -m nsm.")
]


def single(overrides: list[str]) -> list[str]:
    """The first run of a sweep."""
    return [re.sub(r"^(\+?[^=]+)=(\[[^\]]*\]|[^,]*),.*$", r"\1=\2", override) for override in overrides]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_is_understood(command: list[str]) -> None:
    entry, *overrides = command
    overrides = [override for override in overrides if override not in {"-m", "…"}]
    if entry == "nsm.train":
        assert composed(*single(overrides)).steps > 0
        return
    with initialize_config_dir(str(CONF), version_base="1.3"):
        config = compose(entry.removeprefix("nsm."), overrides)
    if entry == "nsm.compare":
        assert read_study(OmegaConf.to_container(config, resolve=True)).methods
    else:
        assert config.checkpoint == "outputs/demo"


def test_the_make_targets_are_there() -> None:
    wanted = re.findall(r"^make (\w+)", README, re.MULTILINE)
    assert {"demo", "test"} <= set(wanted)
    makefile = (ROOT / "Makefile").read_text()
    assert all(re.search(rf"^{target}:", makefile, re.MULTILINE) for target in wanted)


def test_the_files_that_it_shows_and_names_are_there() -> None:
    for name in re.findall(r"\]\(((?!http)[^)]+)\)", README):
        assert (ROOT / name).exists(), name


def test_the_library_snippet_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save(turning(3, 0.1), tmp_path / "outputs" / "demo" / "checkpoints" / "best.ckpt")
    monkeypatch.chdir(tmp_path)
    (snippet,) = (block for kind, block in BLOCKS if kind == "python")
    exec(snippet, {})  # our own README
