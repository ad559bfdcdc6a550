"""Volume curves as CSV and as a figure."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from torch import Tensor

from nsm.files import whole_file

#: Colours that stay apart for colour-blind readers (Okabe and Ito, 2008), the calm ones first.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def write_volume_curve(path: Path | str, times: Tensor, volumes: Tensor) -> None:
    """Write a volume curve as CSV with the columns time, volume, deviation (V / V(0) - 1)."""
    with whole_file(path) as temporary, temporary.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "volume", "deviation"])
        deviations = volumes / volumes[0] - 1
        for row in zip(times.tolist(), volumes.tolist(), deviations.tolist(), strict=True):
            writer.writerow([f"{number:.9g}" for number in row])


def plot_volume_curves(path: Path | str, curves: Mapping[str, tuple[Tensor, Tensor]]) -> None:
    """Draw how far volumes stray from the one at the start, in per cent over time, one line a morph.

    Args:
        path: a picture; its suffix chooses the format (.png, .pdf, .svg).
        curves: times (k,) and volumes (k,) by name.
    """
    figure = Figure(figsize=(5.2, 3.2), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.axhline(0, color="0.75", linewidth=0.8, zorder=0)
    # per cent; a curve that is flat to a thousandth should look flat
    lowest, highest = -0.1, 0.1
    for number, (name, (times, volumes)) in enumerate(curves.items()):
        deviation = 100 * (volumes / volumes[0] - 1)
        finite = deviation[torch.isfinite(deviation)]
        lowest, highest = min([lowest, *finite.tolist()]), max([highest, *finite.tolist()])
        axes.plot(
            times.tolist(),
            deviation.tolist(),
            color=COLOURS[number % len(COLOURS)],
            marker="o",
            markersize=3,
            linewidth=1.5,
            label=name,
        )
    margin = 0.08 * (highest - lowest)
    axes.set_ylim(lowest - margin, highest + margin)
    axes.set_xlim(-0.02, 1.02)
    axes.set_xlabel("time")
    axes.set_ylabel("change of volume in %")
    axes.spines[["top", "right"]].set_visible(False)
    if any(curves):
        axes.legend(frameon=False, fontsize="small")
    with whole_file(path) as temporary:
        figure.savefig(temporary)
