"""The few types that every part of nsm speaks."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

from jaxtyping import Float, Int
from torch import Tensor

#: Anything that maps points (n, d) to signed distances (n,), negative inside.
SignedDistance = Callable[[Tensor], Tensor]


class Jet(NamedTuple):
    """A scalar field and its first derivatives at n points: ``value`` (n,), ``gradient`` (n, k)."""

    value: Float[Tensor, " n"]
    gradient: Float[Tensor, "n k"]


class VectorJet(NamedTuple):
    """A vector field and its first derivatives at n points: ``value`` (n, m), ``jacobian`` (n, m, k)."""

    value: Float[Tensor, "n m"]
    jacobian: Float[Tensor, "n m k"]


class SimplexMesh(NamedTuple):
    """A surface of triangles in 3D, a curve of segments in 2D, oriented so that normals point outwards.

    ``vertices`` (v, d); ``simplices`` (m, d) indices into them.
    """

    vertices: Float[Tensor, "v d"]
    simplices: Int[Tensor, "m d"]


class SurfaceSamples(NamedTuple):
    """Points on a surface and the unit normals there, both (n, d)."""

    points: Float[Tensor, "n d"]
    normals: Float[Tensor, "n d"]


class DistanceSamples(NamedTuple):
    """Points in space (n, d) and the signed distance of a shape there (n,)."""

    points: Float[Tensor, "n d"]
    distances: Float[Tensor, " n"]


@runtime_checkable
class Morph(Protocol):
    """A shape that moves from t = 0 to t = 1, known by its signed distance at every time.

    Everything downstream (volume curves, meshes, transport, pictures) consumes this and nothing more.
    """

    dim: int
    #: Corners (2, d) of the box that holds the morph: lowest first.
    bounds: Tensor

    @property
    def source(self) -> SignedDistance:
        """The shape at t = 0, posed and scaled: (n, d) -> (n,)."""
        ...

    @property
    def target(self) -> SignedDistance:
        """The shape at t = 1, posed and scaled: (n, d) -> (n,)."""
        ...

    def __call__(self, x: Tensor, t: float | Tensor) -> Tensor:
        """Signed distance (n,) at x (n, d) and time t, one number or (n,)."""
        ...

    def gradient(self, x: Tensor, t: float | Tensor) -> Tensor:
        """Spatial gradient of the signed distance (n, d)."""
        ...

    def velocity(self, x: Tensor, t: float | Tensor) -> Tensor | None:
        """Velocity (n, d), or None for a method that has no velocity field."""
        ...
