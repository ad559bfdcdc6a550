"""What stands beside the scene: time, figures, how the surface is made and colored, and how far the work is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
import viser
from viser import uplot

from nsm.plots.colors import palette
from nsm.view.frames import COLORS, Settings, Surface, scale_of

#: Resolutions to choose from, beside that of the start.
_RESOLUTIONS = (48, 64, 96, 128, 192, 256)
#: The level goes this far to either side, in shares of the box's edge, in this many steps.
_REACH, _STEPS = 0.05, 50
#: How much faster than planned a morph may be played, and how much slower.
_SPEEDS = ("0.25×", "0.5×", "1×", "2×", "4×")
#: Lines of the volume curves, one a morph, then again from the first.
_LINES = ("#2f5fb3", "#d9762b", "#3a9a5b", "#a2519e")
_LEGENDS = {
    "clay": "",
    "carried": "Each point has the color of where the velocity has brought it from since t = 0.",
}
_RESIDUALS = {
    "level_set": "|∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖, the speed at which V leaves the surface behind",
    "eikonal": "|‖∇f‖ − 1|, zero for a distance",
}


class Controls:
    """The panel.

    Args:
        server: of the page.
        names: of the morphs.
        times: from 0 to 1, one a frame.
        settings: to begin with.
        colors: keys of `COLORS` to choose from.
        edge: longest of the boxes' edges.
        dim: dimension of space.

    Attributes:
        on_time: called with the number of the frame that somebody moved to.
        on_settings: called with the settings that somebody chose.
        playing: whether the morphs are to move by themselves.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        names: Sequence[str],
        times: Sequence[float],
        settings: Settings,
        colors: Sequence[str],
        edge: float,
        dim: int,
    ) -> None:
        self.names, self.times, self._colors = names, times, colors
        self._measure = "area" if dim == 2 else "volume"
        self.on_time: Callable[[int], None] = lambda number: None
        self.on_settings: Callable[[Settings], None] = lambda settings: None
        self.playing = False
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(47, 95, 179))
        gui.set_panel_label("nsm")
        gui.main_panel.dock_right()
        with gui.add_folder("Time"):
            step = 1 / (len(times) - 1)
            self._time: Any = gui.add_slider("t", 0.0, 1.0, step, 0.0)
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY_FILLED)
            self._speed = gui.add_dropdown("Speed", _SPEEDS, initial_value="1×")
            self._progress: Any = gui.add_progress_bar(0.0)
            self._work = gui.add_markdown("computing the first frame")
        with gui.add_folder("Figures"):
            self._figures = gui.add_markdown(self._table({}))
            self._curves = gui.add_uplot(*self._empty_curves(), **self._axes(), height=150)
        with gui.add_folder("Surface"):
            choices = sorted({*_RESOLUTIONS, settings.resolution})
            self._resolution = gui.add_dropdown(
                "Resolution",
                [str(n) for n in choices],
                initial_value=str(settings.resolution),
                hint="Cells along the box",
            )
            reach = max(_REACH * edge, abs(settings.offset))
            self._offset = gui.add_slider(
                "Level", -reach, reach, reach / _STEPS, settings.offset, hint="The value of f on the surface"
            )
            self._exact = gui.add_checkbox(
                f"Exact {self._measure}",
                settings.exact,
                hint=f"At each time the level of the wanted {self._measure}",
            )
        with gui.add_folder("Color"):
            self._color = gui.add_dropdown(
                "Shows", [COLORS[name] for name in colors], initial_value=COLORS[settings.color]
            )
            self._legend = gui.add_html(legend(settings.color))
        self._time.on_update(self._moved)
        self._play.on_click(lambda event: self.play(not self.playing))
        for handle in (self._resolution, self._offset, self._exact, self._color):
            handle.on_update(self._chosen)

    @property
    def settings(self) -> Settings:
        """What is chosen now."""
        color = next(name for name in self._colors if COLORS[name] == self._color.value)
        return Settings(int(self._resolution.value), bool(self._exact.value), float(self._offset.value), color)

    @property
    def figures(self) -> str:
        """The table of figures, in Markdown."""
        return str(self._figures.content)

    @property
    def speed(self) -> float:
        """How many times faster than planned the morphs are played."""
        return float(self._speed.value.rstrip("×"))

    def play(self, on: bool) -> None:
        """Set the morphs in motion, or stop them."""
        self.playing = on
        self._play.label = "Pause" if on else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE_FILLED if on else viser.Icon.PLAYER_PLAY_FILLED

    def move(self, number: int) -> None:
        """Put the slider where the play has come to."""
        self._time.value = self.times[number]

    def tell(self, shown: Mapping[int, Surface]) -> None:
        """Write the figures of the surfaces on show, one a morph."""
        content = self._table(shown)
        if content != self._figures.content:
            self._figures.content = content

    def tell_progress(self, ready: int, of: int, finished: bool) -> None:
        """Say how many frames there are."""
        self._progress.value = 100 * ready / of
        if ready == of:
            self._work.content = f"all {of} frames are ready"
        elif finished:
            self._work.content = f"{ready} of {of} frames fill the memory: raise `memory` for more"
        else:
            self._work.content = f"{ready} of {of} frames are ready"

    def draw(self, times: Sequence[float], deviations: Sequence[Sequence[float]]) -> None:
        """Draw the deviation of the volume at times at which all morphs have a frame, a curve for each."""
        rows = [np.asarray(times), *(100 * np.asarray(row) for row in deviations)]
        if len(times):
            self._curves.data = tuple(rows)

    def _moved(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # else it was `move`
            self.on_time(round(self._time.value * (len(self.times) - 1)))

    def _chosen(self, event: viser.GuiEvent[Any]) -> None:
        settings = self.settings
        self._legend.content = legend(settings.color)
        self.on_settings(settings)

    def _table(self, shown: Mapping[int, Surface]) -> str:
        """The figures as Markdown, a column for each morph."""
        rows: list[tuple[str, Callable[[Surface], str]]] = [
            (self._measure, lambda s: f"{s.volume:.4f}"),
            ("deviation", lambda s: percent(s.deviation)),
            ("pieces", lambda s: str(s.components)),
            ("level", lambda s: f"{s.level:+.4f}"),
        ]
        lines = ["| |" + "".join(f" {name} |" for name in self.names), "|---|" + "--:|" * len(self.names)]
        for title, text in rows:
            cells = [text(shown[n]) if n in shown else "…" for n in range(len(self.names))]
            lines.append(f"| {title} |" + "".join(f" {cell} |" for cell in cells))
        return "\n".join(lines)

    def _empty_curves(self) -> tuple[tuple[np.ndarray, ...], tuple[uplot.Series, ...]]:
        series = [
            uplot.Series(label=name, stroke=_LINES[n % len(_LINES)], width=2) for n, name in enumerate(self.names)
        ]
        return tuple(np.zeros(1) for _ in range(len(series) + 1)), (uplot.Series(label="t"), *series)

    def _axes(self) -> dict[str, Any]:
        return {
            "title": f"{self._measure}, deviation in %",
            "scales": {"x": uplot.Scale(time=False, range=(0.0, 1.0)), "y": uplot.Scale(auto=True)},
            "legend": uplot.Legend(show=False),
        }


def percent(share: float) -> str:
    """A deviation as people read it."""
    return f"{100 * share:+.2f} %"


def legend(color: str) -> str:
    """What a color says, as HTML: a bar from the least to the largest residual, or a sentence."""
    if color in _LEGENDS:
        return f'<div style="font-size:0.8em;opacity:0.75;padding:0 0.6em">{_LEGENDS[color]}</div>'
    stops = (255 * palette(torch.linspace(0, 1, 9))).round().int().tolist()
    bar = ", ".join(f"rgb({r},{g},{b})" for r, g, b in stops)
    return (
        '<div style="font-size:0.8em;padding:0 0.6em">'
        f'<div style="height:0.8em;border-radius:0.2em;background:linear-gradient(to right, {bar})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>0</span><span>{scale_of(color):g} and more</span></div>"
        f'<div style="opacity:0.75">{_RESIDUALS[color]}</div></div>'
    )
