"""Morphs as one file that plays in any browser, without a server."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from nsm.cli.files import whole_file
from nsm.io.loading import LoadedMorph
from nsm.view.frames import Photographer, Settings
from nsm.view.page import caption, close_server, one_dimension, open_server
from nsm.view.stage import Extent, Stage
from nsm.view.store import Key


def record(
    path: Path | str, subjects: Sequence[LoadedMorph], settings: Settings, times: Sequence[float], seconds: float = 6.0
) -> Iterator[int]:
    """Write an HTML file that holds all frames and the page that plays them to and fro, by viser's own recording.

    Args:
        path: the file, which appears whole or not at all.
        subjects: the morphs, all of one dimension.
        settings: of all frames.
        times: from 0 to 1, one a frame.
        seconds: from 0 to 1.

    Yields:
        How many frames are done, of ``len(subjects) * len(times)``; the file is there when it ends.

    Raises:
        InputError: if the file cannot be written, the morphs are not of one dimension, or cannot be colored so.
    """
    morphs = [subject.morph for subject in subjects]
    dim = one_dimension(subjects)
    settings.check(morphs)
    photographers = [Photographer(morph) for morph in morphs]
    with whole_file(path) as temporary:
        server = open_server("127.0.0.1", None)
        try:
            stage = Stage(server, [subject.name for subject in subjects], [Extent.of(morph) for morph in morphs], dim)
            captions: list[dict[int, str]] = []
            for number, instant in enumerate(times):
                captions.append({})
                for morph, photographer in enumerate(photographers):
                    surface = photographer.surface(instant, settings)
                    stage.add(Key(morph, number, settings), photographer.picture(surface, instant, settings).glb)
                    captions[-1][morph] = caption(instant, surface)
                    yield number * len(morphs) + morph + 1
            recorder = server.get_scene_serializer()
            for number in [*range(len(times)), *reversed(range(len(times) - 1))]:
                stage.show({morph: Key(morph, number, settings) for morph in range(len(morphs))}, captions[number])
                recorder.insert_sleep(seconds / (len(times) - 1))
            temporary.write_text(recorder.as_html(), encoding="utf-8")
        finally:
            close_server(server)
