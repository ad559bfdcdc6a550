"""The studio without a browser: files it takes and refuses, landmarks, training, and downloads."""

from __future__ import annotations

import io
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import imageio.v3 as imageio
import msgspec
import numpy as np
import pytest
import torch
import trimesh
import viser
from analytic import FREQUENCY, run_here, save, sentence, shrinking
from pages import JobHere, studio_page
from runs import TINY
from viser._messages import FileTransferPart, FileTransferStartUpload
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from nsm.cli.errors import InputError
from nsm.io.checkpoint import load_morph
from nsm.io.loading import load_run
from nsm.shapes import LandmarkTable
from nsm.view import __main__ as view
from nsm.view.clicks import Clicks
from nsm.view.notice import Notice
from nsm.view.pictures import PictureMaker, Settings
from nsm.view.preview import Preview, first_hit
from nsm.view.result_page import ResultPage, Viewing
from nsm.view.server import page_address
from nsm.view.setup import Setup
from nsm.view.studio import Studio
from nsm.view.training_page import strip
from nsm.view.training_run import read_progress
from nsm.view.uploads import safe_name

LIMIT = 1 << 20


@pytest.fixture
def studio(tmp_path: Path) -> Iterator[Studio]:
    with studio_page(tmp_path / "runs", limit=LIMIT) as studio:
        yield studio


@pytest.fixture
def jobs_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands of the page run in this process; `test_studio_browser.py` runs them as users do."""
    monkeypatch.setattr("nsm.view.training_run.Job", JobHere)
    monkeypatch.setattr("nsm.view.result_page.Job", JobHere)


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def ball(scale: float = 1.0) -> bytes:
    mesh = trimesh.creation.icosphere(2, scale)
    return bytes(mesh.export(file_type="stl"))


def disk(tmp_path: Path) -> bytes:
    axis = np.linspace(-1, 1, 48)
    inside = np.hypot(*np.meshgrid(axis, axis)) < 0.7
    imageio.imwrite(tmp_path / "disk.png", np.where(inside, 0, 255).astype(np.uint8))
    return (tmp_path / "disk.png").read_bytes()


def look_at(setup: Setup, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Origin and direction of a ray from the camera to the middle of a shape."""
    camera, preview = setup.server.initial_camera, setup.previews[side]
    assert preview is not None
    assert setup._stage is not None
    middle = (preview.extent.low + preview.extent.high) / 2
    stage, place = setup._stage, setup._place(side)
    target = stage._turn @ middle + stage._places[place]
    return camera.position, target - camera.position


def test_a_ray_meets_the_nearest_triangle_from_either_side() -> None:
    corners = np.array(trimesh.creation.icosphere(4, 2.0).triangles)
    for toward in np.random.default_rng(0).normal(size=(20, 3)):
        toward /= np.linalg.norm(toward)
        outer = first_hit(corners, 5 * toward, -toward)
        inner = first_hit(corners, np.zeros(3), 7 * toward)
        assert outer == pytest.approx(2 * toward, abs=0.02)
        assert inner == pytest.approx(outer)
        assert first_hit(corners, 5 * toward, toward) is None


@pytest.mark.parametrize("kind", ["mesh", "points", "silhouette"])
def test_clicked_points_are_in_the_coordinates_of_the_file(tmp_path: Path, kind: str) -> None:
    center = np.array([1000.0, -20.0, 5.0])
    if kind == "mesh":
        trimesh.creation.icosphere(3, 4.0).apply_translation(center).export(tmp_path / "a.obj")
        preview = Preview(tmp_path / "a.obj")
    elif kind == "points":
        points = trimesh.creation.icosphere(4, 4.0).vertices
        np.save(tmp_path / "a.npy", np.hstack([center + points, points]))
        preview = Preview(tmp_path / "a.npy")
    else:
        disk(tmp_path)
        preview = Preview(tmp_path / "disk.png")
        center = np.array([24.0, 24.0])
    assert preview.kind == {"points": "point cloud"}.get(kind, kind)
    toward = np.array([0.6, 0.0, 0.8]) if preview.dim == 3 else np.array([0.0, 0.0, 1.0])
    hit = preview.pick(5 * toward, -toward)
    assert hit is not None
    expected = center + 4 * toward if preview.dim == 3 else center
    assert preview.in_file(hit) == pytest.approx(expected, abs=0.1)
    assert preview.in_box(preview.in_file(hit))[: preview.dim] == pytest.approx(hit[: preview.dim], abs=1e-9)


