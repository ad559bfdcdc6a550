"""Morphs in the coordinates and units of a shape's file."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from nsm.cli.errors import InputError
from nsm.shapes import FieldShape, Similarity
from nsm.types import Key, Morph, SignedDistance, Times

#: Ends of a morph, whose files have coordinates.
ENDS = ("source", "target")


class FileCoordinates(Morph):
    """A morph f in the coordinates and units of the file of its source or its target.

    The similarity y = C(x) = s R x + c from the box of the morph to the file undoes everything that brought the shape
    from its file to the box: fit, pose, alignment, the scale of equal volumes, and the common placing. Then

        f̃(y, t) = s f(C⁻¹(y), t),   ∇f̃ = R ∇f,   Ṽ = s R V,   div Ṽ = div V,

    so that lengths, velocities, and volumes are in the units of the file, such as mm, mm per unit of t, and mm³. The
    other end has the same coordinates, as they contain one similarity only: if the volumes were made equal, its volume
    is that of the end whose file it is.

    f is evaluated in its own box only. Outside, f̃ is the value at the nearest point of that box plus the distance to
    it, and Ṽ and div Ṽ are those at that point.

    Args:
        morph: f.
        end: ``source`` or ``target``.

    Raises:
        InputError: If ``end`` is neither, or the morph does not know the coordinates of its file.

    Example:
        >>> import torch
        >>> from nsm.fields import ScalarSiren
        >>> from nsm.morphs.file_coordinates import FileCoordinates
        >>> from nsm.morphs.neural import NeuralMorph
        >>> from nsm.shapes import Ball, Similarity
        >>> half = Ball(1.0).transformed(Similarity.read({"scale": 0.5}, 3))  # a file with a ball of radius 1
        >>> morph = NeuralMorph(ScalarSiren(4, 8, 1), None, half, Ball(0.5)).requires_grad_(False)
        >>> in_file = FileCoordinates(morph, "source")
        >>> float(in_file.source(torch.zeros(1, 3))), in_file.bounds[1].tolist()
        (-1.0, [2.0, 2.0, 2.0])
    """

    def __init__(self, morph: Morph, end: str) -> None:
        if end not in ENDS:
            raise InputError(f"`end` must be {' or '.join(ENDS)}, got {end}. Try `end=source`.")
        shape = morph.source if end == "source" else morph.target
        if not isinstance(shape, FieldShape):
            raise InputError(
                f"`morph` must have a {end} with a file, got a {type(shape).__name__}. Try a morph of `nsm.load_morph`."
            )
        self.morph, self.dim, self.provenance = morph, morph.dim, morph.provenance
        self.to_file = shape.similarity.inverse()
        self.bounds = _box_around(morph.bounds, self.to_file)
        self._keys = tuple(Key(key.time, _transformed(key.shape, self.to_file)) for key in morph.keys)
        self.source, self.target = self._keys[0].shape, self._keys[-1].shape

    def __call__(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"]:
        near, beyond = self._pulled_back(x)
        return (self.to_file.scale * (self.morph(near, t) + beyond.norm(dim=1))).to(x)

    def gradient(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"]:
        """Spatial gradient R ∇f, shape (n, d)."""
        near, beyond = self._pulled_back(x)
        outward = torch.nn.functional.normalize(beyond, dim=1)
        return self.to_file.rotate(torch.where(beyond == 0, self.morph.gradient(near, t), outward)).to(x)

    @property
    def keys(self) -> tuple[Key[SignedDistance], ...]:
        """Shapes of ``morph`` in the coordinates of the file."""
        return self._keys

    @property
    def has_velocity(self) -> bool:
        return self.morph.has_velocity

    def velocity(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, "n d"] | None:
        """Velocity s R V in units of the file per unit of t, shape (n, d); None for a morph without one."""
        velocity = self.morph.velocity(self._pulled_back(x)[0], t)
        return None if velocity is None else (self.to_file.scale * self.to_file.rotate(velocity)).to(x)

    def divergence(self, x: Float[Tensor, "n d"], t: Times) -> Float[Tensor, " n"] | None:
        """Divergence of V in space per unit of t, shape (n,); None for a morph without a velocity."""
        divergence = self.morph.divergence(self._pulled_back(x)[0], t)
        return None if divergence is None else divergence.to(x)

    def domain(self, t: float) -> Float[Tensor, "2 d"]:
        """Corners of the box around the domain of the morph, shape (2, d)."""
        return _box_around(self.morph.domain(t), self.to_file)

    def wanted_volume(self, t: float, initial: float = 1.0) -> float:
        """Volume that the shape should have at time t, in the units of ``initial``."""
        return self.morph.wanted_volume(t, initial)

    def _pulled_back(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Nearest points to C⁻¹(x) in the box of the morph, and the way from there to C⁻¹(x), both (n, d).

        C⁻¹ is applied in double precision, since the coordinates of a file may lie far from their origin.
        """
        low, high = self.morph.bounds
        point = self.to_file.pull_back(x.double()).to(self.morph.bounds)
        near = torch.minimum(torch.maximum(point, low), high)
        return near, point - near


def _box_around(box: Float[Tensor, "2 d"], similarity: Similarity) -> Float[Tensor, "2 d"]:
    """Corners of the axis-parallel box around a box that is moved, in double precision."""
    corners = torch.cartesian_prod(*box.double().T)
    moved = similarity.apply(corners)
    return torch.stack([moved.amin(0), moved.amax(0)])


def _transformed(shape: SignedDistance, similarity: Similarity) -> SignedDistance:
    """A shape after a similarity."""
    if isinstance(shape, FieldShape):
        return shape.transformed(similarity)
    return lambda x: similarity.scale * shape(similarity.pull_back(x))
