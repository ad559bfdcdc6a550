"""Curves over time, as CSV files and as pictures."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from torch import Tensor

from nsm.cli.files import atomic_write

#: Times and values of each line, by name.
Curves = Mapping[str, tuple[Sequence[float], Sequence[float]]]
#: Least extent of the axis of volumes in percent on either side of 0, so that a change below it looks flat.
_FLAT = 0.1
#: Colors that color-blind readers can tell apart (Okabe and Ito, Color Universal Design, 2008,
#: https://jfly.uni-koeln.de/color/), the least bright ones first.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
#: Names per row of a legend, and the height of such a row in inches.
_LEGEND_COLUMNS, _LEGEND_ROW = 3, 0.17
#: Styles of lines, the next one each time the colors are used up.
LINES = ("-", "--", ":", "-.")


#: Columns of the table of a volume curve.
VOLUME_COLUMNS = ("time", "volume", "deviation")


def volume_rows(times: Tensor, volumes: Tensor) -> list[list[float]]:
    """Tabulate a volume curve: time, volume, and deviation, V / V(0) − 1.

    >>> import torch
    >>> volume_rows(torch.tensor([0.0, 1.0]), torch.tensor([2.0, 3.0]))
    [[0.0, 2.0, 0.0], [1.0, 3.0, 0.5]]

    Args:
        times: Times, shape (k,).
        volumes: Volume at each time, shape (k,).
    """
    return torch.stack([times, volumes, volumes / volumes[0] - 1], dim=1).tolist()


def write_volume_curve(path: Path | str, times: Tensor, volumes: Tensor) -> None:
    """Write a volume curve as CSV with the columns time, volume, and deviation, V / V(0) − 1.

    Args:
        path: File to write.
        times: Times, shape (k,).
        volumes: Volume at each time, shape (k,).
    """
    with atomic_write(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(VOLUME_COLUMNS)
        for row in volume_rows(times, volumes):
            writer.writerow([f"{number:.9g}" for number in row])


def plot_volume_curves(path: Path | str, curves: Mapping[str, tuple[Tensor, Tensor]]) -> None:
    """Draw the change of volume since t = 0 in percent, one line per morph (figure 10 of the paper).

    Args:
        path: Picture to write; its suffix chooses the format (.png, .pdf, .svg).
        curves: Times and volumes by name of the morph, both of shape (k,).
    """
    rows = -(-len(curves) // _LEGEND_COLUMNS)
    figure = Figure(figsize=(5.2, 2.7 + _LEGEND_ROW * rows), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.axhline(0, color="0.75", linewidth=0.8, zorder=0)
    changes = {name: (times.tolist(), percent_change(volumes)) for name, (times, volumes) in curves.items()}
    values = _draw(axes, changes, "change of volume in %")
    lowest, highest = min([-_FLAT, *values]), max([_FLAT, *values])
    margin = 0.08 * (highest - lowest)
    axes.set_ylim(lowest - margin, highest + margin)
    _share_legend(figure, axes)
    with atomic_write(path) as temporary:
        figure.savefig(temporary)


def plot_curves(path: Path | str, panels: Mapping[str, Curves], columns: int = 3) -> None:
    """Draw several quantities over time, one panel each, with one line per morph and a shared legend.

    An axis whose values are all integers is one of counts, and has ticks at integers only.

    Args:
        path: Picture to write; its suffix chooses the format (.png, .pdf, .svg).
        panels: Curves of each panel by the label of its axis of values; a value that is not defined is nan.
        columns: Number of panels per row.
    """
    columns = min(columns, len(panels))
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.6 * columns, 1.9 * rows + 0.3), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for axes, (label, curves) in zip(grid, panels.items(), strict=False):
        values = _draw(axes, curves, label)
        if axes.get_subplotspec().rowspan.stop * columns + axes.get_subplotspec().colspan.start < len(panels):
            axes.set_xlabel("")
        axes.xaxis.label.set_size("small")
        axes.yaxis.label.set_size("small")
        axes.tick_params(labelsize="small", labelbottom=True)
        if all(value == round(value) for value in values):
            axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5))
            axes.set_ylim(-0.1, 1.08 * max([1.0, *values]))
        elif 0 <= min(values) < 0.5 * max(values):  # values near 0 are compared with 0
            axes.set_ylim(0, 1.08 * max(values))
    for axes in grid[len(panels) :]:
        axes.set_axis_off()
    _share_legend(figure, grid[0])
    with atomic_write(path) as temporary:
        figure.savefig(temporary)


def percent_change(values: Tensor) -> list[float]:
    """Deviation of each value from the first, in percent of the first, k values.

    >>> import torch
    >>> percent_change(torch.tensor([2.0, 3.0]))
    [0.0, 50.0]
    """
    return (100 * (values / values[0] - 1)).tolist()


def _draw(axes: Axes, curves: Curves, label: str) -> list[float]:
    """Draw one line per morph, and return all finite values."""
    for number, (name, (times, values)) in enumerate(curves.items()):
        again, color = divmod(number, len(COLORS))
        style = LINES[again % len(LINES)]
        axes.plot(times, values, style, label=name, color=COLORS[color], marker="o", markersize=3, linewidth=1.5)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("time")
    axes.set_ylabel(label)
    axes.spines[["top", "right"]].set_visible(False)
    return [value for _, values in curves.values() for value in values if math.isfinite(value)]


def _share_legend(figure: Figure, axes: Axes) -> None:
    """Put one legend above all panels, where no curve crosses it."""
    handles, names = axes.get_legend_handles_labels()
    if handles:
        columns = min(len(handles), _LEGEND_COLUMNS)
        figure.legend(handles, names, loc="outside upper center", ncols=columns, frameon=False, fontsize="small")
