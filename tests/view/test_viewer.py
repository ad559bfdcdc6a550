"""The page of the viewer, recordings, and the command, without a browser."""

from __future__ import annotations

import math
import os
import signal
import socket
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import msgspec
import pytest
import viser
from analytic import run_here, save, sentence, shrinking, unreadable
from pages import shown
from viser._messages import GuiUpdateMessage
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from nsm.cli.errors import InputError
from nsm.io.loading import LoadedMorph
from nsm.view import __main__ as view
from nsm.view.page import Viewer
from nsm.view.pictures import PictureMaker, Settings
from nsm.view.recording import record
from nsm.view.server import free_port, open_server, page_address
from nsm.view.store import Key

COARSE = Settings(resolution=16)
#: What a page of viser calls itself.
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


def loaded(name: str = "ball", dim: int = 3) -> LoadedMorph:
    return LoadedMorph(name, name, shrinking(dim, 0.3), None)


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    with shown([loaded("left"), loaded("right")], COARSE, [0.0, 0.25, 0.5, 0.75, 1.0]) as viewer:
        yield viewer


def until(condition, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)


def test_the_wanted_frame_is_shown_with_its_figures(viewer: Viewer) -> None:
    for number, settings in ((4, COARSE), (2, COARSE), (2, COARSE._replace(offset=0.05))):
        viewer.choose(settings)
        viewer.go(number)
        until(lambda n=number, s=settings: viewer.shown == {Key(0, n, s), Key(1, n, s)})
        expected = PictureMaker(loaded().morph).surface(number / 4, settings)
        assert f"| {expected.volume:.4f} | {expected.volume:.4f} |" in viewer.figures


def test_playback_moves_time_back_and_forth(viewer: Viewer) -> None:
    until(lambda: len(viewer.shown) == 2)
    viewer.seconds = 0.2
    viewer.play(True)
    seen: list[int] = []

    def turned() -> bool:
        number = viewer.time
        seen.extend([number] if seen[-1:] != [number] else [])
        return 4 in seen and 0 in seen[seen.index(4) :]

    until(turned)
    viewer.play(False)
    time.sleep(0.1)
    still = viewer.time
    time.sleep(0.2)
    assert viewer.time == still


def test_values_that_the_controls_do_not_offer_are_ignored(viewer: Viewer) -> None:
    controls = viewer._controls
    before = controls.settings
    for handle, value in (
        (controls._speed, "foo"),
        (controls._resolution, "3000"),
        (controls._offset, math.nan),
        (controls._color, "gold"),
    ):
        handle.value = value  # as a message from any page sets it
    assert controls.settings == before
    assert controls.speed == 1.0
    viewer.play(True)
    time.sleep(0.1)
    assert not viewer.wait(0)


def test_messages_with_senseless_values_leave_the_viewer_running(viewer: Viewer) -> None:
    controls = viewer._controls
    before = controls.settings
    for handle, value in (
        (controls._speed, "foo"),
        (controls._resolution, "3000"),
        (controls._time, "late"),
        (controls._offset, math.nan),
        (controls._exact, ["no"]),
    ):
        with connect(page_address(viewer.server).replace("http", "ws"), subprotocols=[PROTOCOL]) as page:
            page.recv(timeout=10)
            message = GuiUpdateMessage(handle._impl.uuid, {"value": value})
            page.send(msgspec.msgpack.encode(message.as_serializable_dict()))
            page.ping().wait(10)  # answered after what was sent before it
    until(lambda: controls._resolution.value == "3000")
    assert controls.settings._replace(exact=before.exact) == before
    viewer.go(2)
    until(lambda: {key.time for key in viewer.shown} == {2})
    assert not viewer.wait(0)


def test_pages_of_other_sites_are_refused(viewer: Viewer) -> None:
    address = page_address(viewer.server).replace("http", "ws")
    with connect(address, origin="http://localhost:9000"):  # through a tunnel
        pass
    for origin in ("https://example.com", "http://127.0.0.1.example.com"):
        with pytest.raises(InvalidStatus, match="403"), connect(address, origin=origin):
            pass


def test_wait_raises_the_failure_of_a_thread() -> None:
    failing = mock.patch.object(PictureMaker, "surface", side_effect=ZeroDivisionError("no"))
    with failing, shown([loaded()], COARSE, [0.0, 1.0]) as viewer, pytest.raises(ZeroDivisionError):
        viewer.wait(5)


def test_a_closed_viewer_leaves_port_and_threads_free() -> None:
    with shown([loaded()], COARSE, [0.0, 1.0]) as viewer:
        port = viewer.server.get_port()
    assert not any(thread.is_alive() for thread in viewer.threads)
    assert free_port("127.0.0.1", port) == port


