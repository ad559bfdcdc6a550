"""What the viewer computes, keeps and answers, without a browser."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch
from analytic import run_here, save, sentence, shrinking, unreadable
from problems import Ball, GrowingBall, growing_ball, squashed_ball, translating_ball

from nsm.cli.errors import InputError
from nsm.geometry.meshing import extract_surface
from nsm.geometry.topology import enclosed_volume
from nsm.io.loading import LoadedMorph
from nsm.morphs.growth import Grown, VolumeLinear
from nsm.plots.colors import carried_colors
from nsm.types import SimplexMesh
from nsm.view import __main__ as view
from nsm.view.flat import filled, ribbon
from nsm.view.frames import Photographer, Picture, Settings, Surface
from nsm.view.glb import glb
from nsm.view.page import Viewer, free_port, open_server
from nsm.view.recording import record
from nsm.view.store import Key, Store

COARSE = Settings(resolution=16)


def subject(name: str = "ball", dim: int = 3) -> LoadedMorph:
    return LoadedMorph(name, name, shrinking(dim, 0.3), None)


def picture(size: int) -> Picture:
    """A picture that takes so many bytes."""
    nothing = SimplexMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long))
    return Picture(Surface(nothing, torch.zeros(0, 3), 0.0, 0.0, 0.0, 0), bytes(size))


def filled_store(limit: int, morphs: int = 1, times: int = 9, size: int = 10) -> Store:
    """A store in which everything is made that finds room."""
    store = Store(morphs, times, COARSE, limit)
    make_all(store, size)
    return store


def make_all(store: Store, size: int = 10) -> list[Key]:
    made = []
    while not store.complete:
        key = store.next()
        assert key is not None
        store.put(key, picture(size))
        made.append(key)
        assert len(made) < 1000, "the same pictures are made again and again"
    return made


def triangle_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)[:, 2] / 2


# ---------------------------------------------------------------------------------------------------------------- glb


def read_glb(content: bytes) -> tuple[dict, bytes]:
    magic, version, total = struct.unpack_from("<III", content)
    assert (magic, version, total) == (0x46546C67, 2, len(content))
    length, kind = struct.unpack_from("<II", content, 12)
    assert kind == 0x4E4F534A
    return json.loads(content[20 : 20 + length]), content[20 + length + 8 :]


@pytest.mark.parametrize("count", [5, 70_000])
def test_glb_reads_back_as_it_was_written(count: int) -> None:
    rng = np.random.default_rng(0)
    vertices, normals, colors = rng.normal(size=(count, 3)), rng.normal(size=(count, 3)), rng.random((count, 3))
    faces = rng.integers(count, size=(7, 3))
    document, body = read_glb(glb(vertices, normals, faces, colors))
    kinds = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}
    widths = {"VEC3": 3, "VEC4": 4, "SCALAR": 1}

    def array(number: int) -> np.ndarray:
        accessor = document["accessors"][number]
        start, width = document["bufferViews"][accessor["bufferView"]]["byteOffset"], widths[accessor["type"]]
        values = np.frombuffer(body, kinds[accessor["componentType"]], accessor["count"] * width, start)
        return values.reshape(-1, width)

    primitive = document["meshes"][0]["primitives"][0]
    np.testing.assert_allclose(array(primitive["attributes"]["POSITION"]), vertices, rtol=1e-6)
    np.testing.assert_array_equal(array(primitive["indices"]).reshape(-1, 3), faces)
    linear = array(primitive["attributes"]["COLOR_0"])[:, :3] / 65535
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(srgb, colors, atol=1e-3)
    np.testing.assert_allclose(array(primitive["attributes"]["NORMAL"]), normals, rtol=1e-6)


# --------------------------------------------------------------------------------------------------------------- flat


@pytest.mark.parametrize("field", [
    lambda x: x.norm(dim=1) - 0.6,
    lambda x: (x.norm(dim=1) - 0.6).abs() - 0.15,  # a ring
    lambda x: torch.minimum((x - 0.5).norm(dim=1), (x + 0.5).norm(dim=1)) - 0.3,  # two disks
])  # fmt: skip
def test_the_triangles_of_a_flat_shape_cover_its_inside(field) -> None:
    bounds = torch.tensor([[-1.0, -1.0], [1.0, 1.0]])
    mesh = extract_surface(field, bounds, 64)
    vertices, faces = filled(mesh, field, 0.0)
    areas = triangle_areas(vertices, faces)
    assert (areas >= 0).all()
    assert areas.sum() == pytest.approx(enclosed_volume(mesh), rel=2e-3)


def test_an_outline_without_inside_has_no_triangles() -> None:
    line = SimplexMesh(torch.tensor([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]]), torch.tensor([[0, 1], [1, 2]]))
    for mesh in (line, SimplexMesh(line.vertices[:2], line.simplices[:1])):
        assert filled(mesh, lambda x: x[:, 0], 0.0)[1].shape == (0, 3)


def test_a_ribbon_runs_along_its_segments_and_faces_the_viewer() -> None:
    mesh = extract_surface(lambda x: x.norm(dim=1) - 0.6, torch.tensor([[-1.0, -1.0], [1.0, 1.0]]), 32)
    vertices, faces = ribbon(mesh, 2.0)
    ends = mesh.vertices[mesh.simplices].numpy()
    corners = vertices.reshape(-1, 4, 3)
    assert np.abs(corners[:, :2, :2].mean(1) - ends[:, 0]).max() < 0.01
    assert np.abs(corners[:, 2:, :2].mean(1) - ends[:, 1]).max() < 0.01
    assert (triangle_areas(vertices, faces) > 0).all()
    assert (vertices[:, 2] > 0).all()


# ------------------------------------------------------------------------------------------------------------- frames


@pytest.mark.parametrize("dim", [2, 3])
def test_figures_of_a_growing_ball(dim: int) -> None:
    morph = growing_ball(dim)
    surface = Photographer(morph).surface(0.5, Settings(32))
    assert surface.volume == pytest.approx(morph.volume(0.5), rel=1e-3)
    assert surface.deviation == pytest.approx(morph.volume(0.5) / morph.volume(0.0) - 1, rel=1e-3)
    assert surface.components == 1


def test_the_level_offset_moves_the_surface_by_that_much() -> None:
    surface = Photographer(translating_ball(3)).surface(0.5, Settings(24, offset=0.1))
    assert surface.level == 0.1
    assert surface.volume == pytest.approx(Ball(3, 0.5).volume, rel=1e-3)


def test_frames_of_exact_volume_have_it_at_all_times() -> None:
    photographer = Photographer(GrowingBall(3, growth=0.1))
    for instant in (0.0, 0.6):
        surface = photographer.surface(instant, Settings(24, exact=True))
        assert abs(surface.deviation) < 1e-4
        assert enclosed_volume(surface.mesh) == pytest.approx(surface.volume)
    assert surface.level == pytest.approx(-0.1 * 0.6, abs=5e-3)  # that of the ball as it was at the start


def test_a_changing_volume_is_what_is_wanted() -> None:
    photographer = Photographer(Grown(squashed_ball(3), VolumeLinear(3, 1.0, 1.5)))
    assert photographer.wanted_volume(1.0) == pytest.approx(1.5 * Ball(3).volume, rel=1e-3)
    assert photographer.surface(1.0, Settings(32)).deviation == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("color", ["clay", "level_set", "eikonal", "carried"])
def test_every_color_is_given_to_every_vertex(dim: int, color: str) -> None:
    photographer, settings = Photographer(translating_ball(dim, torch.float32)), Settings(12, color=color)
    content = photographer.picture(photographer.surface(0.5, settings), 0.5, settings).glb
    assert content is not None
    document, _ = read_glb(content)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    counts = {document["accessors"][attributes[name]]["count"] for name in ("POSITION", "COLOR_0")}
    assert len(counts) == 1


def test_a_time_without_a_surface_has_no_triangles() -> None:
    photographer = Photographer(shrinking(3, 2.0))
    surface = photographer.surface(1.0, COARSE)
    assert photographer.picture(surface, 1.0, COARSE).glb is None
    assert (surface.volume, surface.components) == (0.0, 0)


def test_colors_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="give one of clay"):
        Settings(color="red").check([shrinking(3, 0.1)])
    with pytest.raises(InputError, match="needs a velocity"):
        Settings(color="carried").check([shrinking(3, 0.1)])
    Settings(color="carried").check([shrinking(3, 0.1), translating_ball(3)])  # the first is then shown in clay


# -------------------------------------------------------------------------------------------------------------- store


def test_pictures_are_made_from_the_wanted_time_outwards() -> None:
    store = Store(2, 5, COARSE, 1 << 20)
    store.want(time=2)
    order = [(key.time, key.morph) for key in make_all(store)]
    assert order[:2] == [(2, 0), (2, 1)]
    distances = [abs(number - 2) for number, _ in order]
    assert distances == sorted(distances)
    assert len(set(order)) == 10


def test_a_change_of_mind_comes_first() -> None:
    store = Store(1, 9, COARSE, 1 << 20)
    store.put(store.next(), picture(10))
    store.want(time=8)
    assert store.next() == Key(0, 8, COARSE)
    other = COARSE._replace(resolution=20)
    store.want(settings=other)
    assert store.next() == Key(0, 8, other)


def test_the_nearest_picture_stands_in_for_one_that_is_not_there() -> None:
    store = Store(1, 9, COARSE, 1 << 20)
    assert store.nearest(0) is None
    for number in (0, 5):
        store.put(Key(0, number, COARSE), picture(10))
    store.want(time=4)
    assert store.nearest(0) == Key(0, 5, COARSE)
    store.want(settings=COARSE._replace(exact=True))
    assert store.nearest(0) is None


def test_memory_keeps_what_is_near_and_the_work_ends() -> None:
    store = filled_store(limit=45)
    assert sorted(key.time for key in store.ready()) == [0, 1, 2, 3]
    store.want(time=8)
    make_all(store)
    assert sorted(key.time for key in store.ready()) == [5, 6, 7, 8]
    assert store.size <= 45


def test_the_work_ends_even_where_not_one_picture_finds_room() -> None:
    store = filled_store(limit=1, morphs=2)
    assert len(store.ready()) <= 2


def test_what_is_on_show_stays() -> None:
    store = filled_store(limit=45)
    store.show({Key(0, 0, COARSE)})
    store.want(time=8)
    make_all(store)
    assert store.get(Key(0, 0, COARSE)) is not None


def test_other_settings_go_first_and_the_latest_of_them_last() -> None:
    store = Store(1, 2, COARSE, 60)
    first, second, third = (COARSE._replace(resolution=n) for n in (20, 21, 22))
    for settings in (first, second, first, third):
        store.want(settings=settings)
        make_all(store)
    store.want(settings=third._replace(exact=True))
    gone = {key.settings for number in range(2) for key in store.put(Key(0, number, store.settings), picture(10))}
    assert gone == {second}


def test_another_color_needs_no_other_surface() -> None:
    store = filled_store(limit=1 << 20)
    held = store.get(Key(0, 3, COARSE))
    assert held is not None
    assert store.surface(Key(0, 3, COARSE._replace(color="eikonal"))) is held.surface
    assert store.surface(Key(0, 3, COARSE._replace(offset=0.1))) is None


def test_a_closed_store_lets_those_go_who_wait() -> None:
    store = filled_store(limit=1 << 20)
    waiting = threading.Thread(target=store.next)
    waiting.start()
    store.close()
    waiting.join(2)
    assert not waiting.is_alive()


# --------------------------------------------------------------------------------------------------------------- page


@pytest.fixture
def viewer() -> Iterator[Viewer]:
    viewer = Viewer([subject("left"), subject("right")], COARSE, [0.0, 0.25, 0.5, 0.75, 1.0])
    yield viewer
    viewer.close()


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
        expected = Photographer(subject().morph).surface(number / 4, settings)
        assert f"| {expected.volume:.4f} | {expected.volume:.4f} |" in viewer.figures


def test_playing_moves_time_to_and_fro(viewer: Viewer) -> None:
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


def test_a_failure_of_the_work_reaches_who_waits() -> None:
    with mock.patch.object(Photographer, "surface", side_effect=ZeroDivisionError("no")):
        viewer = Viewer([subject()], COARSE, [0.0, 1.0])
        with pytest.raises(ZeroDivisionError):
            viewer.wait(5)
        viewer.close()


def test_a_closed_viewer_leaves_port_and_threads_free() -> None:
    viewer = Viewer([subject()], COARSE, [0.0, 1.0])
    port = viewer.server.get_port()
    viewer.close()
    assert not any(thread.is_alive() for thread in viewer.threads)
    assert free_port("127.0.0.1", port) == port


def test_morphs_of_two_dimensions_are_refused() -> None:
    with pytest.raises(InputError, match="side by side"):
        Viewer([subject(), subject(dim=2)], COARSE, [0.0, 1.0])


def test_a_busy_port_is_refused_with_a_free_one() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(
            InputError, match=rf"port={port} of 127.0.0.1 is taken: give another such as port=\d+"
        ) as told:
            open_server("127.0.0.1", port)
    other = int(str(told.value).rpartition("=")[2])
    assert other != port
    assert free_port("127.0.0.1", other) == other


def test_a_host_of_nobody_is_refused() -> None:
    with pytest.raises(InputError, match=r"host=192\.0\.2\.1.*give host=127\.0\.0\.1"):
        open_server("192.0.2.1", 8080)  # an address set aside for documents


# ---------------------------------------------------------------------------------------------------------- recording


def test_a_recording_is_one_file_without_addresses_to_fetch_from(tmp_path: Path) -> None:
    steps = list(record(tmp_path / "a.html", [subject()], COARSE, [0.0, 0.5, 1.0], seconds=1.0))
    assert steps == [1, 2, 3]
    text = (tmp_path / "a.html").read_text()
    assert "__VISER_EMBED_DATA__" in text
    assert not any(tag in text.partition("<body")[0] for tag in ('src="http', 'href="http'))
    assert os.listdir(tmp_path) == ["a.html"]


def test_an_interrupted_recording_leaves_nothing(tmp_path: Path) -> None:
    work = record(tmp_path / "a.html", [subject()], COARSE, [0.0, 1.0])
    next(work)
    work.close()
    assert os.listdir(tmp_path) == []


# ------------------------------------------------------------------------------------------------------------ command


def test_the_command_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball, out = save(shrinking(3, 0.2), tmp_path / "ball.ckpt"), tmp_path / "out.html"
    assert run_here(view, f"checkpoint={ball}", "times=2", "resolution=12", f"record={out}") == 0
    assert out.stat().st_size > 0
    said = sentence(capsys.readouterr().out)
    assert f"wrote {out}" in said
    assert "has no velocity to advect detail" in said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_serves_a_page_until_it_is_told_to_end(tmp_path: Path, number: signal.Signals) -> None:
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


def test_a_machine_without_a_browser_is_told_and_served(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball = save(shrinking(2, 0.2), tmp_path / "ball.ckpt")

    def fail(_: str) -> bool:
        os.kill(os.getpid(), signal.SIGINT)
        return False

    with mock.patch("webbrowser.open", fail):
        assert run_here(view, f"checkpoint={ball}", "times=2", "resolution=12", "port=null", "open_browser=true") == 0
    assert "no browser is found on this machine: open http://127.0.0.1:" in sentence(capsys.readouterr().out)


@pytest.mark.parametrize(("override", "words"), [
    ("times=1", "times=1 cannot be"),
    ("resolution=2", "resolution=2 cannot be"),
    ("level=high", "level=high is no number"),
    ("exact_volume=3", "exact_volume=3 is neither on nor off"),
    ("seconds=0", "seconds=0 cannot be: give a number above 0"),
    ("memory=0", "memory=0 cannot be"),
    ("port=70000", "port=70000 cannot be"),
    ("color=red", "color=red is not known"),
    ("color=carried", "needs a velocity"),
    ("record=film.mp4", "record=film.mp4 is no page"),
    ("growth=volume_linear growth.source=-1", "is positive"),
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


def test_carried_colors_of_few_points_are_near_those_of_all() -> None:
    photographer, settings = Photographer(translating_ball(3, torch.float32)), Settings(96, color="carried")
    surface = photographer.surface(0.5, settings)
    document, body = read_glb(photographer.picture(surface, 0.5, settings).glb or b"")
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    linear = np.frombuffer(body, np.uint16, 4 * accessor["count"], start).reshape(-1, 4)[:, :3] / 65535
    shown = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert len(shown) > 4000
    every = carried_colors(photographer.morph, surface.mesh.vertices, 0.5).numpy()
    assert np.abs(shown - every).max() < 0.1
    assert np.abs(shown - every).mean() < 0.01