def test_clicks_make_a_table_of_pairs_that_reads_back(tmp_path: Path) -> None:
    clicks = Clicks()
    first, second = torch.randn(2, 3, 3, dtype=torch.double).tolist()
    for k in range(3):
        clicks.add(0, first[k])
    with pytest.raises(InputError, match="got 3 on the first shape and 0 on the second"):
        clicks.table()
    for k in range(3):
        clicks.add(1, second[k])
    clicks.add(1, [0.0, 0.0, 0.0])
    assert clicks.undo() == 1
    (tmp_path / "pairs.csv").write_text(clicks.table())
    pairs = LandmarkTable(str(tmp_path / "pairs.csv")).read(3)
    assert pairs.source.tolist() == first
    assert pairs.target.tolist() == second


def test_landmarks_are_where_the_user_clicks_and_can_be_undone(studio: Studio) -> None:
    setup = studio.setup
    setup.receive(1, "ball.stl", ball(3.0))  # the only shape, so that it stands in the first place
    setup.click(1, *look_at(setup, 1))
    assert setup.clicks.count(1) == 0  # nobody picks
    setup._picking.value = True
    setup.receive(0, "ball.stl", ball())
    for side, radius in ((0, 1.0), (1, 3.0)):
        origin, direction = look_at(setup, side)
        setup.click(side, origin, direction)
        setup.click(side, origin, -direction)  # away from the shape
        (point,) = setup.clicks.points(side)
        assert np.linalg.norm(point) == pytest.approx(radius, rel=0.02)
        assert point[2] > 0.5 * radius  # in front
    assert setup.choices().landmarks == setup.clicks.table()
    setup.undo()
    with pytest.raises(InputError, match="got 1 on the first shape and 0 on the second"):
        setup.choices()
    setup.undo()
    setup.undo()
    assert setup.choices().landmarks is None


@pytest.mark.parametrize(("name", "content", "words"), [
    ("cow.exe", b"MZ", "The name of a file must end as one of these kinds does"),
    ("weights.pth", b"\x80\x04", "got `weights.pth`"),
    ("run.ckpt", b"\x80\x04", "got `run.ckpt`"),
    ("empty.obj", b"", "`empty.obj` must contain a mesh, got an empty file"),
    ("../../etc/evil one.ply", b"ply\nnonsense", "`evil_one.ply` must"),
    ("sheet.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", "`sheet.off` must be nearly closed"),
    ("pickled.npy", b"\x93NUMPY\x01\x00F\x00{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", "`pickled.npy`"),
])  # fmt: skip
def test_files_without_a_shape_are_refused_in_a_sentence(studio: Studio, name: str, content: bytes, words: str) -> None:
    setup = studio.setup
    setup._notice.guard(lambda event: setup.receive(0, name, content))(None)
    said = setup.said.replace("<code>", "`").replace("</code>", "`")
    assert words in said
    assert "nsm-view-" not in said
    assert "Traceback" not in said
    assert setup.previews == [None, None]
    assert not [path for path in setup._folder.rglob("*") if path.is_file()]


def test_a_file_that_does_not_fit_leaves_the_one_before(studio: Studio, tmp_path: Path) -> None:
    setup = studio.setup
    setup.receive(0, "a.stl", ball())
    setup.receive(1, "b.stl", ball(2.0))
    with pytest.raises(InputError, match=r"got `disk\.png` in 2D beside `a\.stl` in 3D"):
        setup.receive(1, "disk.png", disk(tmp_path))
    with pytest.raises(InputError, match=r"must be at most 1 MiB large, got 1\.0 MiB"):
        setup.receive(1, "big.stl", bytes(LIMIT + 1))
    chosen = setup.choices()
    assert (chosen.source.name, chosen.target.name) == ("a.stl", "b.stl")
    assert chosen.source.is_file()
    assert chosen.target.is_file()


