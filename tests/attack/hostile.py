"""Hostile files: checkpoints, networks, meshes, images, and volumes that are damaged or made to do harm."""

from __future__ import annotations

import os
import pickle
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from PIL import Image

import nsm
from nsm.io.build import build
from nsm.io.checkpoint import FORMAT
from nsm.shapes import Ball

#: Networks as small as they can be, between two disks.
MODEL: dict[str, Any] = {
    "_target_": "nsm.morphs.neural.NeuralMorph",
    "field": {"_target_": "nsm.fields.ScalarSiren", "in_features": 3, "hidden_features": 8, "hidden_layers": 2},
    "velocity": {
        "_target_": "nsm.fields.Free",
        "dim": 2,
        "network": {"_target_": "nsm.fields.VectorSiren", "_partial_": True, "hidden_features": 8, "hidden_layers": 2},
    },
    "source": Ball(0.3, [0.0, 0.0]).config(),
    "target": Ball(0.4, [0.1, 0.0]).config(),
}


def checkpoint(**changes: Any) -> dict[str, Any]:
    """The content of a sound checkpoint, with some entries of its description replaced."""
    torch.manual_seed(0)
    state = {f"morph.{name}": value for name, value in build(MODEL).state_dict().items()}
    entry = {"format": FORMAT, "version": nsm.__version__, "model": MODEL, "config": {}, "provenance": {}}
    return {"state_dict": state, "nsm": {**entry, **changes}}


