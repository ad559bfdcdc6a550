"""Control panel of the page: time, figures, settings of the surface and its color, and progress."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
import viser
from viser import uplot

from nsm.plots.colors import RESIDUALS, colormap
from nsm.plots.curves import COLORS
from nsm.view.pictures import Settings, Surface

#: Resolutions to choose from, besides the initial one.
_RESOLUTIONS = (48, 64, 96, 128, 192, 256)
#: Greatest level relative to the edge of the box, and number of steps of the slider from 0 to it.
_REACH, _STEPS = 0.05, 50
#: Speeds of playback relative to the setting ``seconds``, by label.
_SPEEDS = {f"{speed:g}×": speed for speed in (0.25, 0.5, 1.0, 2.0, 4.0)}
#: Labels of colors.
_LABELS = {
    "clay": "clay",
    "position": "position",
    "advected": "position at t = 0, advected",
    "level_set": "level-set residual",
    "eikonal": "Eikonal residual",
}
#: Explanations of colors, and of those that show a residual.
_LEGENDS = {
    "clay": "",
    "position": "Each point has the color of its position.",
    "advected": "Each point has the color of its position at t = 0, from where the velocity has advected it.",
}
_RESIDUAL_LEGENDS = {
    "level_set": "|∂f/∂t + ⟨∇f, V⟩| / ‖∇f‖, the normal speed of the surface that V does not account for",
    "eikonal": "|‖∇f‖ − 1|, zero for a distance",
}


class Controls:
    """Control panel of the page.

    Values from the browser are checked before use: any page can send messages to the server.

    Args:
        server: Server of the page.
        names: Names of the morphs.
        times: Times in [0, 1], one per picture.
        settings: Initial settings.
        colors: Keys of `nsm.plots.colors.COLORS` to choose from.
        edge: Longest edge of the boxes of all morphs.
        dim: Dimension of space.

    Attributes:
        on_time: Called with the index of the time that a user selects.
        on_settings: Called with the settings that a user selects.
        playing: Whether time advances by itself.
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
        self.names, self.times, self._chosen = names, times, settings
        self._measure = "area" if dim == 2 else "volume"
        self.on_time: Callable[[int], None] = lambda number: None
        self.on_settings: Callable[[Settings], None] = lambda settings: None
        self.playing = False
        gui = server.gui
        with gui.add_folder("Time"):
            step = 1 / (len(times) - 1)
            self._time: Any = gui.add_slider("t", 0.0, 1.0, step, 0.0)
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY_FILLED)
            self._speed = gui.add_dropdown("Speed", list(_SPEEDS), initial_value="1×")
            self._progress: Any = gui.add_progress_bar(0.0)
            self._work = gui.add_markdown("computing the first surface")
        with gui.add_folder("Figures"):
            self._figures = gui.add_markdown(self._table({}))
            self._curves = gui.add_uplot(*self._empty_curves(), **self._axes(), height=150)
        with gui.add_folder("Surface"):
            self._resolutions = {str(n): n for n in sorted({*_RESOLUTIONS, settings.resolution})}
            self._resolution = gui.add_dropdown(
                "Resolution",
                list(self._resolutions),
                initial_value=str(settings.resolution),
                hint="Cells along the box",
            )
            self._reach = reach = max(_REACH * edge, abs(settings.offset))
            self._offset = gui.add_slider(
                "Level", -reach, reach, reach / _STEPS, settings.offset, hint="Value of f on the surface"
            )
            self._exact = gui.add_checkbox(
                f"Exact {self._measure}",
                settings.exact,
                hint=f"Show at each time the level set with the wanted {self._measure}",
            )
        with gui.add_folder("Color"):
            self._colors = {_LABELS[name]: name for name in colors}
            self._color = gui.add_dropdown("Shows", list(self._colors), initial_value=_LABELS[settings.color])
            self._legend = gui.add_html(legend(settings.color))
        self._time.on_update(self._moved)
        self._play.on_click(lambda event: self.play(not self.playing))
        for handle in (self._resolution, self._offset, self._exact, self._color):
            handle.on_update(self._changed)

    @property
    def settings(self) -> Settings:
        """Settings that the controls show; a control with a value that it does not offer keeps the previous one."""
        before = self._chosen
        offset = float(self._offset.value)
        self._chosen = Settings(
            self._resolutions.get(self._resolution.value, before.resolution),
            bool(self._exact.value),
            offset if abs(offset) <= self._reach else before.offset,
            self._colors.get(self._color.value, before.color),
        )
        return self._chosen

    @property
    def figures(self) -> str:
        """The table of figures as Markdown."""
        return str(self._figures.content)

    @property
    def speed(self) -> float:
        """Speed of playback relative to the setting ``seconds``."""
        return _SPEEDS.get(self._speed.value, 1.0)

    def play(self, on: bool) -> None:
        """Start or stop playback."""
        self.playing = on
        self._play.label = "Pause" if on else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE_FILLED if on else viser.Icon.PLAYER_PLAY_FILLED

    def move(self, number: int) -> None:
        """Move the slider to a time, given by its index."""
        self._time.value = self.times[number]

    def show_figures(self, shown: Mapping[int, Surface]) -> None:
        """Update the table with the figures of the visible surfaces, by index of the morph."""
        content = self._table(shown)
        if content != self._figures.content:
            self._figures.content = content

    def show_progress(self, ready: int, of: int, finished: bool) -> None:
        """Update the progress: how many of all surfaces are ready, and whether memory allows no more."""
        self._progress.value = 100 * ready / of
        if ready == of:
            self._work.content = f"all {of} surfaces are ready"
        elif finished:
            self._work.content = f"{ready} of {of} surfaces fill the memory; try a larger `memory`"
        else:
            self._work.content = f"{ready} of {of} surfaces are ready"

    def draw(self, times: Sequence[float], deviations: Sequence[Sequence[float]]) -> None:
        """Plot the relative deviations of the volume, one curve per morph, at times at which all of them are known."""
        rows = [np.asarray(times), *(100 * np.asarray(row) for row in deviations)]
        if len(times):
            self._curves.data = tuple(rows)

    def _moved(self, event: viser.GuiEvent[Any]) -> None:
        value = float(self._time.value)
        if event.client is not None and math.isfinite(value):  # without a client, `move` was the cause
            self.on_time(round(min(max(value, 0.0), 1.0) * (len(self.times) - 1)))

    def _changed(self, event: viser.GuiEvent[Any]) -> None:
        settings = self.settings
        self._legend.content = legend(settings.color)
        self.on_settings(settings)

    def _table(self, shown: Mapping[int, Surface]) -> str:
        """The figures as Markdown, one column per morph."""
        rows: list[tuple[str, Callable[[Surface], str]]] = [
            (self._measure, lambda s: f"{s.volume:.4f}"),
            ("deviation", lambda s: percent(s.deviation)),
            ("components", lambda s: str(s.components)),
            ("level", lambda s: f"{s.level:+.4f}"),
        ]
        lines = ["| |" + "".join(f" {name} |" for name in self.names), "|---|" + "--:|" * len(self.names)]
        for title, text in rows:
            cells = [text(shown[n]) if n in shown else "…" for n in range(len(self.names))]
            lines.append(f"| {title} |" + "".join(f" {cell} |" for cell in cells))
        return "\n".join(lines)

    def _empty_curves(self) -> tuple[tuple[np.ndarray, ...], tuple[uplot.Series, ...]]:
        series = [
            uplot.Series(label=name, stroke=COLORS[n % len(COLORS)], width=2) for n, name in enumerate(self.names)
        ]
        return tuple(np.zeros(1) for _ in range(len(series) + 1)), (uplot.Series(label="t"), *series)

    def _axes(self) -> dict[str, Any]:
        return {
            "title": f"{self._measure}, deviation in %",
            "scales": {"x": uplot.Scale(time=False, range=(0.0, 1.0)), "y": uplot.Scale(auto=True)},
            "legend": uplot.Legend(show=False),
        }


def percent(share: float) -> str:
    """Format a relative deviation in percent.

    >>> percent(-0.0123)
    '-1.23 %'
    """
    return f"{100 * share:+.2f} %"


def legend(color: str) -> str:
    """Explain a color in HTML: a color bar for a residual, or a sentence."""
    if color in _LEGENDS:
        return f'<div style="font-size:0.8em;opacity:0.75;padding:0 0.6em">{_LEGENDS[color]}</div>'
    stops = (255 * colormap(torch.linspace(0, 1, 9))).round().int().tolist()
    bar = ", ".join(f"rgb({r},{g},{b})" for r, g, b in stops)
    return (
        '<div style="font-size:0.8em;padding:0 0.6em">'
        f'<div style="height:0.8em;border-radius:0.2em;background:linear-gradient(to right, {bar})"></div>'
        '<div style="display:flex;justify-content:space-between">'
        f"<span>0</span><span>{RESIDUALS[color][1]:g} and more</span></div>"
        f'<div style="opacity:0.75">{_RESIDUAL_LEGENDS[color]}</div></div>'
    )
