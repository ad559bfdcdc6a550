"""The first part of the studio: two files, landmarks on them, and what to train."""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import viser

from nsm.cli.errors import InputError
from nsm.cli.groups import option_names
from nsm.plots.curves import COLORS
from nsm.view.clicks import Clicks
from nsm.view.notice import Notice, styled
from nsm.view.preview import Preview
from nsm.view.server import clear
from nsm.view.stage import Stage
from nsm.view.training_run import BUDGETS, Choices
from nsm.view.uploads import DROP_AREAS, keep_upload, limit_uploads, too_large

#: Names of the two shapes on the page.
SIDES = ("First shape", "Second shape")
_WELCOME = "Choose two files of shapes: meshes, point clouds, volumes of labels, images, or drawings."
_READY = "Both shapes are there. Click landmarks on them if corresponding points matter, and start the training."
#: Radius of the dots of landmarks, and height of their numbers above them, in units of the box.
_DOT, _ABOVE = 0.035, 0.06
#: Colors of the dots, those of curves without the blue that surfaces have.
_COLORS = COLORS[1:]


class Setup:
    """Panel and scene for choosing what to train.

    Args:
        server: Server of the page.
        folder: Folder for files that the browser sends.
        limit: Greatest size of a file in bytes.
        start: Called with what to train.
    """

    def __init__(self, server: viser.ViserServer, folder: Path, limit: int, start: Callable[[Choices], object]) -> None:
        self.server, self._folder, self._limit, self._start = server, folder, limit, start
        self.previews: list[Preview | None] = [None, None]
        self.clicks = Clicks()
        self._lock = threading.RLock()
        self._surfaces: list[viser.GlbHandle] = []
        self._dots: dict[int, list[Any]] = {0: [], 1: []}
        self._stage: Stage | None = None
        limit_uploads(server, limit, self._refuse)

    def show(self, error: str = "") -> None:
        """Show panel and shapes, with the reason if something has failed."""
        with self._lock:
            clear(self.server)
            gui = self.server.gui
            self._notice = Notice(self.server)
            with gui.add_folder("Shapes"):
                self._uploads = [self._add_upload(side, order=2 * side) for side in (0, 1)]
                self._files = [gui.add_html("", order=2 * side + 1) for side in (0, 1)]
                gui.add_html(DROP_AREAS)
            with gui.add_folder("Landmarks"):
                self._picking: Any = gui.add_checkbox(
                    "Pick by click", False, hint="Click the same point on both shapes"
                )
                self._counts = gui.add_html("")
                self._undo = gui.add_button("Undo", icon=viser.Icon.ARROW_BACK_UP)
                self._save = gui.add_button("Save as CSV", icon=viser.Icon.DOWNLOAD)
            with gui.add_folder("Training"):
                self._budget = gui.add_dropdown("Budget", list(BUDGETS[3]), initial_value="fast")
                self._align = gui.add_dropdown("Alignment", option_names("align"), initial_value="none")
                self._begin = gui.add_button("Start training", icon=viser.Icon.PLAYER_PLAY_FILLED)
            self._picking.on_update(self._notice.guard(lambda event: self._listen()))
            self._undo.on_click(self._notice.guard(lambda event: self.undo()))
            self._save.on_click(self._notice.guard(self._download))
            self._begin.on_click(self._notice.guard(lambda event: self._start(self.choices())))
            self._draw()
            if error:
                self._notice.warn(error)

    @property
    def said(self) -> str:
        """The sentence at the top of the panel, as HTML."""
        return self._notice.content

    def receive(self, side: int, name: str, content: bytes) -> None:
        """Read a file that the browser has sent, and show its shape.

        Raises:
            InputError: If it is too large, or holds no shape of the dimension of the other one.
        """
        with self._lock:
            if len(content) > self._limit:
                raise too_large(name, len(content), self._limit)
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            try:
                preview = self._read(folder, side, name, content)
            except BaseException:
                shutil.rmtree(folder)
                raise
            self.previews[side] = preview
            self.clicks.clear()
            self._draw()

    def _read(self, folder: Path, side: int, name: str, content: bytes) -> Preview:
        """Keep a file in a folder of its own, and read its shape, which must fit to the other one."""
        path = keep_upload(folder, name, content)
        self._notice.say(f"Reading {path.name} …")
        try:
            preview = Preview(path)
        except InputError as error:
            raise type(error)(str(error).replace(f"{folder}/", "")) from error  # the user knows no folder
        other = self.previews[1 - side]
        if other is not None and other.dim != preview.dim:
            raise InputError(
                f"Both shapes must have the same dimension, got `{path.name}` in {preview.dim}D beside "
                f"`{other.path.name}` in {other.dim}D. Try two meshes, or two images."
            )
        return preview

    def click(self, side: int, origin: Any, direction: Any) -> None:
        """Add a landmark where a ray of the page meets a shape, if landmarks are picked."""
        with self._lock:
            preview, stage = self.previews[side], self._stage
            if preview is None or stage is None or not self._picking.value:
                return
            ray = np.asarray(origin, float), np.asarray(direction, float)
            point = preview.pick(*stage.ray(self._place(side), *ray))
            if point is not None:
                self.clicks.add(side, preview.in_file(point))
                self._add_dot(side, point)
                self._report()

    def undo(self) -> None:
        """Remove the landmark that was clicked last."""
        with self._lock:
            if (side := self.clicks.undo()) is not None:
                for node in self._dots[side].pop():
                    node.remove()
                self._report()

    def choices(self) -> Choices:
        """What the page says to train.

        Raises:
            InputError: If a shape is missing, or a landmark has no partner.
        """
        with self._lock:
            source, target = self.previews
            if source is None or target is None:
                missing = "first shape" if source is None else "second shape"
                raise InputError(f"The `{missing}` must be chosen before training, got no file. Try the button above.")
            clicked = self.clicks.count(0) + self.clicks.count(1)
            budgets = BUDGETS[source.dim]
            return Choices(
                source.path,
                target.path,
                source.dim,
                self._budget.value if self._budget.value in budgets else next(iter(budgets)),
                self._align.value if self._align.value in option_names("align") else "none",
                self.clicks.table() if clicked else None,
            )

    def leave(self) -> None:
        """Listen to no more clicks on the shapes, which stay visible."""
        with self._lock:
            self._picking.value = False
            self._listen()

    def _add_upload(self, side: int, order: float) -> viser.GuiUploadButtonHandle:
        label = f"{SIDES[side]} (t = {side})"
        button = self.server.gui.add_upload_button(label, icon=viser.Icon.UPLOAD, order=order)

        def receive(event: Any) -> None:
            self.receive(side, str(button.value.name), button.value.content)

        button.on_upload(self._notice.guard(receive))
        return button

    def _refuse(self, button: str, error: InputError) -> None:
        if button in [upload._impl.uuid for upload in self._uploads]:
            self._notice.warn(str(error))

    def _download(self, event: Any) -> None:
        event.client.send_file_download("landmarks.csv", self.clicks.table().encode(), save_immediately=True)

    def _place(self, side: int) -> int:
        """Place of a shape on the stage."""
        return side if self.previews[0] is not None else 0

    def _draw(self) -> None:
        """Show the shapes that are there, side by side, without landmarks."""
        there = [(side, preview) for side, preview in enumerate(self.previews) if preview is not None]
        for side, preview in there:
            self._files[side].content = styled(f"{preview.path.name}: {preview.kind} in {preview.dim}D")
        self._notice.say(_READY if len(there) == 2 else _WELCOME)
        self._surfaces, self._dots = [], {0: [], 1: []}
        if there:
            dim, extents = there[0][1].dim, [preview.extent for _, preview in there]
            self._stage = Stage(self.server, [SIDES[side] for side, _ in there], extents, dim)
            for side, preview in there:
                self._stage.caption(self._place(side), f"t = {side}")
                node = f"{Stage.folder(self._place(side))}/surface"
                self._surfaces.append(self.server.scene.add_glb(node, preview.glb))
            for side, preview in there:
                for point in self.clicks.points(side):
                    self._add_dot(side, preview.in_box(point))
        self._listen()
        self._report()

    def _listen(self) -> None:
        """Listen to clicks on the shapes exactly if landmarks are picked."""
        sides = [side for side, preview in enumerate(self.previews) if preview is not None]
        for side, surface in zip(sides, self._surfaces, strict=True):
            surface.remove_click_callback("all")
            if self._picking.value:
                surface.on_click(self._notice.guard(partial(self._clicked, side)))

    def _clicked(self, side: int, event: Any) -> None:
        self.click(side, event.ray_origin, event.ray_direction)

    def _add_dot(self, side: int, point: np.ndarray) -> None:
        number, folder = len(self._dots[side]), Stage.folder(self._place(side))
        red, green, blue = bytes.fromhex(_COLORS[number % len(_COLORS)].lstrip("#"))
        name, position = f"{folder}/landmark_{number}", tuple(point)
        dot = self.server.scene.add_icosphere(name, _DOT, color=(red, green, blue), position=position)
        above = (point[0], point[1] + _ABOVE, point[2])
        label = self.server.scene.add_label(f"{name}_number", str(number + 1), position=above, anchor="bottom-center")
        self._dots[side].append((dot, label))

    def _report(self) -> None:
        """Show how many landmarks there are, and enable the controls that have something to work on."""
        first, second = self.clicks.count(0), self.clicks.count(1)
        self._counts.content = styled(count_landmarks(first, second))
        self._undo.disabled = self._save.disabled = not first + second
        self._picking.disabled = self.previews == [None, None]
        self._begin.disabled = None in self.previews


def count_landmarks(first: int, second: int) -> str:
    """Say how many landmarks are on the first and the second shape.

    >>> count_landmarks(0, 0), count_landmarks(1, 1), count_landmarks(2, 2), count_landmarks(2, 1)
    ('no pairs', '1 pair', '2 pairs', '2 on the first shape, 1 on the second')
    """
    if first != second:
        return f"{first} on the first shape, {second} on the second"
    return f"{first or 'no'} pair{'' if first == 1 else 's'}"
