"""Types that all parts of nsm share, and the contract of a morph."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Generic, NamedTuple, TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from nsm.cli.errors import InputError

#: Function that maps points (n, d) to signed distances (n,), negative inside.
SignedDistance = Callable[[Tensor], Tensor]
#: Kind of shape of a key: any signed distance, or a shape that knows more of itself.
ShapeT = TypeVar("ShapeT", bound=SignedDistance, covariant=True)
#: One time, or one for each of n points, shape (n,).
Times = float | Float[Tensor, " n"]

#: Step of the central differences that give div V where a morph has no closed form, relative to the longest edge of its
#: box: far above the rounding errors of single precision, and below the detail that a network resolves.
DIVERGENCE_STEP = 1e-3


class Jet(NamedTuple):
    """A scalar field and its first derivatives at n points.

    Attributes:
        value: Values, shape (n,).
        gradient: Derivatives with respect to the k inputs, shape (n, k).
    """

    value: Float[Tensor, " n"]
    gradient: Float[Tensor, "n k"]


class VectorJet(NamedTuple):
    """A vector field and its first derivatives at n points.

    Attributes:
        value: Values, shape (n, m).
        jacobian: Derivatives of each component with respect to the k inputs, shape (n, m, k).
    """

    value: Float[Tensor, "n m"]
    jacobian: Float[Tensor, "n m k"]


class SimplexMesh(NamedTuple):
    """A surface of triangles in 3D, or a curve of segments in 2D, oriented so that its normals point outward.

    Attributes:
        vertices: Positions, shape (v, d).
        simplices: Indices of the d vertices of each simplex, shape (m, d).
    """

    vertices: Float[Tensor, "v d"]
    simplices: Int[Tensor, "m d"]


class SurfaceSamples(NamedTuple):
    """Points on a surface.

    Attributes:
        points: Positions, shape (n, d).
        normals: Outward unit normals, shape (n, d).
    """

    points: Float[Tensor, "n d"]
    normals: Float[Tensor, "n d"]


class DistanceSamples(NamedTuple):
    """Points in space with the signed distance of a shape.

    Attributes:
        points: Positions, shape (n, d).
        distances: Signed distances, shape (n,).
    """

    points: Float[Tensor, "n d"]
    distances: Float[Tensor, " n"]


@dataclass(frozen=True)
class Key(Generic[ShapeT]):
    """A shape that a morph passes through, with the time at which it does.

    Attributes:
        time: Time in [0, 1].
        shape: Signed distance (n,) of the shape, posed and scaled, at points of shape (n, d).
    """

    time: float
    shape: ShapeT


class Networks(NamedTuple):
    """The networks of a morph for programs that do not have nsm, in single precision on the CPU.

    Attributes:
        program: Module that maps points (n, d) and times (n,) to a tuple of f (n,), ∇f (n, d), and V (n, d) if the
            morph has a velocity field.
        description: Values that JSON can hold: dimension, box, layers, activations, ω, β, and the end shapes.
        weights: Layers of the networks by name, with ω folded in; None where a part of the morph is a formula without
            weights, such as a changing volume.
    """

    program: nn.Module
    description: dict[str, Any]
    weights: dict[str, Tensor] | None


class Morph(ABC):
    """A shape that moves from t = 0 to t = 1, known by its signed distance f(x, t) at every time.

    Everything downstream (volume curves, meshes, advection, pictures) takes a `Morph` and needs nothing else. A
    subclass implements `__call__` and `gradient`, and sets the attributes below. One with a velocity field also
    overrides `has_velocity` and `velocity`, and `divergence` where it is known in closed form.

    Attributes:
        dim: Dimension d of space, 2 or 3.
        bounds: Corners of a box that contains the shape at all times, lowest first, shape (2, d).
        source: Signed distance (n,) of the shape at t = 0, posed and scaled, at points of shape (n, d).
        target: The same for the shape at t = 1.
        provenance: Where the two end shapes come from, as values that JSON can hold: under ``source`` and ``target``,
            what `nsm.shapes.Shape.provenance` returns, with the factor ``scale`` by which the shape was scaled to
            make both volumes equal; under ``between``, a list of the same for the keys between them; under
            ``landmarks``, the corresponding points that a morph was trained with, in the coordinates of both files
            (`nsm.shapes.LandmarkPairs`); empty where nothing is known.
    """

    dim: int
    bounds: Float[Tensor, "2 d"]
    source: SignedDistance
    target: SignedDistance
    provenance: Mapping[str, Any] = MappingProxyType({})

    @abstractmethod
    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        """Signed distance f at points and times, negative inside.

        Args:
            x: Points, shape (n, d).
            t: One time for all points, or one for each, shape (n,).

        Returns:
            Values of f, shape (n,).
        """

    @abstractmethod
    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient ∇f at points and times, shape (n, d)."""

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes that the morph passes through, in order of time: by default the source at 0 and the target at 1."""
        return Key(0.0, self.source), Key(1.0, self.target)

    @property
    def has_velocity(self) -> bool:
        """Whether the morph has a velocity field that advects its surface."""
        return False

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity V in units of length per unit of t, shape (n, d); None for a morph without a velocity field."""
        return None

    @torch.no_grad()
    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence of V in space per unit of t, shape (n,); None for a morph without a velocity field.

        By default from central differences of V, with steps of `DIVERGENCE_STEP` times the longest edge of ``bounds``.
        """
        step = DIVERGENCE_STEP * float((self.bounds[1] - self.bounds[0]).max())
        total = x.new_zeros(len(x))
        for axis, shift in enumerate(step * torch.eye(self.dim, dtype=x.dtype, device=x.device)):
            before, after = self.velocity(x - shift, t), self.velocity(x + shift, t)
            if before is None or after is None:
                return None
            total += (after[:, axis] - before[:, axis]) / (2 * step)
        return total

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the box in which f is known at time t, lowest first, shape (2, d); by default ``bounds``.

        Beyond this box f may take any value that is consistent with its neighborhood, such as an extrapolation.
        """
        return self.bounds

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """Volume that the shape should have at time t, given the volume that it has at t = 0.

        Args:
            t: Time in [0, 1].
            initial: Volume at t = 0; with the default of 1, the result is relative to it.

        Returns:
            The wanted volume in the units of ``initial``: by default ``initial`` itself, so that volume is preserved.
        """
        return initial

    def networks(self) -> Networks:
        """The networks of the morph, for export to other programs.

        Raises:
            InputError: If the morph is not made of networks.
        """
        raise InputError(
            f"The morph must be made of networks to be exported as a program, got {type(self).__name__}. Try a morph "
            "trained with `method=adadiv` and `ends=network`."
        )
