"""Colored triangles as a binary glTF in memory: the one form in which the page takes a color for every vertex."""

from __future__ import annotations

import json
import struct

import numpy as np
from jaxtyping import Float, Int

# numbers of the glTF 2.0 specification
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_VERTICES, _INDICES = 34962, 34963
_MAGIC, _VERSION, _JSON, _BINARY = 0x46546C67, 2, 0x4E4F534A, 0x004E4942


def glb(
    vertices: Float[np.ndarray, "v 3"],
    normals: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "m 3"],
    colors: Float[np.ndarray, "v 3"],
) -> bytes:
    """A glTF file of triangles, matt and visible from both sides.

    viser's page computes the normals anew, but shades smoothly only what comes with some.

    Args:
        vertices: (v, 3).
        normals: (v, 3), of unit length.
        faces: (m, 3), counter-clockwise seen from outside.
        colors: (v, 3), sRGB in 0..1.
    """
    small = len(vertices) <= np.iinfo(np.uint16).max
    linear = np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
    rgba = np.ones((len(vertices), 4), dtype=np.uint16)
    rgba[:, :3] = np.rint(linear.clip(0, 1) * np.iinfo(np.uint16).max)
    rgba[:, 3] = np.iinfo(np.uint16).max
    positions = vertices.astype(np.float32)
    indices = faces.astype(np.uint16 if small else np.uint32).ravel()
    buffers: list[tuple[np.ndarray, int]] = [
        (positions, _VERTICES),
        (normals.astype(np.float32), _VERTICES),
        (rgba, _VERTICES),
        (indices, _INDICES),
    ]
    views: list[dict[str, int]] = []
    chunks: list[bytes] = []
    length = 0
    for array, target in buffers:
        content = _padded(array.tobytes(), b"\0")
        views.append({"buffer": 0, "byteOffset": length, "byteLength": array.nbytes, "target": target})
        chunks.append(content)
        length += len(content)
    accessors = [
        {"bufferView": 0, "componentType": _FLOAT, "count": len(positions), "type": "VEC3"}
        | {"min": positions.min(0).tolist(), "max": positions.max(0).tolist()},
        {"bufferView": 1, "componentType": _FLOAT, "count": len(normals), "type": "VEC3"},
        {"bufferView": 2, "componentType": _USHORT, "normalized": True, "count": len(rgba), "type": "VEC4"},
        {"bufferView": 3, "componentType": _USHORT if small else _UINT, "count": len(indices), "type": "SCALAR"},
    ]
    material = {"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.55}, "doubleSided": True}
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "indices": 3, "material": 0}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [material],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": length}],
    }
    header, body = _padded(json.dumps(document).encode(), b" "), b"".join(chunks)
    total = 12 + 8 + len(header) + 8 + len(body)
    return b"".join(
        [
            struct.pack("<III", _MAGIC, _VERSION, total),
            struct.pack("<II", len(header), _JSON),
            header,
            struct.pack("<II", len(body), _BINARY),
            body,
        ]
    )


def _padded(content: bytes, filler: bytes) -> bytes:
    """Content up to the next multiple of 4 bytes, as glTF has it."""
    return content + filler * (-len(content) % 4)
