"""Outlines of the foreground of images, with sub-pixel accuracy."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, gaussian_filter1d, maximum_filter
from scipy.optimize import brentq
from skimage.filters import threshold_otsu
from skimage.measure import find_contours

from nsm.cli.errors import InputError
from nsm.shapes.reading import unreadable

log = logging.getLogger(__name__)

#: Extensions of supported files.
IMAGE_FORMATS = (".png", ".jpg", ".jpeg", ".bmp", ".gif", ".webp", ".tif", ".tiff")
#: Standard deviation, in pixels, of the Gaussian that smooths the steps between pixels, in images with hard edges and
#: with antialiased edges. The normals of a disk are then off by 2.5 and 0.7 degrees (mean).
SMOOTHING_HARD, SMOOTHING_SOFT = 1.5, 1.0
#: Maximum deviation of pixels from inside or outside in an image with hard edges, relative to the contrast.
HARD = 0.02
#: Minimum length, in pixels, of a row and a column that form a corner.
RUN = 4
#: Radius, in pixels, around corners and thin parts in which smoothing is not applied.
KEPT = 9
#: Change of the indicator (±1/2) at the center of a pixel above which smoothing would lose a thin part.
STEEP = 0.1
#: Bounds on the level that gives the outline its area.
LEVELS = (-0.45, 0.45)
#: Maximum length of the side with which the contour cuts off a corner, and minimum length of its neighbors, in pixels.
BEVEL, SIDE = 1.5, 2.0
#: Area, relative to the largest loop, below which components and holes are removed as specks.
SPECK = 1e-4
#: Number of outside pixels around the image.
PADDING = 6


class _Indicator(NamedTuple):
    """An image as a field, 1/2 inside and −1/2 outside, and whether its edges are hard."""

    field: np.ndarray
    hard: bool


def image_outline(file: Path, threshold: float | None = None) -> list[np.ndarray]:
    """Find the closed polygons around the foreground of an image.

    The foreground of an image with transparency is its opaque part. Otherwise it differs in brightness from the border,
    by Otsu's threshold unless one is given. The outline encloses the area of the foreground pixels, in which pixels at
    edges count in proportion to their opacity or brightness. Corners between a row and a column of pixels remain exact.

    Args:
        file: Image file.
        threshold: Opacity or brightness in (0, 1) at which the inside begins.

    Returns:
        Corners of each polygon in pixels from the lower left corner of the image, shape (k, 2). Outlines are
        counterclockwise and holes clockwise.

    Raises:
        InputError: If the file cannot be read, or has no foreground.
    """
    indicator = _read_indicator(file, threshold)
    field = _smoothed(indicator)
    area = float((field.original + 0.5).sum())

    def excess(level: float) -> float:
        return sum(map(loop_area, _loops(field.smooth, level))) - area

    level = 0.0
    if abs(excess(level)) > 1e-6 * area and excess(LEVELS[0]) > 0 > excess(LEVELS[1]):
        level = float(brentq(excess, *LEVELS, xtol=1e-5))
    loops = _loops(field.smooth, level)
    least = SPECK * max(abs(loop_area(loop)) for loop in loops)
    kept = [loop for loop in loops if abs(loop_area(loop)) >= least]
    if len(kept) < len(loops):
        log.info("%s: %d specks of less than %.2g pixels are left out", file, len(loops) - len(kept), least)
    height = indicator.field.shape[0]
    return [np.stack([loop[:, 1] + 0.5, height - loop[:, 0] - 0.5], 1) for loop in kept]


def loop_area(loop: np.ndarray) -> float:
    """Compute the area of a polygon of (row, column), shape (k, 2), positive if counterclockwise in the image."""
    rows, columns = loop.T
    return float((columns * np.roll(rows, -1) - rows * np.roll(columns, -1)).sum()) / -2


def _read_indicator(file: Path, threshold: float | None) -> _Indicator:
    if threshold is not None and not 0 < threshold < 1:
        raise InputError(f"`threshold` must be between 0 and 1, got {threshold:g}. Try `threshold=0.5`.")
    values, opaque = _read_values(file)
    low, high = float(values.min()), float(values.max())
    level = threshold if threshold is not None else 0.5 if opaque else (low if low == high else threshold_otsu(values))
    above = values > level
    if above.all() or not above.any():
        raise InputError(
            f"`{file}` must show something in front of a background, but all of its {values.size} pixels are on one "
            f"side of the threshold {level:.3g} (they lie between {low:.3g} and {high:.3g}). Try another `threshold=`."
        )
    border = np.concatenate([above[0], above[-1], above[:, 0], above[:, -1]])
    inside = above if opaque or border.mean() <= 0.5 else ~above
    if border.any() and not border.all():
        log.warning("%s: what it shows reaches the border of the image, where it is cut", file)
    within, without = float(np.median(values[inside])), float(np.median(values[~inside]))
    middle = level if threshold is not None else (within + without) / 2
    field = np.where(
        inside,
        (values - middle) / (2 * (within - middle) or 1),
        (values - middle) / (2 * (middle - without) or 1),
    ).clip(-0.5, 0.5)
    hard = bool((np.abs(field) > 0.5 - HARD).all())
    return _Indicator(np.sign(field) / 2 if hard else field, hard)


def _read_values(file: Path) -> tuple[np.ndarray, bool]:
    """Read the opacity of the pixels (with True) or their brightness (with False), in [0, 1]."""
    try:
        with Image.open(file) as image:
            if image.has_transparency_data:
                opacity = np.asarray(image.convert("RGBA"), dtype=np.float64)[:, :, 3] / 255
                if opacity.min() < 1:
                    return opacity, True
            if image.mode.startswith(("I", "F")):
                values = np.asarray(image, dtype=np.float64)
                return values / max(float(values.max()), 1.0), False
            return np.asarray(image.convert("RGB").convert("L"), dtype=np.float64) / 255, False
    except Exception as error:  # readers raise various exceptions for damaged files
        raise unreadable(file, "an image", error) from error


class _Field(NamedTuple):
    """The padded field before and after smoothing."""

    original: np.ndarray
    smooth: np.ndarray


def _smoothed(indicator: _Indicator) -> _Field:
    steps = np.pad(indicator.field, PADDING, constant_values=-0.5)
    sigma = SMOOTHING_HARD if indicator.hard else SMOOTHING_SOFT
    smooth = gaussian_filter(steps, sigma)
    lost = (2 * smooth * np.sign(steps) < -STEEP) & (np.abs(steps) > 0.4)
    smooth = smooth / gaussian_filter1d([0] * 9 + [1.0] + [0] * 9, sigma)[9]  # ±1/2 again beside straight edges
    near = maximum_filter(_corners(steps > 0) | lost, 2 * KEPT + 1).astype(np.float64)
    kept = np.maximum(gaussian_filter(near, sigma), near)
    return _Field(steps, smooth + kept * (steps - smooth))


def _corners(mask: np.ndarray) -> np.ndarray:
    """Mark pixels in a corner between a row and a column of inside or outside pixels."""
    found = np.zeros_like(mask)
    for inside in (mask, ~mask):
        for down, right in ((1, 1), (1, -1), (-1, 1), (-1, -1)):

            def at(i: int, j: int, inside: np.ndarray = inside, down: int = down, right: int = right) -> np.ndarray:
                return np.roll(inside, (-down * i, -right * j), (0, 1))

            corner = ~at(-1, -1)
            for k in range(RUN):
                corner &= at(k, 0) & ~at(k, -1) & at(0, k) & ~at(-1, k)
            found |= corner
    return found


def _loops(field: np.ndarray, level: float) -> list[np.ndarray]:
    """Extract closed polygons of (row, column) without padding, all with the inside on the same side."""
    loops = [_with_corners(_simplified(contour[:-1])) for contour in find_contours(field, level)]
    loops = [loop - PADDING for loop in loops if len(loop) >= 3]
    if sum(map(loop_area, loops)) < 0:
        loops = [loop[::-1] for loop in loops]
    return loops


def _simplified(loop: np.ndarray) -> np.ndarray:
    """Remove corners that coincide with the next one or are collinear with both neighbors."""
    loop = loop[np.linalg.norm(np.roll(loop, -1, 0) - loop, axis=1) > 1e-9]
    before, after = loop - np.roll(loop, 1, 0), np.roll(loop, -1, 0) - loop
    turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    return loop[np.abs(turn) > 1e-9]


def _with_corners(loop: np.ndarray) -> np.ndarray:
    """Restore the corners between a row and a column of pixels that the contour cuts off."""
    if len(loop) < 3:
        return loop
    sides = np.roll(loop, -1, 0) - loop
    before, after = np.roll(sides, 1, 0), np.roll(sides, -1, 0)
    upright = np.abs(before) < 1e-6, np.abs(after) < 1e-6
    bevel = (np.linalg.norm(sides, axis=1) < BEVEL) & (upright[0] & upright[1][:, ::-1]).any(1)
    bevel &= (np.linalg.norm(before, axis=1) > SIDE) & (np.linalg.norm(after, axis=1) > SIDE)
    corners = loop.copy()
    ends = np.roll(loop, -1, 0)
    # the corner shares its row or column with the side before, and the other coordinate with the side after
    corners[bevel] = np.where(upright[0][bevel], loop[bevel], ends[bevel])
    return corners[~np.roll(bevel, 1)]
