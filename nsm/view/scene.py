"""The pictures of morphs on the page, of which one per morph is visible."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import viser

from nsm.view.pictures import Settings
from nsm.view.stage import Extent, Stage
from nsm.view.store import Key


class Scene:
    """Pictures of morphs on a stage: every picture is a node of its own, of which one per morph is visible.

    The browser receives pictures before they are shown, so that one replaces another at once and nothing flickers.

    Args:
        server: Server of the page.
        names: Names of the morphs.
        extents: Extents of the morphs.
        dim: Dimension of space.
    """

    def __init__(self, server: viser.ViserServer, names: Sequence[str], extents: Sequence[Extent], dim: int) -> None:
        self.server = server
        self._stage = Stage(server, names, extents, dim)
        self._nodes: dict[Key, viser.GlbHandle] = {}
        self._shown: dict[int, Key] = {}
        self._settings: dict[Settings, int] = {}

    @property
    def shown(self) -> set[Key]:
        """Keys of the visible pictures."""
        return set(self._shown.values())

    def add(self, key: Key, content: bytes | None) -> None:
        """Send a picture to the browser, where it stays hidden until `show` selects it."""
        if content is not None:
            number = self._settings.setdefault(key.settings, len(self._settings))
            name = f"{self._stage.folder(key.morph)}/settings_{number}/{key.time}"
            self._nodes[key] = self.server.scene.add_glb(name, content, visible=False)

    def remove(self, keys: Sequence[Key]) -> None:
        """Remove pictures from the browser."""
        for key in keys:
            if (node := self._nodes.pop(key, None)) is not None:
                node.remove()

    def show(self, keys: Mapping[int, Key], captions: Mapping[int, str]) -> None:
        """Replace the visible picture and caption of each given morph, all at once."""
        with self.server.atomic():
            for morph, key in keys.items():
                before = self._shown.get(morph)
                if before == key:
                    continue
                for other, visible in ((before, False), (key, True)):
                    if other is not None and other in self._nodes:
                        self._nodes[other].visible = visible
                self._shown[morph] = key
            for morph, text in captions.items():
                self._stage.caption(morph, text)
