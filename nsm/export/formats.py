"""Formats of the export command by name."""

from __future__ import annotations

from collections.abc import Mapping

from nsm.export.glb import GlbAnimation
from nsm.export.meshes import Meshes
from nsm.export.network_format import NetworkFormat
from nsm.export.onnx import write_onnx
from nsm.export.pt2 import write_pt2
from nsm.export.request import Format
from nsm.export.safetensors import write_safetensors
from nsm.export.usd import UsdAnimation

#: Formats by the value of the setting ``format``; the first that can hold a morph is its default.
FORMATS: Mapping[str, Format] = {
    "ply": Meshes("ply"),
    "obj": Meshes("obj", dims=(2, 3)),
    "stl": Meshes("stl"),
    "glb": GlbAnimation(),
    "usd": UsdAnimation(),
    "safetensors": NetworkFormat("safetensors", write_safetensors),
    "pt2": NetworkFormat("pt2", write_pt2),
    "onnx": NetworkFormat("onnx", write_onnx),
}
