"""Shapes that are triangle meshes."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from nsm.geometry.triangles import Triangles
from nsm.geometry.volume import volume
from nsm.shapes.base import VOLUME_RESOLUTION, FieldShape
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.mesh_reading import openness, read_mesh, signed_volume, turned_outwards, welded
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.primitive import Pose
from nsm.shapes.sampling import sample_mesh_surface, simplex_normals
from nsm.shapes.similarity import Similarity
from nsm.shapes.solid import solid_boundary
from nsm.types import Jet, SimplexMesh, SurfaceSamples

log = logging.getLogger(__name__)

#: Nearer to a triangle than this part of the size of the mesh, the gradient is the normal of the triangle: the
#: direction from the closest point is lost in the rounding of the point.
_ON_TRIANGLE = 1e-5
#: Margin around the mesh in which its volume is measured on a grid, in parts of its size.
_MARGIN = 0.05


class MeshShape(FieldShape):
    """The signed distance to triangles: exact, and negative where their winding number is above 1/2.

    The winding number (Jacobson et al., SIGGRAPH 2013; fast: Barill et al., SIGGRAPH 2018) is 1 inside and 0
    outside a closed mesh and varies smoothly across holes, so that a mesh with holes has an inside too.

    Args:
        vertices: how many there are; they are part of the state, in double precision and relative to the center of the
            mesh, so that a small mesh far from its origin loses nothing.
        faces: how many triangles there are; they are part of the state.
        closed: whether neighbors share their edges, so that the divergence theorem gives the volume, which is else
            measured on a grid.
        pose: from the coordinates of the file to the box.
        placement: from coordinates relative to the center of the mesh to the box.
        origin: where the mesh comes from (part of the provenance).
    """

    vertices: Tensor
    faces: Tensor

    def __init__(
        self,
        vertices: int,
        faces: int,
        closed: bool,
        pose: Pose = None,
        placement: Pose = None,
        origin: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(3, Similarity.read(pose, 3), Similarity.read(placement, 3))
        self.closed, self.origin = closed, dict(origin or {"kind": "mesh"})
        self.register_buffer("vertices", torch.zeros(vertices, 3, dtype=torch.float64))
        self.register_buffer("faces", torch.zeros(faces, 3, dtype=torch.int64))
        self._triangles: Triangles | None = None

    def own_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Signed distance, differentiable once."""
        return _Distance.apply(p, partial(self._signed, with_gradient=p.requires_grad))

    def own_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Signed distance and its gradient (p − c)/d with c the closest point, on a triangle its normal."""
        distance, gradient = self._signed(p.detach(), with_gradient=True)
        return Jet(distance, gradient)

    def own_surface(self) -> SimplexMesh:
        """The mesh itself."""
        return SimplexMesh(self.vertices, self.faces)

    def surface(self) -> SimplexMesh:
        """The mesh in the box, in the default precision."""
        vertices = self.placement.apply(self.vertices.double()).to(torch.get_default_dtype())
        return SimplexMesh(vertices, self.faces)

    def own_box(self) -> Float[Tensor, "2 d"]:
        """The bounding box with a margin."""
        low, high = self.vertices.amin(0), self.vertices.amax(0)
        margin = _MARGIN * (high - low).max()
        return torch.stack([low - margin, high + margin])

    def volume(self) -> float:
        """Volume of the inside: by the divergence theorem if the mesh is closed, else from a grid."""
        if self.closed:
            own = signed_volume(self.vertices.cpu().numpy(), self.faces.cpu().numpy())
        else:
            own = volume(self._own_field, self.own_box(), VOLUME_RESOLUTION[3])
        return self.placement.scale**3 * own

    def surface_samples(self, count: int, generator: torch.Generator) -> SurfaceSamples:
        """Points drawn by area on the triangles, and the normals of the triangles."""
        mesh = self.surface()
        points, chosen = sample_mesh_surface(mesh, count, generator)
        return SurfaceSamples(points, simplex_normals(mesh.vertices[mesh.simplices[chosen]]))

    def config(self) -> dict[str, Any]:
        """Sizes, placement and origin; the triangles are the state."""
        return {
            "_target_": "nsm.shapes.MeshShape",
            "vertices": len(self.vertices),
            "faces": len(self.faces),
            "closed": self.closed,
            "pose": self.similarity.to_config(),
            "placement": self.placement.to_config(),
            "origin": self.origin,
        }

    def content_key(self) -> str:
        """SHA-256 of the triangles and their place in the box, from whatever file."""
        digest = hashlib.sha256(json.dumps([self.closed, self.placement.to_config()]).encode())
        for value in self.state_dict().values():
            digest.update(value.cpu().numpy().tobytes())
        return digest.hexdigest()

    def provenance(self) -> dict[str, Any]:
        """File, hash and the similarity from its coordinates to the box."""
        return {**self.origin, "similarity": self.similarity.to_config()}

    def _signed(self, p: Float[Tensor, "n d"], with_gradient: bool) -> tuple[Tensor, Tensor]:
        """Signed distances (n,), and gradients (n, d) if they are wanted, else none (0, d)."""
        x = p.double()
        closest = self._search().closest(x)
        outside = self._search().winding_number(x) <= 0.5
        distance = torch.where(outside, closest.distances, -closest.distances)
        if not with_gradient:
            return distance.to(p), p.new_zeros(0, 3)
        normals = simplex_normals(self.vertices.to(x)[self.faces[closest.simplices]])
        size = float((self.vertices.amax(0) - self.vertices.amin(0)).max())
        away = nn.functional.normalize(x - closest.points, dim=1) * distance.sign()[:, None]
        on = closest.distances < _ON_TRIANGLE * size
        return distance.to(p), torch.where(on[:, None], normals, away).to(p)

    def _search(self) -> Triangles:
        if self._triangles is None:
            self._triangles = Triangles(self.vertices.double().cpu().numpy(), self.faces.cpu().numpy())
        return self._triangles

    def _load_from_state_dict(self, *args: Any) -> None:
        super()._load_from_state_dict(*args)
        self._triangles = None


class MeshFile(MeshShape):
    """A triangle mesh from a file.

    Vertices that the file splits at texture seams are welded, and a mesh inside out is turned. Its surface is that of
    the solid (`nsm.shapes.solid`): holes are closed, and what lies inside other parts of the mesh is left out.

    Args:
        path: an obj, ply, stl, off or glb file, or a public name such as ``meshes/spot.obj``.
        fit: half of the longest side after fitting; None keeps the coordinates of the file.
        pose: rotation, translation and scale given to the mesh after that.
        up: the direction in the coordinates of the file that becomes +y, before all else; None if it is +y already.

    Raises:
        InputError: if the file holds no mesh with an inside.
    """

    def __init__(
        self, path: str, fit: float | None = 0.8, pose: Pose = None, up: Sequence[float] | None = None
    ) -> None:
        place, file = FilePlacement(fit, pose, up), resolve(path)
        raw, faces = welded(read_mesh(file), str(path))
        vertices, center = centered(torch.from_numpy(raw))
        faces = turned_outwards(vertices.numpy(), faces, str(path))
        state = openness(vertices.numpy(), faces)
        if state.edges:
            log.warning(
                "%s is open: %d boundary edges in %d loops, and its oriented area does not close by %.2g %%; "
                "its inside is where the winding number is above 1/2, and its holes are closed there",
                *(path, state.edges, state.loops, 100 * state.gap),
            )
        placement = place.of_centered(vertices, center)
        points, solid = solid_boundary(vertices.numpy(), faces, is_open=bool(state.edges))
        origin = {"kind": "mesh", "path": str(path), "sha256": file_sha256(file)}
        pose = placement.after(Similarity.shift(-center))
        super().__init__(len(points), len(solid), solid is faces, pose, placement, origin)
        self.openness = state
        self.vertices.copy_(torch.from_numpy(points))
        self.faces.copy_(torch.from_numpy(solid))


class _Distance(torch.autograd.Function):
    """Signed distances whose gradient was found along with them."""

    @staticmethod
    def forward(ctx: Any, p: Tensor, signed: Any) -> Tensor:
        distance, gradient = signed(p)
        ctx.save_for_backward(gradient)
        return distance

    @staticmethod
    def backward(ctx: Any, above: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return above[:, None] * gradient, None
