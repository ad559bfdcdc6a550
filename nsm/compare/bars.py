"""Bar charts of methods."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from nsm.cli.files import atomic_write
from nsm.plots.curves import COLORS

#: Height in inches of one bar, and of a panel without its bars.
_BAR, _MARGINS = 0.24, 0.75


def plot_bars(path: Path | str, panels: Mapping[str, Mapping[str, Mapping[str, float]]]) -> None:
    """Draw horizontal bars with their values at their ends.

    Args:
        path: Picture to write; its suffix chooses the format (.png, .pdf, .svg).
        panels: Values by the label of the panel, then by row, then by group, which sets the color.
    """
    rows = list(dict.fromkeys(row for panel in panels.values() for row in panel))
    groups = list(dict.fromkeys(group for panel in panels.values() for bars in panel.values() for group in bars))
    thickness = 0.8 / max(1, len(groups))
    height = _MARGINS + _BAR * max(1, len(groups)) * max(1, len(rows)) * 1.25
    figure = Figure(figsize=(3.6 * max(1, len(panels)), height), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axes, (label, panel) in zip(grid, panels.items(), strict=True):
        for number, group in enumerate(groups):
            known = [(place, panel[row][group]) for place, row in enumerate(rows) if group in panel.get(row, {})]
            bars = axes.barh(
                [place + (number - (len(groups) - 1) / 2) * thickness for place, _ in known],
                [value for _, value in known],
                height=0.9 * thickness,
                color=COLORS[number % len(COLORS)],
                label=group,
            )
            axes.bar_label(bars, fmt="%.3g", padding=2, fontsize="x-small")
        axes.set_yticks(range(len(rows)), rows, fontsize="small")
        axes.set_xlabel(label, fontsize="small")
        axes.tick_params(labelsize="small")
        axes.margins(x=0.16)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].invert_yaxis()
    if len(groups) > 1:
        figure.legend(
            *figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=len(groups), frameon=False,
            fontsize="small",
        )  # fmt: skip
    with atomic_write(path) as temporary:
        figure.savefig(temporary)
