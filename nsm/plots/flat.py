"""Drawings of 2D shapes: filled, with their level sets."""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from matplotlib.axes import Axes

from nsm.geometry.grid import Lattice, evaluate
from nsm.plots.look import Look, clay
from nsm.types import Morph

#: Level sets on either side of the outline, and their distance as a share of the box.
_LEVELS, _SPACING = 20, 1 / 24
#: From the outline inwards, and from it outwards.
_INSIDE = ("#CFE1F5", "#B4CFEC", "#98BCE2", "#7CA8D7", "#6496CB", "#5086BF")
_OUTSIDE = ("#FFFFFF", "#FCFCFC", "#FAFAFA", "#F8F8F8", "#F6F6F6", "#F4F4F4")
#: Lines of the level sets inside and outside, and the outline.
_LINE_INSIDE, _LINE_OUTSIDE = "#6E97C4", "0.80"
_OUTLINE = "#174A85"


class PlaneDrawing:
    """Draws a 2D morph on axes that have the shape of its box: inside filled, outline strong, level sets fine.

    Args:
        morph: of two dimensions.
        look: how fine, at which levels, in which colors; clay shades the inside by its depth.
    """

    def __init__(self, morph: Morph, look: Look) -> None:
        self._morph, self._look, self._levels = morph, look, look.levels(morph)
        lattice = Lattice.corners(morph.bounds, look.resolution)
        ticks = [torch.arange(n, device=morph.bounds.device) for n in lattice.shape]
        self._points = lattice.points(torch.stack(torch.meshgrid(*ticks, indexing="ij"), -1))
        extent = morph.bounds[1] - morph.bounds[0]
        width, height = extent.tolist()
        #: Height of the box as a share of its width.
        self.aspect = height / width
        self._spacing = float(extent.max()) * _SPACING

    def draw(self, axis: Axes, time: float, line: float = 1.6) -> None:
        """Draw one time, with an outline of ``line`` points."""
        field = partial(self._morph, t=time)
        values = evaluate(field, self._points.view(-1, 2)).view(self._points.shape[:2]) - self._levels(time)
        heights, place = values.cpu().numpy(), self._points.cpu().unbind(-1)
        steps = self._spacing * np.arange(-_LEVELS, _LEVELS + 1)
        deeper, higher = (
            [shades[min(number, len(shades) - 1)] for number in range(_LEVELS)] for shades in (_INSIDE, _OUTSIDE)
        )
        axis.contourf(*place, heights, levels=steps, colors=[*deeper[::-1], *higher], extend="both")
        if self._look.colors is not clay:
            self._fill(axis, values, time)
        for levels, color in ((steps[steps < 0], _LINE_INSIDE), (steps[steps > 0], _LINE_OUTSIDE)):
            axis.contour(*place, heights, levels=levels, colors=color, linewidths=line / 4, linestyles="-")
        if heights.min() < 0 < heights.max():
            axis.contour(*place, heights, levels=[0.0], colors=_OUTLINE, linewidths=line)
        low, high = self._morph.bounds.cpu().double().numpy()
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
        axis.set_xticks([])
        axis.set_yticks([])

    def _fill(self, axis: Axes, values: torch.Tensor, time: float) -> None:
        """Colors of the look inside the shape and just around it, where the outline covers their rim."""
        inside = values < 0.25 * self._spacing
        pixels = np.zeros((*values.shape, 4))
        if bool(inside.any()):
            colors = self._look.colors(self._morph, self._points[inside], time)
            pixels[inside.cpu().numpy()] = np.c_[colors.cpu().double().numpy(), np.ones(len(colors))]
        pixels[..., 3] *= (values < 0).cpu().numpy()
        low, high = self._morph.bounds.cpu().double().numpy()
        extent = (low[0], high[0], low[1], high[1])
        # over the filled contours and under their lines
        axis.imshow(
            pixels.swapaxes(0, 1), extent=extent, origin="lower", interpolation="bilinear", aspect="auto", zorder=1.5
        )
