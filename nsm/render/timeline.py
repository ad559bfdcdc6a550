"""Plot of the volume over time, with a marker that moves as a film plays."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from nsm.geometry.volume import volume
from nsm.metrics import VolumeCurve
from nsm.morphs.surfaces import Levels
from nsm.plots.curves import COLORS
from nsm.render.panel import pixels
from nsm.types import Morph

#: Number of times at which the volume is measured.
_TIMES = 21
#: Points of each drawn curve.
_POINTS = 401
#: Deviation in percent below which a curve should look flat.
_FLAT = 0.5
_DPI = 100


def measure_volumes(morph: Morph, levels: Levels) -> VolumeCurve:
    """Measure the volume that a morph's surface encloses at the level of each time."""
    times = torch.linspace(0, 1, _TIMES, dtype=torch.double)
    volumes = []
    for time in times.tolist():
        level = levels(time)
        volumes.append(volume(lambda x, t=time, c=level: morph(x, t) - c, morph.bounds))  # type: ignore[misc]
    return VolumeCurve(times, torch.tensor(volumes, dtype=torch.double))


class Timeline:
    """Plot of each morph's volume relative to that at t = 0, with a dot at the current time.

    Args:
        curves: Volume curves by name.
        size: Width and height in pixels.
    """

    def __init__(self, curves: Mapping[str, VolumeCurve], size: tuple[int, int]) -> None:
        self.size = size
        self._times = np.linspace(0, 1, _POINTS)
        self._curves = {}
        for name, curve in curves.items():
            deviation = 100 * torch.nan_to_num(curve.deviations, 0.0, 0.0, 0.0).numpy()
            self._curves[name] = PchipInterpolator(curve.times.numpy(), deviation)(self._times)
        values = np.concatenate([*self._curves.values(), [-_FLAT, _FLAT]])
        margin = 0.15 * (values.max() - values.min())
        self._range = (float(values.min() - margin), float(values.max() + margin))

    def draw(self, time: float) -> np.ndarray:
        """Draw the plot at a time as sRGB pixels of 8 bits (height, width, 3)."""
        width, height = self.size
        figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        letters = 0.095 * height * 72 / _DPI
        line = letters / 6
        axis = figure.add_axes((0.16, 0.3, 0.68, 0.6))
        axis.axhline(0, color="0.8", linewidth=line / 3, zorder=0)
        for number, values in enumerate(self._curves.values()):
            color = COLORS[number % len(COLORS)]
            axis.plot(self._times, values, color=color, alpha=0.25, linewidth=line)
            past = self._times <= time
            now = float(np.interp(time, self._times, values))
            axis.plot([*self._times[past], time], [*values[past], now], color=color, linewidth=1.4 * line)
            axis.plot([time], [now], "o", color=color, markersize=5 * line, clip_on=False, zorder=3)
        axis.set_xlim(0, 1)
        axis.set_ylim(*self._range)
        axis.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "1"])
        axis.locator_params(axis="y", nbins=4)
        axis.tick_params(labelsize=letters, width=line / 3, length=letters / 3, color="0.6", labelcolor="0.3")
        axis.spines[["top", "right"]].set_visible(False)
        axis.spines[:].set(color="0.6", linewidth=line / 3)
        axis.set_ylabel("volume ±%", fontsize=letters, color="0.3")
        figure.text(0.86, 0.6, f"t = {time:.2f}", fontsize=1.6 * letters, va="center", color="0.15")
        return pixels(figure)
