"""Changes of topology: when and where they are, and how large the residuals of both equations are there (figure 11)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.compare.plan import Slices
from nsm.compare.results import Result
from nsm.metrics.residuals import eikonal_residual, level_set_residual, mean_magnitude
from nsm.metrics.unit import COUNT
from nsm.plots.slices import AXES, SlicePlane, plot_residual_slices
from nsm.plots.tables import Cell, Column, Table
from nsm.types import Morph

#: Radius of the ball around a change in which residuals are averaged, a length.
RADIUS = 0.05
#: Points in the ball, and in the box with which it is compared.
_POINTS = 2000
#: Times of the columns of a picture, relative to that of the change.
_AROUND = (-0.1, -0.02, 0.0, 0.02, 0.1)
#: Columns of the table.
_COLUMNS = (
    Column("time", None),
    *(Column(f"{what} {when}", None, COUNT) for what in ("components", "genus") for when in ("before", "after")),
    *(Column(axis, None) for axis in AXES),
    Column("eikonal there", None),
    Column("eikonal in the box", None),
    Column("‖∇f‖ least", None),
    Column("level set there", None),
    Column("level set in the box", None),
)


def changes_table(pair: str, results: Sequence[Result], slices: Slices, morphs: Callable[[Result], Morph]) -> Table:
    """Tabulate the first changes of topology of each morph, with the residuals around them and in the whole box.

    Args:
        pair: Name of the pair.
        results: One result of each method on this pair.
        slices: How many changes of a morph are shown.
        morphs: Loads the morph of a result.
    """
    cells: dict[tuple[str, str], Cell] = {}
    rows = []
    for result in results:
        for number, event in enumerate(result.events[: slices.changes], 1):
            row = f"{result.method}, change {number} of {len(result.events)}"
            rows.append(row)
            cells |= {(row, name): Cell(value) for name, value in _figures(morphs(result), event).items()}
    columns = [column for column in _COLUMNS if any((row, column.name) in cells for row in rows)]
    title = f"{pair}: changes of topology, with residuals within {RADIUS:g} of each and in the box"
    return Table(title, columns, rows, cells, "change")


def plot_changes(
    folder: Path, pair: str, results: Sequence[Result], slices: Slices, morphs: Callable[[Result], Morph]
) -> list[Path]:
    """Draw the residuals on a plane through each change, shortly before and after it.

    Args:
        folder: Folder of the pictures.
        pair: Name of the pair.
        results: One result of each method on this pair.
        slices: Number of changes of a morph that are drawn, and the axis of the planes.
        morphs: Loads the morph of a result.

    Returns:
        The pictures.
    """
    pictures = []
    for result in results:
        for number, event in enumerate(result.events[: slices.changes], 1):
            picture = folder / f"change_{pair}_{result.method}_{number}.png"
            time = _time(event)
            times = sorted({min(max(time + offset, 0.0), 1.0) for offset in _AROUND})
            offset = event["place"][AXES.index(slices.axis)] if len(event["place"]) == len(AXES) else 0.0
            plane = SlicePlane(slices.axis, round(offset, 3) + 0.0)  # no −0 in the titles
            plot_residual_slices(picture, morphs(result), times, plane, dpi=120)
            pictures.append(picture)
    return pictures


@torch.no_grad()
def _figures(morph: Morph, event: dict[str, Any]) -> dict[str, float]:
    time, place = _time(event), morph.bounds.new_tensor(event["place"])
    near, box = _ball(place), _box(morph.bounds)
    slopes = morph.gradient(near, time).norm(dim=1)
    figures = {
        "time": time,
        **dict(zip(("components before", "components after"), event["components"], strict=True)),
        **dict(zip(("genus before", "genus after"), event["genus"], strict=True)),
        **dict(zip(AXES, place.tolist(), strict=False)),
        "eikonal there": mean_magnitude(eikonal_residual(morph, near, time)),
        "eikonal in the box": mean_magnitude(eikonal_residual(morph, box, time)),
        "‖∇f‖ least": float(slopes.min()),
    }
    if morph.has_velocity:
        figures |= {
            "level set there": mean_magnitude(level_set_residual(morph, near, time)),
            "level set in the box": mean_magnitude(level_set_residual(morph, box, time)),
        }
    return figures


def _time(event: dict[str, Any]) -> float:
    """Time in the middle of the shortest interval that holds the change."""
    before, after = event["times"]
    return float(before + after) / 2


def _ball(place: Float[Tensor, " d"]) -> Float[Tensor, "n d"]:
    """Points drawn evenly in a ball around a place, the same offsets in each call."""
    generator = torch.Generator(place.device).manual_seed(0)
    directions = torch.randn(_POINTS, len(place), generator=generator, dtype=place.dtype, device=place.device)
    radii = torch.rand(_POINTS, 1, generator=generator, dtype=place.dtype, device=place.device) ** (1 / len(place))
    return place + RADIUS * radii * torch.nn.functional.normalize(directions, dim=1)


def _box(bounds: Float[Tensor, "2 d"]) -> Float[Tensor, "n d"]:
    """Points drawn evenly in a box, the same ones in each call."""
    generator = torch.Generator(bounds.device).manual_seed(0)
    share = torch.rand(_POINTS, bounds.shape[1], generator=generator, dtype=bounds.dtype, device=bounds.device)
    return bounds[0] + share * (bounds[1] - bounds[0])
