"""Recordings: HTML files that play morphs in any browser, without a server."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from nsm.cli.files import atomic_write
from nsm.io.loading import LoadedMorph
from nsm.view.page import caption, one_dimension
from nsm.view.pictures import PictureMaker, Settings
from nsm.view.scene import Scene
from nsm.view.server import close_server, open_server
from nsm.view.stage import Extent
from nsm.view.store import Key


def record(
    path: Path | str,
    loaded: Sequence[LoadedMorph],
    settings: Settings,
    times: Sequence[float],
    seconds: float = 6.0,
) -> Iterator[int]:
    """Write an HTML file that holds all pictures and plays them back and forth, with the recorder of viser.

    Args:
        path: The file to write, atomically.
        loaded: The morphs, all of one dimension.
        settings: Settings of all pictures.
        times: Times in [0, 1].
        seconds: Seconds from the first time to the last.

    Yields:
        Number of pictures done, of ``len(loaded) * len(times)``. The file exists once the iterator is exhausted.

    Raises:
        InputError: If the file cannot be written, the morphs are of different dimensions, or lack what the color shows.
    """
    morphs = [each.morph for each in loaded]
    dim = one_dimension(loaded)
    settings.check(morphs)
    makers = [PictureMaker(morph) for morph in morphs]
    with atomic_write(path) as temporary:
        server = open_server("127.0.0.1", None)
        try:
            scene = Scene(server, [each.name for each in loaded], [Extent.of(morph) for morph in morphs], dim)
            captions: list[dict[int, str]] = []
            for number, instant in enumerate(times):
                captions.append({})
                for morph, maker in enumerate(makers):
                    surface = maker.surface(instant, settings)
                    scene.add(Key(morph, number, settings), maker.picture(surface, instant, settings).glb)
                    captions[-1][morph] = caption(instant, surface)
                    yield number * len(morphs) + morph + 1
            recorder = server.get_scene_serializer()
            for number in [*range(len(times)), *reversed(range(len(times) - 1))]:
                scene.show({morph: Key(morph, number, settings) for morph in range(len(morphs))}, captions[number])
                recorder.insert_sleep(seconds / (len(times) - 1))
            temporary.write_text(recorder.as_html(), encoding="utf-8")
        finally:
            close_server(server)