def test_training_needs_two_files(studio: Studio) -> None:
    with pytest.raises(InputError, match="The `first shape` must be chosen"):
        studio.setup.choices()
    studio.setup.receive(0, "a.stl", ball())
    with pytest.raises(InputError, match="The `second shape` must be chosen"):
        studio.setup.choices()


def test_an_oversized_upload_is_dropped_before_it_is_kept(studio: Studio) -> None:
    button = studio.setup._uploads[0]._impl.uuid
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    with connect(page_address(studio.server).replace("http", "ws"), subprotocols=[protocol]) as page:
        page.recv(timeout=10)
        for message in (
            FileTransferStartUpload(button, "id", "huge.obj", "", 2, LIMIT + 1),
            FileTransferPart(button, "id", 0, b"v 0 0 0"),
            FileTransferPart(button, "id", 1, bytes(LIMIT)),
        ):
            page.send(msgspec.msgpack.encode(message.as_serializable_dict()))
        until(lambda: "<code>huge.obj</code> must be at most 1 MiB large" in studio.setup.said)
        page.ping().wait(10)
    assert studio.server.gui._current_file_upload_states == {}
    assert studio.setup.previews == [None, None]


def test_values_that_the_setup_does_not_offer_are_ignored(studio: Studio) -> None:
    setup = studio.setup
    for side in (0, 1):
        setup.receive(side, "a.stl", ball())
    setup._budget.value, setup._align.value = "gigantic", "../../none"
    chosen = setup.choices()
    assert (chosen.budget, chosen.align) == ("fast", "none")


def test_names_of_files_become_harmless() -> None:
    for name in ("", "...", "/", "a/../../b", "x" * 300, "ä\n;.obj", "a.nii.gz", "C:\\x\\y.STL", "a" + "." * 90 + "x"):
        safe = safe_name(name)
        assert 0 < len(safe) <= 90
        assert not set(safe) - set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
        assert not safe.startswith(".")
    assert safe_name("C:\\x\\y.STL") == "y.stl"


def test_progress_is_read_while_rows_are_being_written(tmp_path: Path) -> None:
    assert read_progress(tmp_path) is None
    (tmp_path / ".hydra").mkdir()
    (tmp_path / "log").mkdir()
    (tmp_path / ".hydra" / "config.yaml").write_text("steps: 100\nname: ${unknown:resolver}\n")
    log = tmp_path / "log" / "metrics.csv"
    log.write_text("step,train/loss,val/error\n")
    assert read_progress(tmp_path) is None
    log.write_text("step,train/loss,val/error\n9,0.5,\n9,,0.25\n19,0.125,\n29,0.0")
    progress = read_progress(tmp_path)
    assert progress is not None
    assert progress == (20, 100, 0.125, {"val/error": 0.25}, None)


@pytest.mark.usefixtures("jobs_here")
def test_a_training_that_fails_says_why_on_the_page(studio: Studio) -> None:
    for side in (0, 1):
        studio.setup.receive(side, "a.stl", ball())
    studio._workplace = studio._workplace._replace(overrides=["steps=0"])
    studio.start(studio.setup.choices())
    until(lambda: "<code>steps</code> must be a positive integer, got 0" in studio.setup.said)
    assert studio.training is None
    assert studio.result is None


@pytest.mark.usefixtures("jobs_here")
def test_a_training_in_the_plane_ends_with_its_morph(tmp_path: Path) -> None:
    few = [override for override in TINY if not override.startswith("callbacks.")]
    short = [*few, "callbacks=none", "steps=4", "validations=2", "trainer.log_every_n_steps=1", "optimizer.lr=1e-4"]
    with studio_page(tmp_path / "runs", short) as studio:
        setup = studio.setup
        setup.receive(0, "disk.png", disk(tmp_path))
        setup.receive(1, "disk.png", disk(tmp_path))
        studio.start(setup.choices())
        until(lambda: studio.result is not None)
        assert studio.result is not None
        studio.start(setup.choices())  # a click that came late changes nothing
        assert studio.training is None
        assert "Training has finished." in studio.result.said
        until(lambda: len(studio.result.viewer.shown) == 1)
        kept = studio.result.folder
        studio.again()
        assert [preview.path.name for preview in setup.previews if preview is not None] == ["disk.png"] * 2
    assert (kept / "shapes" / "source" / "disk.png").is_file()
    progress = read_progress(kept)
    assert progress is not None
    assert (progress.step, progress.steps) == (4, 4)
    pictures = strip(PictureMaker(load_morph(kept / "checkpoints" / "last.ckpt")))
    assert [picture.name for picture in pictures] == ["t = 0", "t = 0.25", "t = 0.5", "t = 0.75", "t = 1"]


