"""Films of morphs as MP4 or GIF: one morph or several side by side, above a plot of their volumes."""

from __future__ import annotations

import math
import os
import subprocess
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import DISK_ERRORS, atomic_write
from nsm.cli.settings import invalid, positive
from nsm.plots.look import LOOK, Look
from nsm.render.panel import LevelSetPanel, Panel, SurfacePanel, caption
from nsm.render.timeline import Timeline, measure_volumes
from nsm.types import Morph

#: Width and height in pixels by default.
SIZE = (1920, 1080)
#: File formats of a film, by suffix.
SUFFIXES = (".mp4", ".gif")
#: Part of the height that the plot of the volume takes, and part that a caption takes.
_TIMELINE, _CAPTION = 0.2, 0.06
#: Options of ffmpeg for GIF, with a palette of the film's own colors.
_GIF = ["-filter_complex", "split[a][b];[a]palettegen[p];[b][p]paletteuse=dither=sierra2_4a", "-loop", "0"]
#: Options of ffmpeg for H.264, visually lossless, which plays before the whole file is there.
_MP4 = ["-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", "17", "-preset", "slow", "-movflags", "+faststart"]
#: Called after each frame with the number of frames done and their total.
Progress = Callable[[int, int], object]


class FilmFrame(NamedTuple):
    """Time of the morph that one frame shows, and angle by which shapes are turned, in radians."""

    time: float
    angle: float


class Pace(NamedTuple):
    """Timing of a film.

    Attributes:
        seconds: Seconds from t = 0 to t = 1.
        hold: Seconds for which it holds the first and the last time.
        fps: Frames per second.
        back: Whether it also plays back to t = 0.
        turns: Turns of shapes about the vertical in the whole film (3D).

    >>> [frame.time for frame in Pace(seconds=0.5, hold=0.0, fps=4).frames()]
    [0.0, 0.5, 1.0]
    """

    seconds: float = 6.0
    hold: float = 0.5
    fps: int = 30
    back: bool = False
    turns: float = 0.0

    def frames(self) -> list[FilmFrame]:
        """List the frames of the film.

        Raises:
            InputError: If a number is out of range.
        """
        _require_pace(self.seconds, self.fps)
        if not 0 <= self.hold < math.inf:
            raise invalid("hold", "a number of seconds of at least 0", self.hold, 0.5)
        steps, held = max(1, round(self.seconds * self.fps)), round(self.hold * self.fps)
        forth = [number / steps for number in range(steps + 1)]
        times = [0.0] * held + forth + [1.0] * held
        if self.back:
            times += forth[-2::-1] + [0.0] * held
        # a film of whole turns ends just before the angle at which it begins, so that it can be looped
        return [FilmFrame(time, 2 * math.pi * self.turns * number / len(times)) for number, time in enumerate(times)]


