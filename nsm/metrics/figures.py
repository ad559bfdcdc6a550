"""The headline figures of a morph: what each means, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from rich.table import Table

#: Figures by run, by name; None or not a number where one is not defined.
Runs = Mapping[str, Mapping[str, float | None]]


class Meaning(NamedTuple):
    """The unit of a figure, and what it is."""

    unit: str
    text: str


#: What stands after the name of a figure that is taken at one time: ``volume error t=0``.
AT = " t="
#: The unit of figures that are not measured in the morph's box.
_FILE_UNITS = "file length^d"
#: Every figure by its name, in the order of tables. Lengths are those of the morph's box.
MEANINGS = {
    "volume": Meaning(_FILE_UNITS, "volume (area in 2D) of the morph at one time, in the units of the source's file"),
    "volume std": Meaning(
        "relative", "standard deviation over time of V(t) / wanted volume, V(0) unless it is to grow"
    ),
    "volume max": Meaning("relative", "greatest |V(t) / wanted volume - 1|"),
    "volume estimator error": Meaning("relative", "how far these volumes may be off, from two resolutions"),
    "volume beyond": Meaning("relative", "greatest volume outside the box over V(0), where the surface leaves the box"),
    "morph to shape": Meaning("length", "mean distance from the morph's surface to the shape's at one end"),
    "morph to shape 99%": Meaning("length", "99th percentile of that distance"),
    "morph to shape max": Meaning("length", "greatest such distance"),
    "shape to morph": Meaning("length", "mean distance from the shape's surface to the morph's at one end"),
    "shape to morph 99%": Meaning("length", "99th percentile of that distance"),
    "shape to morph max": Meaning("length", "greatest such distance"),
    "chamfer": Meaning("length", "mean of both mean distances"),
    "hausdorff": Meaning("length", "greatest distance from a point of either surface to the other"),
    "normal error": Meaning("degree", "mean angle between the gradient of f and the normal of the shape"),
    "volume error": Meaning("relative", "volume of the morph over that of the shape - 1"),
    "gradient norm mean": Meaning("ratio", "mean of |grad f| over surface and times: 1 for a distance"),
    "gradient norm least": Meaning("ratio", "mean of |grad f| over the surface, at the time when it is least"),
    "gradient norm greatest": Meaning("ratio", "the same at the time when it is greatest"),
    "gradient norm std": Meaning("relative", "standard deviation of |grad f| over the surface, mean over times"),
    "eikonal shell": Meaning("relative", "mean of ||grad f| - 1| in the shell around the surface, mean over times"),
    "eikonal box": Meaning("relative", "the same in the whole box"),
    "level set surface": Meaning("length/time", "mean of |df/dt + <grad f, V>| / |grad f| over surface and times"),
    "level set shell": Meaning("length/time", "mean of |df/dt + <grad f, V>| / mean of |grad f|, mean over times"),
    "level set box": Meaning("length/time", "the same in the whole box"),
    "divergence surface": Meaning("1/time", "mean of |div V| over surface and times; a growth has one too"),
    "divergence shell": Meaning("1/time", "the same in the shell"),
    "divergence box": Meaning("1/time", "the same in the whole box"),
    "carried volume drift": Meaning("relative", "greatest |volume in the source surface carried by V / wanted - 1|"),
    "carried volume error": Meaning("relative", "how far that may be off, from two meshes"),
    "carried distance": Meaning("length", "mean distance of that surface from the surface of f, when it is greatest"),
    "carried distance max": Meaning("length", "greatest distance of any of its vertices at any time"),
    "distance moved": Meaning("length", "mean distance that the surface moves along its normal in all"),
    "speed max/mean": Meaning("ratio", "greatest over mean speed of the surface: 1 for an even motion"),
    "motion in middle half": Meaning("relative", "part of the motion between t = 1/4 and 3/4: 0.5 if even"),
    "area least": Meaning("length^(d-1)", "area of the surface (length in 2D) at the time when it is least"),
    "area greatest": Meaning("length^(d-1)", "the same at the time when it is greatest"),
    "roughness mean": Meaning("degree", "mean angle between neighbouring triangles, mean over times"),
    "roughness greatest": Meaning("degree", "the same at the time when it is greatest"),
    "roughness at 1/2": Meaning("ratio", "roughness at t = 1/2 over the greater one of the two ends"),
    "fewest components": Meaning("count", "connected components of the surface, however small"),
    "most components": Meaning("count", "connected components of the surface, however small"),
    "fewest pieces": Meaning("count", "components that enclose more than 1e-5 of the volume of the largest"),
    "most pieces": Meaning("count", "components that enclose more than 1e-5 of the volume of the largest"),
    "most handles": Meaning("count", "genus of the surface, all components together"),
    "topology events": Meaning("count", "changes of components or genus over time"),
    "flow map": Meaning("length", "exact ends: mean error of the flow maps of V against direct integration"),
    "flow map max": Meaning("length", "the same at the worst of the points"),
    "carried detail": Meaning("length", "mean error of f that follows from it, on the surface between the ends"),
}


def meaning(figure: str) -> Meaning:
    """What a figure is; those taken at one time (`AT`) mean the same at any.

    Raises:
        KeyError: for a name that no figure has.
    """
    return MEANINGS[figure.split(AT)[0]]


def table(runs: Runs, title: str | None = None) -> Table:
    """A rich table of figures: one row a figure, one column a run.

    Args:
        runs: figures by run; runs may lack figures that others have.
        title: heading.
    """
    out = Table(title=title)
    out.add_column("figure", no_wrap=True)
    for name in runs:
        out.add_column(name, justify="right")
    for row in _rows(runs):
        out.add_row(*row)
    return out


def markdown_table(runs: Runs) -> str:
    """The same table in Markdown."""
    head = ["figure", *(name.replace("|", r"\|") for name in runs)]
    lines = [head, ["---", *["---:"] * len(runs)], *_rows(runs)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _rows(runs: Runs) -> list[list[str]]:
    """Figures that at least one run has, as text."""
    names = dict.fromkeys(name for figures in runs.values() for name in figures)
    rows = [[name, *(_cell(name, figures.get(name)) for figures in runs.values())] for name in names]
    return [row for row in rows if any(row[1:])]


def _cell(name: str, value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    unit = meaning(name).unit
    if unit == "count":
        return f"{value:.0f}"
    if unit == "degree":
        return f"{value:.1f}°"
    if unit == _FILE_UNITS:
        return f"{value:.5g}"
    if unit == "ratio":
        return f"{value:.2f}"
    # four places, unless nothing would be left of a small number
    return f"{value:.4f}" if abs(value) >= 1e-3 or value == 0 else f"{value:.1e}"
