"""Pictures show what is there, where it is; films play as they should; and what cannot be drawn is said."""

from __future__ import annotations

import logging
import math
from contextlib import closing
from functools import partial
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import lightning as L
import numpy as np
import pytest
import torch
from analytic import run_here, save, sentence, shrinking
from PIL import Image
from problems import MOTIONS, Ball, Box, LinearMotion

from nsm.cli.errors import InputError
from nsm.geometry.meshing import extract_surface
from nsm.geometry.refinement import refine_bends
from nsm.geometry.topology import component_count
from nsm.plots import opengl
from nsm.plots.camera import place_camera
from nsm.plots.colors import carried_colors
from nsm.plots.light import Room
from nsm.plots.look import Look, camera_for, carried, facing
from nsm.plots.strip import render_strip, try_strip
from nsm.render import __main__ as render
from nsm.render.film import Pace, render_film, render_turntable
from nsm.train.callbacks import Strip

COARSE = Look(resolution=32)
SMALL = {"size": (128, 96), "look": COARSE}


def picture(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def colored(pixels: np.ndarray) -> np.ndarray:
    """Where a picture is not gray: on the shape, as paper and shadow are."""
    return pixels.max(-1) - pixels.min(-1) > 12


def middle(mask: np.ndarray) -> np.ndarray:
    """Row and column of the middle of what is marked."""
    return np.argwhere(mask).mean(0)


def test_a_normal_that_faces_inwards_is_that_of_its_triangles() -> None:
    mesh = extract_surface(lambda x: Ball(3).jet(x).value, torch.tensor([[-1.0] * 3, [1.0] * 3]), 16)
    normals = mesh.vertices / mesh.vertices.norm(dim=1, keepdim=True)
    torn = normals.clone()
    torn[::7] *= -1
    torn[1::7] = 0
    mended = facing(torn, mesh)
    assert (mended * normals).sum(1).min() > 0.98
    assert torch.equal(facing(normals, mesh), normals)


class Sliding(LinearMotion):
    """A ball that crosses the box, faster to compute than as a linear motion."""

    def __init__(self) -> None:
        super().__init__(Ball(3), drift=[0.6, 0.3, -0.2], start=[-0.3, -0.15, 0.1])

    def _back(self, x, t):
        return self._centered(x, t), torch.eye(3, dtype=x.dtype).expand(len(x), 3, 3)


def red(morph, points, time):
    return torch.tensor([0.8, 0.2, 0.2]).expand(len(points), 3)


# refinement


@pytest.mark.parametrize("name", ["rotating_box", "squashed_ball"])
def test_bends_are_refined_without_gaps_and_onto_the_surface(name: str) -> None:
    motion = MOTIONS[name](3)
    field, gradient = partial(motion, t=0.3), partial(motion.gradient, t=0.3)
    coarse = extract_surface(field, motion.bounds, 20)
    fine, normals = refine_bends(coarse, field, gradient)
    assert len(fine.simplices) > 1.5 * len(coarse.simplices)
    # every directed edge once, and once the other way: closed, and turned the same everywhere
    edges = torch.cat([fine.simplices[:, [i, (i + 1) % 3]] for i in range(3)])
    assert len(edges.unique(dim=0)) == len(edges)
    assert torch.equal(edges.unique(dim=0), edges.flip(1).unique(dim=0))
    assert len(fine.vertices) - len(edges) // 2 + len(fine.simplices) == 2
    assert component_count(fine) == 1
    assert normals.norm(dim=1) == pytest.approx(1.0)

    def off_surface(mesh):
        return float(field(mesh.vertices[mesh.simplices].mean(1)).abs().mean())

    assert off_surface(fine) < 0.8 * off_surface(coarse)


# camera and light


def test_a_camera_holds_the_shape_at_every_angle() -> None:
    points = np.array([[0.9, 0.1, 0.0], [-0.3, -0.4, 0.2], [0.0, 0.5, -0.7]])
    camera = place_camera(points, (0.5, 0.4, 1.0), (0, 1, 0), aspect=0.5, turning=True)
    assert camera.aspect == pytest.approx(0.5)
    for angle in np.linspace(0, 2 * math.pi, 13):
        assert np.abs(camera.on_picture(camera.turned(points, angle))).max() < 1
    assert camera.turned(points, 2 * math.pi) == pytest.approx(points)
    assert camera.turned(points, 1.0)[:, 1] == pytest.approx(points[:, 1])
    closer = place_camera(points, (0.5, 0.4, 1.0), (0, 1, 0), zoom=2.0, aspect=0.5, turning=True)
    assert closer.half_width == pytest.approx(camera.half_width / 2)


@pytest.mark.parametrize("height", [0.5, 1.0])
def test_the_shadow_of_a_ball_is_the_form_factor_of_a_sphere(height: float) -> None:
    """A ball of radius r, its middle h above a floor, takes r² h / D³ of the light at a distance D from its middle."""
    radius = 0.5
    motion = LinearMotion(Ball(3, radius))
    mesh = extract_surface(motion.source, motion.bounds, 48)
    vertices = mesh.vertices.numpy() + np.array([0, height, 0])
    camera = place_camera(vertices, (0, 0.5, 1), (0, 1, 0))
    along = np.linspace(0.3, 3.0, 12)
    points = np.stack([along, np.zeros(12), 0.3 * along], 1)
    distance = np.linalg.norm(points - [0, height, 0], axis=1)
    shadow = Room(vertices, mesh.simplices.numpy(), camera).floor_shadow(points)
    assert shadow == pytest.approx(radius**2 * height / distance**3, abs=0.03)


def test_a_convex_surface_is_lit_by_all_that_is_above_it() -> None:
    motion = LinearMotion(Ball(3, 0.5))
    mesh = extract_surface(motion.source, motion.bounds, 48)
    points = mesh.vertices.numpy()
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    camera = place_camera(points, (0, 0.5, 1), (0, 1, 0))
    light = Room(points, mesh.simplices.numpy(), camera).light(points, normals)
    top, side, bottom = (light.room[np.argmin(np.abs(normals[:, 1] - up))] for up in (1.0, 0.0, -1.0))
    assert 0.85 < top <= 1.0
    assert bottom < side < top
    assert bottom > 0.4
    # nothing shadows a ball but itself: neighbors are lit alike, without noise
    edges = mesh.simplices[:, :2].numpy()
    assert np.abs(light.room[edges[:, 0]] - light.room[edges[:, 1]]).max() < 0.06


# strips


def test_a_ball_is_where_it_should_be_and_as_large(tmp_path: Path) -> None:
    motion = Sliding()
    size, times = 120, [0.0, 1.0]
    render_strip(tmp_path / "strip.png", motion, times, size=size, look=COARSE)
    pixels = picture(tmp_path / "strip.png")
    camera = camera_for(motion, COARSE, times)
    height = round(size * camera.aspect)
    assert pixels.shape[1] == 2 * size
    assert pixels.shape[0] > height
    for number, time in enumerate(times):
        tile = colored(pixels)[:height, number * size : (number + 1) * size]
        share = math.pi * motion.shape.radius**2 / (4 * camera.half_width * camera.half_height)
        assert tile.mean() == pytest.approx(share, rel=0.03)
        right, up = camera.on_picture((motion.start + time * motion.drift).numpy()[None])[0]
        assert middle(tile) == pytest.approx([height * (1 - up) / 2 - 0.5, size * (1 + right) / 2 - 0.5], abs=1.0)
        # no holes: every row of the disk is one run of pixels
        assert all((np.diff(row.astype(int)) != 0).sum() <= 2 for row in tile)


def test_pictures_are_bright_on_paper_that_is_white_at_the_rim(tmp_path: Path) -> None:
    render_strip(tmp_path / "strip.png", MOTIONS["rotating_box"](3), [0.5], size=160, look=COARSE)
    pixels = picture(tmp_path / "strip.png")[:150]
    rows, _ = np.nonzero(colored(pixels))
    shape = pixels[colored(pixels)]
    assert shape.mean() > 130
    assert shape.max() < 255
    assert all((edge == 255).all() for edge in (pixels[0], pixels[:, 0], pixels[:, -1]))
    paper = ~colored(pixels)
    gray = pixels[paper]
    assert np.ptp(gray, axis=1).max() <= 12
    # the shadow lies below the shape, not above it
    shaded = paper & (pixels.mean(-1) < 240)
    assert shaded[rows.max() - 5 :].sum() > 20
    assert not shaded[: rows.min()].any()


def test_levels_and_colors_of_a_look_are_drawn(tmp_path: Path) -> None:
    motion = LinearMotion(Ball(3, 0.4))
    thick = COARSE._replace(levels=lambda morph: lambda time: 0.1 * time, colors=red)
    render_strip(tmp_path / "strip.png", motion, [0.0, 1.0], size=100, look=thick)
    pixels = picture(tmp_path / "strip.png")
    thin, grown = (colored(pixels[:100, part]) for part in (slice(0, 100), slice(100, 200)))
    assert grown.sum() / thin.sum() == pytest.approx((0.5 / 0.4) ** 2, rel=0.05)
    shape = pixels[colored(pixels)]
    assert shape[:, 0].mean() > 1.8 * shape[:, 2].mean()


def test_colors_are_carried_for_some_points_and_spread_to_others() -> None:
    motion = MOTIONS["squashed_ball"](3)
    points = extract_surface(partial(motion, t=0.7), motion.bounds, 100).vertices
    assert len(points) > 7000
    assert (carried(motion, points, 0.7) - carried_colors(motion, points, 0.7)).abs().max() < 0.02


def test_filled_pixels_are_the_area_of_a_flat_shape(tmp_path: Path) -> None:
    motion, size = MOTIONS["rotating_box"](2), 200
    look = Look(resolution=200, colors=red)
    render_strip(tmp_path / "strip.png", {"turning": motion}, [0.4], size=size, look=look)
    pixels = picture(tmp_path / "strip.png")
    # the outline lies half outside: 1.6 points at 400 pixels, of which 72 are 200 pixels
    rim = 4 * (0.55 + 0.3) * (size / 2) * (1.6 * size / 400 * 200 / 72) / 2
    area = (colored(pixels).sum() - rim) * (2 / size) ** 2
    assert area == pytest.approx(motion.volume(0.4), rel=0.03)


def test_several_flat_morphs_are_rows_at_all_times(tmp_path: Path) -> None:
    morphs = {name: MOTIONS[name](2) for name in ("rotating_box", "squashed_ball")}
    done = []
    tell = lambda number, total: done.append((number, total))  # noqa: E731
    render_strip(tmp_path / "strip.png", morphs, [0.0, 0.5, 1.0], size=60, look=COARSE, progress=tell)
    height, width, _ = picture(tmp_path / "strip.png").shape
    assert 3 * 60 <= width <= 4 * 60
    assert 2 * 60 <= height <= 3 * 60
    assert done == [(number, 6) for number in range(1, 7)]


def test_a_shape_that_vanishes_leaves_white_paper(tmp_path: Path) -> None:
    class Gone(LinearMotion):
        def __call__(self, x, t):
            return super().__call__(x, t) + t

    render_strip(tmp_path / "2.png", Gone(Ball(2)), [0.0, 1.0], size=60, look=COARSE)
    render_strip(tmp_path / "3.png", Gone(Ball(3)), [0.0, 1.0], size=60, look=COARSE)
    pixels = picture(tmp_path / "3.png")[:40]
    assert colored(pixels[:, :60]).any()
    assert (pixels[:, 60:] == 255).all()


def test_strips_that_cannot_be_are_refused(tmp_path: Path) -> None:
    ball = LinearMotion(Ball(3))
    with pytest.raises(InputError, match=r"dimensions \[2, 3\]"):
        render_strip(tmp_path / "strip.png", {"a": LinearMotion(Ball(2)), "b": ball})
    with pytest.raises(InputError, match=r"strip\.xyz names no format of pictures"):
        render_strip(tmp_path / "strip.xyz", ball)
    with pytest.raises(InputError, match="place no camera"):
        render_strip(tmp_path / "strip.png", ball, [0.0], look=Look(16, view=(0, 1, 0)))
    assert not list(tmp_path.iterdir())


# without OpenGL


@pytest.fixture
def _no_opengl(monkeypatch: pytest.MonkeyPatch):
    """As where VTK finds no library: the process that tries is killed."""
    monkeypatch.setattr(opengl, "_TRIAL", "import os; os.abort()")
    opengl.require_opengl.cache_clear()
    yield
    opengl.require_opengl.cache_clear()


@pytest.mark.usefixtures("_no_opengl")
def test_without_opengl_the_packages_are_named(tmp_path: Path) -> None:
    with pytest.raises(opengl.NoOpenGLError, match="apt-get install libegl1 libgl1-mesa-dri"):
        render_strip(tmp_path / "strip.png", LinearMotion(Ball(3)), [0.0], size=40, look=COARSE)
    assert not list(tmp_path.iterdir())
    render_strip(tmp_path / "strip.png", LinearMotion(Ball(2)), [0.0], size=40, look=COARSE)


@pytest.mark.usefixtures("_no_opengl")
def test_without_opengl_training_goes_on(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert not try_strip(tmp_path / "strip.png", LinearMotion(Ball(3)), [0.0], size=40)
    trainer = L.Trainer(max_steps=0, logger=False, enable_checkpointing=False, accelerator="cpu")
    task = L.LightningModule()
    task.morph = LinearMotion(Ball(3))
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        Strip(str(tmp_path), [0.0], 40).on_train_end(trainer, task)
    assert [record.message.split(" is left out: ")[0] for record in caplog.records] == [str(tmp_path / "strip.png")]
    assert not list(tmp_path.iterdir())


# films


def test_a_pace_goes_from_start_to_end_and_back() -> None:
    times = [moment.time for moment in Pace(seconds=1.0, hold=0.2, fps=10).moments()]
    assert times == pytest.approx([0, 0, *np.linspace(0, 1, 11), 1, 1])
    there = Pace(seconds=1.0, hold=0.2, fps=10, back=True, turns=2).moments()
    assert [m.time for m in there] == [m.time for m in there][::-1]
    steps = [b.angle - a.angle for a, b in pairwise(there)]
    assert steps == pytest.approx([4 * math.pi / len(there)] * len(steps))


def test_a_film_has_its_frames_size_and_rate(tmp_path: Path) -> None:
    motion, told = Sliding(), []
    pace = Pace(seconds=0.5, hold=0.2, fps=10, back=True)
    render_film(tmp_path / "film.mp4", motion, pace=pace, **SMALL, progress=lambda *n: told.append(n))
    frames = iio.imread(tmp_path / "film.mp4").astype(int)
    count = len(pace.moments())
    assert frames.shape == (count, 96, 128, 3)
    with closing(imageio_ffmpeg.read_frames(str(tmp_path / "film.mp4"))) as reader:
        about = next(reader)
    assert (about["fps"], about["codec"], about["pix_fmt"].split("(")[0]) == (10, "h264", "yuv420p")
    assert told == [(number, count) for number in range(1, count + 1)]
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    # the camera stands still, so the ball crosses the picture at a constant speed; forth and back look the same
    shapes = colored(frames)[:, :77]
    places = np.array([middle(shape)[1] for shape in shapes])
    assert np.abs(np.diff(places[:2])).max() < 0.3
    steps = np.diff(places[2:8])
    assert steps.min() > 1
    assert np.ptp(steps) < 1
    assert places == pytest.approx(places[::-1], abs=0.5)
    # the dot on the curve goes with it
    dots = [middle(colored(frame[77:, 20:108]))[1] for frame in frames[2:8]]
    assert all(a < b for a, b in pairwise(dots))


def test_a_film_of_several_flat_morphs_as_gif(tmp_path: Path) -> None:
    morphs = {name: MOTIONS[name](2) for name in ("squashed_ball", "growing_ball")}
    render_film(tmp_path / "film.gif", morphs, pace=Pace(0.2, 0.0, 10), **SMALL)
    with Image.open(tmp_path / "film.gif") as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (3, (128, 96), 0)
        assert film.info["duration"] == 100
        last = np.asarray((film.seek(2), film.convert("RGB"))[1]).astype(int)
    left, right = (colored(last[:77, part]).sum() for part in (slice(0, 64), slice(64, 128)))
    assert right > 1.3 * left


def test_a_turntable_turns_once_and_can_be_looped(tmp_path: Path) -> None:
    motion = LinearMotion(Box((0.7, 0.3, 0.2)))
    look = Look(resolution=24, view=(0, 0.3, 1))
    render_turntable(tmp_path / "turn.mp4", motion, 0.5, seconds=0.8, fps=10, size=(128, 96), look=look)
    frames = iio.imread(tmp_path / "turn.mp4").astype(int)
    assert frames.shape == (8, 96, 128, 3)
    widths = [np.ptp(np.nonzero(colored(frame)[:88])[1]) for frame in frames]
    # a box looks alike from both sides, is wide in front and narrow after a quarter
    assert widths[:4] == pytest.approx(widths[4:], abs=2)
    assert widths[2] < 0.4 * widths[0]
    # to the next frame after the last is as far as to any other
    assert abs(widths[7] - widths[0]) == pytest.approx(abs(widths[1] - widths[0]), abs=2)
    with pytest.raises(InputError, match="no other sides"):
        render_turntable(tmp_path / "flat.mp4", LinearMotion(Ball(2)), **SMALL)


def test_an_interrupted_film_leaves_the_old_one(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").write_text("old")

    def interrupt(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        render_film(tmp_path / "film.mp4", LinearMotion(Ball(2)), pace=Pace(1.0), **SMALL, progress=interrupt)
    assert (tmp_path / "film.mp4").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_films_that_cannot_be_are_refused(tmp_path: Path) -> None:
    ball, path = LinearMotion(Ball(2)), tmp_path / "film.mp4"
    for settings, words in [
        ({"size": (129, 96)}, r"size=\[129, 96\] is none of a film"),
        ({"size": (64,)}, "is none of a film"),
        ({"pace": Pace(seconds=0)}, "seconds=0 make no film"),
        ({"pace": Pace(fps=0)}, "fps=0 cannot be played"),
        ({"pace": Pace(hold=-1)}, "hold=-1 cannot be"),
    ]:
        with pytest.raises(InputError, match=words):
            render_film(path, ball, **settings)
    with pytest.raises(InputError, match="names no format of films"):
        render_film(tmp_path / "film.avi", ball)
    with pytest.raises(InputError, match=r"dimensions, *|not of dimensions \[2, 3\]"):
        render_film(path, {"a": ball, "b": LinearMotion(Ball(3))})
    assert not list(tmp_path.iterdir())


# the command


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    save(shrinking(2, 0.1), tmp_path / "outputs" / "disk" / "checkpoints" / "best.ckpt")
    return tmp_path / "outputs" / "disk"


FEW = {
    "strip": ("times=2", "size=40", "resolution=24", "exact_volume=true"),
    "film": ("seconds=0.2", "hold=0", "fps=10", "size=[128,96]", "resolution=24"),
    "slices": ("times=[0.5]", "resolution=24"),
}


@pytest.mark.parametrize("kind", FEW)
def test_every_kind_is_drawn_into_the_folder_of_the_run(run: Path, kind: str) -> None:
    assert run_here(render, f"checkpoint={run}", f"kind={kind}", *FEW[kind]) == 0
    assert [path.stem for path in (run / "render").iterdir()] == [kind]


def test_a_turntable_by_command(run: Path) -> None:
    save(shrinking(3, 0.1), run.parent / "ball.ckpt")
    settings = ("kind=turntable", "time=0.2", "seconds=0.2", "fps=10", "size=[128,96]", "resolution=24")
    assert run_here(render, f"checkpoint={run.parent / 'ball.ckpt'}", *settings, "output=turn.gif") == 0
    with Image.open("turn.gif") as film:
        assert film.n_frames == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["kind=sculpture"], "Could not find 'kind/sculpture'"),
        (["kind=strip", "fps=3"], "`fps` must be a setting of `nsm render`"),
        (["color=gold"], "color=gold is not known: give one of clay, position, carried"),
        (["color=carried"], "velocity"),
        (["times=[0,2]"], "`times` must be a number of times or a list of times from 0 to 1, got [0, 2]"),
        (["times=none"], "`times` must be a number of times or a list of times from 0 to 1, got none"),
        (["size=3"], "`size` must be an integer of at least 16, got 3"),
        (["zoom=much"], "`zoom` must be a finite number, got much"),
        (["kind=film", "size=12"], "`size` must be a list of numbers, got 12"),
        (["kind=film", "fps=fast"], "`fps` must be a positive integer, got fast"),
        (["kind=turntable"], "no other sides"),
        (
            ["kind=slices", "axis=w", "times=[3]"],
            "`times` must be a number of times or a list of times from 0 to 1, got [3]",
        ),
    ],
)
def test_what_cannot_be_drawn_is_said(
    run: Path, capfd: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert run_here(render, f"checkpoint={run}", *arguments) == 2
    told = sentence(capfd.readouterr().err)
    assert words in told
    assert "Traceback" not in told
    assert not (run / "render").exists()
