"""Draw the three pictures of docs/concepts.md from a morph in 2D: level sets, divergence, and exact ends.

python tools/draw_concepts.py                        # trains a square to a rectangle, a minute or two
python tools/draw_concepts.py --run outputs/square   # draws a run that was trained before
"""

from __future__ import annotations

import argparse
from pathlib import Path

import nsm  # isort: skip (before torch, so that the settings of its threads apply)
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "concepts"
#: Points and arrows along an edge of a picture.
CELLS, ARROWS = 400, 19
#: Part of the plane, along both axes, that pictures show, and around the corner of the square.
LIMITS, CORNER = (-1.0, 1.0), (0.18, 0.31)
INK, SHAPE, NETWORK = "#22303c", "#2a78b8", "#d1495b"


def main() -> None:
    """Train or load the morph, and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, help="folder of a run in 2D")
    run = parser.parse_args().run
    morph = nsm.load_morph(run) if run else nsm.morph("square", "rectangle", budget="plane", network="small")
    FOLDER.mkdir(parents=True, exist_ok=True)
    draw_levels(morph)
    draw_divergence(morph)
    draw_ends(morph)


def draw_levels(morph: nsm.TrainedMorph) -> None:
    """Draw the level sets of f at five times, with the shape filled."""
    figure, axes = canvas(5)
    for axis, time in zip(axes, np.linspace(0, 1, 5), strict=True):
        values = sampled(morph, time)
        axis.contour(*plane(), values, levels=np.arange(-1, 1.01, 0.1), colors="0.75", linewidths=0.6)
        axis.contourf(*plane(), values, levels=[-9, 0], colors=[SHAPE], alpha=0.35)
        axis.contour(*plane(), values, levels=[0], colors=[INK], linewidths=1.6)
        axis.set_xlabel(f"$t = {time:g}$")
    save(figure, "levels.png")


def draw_divergence(morph: nsm.TrainedMorph) -> None:
    """Draw V, and |div V| beside it, which vanishes on the curve f = 0 and only there."""
    figure, axes = canvas(2, width=4.2)
    time, values = 0.5, sampled(morph, 0.5)
    ticks = np.linspace(*LIMITS, ARROWS)
    x, y = np.meshgrid(ticks, ticks)
    velocity = morph.velocity(torch.tensor(np.stack([x.ravel(), y.ravel()], 1), dtype=torch.float32), time)
    assert velocity is not None
    axes[0].quiver(x, y, *velocity.numpy().T, color=SHAPE, width=0.005)
    axes[0].set_xlabel("velocity $V$")
    divergence = morph.divergence(points(), time)
    assert divergence is not None
    size = divergence.abs().reshape(CELLS, CELLS).numpy()
    shown = axes[1].pcolormesh(*plane(), size, cmap="magma_r", vmin=0, vmax=np.quantile(size, 0.98), rasterized=True)
    axes[1].set_xlabel("divergence $|\\nabla\\cdot V|$")
    figure.colorbar(shown, ax=axes[1], shrink=0.85)
    for axis in axes:
        axis.contour(*plane(), values, levels=[0], colors=[INK], linewidths=1.6)
    save(figure, "divergence.png")


def draw_ends(morph: nsm.TrainedMorph) -> None:
    """Draw a corner of the source as the networks have it, and with exact ends, at t = 0 and a little later."""
    figure, axes = canvas(3, width=3.0)
    for axis, time in zip(axes, (0.0, 0.05, 0.1), strict=True):
        for field, color, style, name in (
            (morph.network, NETWORK, "--", "networks alone"),
            (morph, INK, "-", "with exact ends"),
        ):
            values = sampled(field, time, CORNER)
            axis.contour(*plane(CORNER), values, levels=[0], colors=[color], linestyles=[style], linewidths=1.6)
            axis.plot([], [], color=color, linestyle=style, label=name)
        axis.set(xlim=CORNER, ylim=CORNER)
        axis.set_xlabel(f"$t = {time:g}$")
    axes[0].legend(loc="lower left", fontsize=8, frameon=False)
    save(figure, "ends.png")


def sampled(field: nsm.Morph, time: float, limits: tuple[float, float] = LIMITS) -> np.ndarray:
    """Evaluate f on a grid that spans the limits along both axes."""
    with torch.no_grad():
        return field(points(limits), float(time)).reshape(CELLS, CELLS).numpy()


def points(limits: tuple[float, float] = LIMITS) -> torch.Tensor:
    """The points of the grid, shape (n, 2)."""
    x, y = np.meshgrid(*plane(limits))
    return torch.tensor(np.stack([x.ravel(), y.ravel()], 1), dtype=torch.float32)


def plane(limits: tuple[float, float] = LIMITS) -> tuple[np.ndarray, np.ndarray]:
    """The coordinates of the grid along both axes."""
    ticks = np.linspace(*limits, CELLS)
    return ticks, ticks


def canvas(count: int, width: float = 2.2) -> tuple[Figure, list[Axes]]:
    """A row of square axes without ticks."""
    figure = Figure(figsize=(count * width, width * 1.08), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(1, count, squeeze=False)[0])
    for axis in axes:
        axis.set(aspect="equal", xticks=[], yticks=[], xlim=LIMITS, ylim=LIMITS)
        axis.spines[:].set(color="0.8")
    return figure, axes


def save(figure: Figure, name: str) -> None:
    """Write a picture and name it."""
    figure.savefig(FOLDER / name, dpi=160)
    print(FOLDER / name)


if __name__ == "__main__":
    main()
