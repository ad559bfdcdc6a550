"""Films of morphs: MP4 and GIF, one morph or several side by side, with the volume as it goes."""

from __future__ import annotations

import math
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import whole_file
from nsm.plots.look import LOOK, Look
from nsm.render.panel import Panel, PlanePanel, SurfacePanel, caption
from nsm.render.timeline import Timeline, measure_volumes
from nsm.types import Morph

#: Width and height in pixels unless told otherwise.
SIZE = (1920, 1080)
#: Suffixes that a film may have.
SUFFIXES = (".mp4", ".gif")
#: Part of the height that the volume takes, and that captions take.
_TIMELINE, _CAPTION = 0.2, 0.06
#: Quality of H.264, a constant rate factor: visually without loss.
_RATE_FACTOR = "17"
#: Told after each frame: how many are done, of how many.
Progress = Callable[[int, int], object]


class Moment(NamedTuple):
    """What one frame shows: a time of the morph, and the angle by which shapes are turned, in radians."""

    time: float
    angle: float


class Pace(NamedTuple):
    """How a film goes from t = 0 to 1.

    Attributes:
        seconds: from t = 0 to 1.
        hold: seconds that it stands at either end.
        fps: frames a second.
        back: whether it plays back to t = 0 as well.
        turns: how often shapes turn about the vertical in the whole film (3D).
    """

    seconds: float = 6.0
    hold: float = 0.5
    fps: int = 30
    back: bool = False
    turns: float = 0.0

    def moments(self) -> list[Moment]:
        """One a frame.

        Raises:
            InputError: if there are none.
        """
        _require_pace(self.seconds, self.fps)
        if self.hold < 0:
            raise InputError(f"hold={self.hold} cannot be: give seconds from 0 on, such as 0.5")
        steps, held = max(1, round(self.seconds * self.fps)), round(self.hold * self.fps)
        forth = [number / steps for number in range(steps + 1)]
        times = [0.0] * held + forth + [1.0] * held
        if self.back:
            times += forth[-2::-1] + [0.0] * held
        # a film of whole turns goes on where it began
        return [Moment(time, 2 * math.pi * self.turns * number / len(times)) for number, time in enumerate(times)]


#: A film of seven seconds.
PACE = Pace()


def render_film(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    *,
    pace: Pace = PACE,
    size: Sequence[int] = SIZE,
    look: Look = LOOK,
    progress: Progress = lambda done, total: None,
) -> None:
    """Film morphs from t = 0 to 1, side by side, above a curve of their volumes.

    The camera stands still. The curve is that of the shapes as they are drawn, at the levels of the look.

    Args:
        path: ends in .mp4 (H.264) or .gif.
        morphs: one, or several of the same dimension by name.
        pace: how long, how smooth.
        size: width and height in pixels.
        look: how fine, in which colors and from where.
        progress: told after each frame.

    Raises:
        InputError: for a size, pace or suffix of which no film can be made, for morphs of 2 and 3 dimensions together,
            or if there is no OpenGL to draw surfaces with.
    """
    named, moments = _named(morphs), pace.moments()
    width, height = _require_film(path, named, size)
    curves = {name: measure_volumes(morph, look.levels(morph)) for name, morph in named.items()}
    timeline = Timeline(curves, (width, round(height * _TIMELINE)))
    turning = pace.turns != 0
    with ExitStack() as stack:
        tiles = [stack.enter_context(t) for t in _tiles(named, (width, height - timeline.size[1]), look, None, turning)]
        _write(
            Path(path), (width, height), pace.fps, moments, lambda m: _frame(tiles, m, timeline.draw(m.time)), progress
        )


def render_turntable(
    path: Path | str,
    morphs: Morph | Mapping[str, Morph],
    time: float = 0.5,
    *,
    seconds: float = 6.0,
    fps: int = 30,
    size: Sequence[int] = SIZE,
    look: Look = LOOK,
    progress: Progress = lambda done, total: None,
) -> None:
    """Film shapes at one time while they turn once about the vertical; the film can be looped.

    Args:
        path: ends in .mp4 (H.264) or .gif.
        morphs: one of three dimensions, or several by name.
        time: from 0 to 1.
        seconds: of a whole turn.
        fps: frames a second.
        size: width and height in pixels.
        look: how fine, in which colors and from where.
        progress: told after each frame.

    Raises:
        InputError: as `render_film`, and for morphs of two dimensions.
    """
    named = _named(morphs)
    width, height = _require_film(path, named, size)
    if {morph.dim for morph in named.values()} == {2}:
        raise InputError("a shape of the plane has no other sides to turn to: give kind=film or kind=strip")
    _require_pace(seconds, fps)
    count = max(2, round(seconds * fps))
    moments = [Moment(time, 2 * math.pi * number / count) for number in range(count)]
    foot = caption(f"t = {time:.3g}", (width, round(height * _CAPTION)))
    with ExitStack() as stack:
        tiles = [stack.enter_context(t) for t in _tiles(named, (width, height - len(foot)), look, [time], True)]
        _write(Path(path), (width, height), fps, moments, lambda m: _frame(tiles, m, foot), progress)


