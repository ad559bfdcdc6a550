"""Surfaces as binary glTF 2.0 files (GLB), still or animated, which browsers and modeling programs open.

References:
    Khronos Group, glTF 2.0 specification, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pygltflib as gl
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import atomic_write
from nsm.io.moving import is_closed, playing_times
from nsm.io.palette import CLAY, linear_from_srgb
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

#: Roughness of the material, from a mirror (0) to chalk (1).
_ROUGHNESS = 0.65
#: Bytes that a GLB file can hold, because its length is a 32-bit number.
_MAX_BYTES = (1 << 32) - 1
#: Largest number that 16 bits hold: full intensity of a color, and the first index that glTF reserves.
_MAX_USHORT = np.iinfo(np.uint16).max
_COMPONENTS = {
    np.dtype(np.float32): gl.FLOAT,
    np.dtype(np.uint32): gl.UNSIGNED_INT,
    np.dtype(np.uint16): gl.UNSIGNED_SHORT,
}
_KINDS = {1: gl.SCALAR, 2: gl.VEC2, 3: gl.VEC3, 4: gl.VEC4}


def write_glb_frames(path: Path | str, frames: Iterable[Frame], seconds: float) -> None:
    """Write surfaces of any connectivity as one GLB file that shows them one after another.

    Each frame is a mesh of its own. glTF cannot hide a mesh, so all but one are scaled to zero, which the specification
    tells viewers to draw as hidden. The frame nearest in time is visible; at a time without a surface, none is.

    Args:
        path: The file to write.
        frames: 3D surfaces at increasing times.
        seconds: Seconds from the first frame to the last.

    Raises:
        InputError: If the times do not increase, the file would exceed 4 GiB, or it cannot be written.
    """
    document, times, nodes = _Document(), [], {}
    for number, frame in enumerate(frames):
        times.append(frame.time)
        if len(frame.mesh.simplices):
            nodes[number] = document.surface(f"t = {frame.time:g}", frame.mesh, frame.normals, Attributes())
    moments = playing_times(times, seconds)
    if len(times) > 1 and nodes:
        changes = (moments[1:] + moments[:-1]) / 2
        keys = document.accessor(np.concatenate([[0.0], changes, [seconds]]), bounds=True)
        visible = np.vstack([np.eye(len(times)), np.eye(len(times))[-1:]])
        for number, node in nodes.items():
            scales = document.accessor(np.repeat(visible[:, number, None], 3, axis=1))
            document.animate(node, "scale", "STEP", keys, scales)
            document.gltf.nodes[node].scale = [float(number == min(nodes))] * 3
    document.save(path)


def write_glb_advected(path: Path | str, frames: Iterable[Frame], seconds: float, attributes: Attributes) -> None:
    """Write one surface whose vertices move as a GLB file with a morph target per frame, blended linearly in time.

    Args:
        path: The file to write.
        frames: 3D surfaces of the same connectivity at increasing times.
        seconds: Seconds from the first frame to the last.
        attributes: Colors, or texture and its coordinates, which the vertices keep.

    Raises:
        InputError: If the times do not increase, the file would exceed 4 GiB, or it cannot be written.
    """
    document, remaining = _Document(), iter(frames)
    first = next(remaining)
    times, targets = [first.time], []
    points, normals = _single(first.mesh.vertices), _unit(first.normals)
    for frame in remaining:
        times.append(frame.time)
        moved = document.accessor(_single(frame.mesh.vertices) - points, gl.ARRAY_BUFFER, bounds=True)
        turned = document.accessor(_unit(frame.normals) - normals, gl.ARRAY_BUFFER)
        targets.append({"POSITION": moved, "NORMAL": turned})
    moments = playing_times(times, seconds)
    node = document.surface("surface", first.mesh, first.normals, attributes, targets)
    if targets:
        weights = np.eye(len(times))[:, 1:]
        keys = document.accessor(moments, bounds=True)
        document.animate(node, "weights", "LINEAR", keys, document.accessor(weights.reshape(-1)))
    document.save(path)


def encode_glb(mesh: SimplexMesh, normals: Float[Tensor, "v 3"], colors: Float[Tensor, "v 3"]) -> bytes:
    """Encode one still surface with colors as the bytes of a GLB file.

    Args:
        mesh: Triangles in 3D, counter-clockwise seen from outside.
        normals: Unit normals at the vertices.
        colors: Colors of the vertices, sRGB in 0..1.

    >>> triangle = SimplexMesh(torch.eye(3), torch.tensor([[0, 1, 2]]))
    >>> encode_glb(triangle, torch.ones(3, 3) / 3**0.5, torch.rand(3, 3))[:4]
    b'glTF'
    """
    document = _Document()
    document.surface("surface", mesh, normals, Attributes(colors=colors))
    return document.encode()


class _Document:
    """A glTF document under construction, together with its binary part."""

    def __init__(self) -> None:
        self.gltf = gl.GLTF2(
            asset=gl.Asset(version="2.0", generator=f"nsm {nsm.__version__}"), scene=0, scenes=[gl.Scene(nodes=[])]
        )
        self._parts: list[bytes] = []
        self._length = 0

    def accessor(
        self, values: np.ndarray, target: int | None = None, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Store an array (n,) or (n, k), floats in single precision, and return the number of its accessor."""
        kept = values.dtype if values.dtype in _COMPONENTS else np.dtype(np.float32)
        array = np.ascontiguousarray(values, dtype=kept.newbyteorder("<"))
        view = self._view(array.tobytes(), target)
        limits = {}
        if bounds:
            table = array.reshape(len(array), -1)
            limits = {"min": table.min(0).tolist(), "max": table.max(0).tolist()}
        kind = _KINDS[1 if array.ndim == 1 else array.shape[1]]
        self.gltf.accessors.append(
            gl.Accessor(
                bufferView=view,
                componentType=_COMPONENTS[kept],
                count=len(array),
                type=kind,
                normalized=normalized,
                **limits,
            )
        )
        return len(self.gltf.accessors) - 1

    def surface(
        self,
        name: str,
        mesh: SimplexMesh,
        normals: Tensor,
        attributes: Attributes,
        targets: Sequence[dict[str, int]] = (),
    ) -> int:
        """Add a mesh with its normals, material, and morph targets, and return the number of its node."""
        streams = gl.Attributes(
            POSITION=self.accessor(_single(mesh.vertices), gl.ARRAY_BUFFER, bounds=True),
            NORMAL=self.accessor(_unit(normals), gl.ARRAY_BUFFER),
        )
        if attributes.colors is not None:
            streams.COLOR_0 = self.accessor(_rgba(attributes.colors), gl.ARRAY_BUFFER, normalized=True)
        if attributes.uv is not None:
            # glTF has the origin of a texture at its upper left corner
            streams.TEXCOORD_0 = self.accessor(_array(attributes.uv) * [1, -1] + [0, 1], gl.ARRAY_BUFFER)
        indices = self.accessor(_indices(mesh), gl.ELEMENT_ARRAY_BUFFER)
        material = self._material(attributes, closed=is_closed(mesh))
        primitive = gl.Primitive(attributes=streams, indices=indices, material=material, targets=list(targets))
        self.gltf.meshes.append(gl.Mesh(name=name, primitives=[primitive], weights=[0.0] * len(targets)))
        self.gltf.nodes.append(gl.Node(name=name, mesh=len(self.gltf.meshes) - 1))
        self.gltf.scenes[0].nodes.append(len(self.gltf.nodes) - 1)
        return len(self.gltf.nodes) - 1

    def animate(self, node: int, path: str, interpolation: str, keys: int, values: int) -> None:
        """Animate a property of a node: it takes the values of one accessor at the seconds of another."""
        if not self.gltf.animations:
            self.gltf.animations.append(gl.Animation(name="morph"))
        animation = self.gltf.animations[0]
        animation.samplers.append(gl.AnimationSampler(input=keys, output=values, interpolation=interpolation))
        target = gl.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gl.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))

    def encode(self) -> bytes:
        """Return the bytes of the file."""
        self.gltf.buffers = [gl.Buffer(byteLength=self._length)] if self._length else []
        self.gltf.set_binary_blob(b"".join(self._parts))
        return b"".join(self.gltf.save_to_bytes())

    def save(self, path: Path | str) -> None:
        """Write the file."""
        if self._length > _MAX_BYTES:
            raise InputError(
                f"{Path(path).name} must fit in 4 GiB, got {self._length / 2**30:.1f} GiB. Try fewer `times`, a lower "
                "`resolution`, or `format=usd`."
            )
        with atomic_write(path) as temporary:
            temporary.write_bytes(self.encode())

    def _material(self, attributes: Attributes, closed: bool) -> int:
        """Return the number of a clay material, of a white one for colors, or of one that shows the texture."""
        plain = attributes.colors is None and attributes.texture is None
        name = ("clay" if plain else "surface") + ("" if closed else ", both sides")
        names = [material.name for material in self.gltf.materials]
        if name in names:
            return names.index(name)
        base = linear_from_srgb(torch.tensor(CLAY)).tolist() if plain else [1.0, 1.0, 1.0]
        surface = gl.PbrMetallicRoughness(baseColorFactor=[*base, 1.0], metallicFactor=0.0, roughnessFactor=_ROUGHNESS)
        if attributes.texture is not None and attributes.uv is not None:
            self.gltf.images.append(
                gl.Image(bufferView=self._view(_png(attributes.texture), None), mimeType="image/png")
            )
            self.gltf.samplers.append(gl.Sampler(magFilter=gl.LINEAR, minFilter=gl.LINEAR_MIPMAP_LINEAR))
            self.gltf.textures.append(gl.Texture(sampler=0, source=0))
            surface.baseColorTexture = gl.TextureInfo(index=0)
        self.gltf.materials.append(
            gl.Material(name=name, pbrMetallicRoughness=surface, doubleSided=not closed, alphaCutoff=None)
        )
        return len(names)

    def _view(self, data: bytes, target: int | None) -> int:
        """Store bytes from a multiple of four on, and return the number of their view."""
        self.gltf.bufferViews.append(
            gl.BufferView(buffer=0, byteOffset=self._length, byteLength=len(data), target=target)
        )
        padded = data + bytes(-len(data) % 4)
        self._parts.append(padded)
        self._length += len(padded)
        return len(self.gltf.bufferViews) - 1


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().numpy()


