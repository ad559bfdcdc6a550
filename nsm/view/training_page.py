"""The second part of the studio: how far training is, and the morph at its latest validation."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
import viser
from viser import uplot

from nsm.cli.progress import duration
from nsm.geometry.topology import component_count, enclosed_volume
from nsm.io.checkpoint import load_morph
from nsm.morphs.surfaces import extract_frame
from nsm.plots.curves import COLORS
from nsm.view.controls import percent
from nsm.view.notice import Notice, styled
from nsm.view.pictures import PictureMaker, Settings, Surface
from nsm.view.server import clear_panel
from nsm.view.stage import Extent, Stage
from nsm.view.training_run import TrainingProgress, TrainingRun

log = logging.getLogger(__name__)

#: Times of the strip, and cells along the box.
_TIMES, _RESOLUTION = (0.0, 0.25, 0.5, 0.75, 1.0), 48
#: Seconds between two looks at the run.
_INTERVAL = 0.3
#: Height of the plot of the loss in pixels.
_PLOT = 150
#: Space around it in pixels: above, right, below, left. Labels at the ends of the axes reach into it.
_PADDING = (10, 12, 0, 4)


class Picture(NamedTuple):
    """The morph at one time of the strip: name, GLB, extent, and caption."""

    name: str
    glb: bytes
    extent: Extent
    caption: str


class TrainingPage:
    """Progress of a training, which the page follows until it ends.

    Args:
        server: Server of the page.
        run: The training.
        ended: Called in the end, in a thread of its own.
    """

    def __init__(self, server: viser.ViserServer, run: TrainingRun, ended: Callable[[], object]) -> None:
        self.server, self.run, self._ended = server, run, ended
        clear_panel(server)
        gui = server.gui
        self._notice = Notice(server, f"The run is kept in {run.folder}.")
        with gui.add_folder("Training"):
            self._bar: Any = gui.add_progress_bar(0.0, animated=True)
            self._status = gui.add_html(styled("starting"))
            self._figures = gui.add_html("")
            self._plot = gui.add_uplot(
                (np.zeros(1), np.ones(1)),
                (uplot.Series(label="step"), uplot.Series(label="loss", stroke=COLORS[0], width=2)),
                title="loss",
                scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True, distr=3)},
                legend=uplot.Legend(show=False),
                height=_PLOT,
                padding=_PADDING,
                visible=False,
            )
            stop = gui.add_button("Stop and keep", icon=viser.Icon.PLAYER_STOP_FILLED)
        stop.on_click(self._notice.guard(lambda event: self.stop()))
        self._losses: dict[int, float] = {}
        self._shown = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    @property
    def status(self) -> str:
        """The line below the bar, as HTML."""
        return str(self._status.content)

    def stop(self) -> None:
        """Stop training after the present step."""
        self.run.job.stop()
        self._notice.say("Stopping after the present step …")

    def close(self) -> None:
        """End the training and follow it no more."""
        self._closing.set()
        self.run.job.close()

    def _follow(self) -> None:
        while self.run.job.running and not self._closing.wait(_INTERVAL):
            try:
                self._report()
                self._draw()
            except Exception:  # training goes on, whatever cannot be shown of it
                log.exception("the progress of training cannot be shown")
        if not self._closing.is_set():
            self._ended()

    def _report(self) -> None:
        progress = self.run.progress()
        if progress is None:
            self._status.content = styled(": ".join(filter(None, ["preparing the shapes", self.run.job.last_line()])))
            return
        self._bar.value = 100 * progress.step / progress.steps
        self._status.content = styled(describe(progress))
        self._losses[progress.step] = progress.loss
        self._plot.data = np.array(list(self._losses), float), np.array(list(self._losses.values()))
        self._plot.visible = True
        if "val/volume_max" in progress.figures:
            self._figures.content = styled(f"volume within ±{100 * progress.figures['val/volume_max']:.2g} %")

    def _draw(self) -> None:
        """Show the morph of the latest validation, if that is new."""
        file = self.run.latest()
        changed = file.stat().st_mtime_ns if file is not None else 0
        if file is None or changed == self._shown:
            return
        self._shown = changed
        morph = load_morph(file)
        if not (pictures := strip(PictureMaker(morph))):
            return
        names = [picture.name for picture in pictures]
        with self.server.atomic():
            stage = Stage(self.server, names, [picture.extent for picture in pictures], morph.dim)
            for number, picture in enumerate(pictures):
                stage.caption(number, picture.caption)
                self.server.scene.add_glb(f"{stage.folder(number)}/surface", picture.glb)


def describe(progress: TrainingProgress) -> str:
    """Say how far training is.

    >>> describe(TrainingProgress(120, 1000, 0.01234, {}, 75.0))
    'step 120 of 1000 · loss 0.0123 · 1 min 15 s left'
    >>> describe(TrainingProgress(1000, 1000, 0.01234, {}, 0.0))
    'step 1000 of 1000 · loss 0.0123 · measuring the morph'
    """
    parts = [f"step {progress.step} of {progress.steps}", f"loss {progress.loss:.3g}"]
    if progress.step == progress.steps:
        parts.append("measuring the morph")
    elif progress.left is not None:
        parts.append(f"{duration(progress.left)} left")
    return " · ".join(parts)


@torch.no_grad()
def strip(maker: PictureMaker) -> list[Picture]:
    """Show a morph at a few times, at a low resolution; times without a surface are left out."""
    morph, settings, pictures, first = maker.morph, Settings(_RESOLUTION), [], 0.0
    for time in _TIMES:
        _, _, mesh, normals = extract_frame(morph, time, _RESOLUTION)
        if not len(mesh.simplices):
            continue
        inside = enclosed_volume(mesh)
        first = first or inside
        deviation = inside / morph.wanted_volume(time, first) - 1
        surface = Surface(mesh, normals, 0.0, inside, deviation, component_count(mesh))
        points = mesh.vertices.cpu().double().numpy()
        points = np.concatenate([points, np.zeros((len(points), 3 - morph.dim))], 1)
        glb = maker.picture(surface, time, settings).glb
        assert glb is not None
        pictures.append(Picture(f"t = {time:g}", glb, Extent(points.min(0), points.max(0)), percent(deviation)))
    return pictures