@pytest.mark.usefixtures("jobs_here")
@pytest.mark.parametrize(("dim", "suffix", "offered"), [(2, "mp4", {"mp4"}), (3, "glb", {"glb", "mp4"})])
def test_a_morph_is_downloaded_as_a_file(tmp_path: Path, dim: int, suffix: str, offered: set[str]) -> None:
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    file = save(shrinking(dim, 0.1), tmp_path / "run" / "checkpoints" / "best.ckpt")
    sent: list[tuple[str, bytes]] = []
    client = SimpleNamespace(send_file_download=lambda name, content, save_immediately: sent.append((name, content)))
    with studio_page(tmp_path / "runs") as studio:
        viewing = Viewing(Settings(16), [0.0, 1.0], 0.1, 1 << 28)
        page = ResultPage(studio.server, load_run("a_b", file, "network"), viewing, lambda: None, "")
        assert set(page._buttons) == offered
        assert not any(button.disabled for button in page._buttons.values())
        page.download(suffix, SimpleNamespace(client=client))
        page.close()
    ((name, content),) = sent
    assert name == f"a_b.{suffix}"
    if suffix == "mp4":
        assert content[4:8] == b"ftyp"
    else:
        surface = trimesh.load(io.BytesIO(content), file_type="glb", force="mesh")
        assert np.ptp(surface.vertices, axis=0) == pytest.approx([2 * math.acos(0.5) / FREQUENCY] * 3, rel=0.01)


def test_a_download_shows_how_far_its_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []

    class Slow(JobHere):
        def wait(self, seconds: float) -> bool:
            return len(said) > 1

        def last_line(self) -> str:
            return "extracting: 5 of 24 frames"

    monkeypatch.setattr("nsm.view.result_page.Job", Slow)
    monkeypatch.setattr(Notice, "say", lambda self, text: said.append(text))
    (tmp_path / "run" / "checkpoints").mkdir(parents=True)
    file = save(shrinking(2, 0.1), tmp_path / "run" / "checkpoints" / "best.ckpt")
    client = SimpleNamespace(send_file_download=lambda *args, **settings: None)
    with studio_page(tmp_path / "runs") as studio:
        said.clear()
        page = ResultPage(
            studio.server, load_run("a_b", file, "network"), Viewing(Settings(16), [0.0, 1.0], 0.1, 1 << 28), print, ""
        )
        said.clear()
        page.download("mp4", SimpleNamespace(client=client))
        page.close()
    written = tmp_path / "run" / "downloads" / "a_b.mp4"
    assert said == [f"Writing {written} …", f"Writing {written} … extracting: 5 of 24 frames", f"Wrote {written}."]


def test_the_command_without_a_morph_waits_for_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with mock.patch.object(Studio, "wait", side_effect=KeyboardInterrupt):
        assert run_here(view, "port=null", f"runs={tmp_path}") == 130
    assert "waits for two files of shapes" in sentence(capsys.readouterr().out)


@pytest.mark.parametrize(("override", "words"), [
    ("upload=0", "`upload` must be a positive integer, got 0"),
    ("train=steps", "`train` must be a list, got steps"),
    ("train=[3]", "`train` must be a list of settings of training, got [3]"),
])  # fmt: skip
def test_bad_settings_are_refused(capsys: pytest.CaptureFixture[str], override: str, words: str) -> None:
    assert run_here(view, "port=null", override) == 2
    assert words in sentence(capsys.readouterr().err)
