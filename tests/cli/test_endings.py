"""How commands end that are told to, or whose disk is full: in order, and without a traceback."""

from __future__ import annotations

import errno
import logging
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nsm.cli import entry
from nsm.cli.files import atomic_write
from nsm.cli.log_format import LogFile


def ended(main: Callable[[list[str]], None], monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["nsm morph"])
    with pytest.raises(SystemExit) as end:
        entry.run_plain(main, "morph")
    return int(end.value.code or 0)


def test_a_command_that_is_terminated_removes_its_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGTERM)

    def write(arguments: list[str]) -> None:
        with atomic_write(tmp_path / "file.txt") as temporary:
            temporary.write_text("half")
            os.kill(os.getpid(), signal.SIGTERM)

    assert ended(write, monkeypatch) == 128 + signal.SIGTERM
    assert not list(tmp_path.iterdir())
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_full_disk_is_one_sentence_whoever_notices_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def write(arguments: list[str]) -> None:
        try:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError as error:
            raise RuntimeError("a library failed") from error

    assert ended(write, monkeypatch) == entry.REFUSED
    said = capsys.readouterr().err.strip()
    assert said.startswith("nsm: `nsm morph` must be able to write its files, got: No space left on device. Try ")
    assert len(said.splitlines()) == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_messages_for_which_there_is_no_space_are_dropped_silently(capfd: pytest.CaptureFixture[str]) -> None:
    file = LogFile("/dev/full")
    for _ in range(2):
        file.handle(logging.makeLogRecord({"msg": "a message"}))
    file.close()
    assert capfd.readouterr().err == ""
