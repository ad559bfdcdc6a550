"""Progress of long work, where stderr is a terminal and where it is not."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

import pytest

from nsm.cli import progress
from nsm.cli.progress import Progress, duration


@pytest.fixture
def lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """Lines on stderr since the last call; they come every 20 ms."""
    monkeypatch.setattr(progress, "LINE_INTERVAL", 0.02)
    return lambda: capsys.readouterr().err.splitlines()


def wait_for(lines: Callable[[], list[str]]) -> str:
    """The last line, once there is one."""
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        if said := lines():
            return said[-1]
        time.sleep(0.01)
    pytest.fail("no line was printed")


def test_lines_come_while_a_single_call_blocks(lines) -> None:
    with Progress("solving", total=4, unit="steps") as shown:
        shown.update(completed=1, detail="loss 0.5")
        lines()
        assert re.fullmatch(r"solving: 1 of 4 steps, \d+ s elapsed, loss 0\.5", wait_for(lines))


def test_a_line_tells_the_time_left(lines) -> None:
    with Progress("solving", total=1000) as shown:
        for _ in range(3):
            time.sleep(0.03)
            shown.advance()
        lines()
        assert " left" in wait_for(lines)


def test_every_stage_ends_with_a_line(lines) -> None:
    with Progress("first", total=2) as shown:
        shown.advance(2)
        shown.stage("second [b]", total=None)
        lines()
    assert re.fullmatch(r"second \[b\]: \d+ s elapsed", lines()[-1])


def test_a_short_stage_prints_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("brief", total=1) as shown:
        shown.advance()
    assert re.fullmatch(r"brief: 1 of 1, \d+ s elapsed\n", capsys.readouterr().err)


def test_an_error_ends_it_without_a_last_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(KeyError), Progress("broken", total=1):
        raise KeyError
    assert capsys.readouterr().err == ""


def test_a_terminal_shows_a_bar(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    with Progress("drawing", total=2, unit="frames") as shown:
        shown.update(description="drawing slices", detail="half done")
        shown.advance()
    said = capsys.readouterr().err
    assert "drawing slices" in said
    assert "1 of 2 frames" in said
    assert "━" in said


@pytest.mark.parametrize(("seconds", "words"), [(0.4, "0 s"), (59.4, "59 s"), (61, "1 min 1 s"), (3700, "1 h 1 min")])
def test_durations(seconds: float, words: str) -> None:
    assert duration(seconds) == words
