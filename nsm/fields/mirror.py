"""The symmetry that a morph is given, as a part of its model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from nsm.geometry.reflection import Reflection


class Mirror:
    """A mirror plane, at which f and V are made symmetric.

    Args:
        normal: Normal of the plane in the axes of the box; in 2D its third number is left out.
        offset: Distance of the plane from the center of the box along the normal.
    """

    def __init__(self, normal: Sequence[float], offset: float = 0.0) -> None:
        self.normal, self.offset = normal, offset

    def reflection(self, dim: int) -> Reflection:
        """The reflection in d dimensions.

        Raises:
            InputError: If the normal is no direction there.
        """
        return Reflection.at(self.normal, self.offset, dim)

    def field(self, network: Mapping[str, Any], dim: int) -> dict[str, Any]:
        """Config of the symmetric f made of that of a network."""
        return {"_target_": "nsm.fields.SymmetricField", "network": dict(network), **self._plane(dim)}

    def velocity(self, velocity: Mapping[str, Any], dim: int) -> dict[str, Any]:
        """Config of the symmetric V made of that of another."""
        return {"_target_": "nsm.fields.SymmetricVelocity", "velocity": dict(velocity), **self._plane(dim)}

    def _plane(self, dim: int) -> dict[str, Any]:
        reflection = self.reflection(dim)
        return {"normal": list(reflection.normal), "offset": reflection.offset}