def _named(morphs: Morph | Mapping[str, Morph]) -> Mapping[str, Morph]:
    return morphs if isinstance(morphs, Mapping) else {"": morphs}


def _tiles(
    morphs: Mapping[str, Morph], size: tuple[int, int], look: Look, times: Sequence[float] | None, turning: bool
) -> Iterator[Panel]:
    """One panel a morph, side by side, which fill a size."""
    edges = np.linspace(0, size[0], len(morphs) + 1).round().astype(int)
    for (name, morph), width in zip(morphs.items(), np.diff(edges).tolist(), strict=True):
        if morph.dim == 3:
            yield SurfacePanel(morph, name, (width, size[1]), look, times, turning)
        else:
            yield PlanePanel(morph, name, (width, size[1]), look)


def _frame(tiles: Sequence[Panel], moment: Moment, foot: np.ndarray) -> np.ndarray:
    return np.concatenate([np.concatenate([tile.draw(*moment) for tile in tiles], 1), foot])


def _write(
    path: Path,
    size: tuple[int, int],
    fps: int,
    moments: Sequence[Moment],
    draw: Callable[[Moment], np.ndarray],
    progress: Progress,
) -> None:
    """Draw every different moment once, and hand frames to ffmpeg."""
    again = {moment for moment, times in Counter(moments).items() if times > 1}
    kept: dict[Moment, bytes] = {}
    with whole_file(path) as temporary, closing(_ffmpeg(temporary, size, fps)) as film:
        film.send(None)
        for number, moment in enumerate(moments):
            if moment in kept:
                frame = zlib.decompress(kept[moment])
            else:
                frame = np.ascontiguousarray(draw(moment)).tobytes()
                if moment in again:
                    kept[moment] = zlib.compress(frame, 1)
            film.send(frame)
            progress(number + 1, len(moments))


def _ffmpeg(path: Path, size: tuple[int, int], fps: int) -> Generator[None, bytes | None, None]:
    """A generator that takes frames, of 8 bits of RGB."""
    import imageio_ffmpeg

    common = {"size": size, "fps": fps, "quality": None, "macro_block_size": 1, "ffmpeg_log_level": "error"}
    if path.suffix.lower() == ".gif":
        palette = "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=sierra2_4a"
        return imageio_ffmpeg.write_frames(
            str(path),
            codec="gif",
            pix_fmt_out="pal8",
            output_params=["-filter_complex", palette, "-loop", "0"],
            **common,
        )
    settings = ["-crf", _RATE_FACTOR, "-preset", "slow", "-movflags", "+faststart"]
    return imageio_ffmpeg.write_frames(
        str(path), codec="libx264", pix_fmt_out="yuv420p", output_params=settings, **common
    )


def _require_film(path: Path | str, morphs: Mapping[str, Morph], size: Sequence[int]) -> tuple[int, int]:
    dims = sorted({morph.dim for morph in morphs.values()})
    if len(dims) != 1:
        raise InputError(f"a film shows morphs of one dimension, not of dimensions {dims}: film them separately")
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} names no format of films: give a name that ends in {' or '.join(SUFFIXES)}")
    require("imageio_ffmpeg", extra="render", task="A film")
    sizes = list(size)
    if len(sizes) != 2 or any(isinstance(n, bool) or not isinstance(n, int) or n < 64 or n % 2 for n in sizes):
        raise InputError(
            f"size={sizes} is none of a film: give an even width and height of at least 64, such as [1920,1080]"
        )
    return sizes[0], sizes[1]


def _require_pace(seconds: float, fps: int) -> None:
    if not 0 < seconds < math.inf:
        raise InputError(f"seconds={seconds} make no film: give a number above 0, such as 6")
    if isinstance(fps, bool) or not isinstance(fps, int) or not 1 <= fps <= 120:
        raise InputError(f"fps={fps} cannot be played: give a whole number from 1 to 120, such as 30")
