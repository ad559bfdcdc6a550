"""Outlines of the filled paths of an SVG drawing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.shapes.reading import unreadable

#: Maximum deviation of polygons from curves, relative to the size of the path.
TOLERANCE = 1e-4
#: Number of pieces of a curve from which the deviation is estimated.
_PROBES = 8
#: Minimum of all color channels (of 255) of a fill that counts as paper and covers what lies below it.
_PAPER = 250


def svg_outline(file: Path) -> list[np.ndarray]:
    """Unite the filled shapes of a drawing, in the order in which they are painted.

    Fill rules, transformations, and holes are those of SVG; white shapes remove what lies below them. If nothing is
    filled, closed strokes serve as outlines.

    Args:
        file: SVG file.

    Returns:
        Corners of each polygon in pixels of the document with y upward, shape (k, 2). Outlines are counterclockwise and
        holes clockwise.

    Raises:
        InputError: If the file cannot be read, or contains no closed shape.
    """
    require("svgelements", "shapely", extra="svg", task="Reading .svg")
    import shapely
    import svgelements

    try:
        drawing = svgelements.SVG.parse(str(file))
        shapes = [e for e in drawing.elements() if isinstance(e, svgelements.Shape) and _is_visible(e)]
        filled = [(shape, _is_paper(shape)) for shape in shapes if shape.fill.value is not None and shape.fill.opacity]
        painted = filled or [(shape, False) for shape in shapes]
        polygons = [(_region(shapely, svgelements, shape), paper) for shape, paper in painted]
    except InputError:
        raise
    except Exception as error:  # readers raise various exceptions for damaged files
        raise unreadable(file, "an SVG drawing", error) from error
    region = shapely.MultiPolygon()
    for polygon, paper in polygons:
        region = region.difference(polygon) if paper else region.union(polygon)
    loops: list[np.ndarray] = []
    for part in shapely.get_parts(region):
        if part.geom_type == "Polygon" and part.area > 0:
            part = shapely.geometry.polygon.orient(part)
            loops += [np.asarray(ring.coords)[:-1] for ring in (part.exterior, *part.interiors)]
    if not loops:
        raise InputError(
            f"`{file}` must hold a filled or closed path, got {len(shapes)} shapes without one. Try filling it."
        )
    return loops


def _is_visible(shape: Any) -> bool:
    return shape.values.get("visibility") not in ("hidden", "collapse")


def _is_paper(shape: Any) -> bool:
    return min(shape.fill.red, shape.fill.green, shape.fill.blue) >= _PAPER


def _region(shapely: Any, svgelements: Any, shape: Any) -> Any:
    """Compute the region that a shape fills: all faces whose winding number is odd or not 0, by its fill rule."""
    loops = [loop for loop in _closed_loops(svgelements, abs(svgelements.Path(shape))) if len(loop) >= 3]
    if not loops:
        return shapely.MultiPolygon()
    lines = shapely.union_all([shapely.LinearRing(loop) for loop in loops])
    faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(lines)))
    odd = shape.values.get("fill-rule") == "evenodd"
    inner = [face for face in faces if _is_filled(_winding(loops, face.representative_point()), odd)]
    return shapely.union_all(inner)


def _is_filled(winding: int, odd: bool) -> bool:
    return winding % 2 == 1 if odd else winding != 0


def _winding(loops: list[np.ndarray], point: Any) -> int:
    """Compute the winding number of loops around a point from signed crossings of the ray to the right."""
    total = 0
    for loop in loops:
        (x, y), (u, v) = (loop - [point.x, point.y]).T, (np.roll(loop, -1, 0) - [point.x, point.y]).T
        left = x * (v - y) - y * (u - x)
        total += int(((y <= 0) & (v > 0) & (left > 0)).sum() - ((y > 0) & (v <= 0) & (left < 0)).sum())
    return total


def _closed_loops(svgelements: Any, path: Any) -> list[np.ndarray]:
    """Convert the parts of a path to polygons, shape (k, 2), with y upward."""
    box = path.bbox()
    size = max(box[2] - box[0], box[3] - box[1]) if box else 0.0
    loops: list[list[complex]] = []
    for segment in path:
        if isinstance(segment, svgelements.Move) or not loops:
            loops.append([])
        if segment.end is None:
            continue
        if not isinstance(segment, (svgelements.Move, svgelements.Line, svgelements.Close)):
            loops[-1] += _curve(segment, TOLERANCE * size)
        loops[-1].append(complex(segment.end.x, segment.end.y))
    return [_distinct(np.array(loop)) for loop in loops if loop]


def _curve(segment: Any, tolerance: float) -> list[complex]:
    """Place the inner corners of a polygon along a curve, whose deviation is quadratic in their distance."""

    def points(count: int) -> np.ndarray:
        return np.array([complex(p.x, p.y) for p in map(segment.point, np.arange(count + 1) / count)])

    fine = points(2 * _PROBES)
    deviation = float(np.abs(fine[1::2] - (fine[:-1:2] + fine[2::2]) / 2).max())
    count = max(1, int(np.ceil(_PROBES * np.sqrt(deviation / tolerance)))) if tolerance else 1
    return list(points(count)[1:-1])


def _distinct(loop: np.ndarray) -> np.ndarray:
    kept = loop[np.abs(np.roll(loop, -1) - loop) > 0]
    return np.stack([kept.real, -kept.imag], 1)
