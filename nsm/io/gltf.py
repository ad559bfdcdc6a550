"""Moving surfaces as animated GLB files (glTF 2.0, Khronos Group), which browsers and modelling programs play."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pygltflib as gl
from PIL import Image
from torch import Tensor

import nsm
from nsm.cli.errors import InputError
from nsm.cli.files import whole_file
from nsm.io.moving import CLAY, is_closed, linear_rgb, playing_times
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes

#: Roughness of the material, from a mirror (0) to chalk (1).
ROUGHNESS = 0.65
#: Bytes that a GLB file can hold: its length is a 32-bit number.
_MOST_BYTES = (1 << 32) - 1
_COMPONENTS = {np.dtype(np.float32): gl.FLOAT, np.dtype(np.uint32): gl.UNSIGNED_INT}
_KINDS = {1: gl.SCALAR, 2: gl.VEC2, 3: gl.VEC3}


def write_glb_frames(path: Path | str, frames: Iterable[Frame], seconds: float) -> None:
    """Write surfaces of any connectivity as one GLB file that shows them one after another.

    Each frame is a mesh of its own; glTF cannot hide one, so all but one are scaled to nothing, which the
    specification tells viewers to draw as hidden. At every moment the frame nearest in time is shown; at a time without
    a surface, none.

    Args:
        path: where to write.
        frames: 3D surfaces at increasing times.
        seconds: from the first frame to the last.

    Raises:
        InputError: if the times do not increase, or the file would exceed 4 GiB or cannot be written.
    """
    document, times, nodes = _Document(), [], {}
    for number, frame in enumerate(frames):
        times.append(frame.time)
        if len(frame.mesh.simplices):
            nodes[number] = document.surface(frame, Attributes(), [])
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


def write_glb_carried(path: Path | str, frames: Iterable[Frame], seconds: float, attributes: Attributes) -> None:
    """Write one surface whose vertices move as a GLB file with a morph target a frame, blended evenly in time.

    Args:
        path: where to write.
        frames: 3D surfaces of the same connectivity at increasing times.
        seconds: from the first frame to the last.
        attributes: what moves along.

    Raises:
        InputError: if the times do not increase, or the file would exceed 4 GiB or cannot be written.
    """
    document, remaining = _Document(), iter(frames)
    first = next(remaining)
    times, targets = [first.time], []
    points, normals = _points(first), _unit(first)
    for frame in remaining:
        times.append(frame.time)
        moved = document.accessor(_points(frame) - points, gl.ARRAY_BUFFER, bounds=True)
        turned = document.accessor(_unit(frame) - normals, gl.ARRAY_BUFFER)
        targets.append({"POSITION": moved, "NORMAL": turned})
    moments = playing_times(times, seconds)
    node = document.surface(first, attributes, targets)
    if targets:
        weights = np.eye(len(times))[:, 1:]
        keys = document.accessor(moments, bounds=True)
        document.animate(node, "weights", "LINEAR", keys, document.accessor(weights.reshape(-1)))
    document.save(path)


class _Document:
    """A glTF document and its binary part, both growing."""

    def __init__(self) -> None:
        self.gltf = gl.GLTF2(
            asset=gl.Asset(version="2.0", generator=f"nsm {nsm.__version__}"), scene=0, scenes=[gl.Scene(nodes=[])]
        )
        self._parts: list[bytes] = []
        self._length = 0

    def accessor(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """Store an array (n,) or (n, k), floats in single precision; returns the number of its accessor."""
        kept = np.dtype(np.uint32 if values.dtype.kind in "iu" else np.float32)
        array = np.ascontiguousarray(values, dtype=kept.newbyteorder("<"))
        view = self._view(array.tobytes(), target)
        limits = {}
        if bounds:
            table = array.reshape(len(array), -1)
            limits = {"min": table.min(0).tolist(), "max": table.max(0).tolist()}
        kind = _KINDS[1 if array.ndim == 1 else array.shape[1]]
        self.gltf.accessors.append(
            gl.Accessor(bufferView=view, componentType=_COMPONENTS[kept], count=len(array), type=kind, **limits)
        )
        return len(self.gltf.accessors) - 1

    def surface(self, frame: Frame, attributes: Attributes, targets: list[dict[str, int]]) -> int:
        """Add a mesh with its normals, material and morph targets; returns the number of its node."""
        streams = gl.Attributes(
            POSITION=self.accessor(_points(frame), gl.ARRAY_BUFFER, bounds=True),
            NORMAL=self.accessor(_unit(frame), gl.ARRAY_BUFFER),
        )
        if attributes.colors is not None:
            streams.COLOR_0 = self.accessor(_array(linear_rgb(attributes.colors)), gl.ARRAY_BUFFER)
        if attributes.uv is not None:
            # glTF has the origin of a texture at its upper left corner
            streams.TEXCOORD_0 = self.accessor(_array(attributes.uv) * [1, -1] + [0, 1], gl.ARRAY_BUFFER)
        indices = self.accessor(frame.mesh.simplices.cpu().numpy().reshape(-1), gl.ELEMENT_ARRAY_BUFFER)
        material = self._material(attributes, closed=is_closed(frame.mesh))
        primitive = gl.Primitive(attributes=streams, indices=indices, material=material, targets=targets)
        name = "surface" if targets else f"t = {frame.time:g}"
        self.gltf.meshes.append(gl.Mesh(name=name, primitives=[primitive], weights=[0.0] * len(targets)))
        self.gltf.nodes.append(gl.Node(name=name, mesh=len(self.gltf.meshes) - 1))
        self.gltf.scenes[0].nodes.append(len(self.gltf.nodes) - 1)
        return len(self.gltf.nodes) - 1

    def animate(self, node: int, path: str, interpolation: str, keys: int, values: int) -> None:
        """Let a property of a node take the values of one accessor at the times of another."""
        if not self.gltf.animations:
            self.gltf.animations.append(gl.Animation(name="morph"))
        animation = self.gltf.animations[0]
        animation.samplers.append(gl.AnimationSampler(input=keys, output=values, interpolation=interpolation))
        target = gl.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(gl.AnimationChannel(sampler=len(animation.samplers) - 1, target=target))

    def save(self, path: Path | str) -> None:
        """Write the file."""
        if self._length > _MOST_BYTES:
            raise InputError(
                f"{Path(path).name} would hold {self._length / 2**30:.1f} GiB, and a GLB file holds 4: give fewer "
                "times or a lower resolution, or format=usd"
            )
        self.gltf.buffers = [gl.Buffer(byteLength=self._length)] if self._length else []
        self.gltf.set_binary_blob(b"".join(self._parts))
        with whole_file(path) as temporary, temporary.open("wb") as file:
            file.writelines(self.gltf.save_to_bytes())

    def _material(self, attributes: Attributes, closed: bool) -> int:
        """The number of a clay-like material, of one that lets colors through, or of one that shows the texture."""
        plain = attributes.colors is None and attributes.texture is None
        surface = gl.PbrMetallicRoughness(
            baseColorFactor=[*(CLAY if plain else (1.0, 1.0, 1.0)), 1.0], metallicFactor=0.0, roughnessFactor=ROUGHNESS
        )
        if attributes.texture is not None and attributes.uv is not None:
            self.gltf.images.append(
                gl.Image(bufferView=self._view(_png(attributes.texture), None), mimeType="image/png")
            )
            self.gltf.samplers.append(gl.Sampler(magFilter=gl.LINEAR, minFilter=gl.LINEAR_MIPMAP_LINEAR))
            self.gltf.textures.append(gl.Texture(sampler=0, source=0))
            surface.baseColorTexture = gl.TextureInfo(index=0)
        name = ("clay" if plain else "surface") + ("" if closed else ", both sides")
        names = [material.name for material in self.gltf.materials]
        if name not in names:
            made = gl.Material(name=name, pbrMetallicRoughness=surface, doubleSided=not closed, alphaCutoff=None)
            self.gltf.materials.append(made)
            return len(names)
        return names.index(name)

    def _view(self, data: bytes, target: int | None) -> int:
        """Store bytes; returns the number of their view. Every one starts at a multiple of four."""
        self.gltf.bufferViews.append(
            gl.BufferView(buffer=0, byteOffset=self._length, byteLength=len(data), target=target)
        )
        padded = data + bytes(-len(data) % 4)
        self._parts.append(padded)
        self._length += len(padded)
        return len(self.gltf.bufferViews) - 1


def _array(values: Tensor) -> np.ndarray:
    return values.detach().cpu().numpy()


def _points(frame: Frame) -> np.ndarray:
    """Vertices (v, 3) in single precision, so that differences of two frames add up to the second."""
    return _array(frame.mesh.vertices).astype(np.float32)


def _unit(frame: Frame) -> np.ndarray:
    """Normals (v, 3) of length one, also where f has no slope and so no direction."""
    normals = _array(frame.normals).astype(np.float32)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.where(length > 0, length, 1), np.array([0, 1, 0], np.float32))


def _png(picture: Image.Image) -> bytes:
    data = io.BytesIO()
    picture.save(data, "PNG")
    return data.getvalue()