def test_morphs_of_two_dimensions_are_refused() -> None:
    two = shown([loaded(), loaded(dim=2)], COARSE, [0.0, 1.0])
    with pytest.raises(InputError, match="must have the same dimension"), two:
        pass


def test_a_busy_port_is_refused_with_a_free_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            InputError, match=rf"`port` must be free, got {port}, which is in use on 127.0.0.1. Try `port=\d+`"
        ) as told:
            open_server("127.0.0.1", port)
    other = int(str(told.value).rpartition("=")[2].removesuffix("`."))
    assert other != port
    assert free_port("127.0.0.1", other) == other


def test_a_foreign_host_is_refused() -> None:
    with pytest.raises(InputError, match=r"got 192\.0\.2\.1 and 8080 .*Try `host=127\.0\.0\.1 port=8080`"):
        open_server("192.0.2.1", 8080)  # an address set aside for documents


def test_a_recording_is_one_file_without_addresses_to_fetch_from(tmp_path: Path) -> None:
    steps = list(record(tmp_path / "a.html", [loaded()], COARSE, [0.0, 0.5, 1.0], seconds=1.0))
    assert steps == [1, 2, 3]
    text = (tmp_path / "a.html").read_text()
    assert "__VISER_EMBED_DATA__" in text
    assert not any(tag in text.partition("<body")[0] for tag in ('src="http', 'href="http'))
    assert os.listdir(tmp_path) == ["a.html"]


def test_an_interrupted_recording_leaves_nothing(tmp_path: Path) -> None:
    work = record(tmp_path / "a.html", [loaded()], COARSE, [0.0, 1.0])
    next(work)
    work.close()
    assert os.listdir(tmp_path) == []


def test_the_command_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball, out = save(shrinking(3, 0.2), tmp_path / "ball.ckpt"), tmp_path / "out.html"
    assert run_here(view, f"checkpoint={ball}", "times=2", "resolution=12", f"record={out}") == 0
    assert out.stat().st_size > 0
    said = sentence(capsys.readouterr().out)
    assert f"wrote {out}" in said
    assert "has no velocity to advect detail" in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_a_page_until_a_signal_ends_it(tmp_path: Path, number: signal.Signals) -> None:
    ball, port = save(shrinking(3, 0.2), tmp_path / "ball.ckpt"), free_port("127.0.0.1", 0)
    answers: list[int] = []

    def visit() -> None:
        for _ in range(1000):
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as page:
                    answers.append(page.status)
                break
            except OSError:
                time.sleep(0.02)
        os.kill(os.getpid(), number)

    visitor = threading.Thread(target=visit)
    before = signal.getsignal(number)
    visitor.start()
    assert run_here(view, f"checkpoint={ball}", "times=2", "resolution=12", f"port={port}") == 0
    visitor.join()
    assert answers == [200]
    assert signal.getsignal(number) is before
    assert free_port("127.0.0.1", port) == port


def test_without_a_browser_the_page_is_served_with_a_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ball = save(shrinking(2, 0.2), tmp_path / "ball.ckpt")

    def fail(_: str) -> bool:
        os.kill(os.getpid(), signal.SIGINT)
        return False

    with mock.patch("webbrowser.open", fail):
        assert run_here(view, f"checkpoint={ball}", "times=2", "resolution=12", "port=null", "open_browser=true") == 0
    assert "found no browser on this machine: open http://127.0.0.1:" in sentence(capsys.readouterr().out)


@pytest.mark.parametrize(("override", "words"), [
    ("times=1", "`times` must be an integer of at least 2, got 1"),
    ("resolution=2", "`resolution` must be an integer of at least 8, got 2"),
    ("level=high", "`level` must be a finite number, got high"),
    ("exact_volume=3", "`exact_volume` must be true or false, got 3"),
    ("seconds=0", "`seconds` must be a number between 0 and 86400, got 0"),
    ("memory=0", "`memory` must be a positive integer, got 0"),
    ("port=70000", "`port` must be an integer of at most 65535, got 70000"),
    ("color=red", "`color` must be one of clay"),
    ("color=advected", "must be given a morph with a velocity"),
    ("record=film.mp4", "`record` must name an .html file, got film.mp4"),
    ("growth=volume_linear growth.source=-1", "`growth.source` must be positive and finite, got -1"),
])  # fmt: skip
def test_bad_settings_are_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], override: str, words: str
) -> None:
    ball = save(shrinking(3, 0.2), tmp_path / "ball.ckpt")
    assert run_here(view, f"checkpoint={ball}", "port=null", *override.split()) == 2
    assert words in sentence(capsys.readouterr().err)


def test_broken_checkpoints_are_refused_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file, words in unreadable(tmp_path).values():
        assert run_here(view, f"checkpoint={file}", "port=null") == 2
        told = sentence(capsys.readouterr().err)
        assert words in told
        assert "Traceback" not in told
