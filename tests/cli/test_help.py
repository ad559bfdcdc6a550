"""Help of the commands: short, complete, and made of the comments in the YAML files."""

from __future__ import annotations

import sys

import pytest

import nsm.__main__ as program
from nsm.cli.groups import describe, group_folders, option_names
from nsm.cli.help import command_help

COMMANDS = [command for command in program.COMMANDS if command != "morph"]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_says_its_purpose_and_fits_a_terminal(command: str) -> None:
    said = command_help(command)
    assert said.startswith(f"usage: nsm {command} ")
    assert describe(command).purpose.endswith(".")
    assert len(describe(command).examples) == 3
    assert all(group.says.endswith(".") for group in describe(command).groups)
    examples = {f"  {example}" for example in describe(command).examples}
    assert max(len(line) for line in said.splitlines() if line not in examples) <= 80


@pytest.mark.parametrize("command", COMMANDS)
def test_every_setting_is_described(command: str) -> None:
    assert all(setting.says for setting in describe(command).settings)


def test_help_of_training_describes_every_group_and_lists_its_options() -> None:
    said = command_help("train")
    description = describe("train")
    assert {group.folder for group in description.groups} <= group_folders()
    for group in description.groups:
        assert f"  {group.typed}\n" in said
        assert group.chosen in option_names(group.folder)
    assert "*adadiv, free, nise, none, nulldiv" in said


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_the_script_lists_its_commands(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["nsm", *arguments])
    program.main()
    said = capsys.readouterr().out
    assert all(f"  {command} " in said for command in program.COMMANDS)


def test_the_script_passes_help_to_a_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["nsm", "train", "--help"])
    program.main()
    assert capsys.readouterr().out.strip() == command_help("train").strip()


def test_an_unknown_command_suggests_the_nearest(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["nsm", "tran"])
    with pytest.raises(SystemExit) as end:
        program.main()
    assert end.value.code == 2
    assert "got tran. Try `nsm train`." in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "word"),
    [("nsm ev", "evaluate"), ("nsm train optim", "optimizer="), ("nsm train velocity=n", "velocity=nise")],
)
def test_tab_completes_commands_and_settings(
    line: str, word: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COMP_LINE", line)
    monkeypatch.setattr(sys, "argv", ["nsm", "-sc", "query=bash"])
    program.main()
    assert word in capsys.readouterr().out.split()


def test_the_completion_of_the_shell_is_that_of_the_script(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["nsm", "-sc", "install=bash"])
    program.main()
    assert capsys.readouterr().out.strip().endswith("-F hydra_bash_completion nsm")
