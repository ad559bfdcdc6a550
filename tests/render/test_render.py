"""Films and turntables play as they should, and the command draws every kind of picture."""

from __future__ import annotations

import math
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import imageio.v3 as iio
import imageio_ffmpeg
import numpy as np
import pytest
from analytic import run_here, save, sentence, shrinking
from pictures import Sliding, colored, middle
from PIL import Image
from problems import MOTIONS, Ball, Box, LinearMotion

from nsm.cli.errors import InputError
from nsm.plots.look import Look
from nsm.render import __main__ as render
from nsm.render.film import Pace, render_film, render_turntable

COARSE = Look(resolution=32)

SMALL = {"size": (128, 96), "look": COARSE}


def test_a_pace_goes_from_start_to_end_and_back() -> None:
    times = [frame.time for frame in Pace(seconds=1.0, hold=0.2, fps=10).frames()]
    assert times == pytest.approx([0, 0, *np.linspace(0, 1, 11), 1, 1])
    there = Pace(seconds=1.0, hold=0.2, fps=10, back=True, turns=2).frames()
    assert [m.time for m in there] == [m.time for m in there][::-1]
    steps = [b.angle - a.angle for a, b in pairwise(there)]
    assert steps == pytest.approx([4 * math.pi / len(there)] * len(steps))


def test_a_film_has_its_frames_size_and_rate(tmp_path: Path) -> None:
    motion, told = Sliding(), []
    pace = Pace(seconds=0.5, hold=0.2, fps=10, back=True)
    render_film(tmp_path / "film.mp4", motion, pace=pace, **SMALL, progress=lambda *n: told.append(n))
    frames = iio.imread(tmp_path / "film.mp4").astype(int)
    count = len(pace.frames())
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
    with pytest.raises(InputError, match="must be given a morph in 3D"):
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
        ({"size": (129, 96)}, r"`size` must be an even width and height .*, got \[129, 96\]"),
        ({"size": (64,)}, "`size` must be an even width and height"),
        ({"pace": Pace(seconds=0)}, "`seconds` must be positive and finite, got 0"),
        ({"pace": Pace(fps=0)}, "`fps` must be an integer from 1 to 120, got 0"),
        ({"pace": Pace(hold=-1)}, "`hold` must be a number of seconds of at least 0, got -1"),
    ]:
        with pytest.raises(InputError, match=words):
            render_film(path, ball, **settings)
    with pytest.raises(InputError, match="name of a film must end in"):
        render_film(tmp_path / "film.avi", ball)
    with pytest.raises(InputError, match=r"got dimensions \[2, 3\]"):
        render_film(path, {"a": ball, "b": LinearMotion(Ball(3))})
    assert not list(tmp_path.iterdir())


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
        (["kind=sculpture"], "`kind` must be one of film, slices, strip, turntable, got sculpture"),
        (["kind=strip", "fps=3"], "`fps` must be a setting of `nsm render`"),
        (["color=gold"], "`color` must be one of clay, position, advected, level_set, eikonal, got gold"),
        (["color=advected"], "velocity"),
        (["times=[0,2]"], "`times` must be a number of times or a list of times from 0 to 1, got [0, 2]"),
        (["times=none"], "`times` must be a number of times or a list of times from 0 to 1, got none"),
        (["size=3"], "`size` must be an integer of at least 16, got 3"),
        (["zoom=much"], "`zoom` must be a number between 0 and 1000, got much"),
        (["kind=film", "size=12"], "`size` must be a list of numbers, got 12"),
        (["kind=film", "fps=fast"], "`fps` must be a positive integer, got fast"),
        (["kind=turntable"], "must be given a morph in 3D"),
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