def _single(vertices: Tensor) -> np.ndarray:
    """Vertices (v, 3) in single precision, so that the first frame plus a difference gives the other exactly."""
    return _array(vertices).astype(np.float32)


def _unit(normals: Tensor) -> np.ndarray:
    """Normals (v, 3) of length one; (0, 1, 0) where ∇f vanishes and gives no direction."""
    values = _array(normals).astype(np.float32)
    length = np.linalg.norm(values, axis=1, keepdims=True)
    return np.where(length > 0, values / np.where(length > 0, length, 1), np.array([0, 1, 0], np.float32))


def _rgba(colors: Tensor) -> np.ndarray:
    """Linear colors with full opacity (v, 4) as 16-bit numbers: three of them would break the alignment to 4 bytes."""
    linear = _array(linear_from_srgb(colors).clamp(0, 1))
    return np.pad(np.rint(_MAX_USHORT * linear), ((0, 0), (0, 1)), constant_values=_MAX_USHORT).astype(np.uint16)


def _indices(mesh: SimplexMesh) -> np.ndarray:
    """Corners of all triangles (3m,), in 16 bits where these can count the vertices."""
    small = len(mesh.vertices) <= _MAX_USHORT
    return _array(mesh.simplices).reshape(-1).astype(np.uint16 if small else np.uint32)


def _png(picture: Image.Image) -> bytes:
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()
