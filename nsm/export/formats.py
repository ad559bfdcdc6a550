"""Formats of the export command by name."""

from __future__ import annotations

from collections.abc import Mapping

from nsm.export.fields import SampledFields
from nsm.export.glb import GlbAnimation
from nsm.export.interior import InteriorPoints
from nsm.export.labels import LabelVolumes
from nsm.export.meshes import Meshes
from nsm.export.network_format import NetworkFormat
from nsm.export.nrrd import write_nrrd_fields
from nsm.export.onnx import write_onnx
from nsm.export.pt2 import write_pt2
from nsm.export.request import Format
from nsm.export.safetensors import write_safetensors
from nsm.export.usd import UsdAnimation
from nsm.export.vti import write_vti_fields

#: Formats by the value of the setting ``format``; the first that can hold a morph is its default.
FORMATS: Mapping[str, Format] = {
    "ply": Meshes("ply"),
    "obj": Meshes("obj", dims=(2, 3)),
    "stl": Meshes("stl"),
    "glb": GlbAnimation(),
    "usd": UsdAnimation(),
    "nrrd": SampledFields("nrrd", write_nrrd_fields),
    "vti": SampledFields("vti", write_vti_fields),
    "labels": LabelVolumes(),
    "interior": InteriorPoints(),
    "safetensors": NetworkFormat("safetensors", write_safetensors),
    "pt2": NetworkFormat("pt2", write_pt2),
    "onnx": NetworkFormat("onnx", write_onnx),
}
