"""Shapes from triangle meshes."""

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
from nsm.shapes.base import VOLUME_RESOLUTION
from nsm.shapes.download import file_sha256, resolve
from nsm.shapes.mesh_reading import merge_vertices, openness, orient_outward, read_mesh, signed_volume
from nsm.shapes.mesh_repair import repaired
from nsm.shapes.placing import FilePlacement, centered
from nsm.shapes.sampling import unit_normals
from nsm.shapes.similarity import Pose, Similarity
from nsm.shapes.simplices import SimplexShape
from nsm.shapes.solid import solid_boundary
from nsm.types import Jet, SimplexMesh

log = logging.getLogger(__name__)

#: Distance to a triangle, relative to the size of the mesh, below which the gradient is the normal of the triangle,
#: because rounding errors dominate the direction from the closest point.
_ON_TRIANGLE = 1e-5


class MeshShape(SimplexShape):
    """The signed distance to a triangle mesh: exact, and negative where the winding number exceeds 1/2.

    The winding number is 1 inside and 0 outside a closed mesh and varies smoothly across holes, so that a mesh with
    holes has an inside as well. Vertices are stored in double precision relative to the center of the mesh, so that a
    small mesh far from its origin does not lose precision.

    Args:
        vertices: Number of vertices, which are part of the state.
        faces: Number of triangles, which are part of the state.
        closed: Whether neighboring triangles share edges, so that the divergence theorem gives the volume. Otherwise
            the volume is measured on a grid.
        pose: Map from the coordinates of the file to the box.
        placement: Map from coordinates relative to the center of the mesh to the box.
        origin: Origin of the mesh, for the provenance.

    References:
        Jacobson, Kavan, and Sorkine-Hornung, Robust Inside-Outside Segmentation Using Generalized Winding Numbers,
        SIGGRAPH 2013. https://doi.org/10.1145/2461912.2461916
        Barill et al., Fast Winding Numbers for Soups and Clouds, SIGGRAPH 2018.
        https://doi.org/10.1145/3197517.3201337
    """

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

    def local_distance(self, p: Float[Tensor, "n d"]) -> Float[Tensor, " n"]:
        """Evaluate the signed distance; the result can be differentiated once."""
        return _Distance.apply(p, partial(self._signed, with_gradient=p.requires_grad))

    def local_jet(self, p: Float[Tensor, "n d"]) -> Jet:
        """Evaluate the signed distance d and its gradient (p − c)/d for the closest point c, or a normal if d ≈ 0."""
        distance, gradient = self._signed(p.detach(), with_gradient=True)
        return Jet(distance, gradient)

    def local_surface(self) -> SimplexMesh:
        """Return the mesh itself."""
        return SimplexMesh(self.vertices, self.faces)

    def volume(self) -> float:
        """Compute the volume of the inside by the divergence theorem if the mesh is closed, and otherwise on a grid."""
        if self.closed:
            local = signed_volume(self.vertices.cpu().numpy(), self.faces.cpu().numpy())
        else:
            local = volume(self._local_field, self.local_box(), VOLUME_RESOLUTION[3])
        return self.placement.scale**3 * local

    def config(self) -> dict[str, Any]:
        """Return sizes, placement, and origin; the triangles are the state."""
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
        """Hash the triangles and their placement with SHA-256, independently of the file."""
        digest = hashlib.sha256(json.dumps([self.closed, self.placement.to_config()]).encode())
        for value in self.state_dict().values():
            digest.update(value.cpu().numpy().tobytes())
        return digest.hexdigest()

    def _signed(self, p: Float[Tensor, "n d"], with_gradient: bool) -> tuple[Tensor, Tensor]:
        """Evaluate signed distances, shape (n,), and gradients, shape (n, d), or (0, d) without ``with_gradient``."""
        x = p.double()
        closest = self._search().closest(x)
        outside = self._search().winding_number(x) <= 0.5
        distance = torch.where(outside, closest.distances, -closest.distances)
        if not with_gradient:
            return distance.to(p), p.new_zeros(0, 3)
        normals = unit_normals(self.vertices.to(x)[self.faces[closest.simplices]])
        size = float((self.vertices.amax(0) - self.vertices.amin(0)).max())
        directions = nn.functional.normalize(x - closest.points, dim=1) * distance.sign()[:, None]
        on = closest.distances < _ON_TRIANGLE * size
        return distance.to(p), torch.where(on[:, None], normals, directions).to(p)

    def _search(self) -> Triangles:
        if self._triangles is None:
            self._triangles = Triangles(self.vertices.double().cpu().numpy(), self.faces.cpu().numpy())
        return self._triangles

    def _load_from_state_dict(self, *args: Any) -> None:
        super()._load_from_state_dict(*args)
        self.require_simplices()
        self._triangles = None


class MeshFile(MeshShape):
    """A triangle mesh from a file.

    Vertices split at texture seams are merged, and a mesh that is inside out is flipped. The surface is that of the
    solid (`nsm.shapes.solid`): holes are closed, and parts inside other parts of the mesh are removed.

    Args:
        path: An obj, ply, stl, off, or glb file, or a public name such as ``meshes/spot.obj``.
        fit: Half the longest side of the bounding box after fitting; None keeps the coordinates of the file.
        pose: Rotation, translation, and scale applied after fitting.
        up: Direction in the coordinates of the file that becomes +y, before all else; None for +y.

    Raises:
        InputError: If the file contains no mesh with an inside.

    Example:
        >>> import tempfile, trimesh
        >>> from nsm.shapes import MeshFile
        >>> with tempfile.NamedTemporaryFile(suffix=".obj") as file:
        ...     _ = trimesh.creation.box((1, 1, 2)).export(file.name)
        ...     shape = MeshFile(file.name, fit=0.8)
        >>> round(shape.volume(), 3)
        1.024
    """

    def __init__(
        self, path: str, fit: float | None = 0.8, pose: Pose = None, up: Sequence[float] | None = None
    ) -> None:
        file_placement, file = FilePlacement(fit, pose, up), resolve(path)
        raw, faces = merge_vertices(read_mesh(file), str(path))
        vertices, center = centered(torch.from_numpy(raw))
        kept, faces = repaired(vertices.numpy(), faces, str(path))
        vertices = torch.from_numpy(kept)
        faces = orient_outward(vertices.numpy(), faces, str(path))
        state = openness(vertices.numpy(), faces)
        if state.edges:
            log.warning(
                "%s is open: it has %d boundary edges in %d loops, and its oriented area does not close by %.2g %%; "
                "holes are closed where the winding number is 1/2",
                *(path, state.edges, state.loops, 100 * state.gap),
            )
        placement = file_placement.of_centered(vertices, center)
        points, solid = solid_boundary(vertices.numpy(), faces, is_open=bool(state.edges))
        origin = {"kind": "mesh", "path": str(path), "sha256": file_sha256(file)}
        pose = placement.after(Similarity.shift(-center))
        super().__init__(len(points), len(solid), solid is faces, pose, placement, origin)
        self.openness = state
        self.vertices.copy_(torch.from_numpy(points))
        self.faces.copy_(torch.from_numpy(solid))


class _Distance(torch.autograd.Function):
    """Signed distances whose gradient is computed in the forward pass."""

    @staticmethod
    def forward(ctx: Any, p: Tensor, signed: Any) -> Tensor:
        distance, gradient = signed(p)
        ctx.save_for_backward(gradient)
        return distance

    @staticmethod
    def backward(ctx: Any, distance_bar: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return distance_bar[:, None] * gradient, None