#: Timing by default: a film of seven seconds.
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
    """Film morphs from t = 0 to t = 1, side by side, above a plot of their volumes.

    The camera does not move. The plot shows the volume of the shapes as they are drawn, at the levels of the look.

    Args:
        path: The file to write, which ends in .mp4 (H.264) or .gif.
        morphs: One morph, or several of the same dimension by name.
        pace: Timing.
        size: Width and height in pixels.
        look: Resolution, colors, and camera.
        progress: Called after each frame.

    Raises:
        InputError: If the size, the timing, or the suffix is unsuitable, the morphs are of different dimensions, or
            surfaces cannot be drawn because there is no OpenGL.

    >>> import nsm
    >>> render_film("film.mp4", nsm.load_morph("outputs/demo"), pace=Pace(seconds=4, back=True))  # doctest: +SKIP
    """
    named, frames = _named(morphs), pace.frames()
    width, height = _require_film(path, named, size)
    curves = {name: measure_volumes(morph, look.levels(morph)) for name, morph in named.items()}
    timeline = Timeline(curves, (width, round(height * _TIMELINE)))
    turning = pace.turns != 0
    with ExitStack() as stack:
        tiles = [stack.enter_context(t) for t in _tiles(named, (width, height - timeline.size[1]), look, None, turning)]
        _write(
            Path(path), (width, height), pace.fps, frames, lambda f: _pixels(tiles, f, timeline.draw(f.time)), progress
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
        path: The file to write, which ends in .mp4 (H.264) or .gif.
        morphs: One morph of three dimensions, or several by name.
        time: Time of the morph in [0, 1].
        seconds: Seconds of the whole turn.
        fps: Frames per second.
        size: Width and height in pixels.
        look: Resolution, colors, and camera.
        progress: Called after each frame.

    Raises:
        InputError: Under the conditions of `render_film`, and for morphs of two dimensions.

    >>> import nsm
    >>> render_turntable("turn.gif", nsm.load_morph("outputs/demo"), time=0.5, seconds=3)  # doctest: +SKIP
    """
    named = _named(morphs)
    width, height = _require_film(path, named, size)
    if {morph.dim for morph in named.values()} == {2}:
        raise InputError(
            "`kind=turntable` must be given a morph in 3D, got one in 2D. Try `kind=film` or `kind=strip`."
        )
    _require_pace(seconds, fps)
    count = max(2, round(seconds * fps))
    frames = [FilmFrame(time, 2 * math.pi * number / count) for number in range(count)]
    foot = caption(f"t = {time:.3g}", (width, round(height * _CAPTION)))
    with ExitStack() as stack:
        tiles = [stack.enter_context(t) for t in _tiles(named, (width, height - len(foot)), look, [time], True)]
        _write(Path(path), (width, height), fps, frames, lambda f: _pixels(tiles, f, foot), progress)


def _named(morphs: Morph | Mapping[str, Morph]) -> Mapping[str, Morph]:
    return morphs if isinstance(morphs, Mapping) else {"": morphs}


def _tiles(
    morphs: Mapping[str, Morph], size: tuple[int, int], look: Look, times: Sequence[float] | None, turning: bool
) -> Iterator[Panel]:
    """Make one panel per morph, side by side, that together fill the given size."""
    edges = np.linspace(0, size[0], len(morphs) + 1).round().astype(int)
    for (name, morph), width in zip(morphs.items(), np.diff(edges).tolist(), strict=True):
        if morph.dim == 3:
            yield SurfacePanel(morph, name, (width, size[1]), look, times, turning)
        else:
            yield LevelSetPanel(morph, name, (width, size[1]), look)


def _pixels(tiles: Sequence[Panel], frame: FilmFrame, foot: np.ndarray) -> np.ndarray:
    return np.concatenate([np.concatenate([tile.draw(*frame) for tile in tiles], 1), foot])


def _write(
    path: Path,
    size: tuple[int, int],
    fps: int,
    frames: Sequence[FilmFrame],
    draw: Callable[[FilmFrame], np.ndarray],
    progress: Progress,
) -> None:
    """Draw every distinct frame once, and pass all frames to ffmpeg."""
    repeated = {frame for frame, count in Counter(frames).items() if count > 1}
    kept: dict[FilmFrame, bytes] = {}
    with atomic_write(path) as temporary, _encoder(path, temporary, size, fps) as encode:
        for number, frame in enumerate(frames):
            if frame in kept:
                pixels = zlib.decompress(kept[frame])
            else:
                pixels = np.ascontiguousarray(draw(frame)).tobytes()
                if frame in repeated:
                    kept[frame] = zlib.compress(pixels, 1)
            encode(pixels)
            progress(number + 1, len(frames))


@contextmanager
def _encoder(path: Path, temporary: Path, size: tuple[int, int], fps: int) -> Iterator[Callable[[bytes], object]]:
    """Provide a function that encodes one frame, given as RGB of 8 bits.

    Args:
        path: Name of the film in messages.
        temporary: File to write.
        size: Width and height in pixels.
        fps: Frames per second.

    Raises:
        InputError: If ffmpeg could not write the film.
    """
    import imageio_ffmpeg

    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{size[0]}x{size[1]}", "-r", str(fps), "-i", "-", "-an"]
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", "-xerror", *raw]
    command += _GIF if path.suffix.lower() == ".gif" else _MP4
    film = subprocess.Popen([*command, str(temporary)], stdin=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0)
    assert film.stdin is not None
    try:
        with suppress(BrokenPipeError):  # ffmpeg says why it ended
            yield film.stdin.write
        _, said = film.communicate()
    finally:
        film.kill()
        film.communicate()
    if film.returncode:
        lines = said.decode(errors="replace").strip().splitlines()  # such as "[out#0/mp4 @ 0x55] No space left"
        of_disk = [line for line in lines if any(os.strerror(number) in line for number in DISK_ERRORS)]
        told = next(iter([*of_disk, *lines[-1:]]), "")
        reason = told.rpartition("] ")[2] or f"status {film.returncode} of ffmpeg"
        raise InputError(f"`{path}` must be writable, got: {reason}. Try to free space there, or another folder.")


def _require_film(path: Path | str, morphs: Mapping[str, Morph], size: Sequence[int]) -> tuple[int, int]:
    dims = sorted({morph.dim for morph in morphs.values()})
    if len(dims) != 1:
        raise InputError(
            f"The `morphs` of a film must have one dimension, got dimensions {dims}. Try one film for each dimension."
        )
    if Path(path).suffix.lower() not in SUFFIXES:
        raise InputError(f"The name of a film must end in {' or '.join(SUFFIXES)}, got {path}. Try `output=film.mp4`.")
    require("imageio_ffmpeg", extra="render", task="A film")
    sizes = list(size)
    if len(sizes) != 2 or any(isinstance(n, bool) or not isinstance(n, int) or n < 64 or n % 2 for n in sizes):
        raise invalid("size", "an even width and height of at least 64", sizes, "[1920,1080]")
    return sizes[0], sizes[1]


def _require_pace(seconds: float, fps: int) -> None:
    positive("seconds", seconds, 6)
    if isinstance(fps, bool) or not isinstance(fps, int) or not 1 <= fps <= 120:
        raise invalid("fps", "an integer from 1 to 120", fps, 30)