class Bomb:
    """A pickle that makes a file when it is read."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> Any:
        return os.system, (f"touch {self.marker}",)


def _changed(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    """The model with one entry replaced."""
    first, *rest = path
    inner = value if not rest else _replaced(MODEL[first], tuple(rest), value)
    return {**MODEL, first: inner}


def _replaced(node: dict[str, Any], path: tuple[str, ...], value: Any) -> dict[str, Any]:
    first, *rest = path
    return {**node, first: value if not rest else _replaced(node[first], tuple(rest), value)}


def hostile_checkpoints(marker: Path) -> Iterator[tuple[str, Any]]:
    """Names and contents of checkpoints that must not load."""
    nan, inf = float("nan"), float("inf")
    sizes = {
        "hidden_layers": (10**9, 10**6, 0, -1, "two", None, [2], nan, True),
        "hidden_features": (10**9, 10**5, 0, -1, "two", None),
        "in_features": (10**9, 0, -1, 4),
        "omega": (nan, inf, "high", [1.0], [nan, nan], 1e39),
    }
    for key, values in sizes.items():
        for value in values:
            yield f"field {key} {value}", checkpoint(model=_changed(("field", key), value))
    for value in (10**9, 7, 0, -1, None, "2"):
        yield f"velocity dim {value}", checkpoint(model=_changed(("velocity", "dim"), value))
    for target in ("os.system", "nsm.fields.Gaussian", "nsm.shapes.Ball", "torch.nn.Linear", "nsm.io.checkpoint.Path"):
        for part in ("field", "velocity", "source"):
            node = {"_target_": target, "command": f"touch {marker}"}
            if target == "nsm.shapes.Ball":
                node = Ball(0.3, [0.0, 0.0, 0.0]).config()
            if target == "nsm.fields.Gaussian":
                node = {"_target_": target}
            yield f"{part} is {target}", checkpoint(model=_changed((part,), node))
    mesh = {"_target_": "nsm.shapes.MeshShape", "closed": True}
    for vertices, faces in ((10**10, 4), (4, 10**10), (0, 0), (4, 4)):
        yield (
            f"mesh {vertices} {faces}",
            checkpoint(model=_changed(("source",), {**mesh, "vertices": vertices, "faces": faces})),
        )
    outline = {"_target_": "nsm.shapes.OutlineShape", "corners": 3}
    for loops in ([10**10], [-3], [], [1, 1], "abc", None):
        yield f"outline {loops}", checkpoint(model=_changed(("source",), {**outline, "loops": loops}))
    for key, value in (("radius", nan), ("radius", -1.0), ("center", [nan, 0.0]), ("center", [0.0] * 3)):
        yield f"ball {key} {value}", checkpoint(model=_changed(("source", key), value))
    for value in (
        3,
        [],
        {"source": 3},
        {"source": {"scale": nan}},
        {"source": {"scale": "x"}},
        {"source": {"scale": 0}},
    ):
        yield f"provenance {value}", checkpoint(provenance=value)
    for key, value in (("model", 3), ("model", None), ("model", []), ("format", None), ("format", "2"), ("format", 99)):
        yield f"{key} {value}", checkpoint(**{key: value})
    deep: Any = 0
    for _ in range(200):
        deep = [deep]
    yield "deep", checkpoint(model=_changed(("field",), {"_target_": "nsm.fields.ScalarSiren", "in_features": deep}))
    yield from _hostile_weights(nan, inf)
    for place in ("state_dict", "loops", "optimizer_states"):
        yield f"bomb in {place}", {**checkpoint(), place: Bomb(marker)}
    yield "bomb", Bomb(marker)


def _hostile_weights(nan: float, inf: float) -> Iterator[tuple[str, Any]]:
    name = "morph.field.linears.0.weight"
    whole = checkpoint()["state_dict"]
    tensors = {
        "nan": torch.full_like(whole[name], nan),
        "inf": torch.full_like(whole[name], inf),
        "sparse": whole[name].to_sparse(),
        "csr": whole[name].to_sparse_csr(),
        "meta": whole[name].to("meta"),
        "complex": whole[name].to(torch.complex64),
        "expanded": torch.zeros(1).expand(10**6, 10**6),
        "text": "weights",
        "none": None,
        "empty": torch.zeros(0),
        "transposed": whole[name].T,
        "quantized": torch.quantize_per_tensor(whole[name], 0.1, 0, torch.qint8),
    }
    for kind, value in tensors.items():
        yield f"weight {kind}", {**checkpoint(), "state_dict": {**whole, name: value}}
    yield "integer keys", {**checkpoint(), "state_dict": {**whole, 3: whole[name]}}
    yield "no weights", {**checkpoint(), "state_dict": {}}
    yield "a list of weights", {**checkpoint(), "state_dict": [1, 2]}


def hostile_networks(marker: Path) -> Iterator[tuple[str, Any]]:
    """Names and contents of files that are no network of the published format."""
    layers = {
        f"net.{i}.0.{k}": torch.zeros(8, 3) if k == "weight" else torch.zeros(8)
        for i in range(2)
        for k in ("weight", "bias")
    }
    yield "zeros", layers
    yield "integer keys", dict(enumerate(layers.values()))
    yield "mixed keys", {**layers, 3: torch.zeros(3)}
    yield "sparse", {k: v.to_sparse() for k, v in layers.items()}
    yield "meta", {k: v.to("meta") for k, v in layers.items()}
    yield "texts", dict.fromkeys(layers, "x")
    yield "nothing", {}
    yield "a list", [1, 2, 3]
    yield "a tensor", torch.zeros(3)
    yield "one layer", {"net.0.0.weight": torch.zeros(1, 3), "net.0.0.bias": torch.zeros(1)}
    yield "scalars", {k: torch.tensor(1.0) for k in layers}
    yield "nan", {k: torch.full_like(v, float("nan")) for k, v in layers.items()}
    yield "expanded", {k: torch.zeros(1).expand(10**6, 10**6) for k in layers}
    yield "bomb", Bomb(marker)
    yield "bomb inside", {**layers, "net.2.0.weight": Bomb(marker)}


def damaged_meshes(folder: Path) -> Iterator[Path]:
    """Files of meshes that are no meshes."""
    sphere = trimesh.creation.icosphere(1)
    good = "".join(f"v {x} {y} {z}\n" for x, y, z in sphere.vertices)
    faces = "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in sphere.faces)
    texts = {
        "two_coordinates.obj": good.replace("v 0.0 ", "v ") + faces,
        "plane.obj": "v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n",
        "beyond.obj": good + faces + "f 1 2 999\n",
        "before.obj": good + faces + "f -999 -998 -997\n",
        "zero.obj": good + faces + "f 0 0 0\n",
        "letters.obj": good + faces + "f a b c\n",
        "nan.obj": good.replace("v 0.0 ", "v nan ") + faces,
        "inf.obj": good.replace("v 0.0 ", "v inf ") + faces,
        "huge.obj": good.replace("v 0.0 ", "v 1e300 ") + faces,
        "words.obj": good.replace("v 0.0 ", "v zero ") + faces,
        "points.obj": good,
        "noise.obj": "\x00\x01\x02" * 100,
        "counts.ply": "ply\nformat ascii 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n0\n",
        "minus.ply": "ply\nformat ascii 1.0\nelement vertex -3\nproperty float x\nend_header\n0\n",
        "header.ply": "ply\n",
        "words.off": "OFF\nmany few none\n",
        "counts.off": "OFF\n1000000000 1000000000 0\n0 0 0\n",
        "cut.off": "OFF\n8 12 0\n0 0 0\n",
        "text.stl": "solid x\nfacet normal a b c\n",
        "text.glb": "glTF",
        "brackets.gltf": "{{{",
        "empty.gltf": '{"asset": {"version": "2.0"}, "meshes": [{"primitives": [{"attributes": {"POSITION": 99}}]}]}',
        "letters.xyz": "a b c\n",
        "ragged.xyz": "1 2 3\n1 2\n",
        "nan.xyz": "nan nan nan\n" * 10,
        "one.xyz": "0 0 0\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
        yield folder / name
    glb = bytes(sphere.export(file_type="glb"))
    stl = bytes(sphere.export(file_type="stl"))
    ply = bytes(sphere.export(file_type="ply"))
    binary = {
        "cut.glb": glb[: len(glb) // 2],
        "chunk.glb": glb[:12] + struct.pack("<I", 2**31 - 1) + glb[16:], "zeros.glb": bytes(200),
        "count.stl": stl[:80] + struct.pack("<I", 2**31) + stl[84:], "cut.stl": stl[:200],
        "cut.ply": ply[: len(ply) // 2],
        "pickle.npy": pickle.dumps([1, 2]), "cut.nii": bytes(100), "noise.nrrd": b"NRRD0004\ntype: lots\n\n",
        "noise.tif": b"II*\x00" + bytes(50), "noise.png": b"\x89PNG\r\n\x1a\n" + bytes(50), "noise.svg": b"<svg",
        "noise.las": b"LASF" + bytes(100), "empty.obj": b"", "empty.png": b"", "empty.nii": b"", "empty.npy": b"",
    }  # fmt: skip
    for name, data in binary.items():
        (folder / name).write_bytes(data)
        yield folder / name
    np.save(folder / "text.npy", np.array(["a", "b"]))
    np.save(folder / "cube.npy", np.zeros((3, 3, 3)))
    np.save(folder / "nan.npy", np.full((100, 3), np.nan))
    yield from (folder / name for name in ("text.npy", "cube.npy", "nan.npy"))
    Image.fromarray(np.zeros((16, 16), dtype=np.uint8)).save(folder / "black.png")
    yield folder / "black.png"
