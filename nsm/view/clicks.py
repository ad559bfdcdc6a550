"""Landmarks that a user clicks on two shapes."""

from __future__ import annotations

from collections.abc import Sequence

from nsm.cli.errors import InputError

#: Names of the coordinates.
_AXES = "xyz"


class Clicks:
    """Points that were clicked on two shapes, in the coordinates of their files.

    The k-th point on the first shape belongs to the k-th point on the second, in whichever order they were clicked.

    >>> clicks = Clicks()
    >>> for side, point in ((0, [0.0, 0.5]), (0, [2.0, 0.0]), (1, [1.0, 1.0])):
    ...     clicks.add(side, point)
    >>> clicks.count(0), clicks.count(1)
    (2, 1)
    >>> clicks.undo()
    1
    """

    def __init__(self) -> None:
        self._clicks: list[tuple[int, list[float]]] = []

    def add(self, side: int, point: Sequence[float]) -> None:
        """Add a point on the first (0) or the second (1) shape."""
        self._clicks.append((side, list(point)))

    def undo(self) -> int | None:
        """Remove the last point, and return the side that it was on; None if there is none."""
        return self._clicks.pop()[0] if self._clicks else None

    def clear(self) -> None:
        """Remove all points."""
        self._clicks.clear()

    def count(self, side: int) -> int:
        """Count the points on one shape."""
        return len(self.points(side))

    def points(self, side: int) -> list[list[float]]:
        """List the points on one shape."""
        return [point for clicked, point in self._clicks if clicked == side]

    def table(self) -> str:
        """Write the pairs as CSV, in the format of `nsm.shapes.LandmarkTable`.

        Raises:
            InputError: If there are none, or a point has no partner.
        """
        first, second = self.points(0), self.points(1)
        if not first or len(first) != len(second):
            raise InputError(
                f"The `landmarks` must be pairs of points, got {len(first)} on the first shape and {len(second)} on "
                "the second. Try to click the missing ones, or `Undo`."
            )
        axes = _AXES[: len(first[0])]
        names = ",".join(f"{side}_{axis}" for side in ("source", "target") for axis in axes)
        rows = [",".join(map(repr, [*a, *b])) for a, b in zip(first, second, strict=True)]
        return "\n".join([names, *rows, ""])
