"""Animated GLB files: what the Khronos validator says, and what an independent reader finds in them."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from problems import MOTIONS
from pygltflib import GLTF2

from nsm.cli.errors import InputError
from nsm.geometry.advection import advect
from nsm.geometry.topology import enclosed_volume
from nsm.io.gltf import write_glb_advected, write_glb_frames
from nsm.io.moving import is_closed, playing_times
from nsm.io.palette import linear_from_srgb
from nsm.morphs.surfaces import Frame, extract_frame
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

VALIDATOR = Path(__file__).parent / "validator"
TIMES = [0.0, 0.25, 1.0]
MOTION = MOTIONS["squashed_ball"](3)


def require_valid(path: Path) -> dict:
    """The validator's report, after it has said that the file is right; without the validator the test is skipped."""
    if shutil.which("node") is None or not (VALIDATOR / "node_modules" / "gltf-validator").is_dir():
        if os.environ.get("CI") == "true":
            pytest.fail("needs node, and npm ci in tests/io/validator")
        pytest.skip("needs node, and npm ci in tests/io/validator")
    command = ["node", str(VALIDATOR / "validate.js"), str(path)]
    report = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert (report["issues"]["numErrors"], report["issues"]["numWarnings"]) == (0, 0), report["issues"]["messages"]
    return report["info"]


@pytest.fixture(scope="module")
def extracted() -> list[Frame]:
    return [extract_frame(MOTION, time, 20) for time in TIMES]


@pytest.fixture(scope="module")
def carried(extracted: list[Frame]) -> list[Frame]:
    first = extracted[0].mesh
    places = advect(MOTION.velocity, first.vertices, TIMES)
    return [
        Frame(time, 0.0, SimplexMesh(x, first.simplices), torch.nn.functional.normalize(MOTION.gradient(x, time)))
        for time, x in zip(TIMES, places, strict=True)
    ]


def read(path: Path) -> GLTF2:
    return GLTF2().load(str(path))


def values(gltf: GLTF2, number: int) -> np.ndarray:
    """The content of an accessor."""
    accessor = gltf.accessors[number]
    view = gltf.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor.type]
    kind = {5126: "<f4", 5125: "<u4", 5123: "<u2"}[accessor.componentType]
    array = np.frombuffer(gltf.binary_blob(), kind, accessor.count * width, view.byteOffset)
    return array.reshape(accessor.count, width)


def test_frames_are_shown_one_at_a_time(tmp_path: Path, extracted: list[Frame]) -> None:
    write_glb_frames(tmp_path / "m.glb", extracted, 2.0)
    info = require_valid(tmp_path / "m.glb")
    assert info["generator"].startswith("nsm ")
    assert (info["animationCount"], info["drawCallCount"]) == (1, 3)
    gltf = read(tmp_path / "m.glb")
    assert gltf.animations[0].name == "morph"
    assert [material.doubleSided for material in gltf.materials] == [False]
    assert [node.scale for node in gltf.nodes] == [[1.0] * 3, [0.0] * 3, [0.0] * 3]
    # at each moment the one whose time, 0, 0.5 and 2 seconds, is nearest
    for moment, shown in ((0.0, 0), (0.2, 0), (0.3, 1), (1.2, 1), (1.3, 2), (2.0, 2)):
        for channel in gltf.animations[0].channels:
            sampler = gltf.animations[0].samplers[channel.sampler]
            assert (channel.target.path, sampler.interpolation) == ("scale", "STEP")
            step = np.searchsorted(values(gltf, sampler.input)[:, 0], moment, side="right") - 1
            assert (values(gltf, sampler.output)[step] == float(channel.target.node == shown)).all()


def test_another_reader_finds_the_same_surfaces(tmp_path: Path, extracted: list[Frame]) -> None:
    write_glb_frames(tmp_path / "m.glb", extracted, 2.0)
    scene = trimesh.load(tmp_path / "m.glb", process=False)
    assert len(scene.geometry) == len(extracted)
    for frame, mesh in zip(extracted, scene.geometry.values(), strict=True):
        assert np.abs(mesh.vertices - frame.mesh.vertices.numpy()).max() < 1e-6
        assert (mesh.faces == frame.mesh.simplices.numpy()).all()
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(enclosed_volume(frame.mesh), rel=1e-5)
        assert np.abs(mesh.vertex_normals - frame.normals.numpy()).max() < 1e-5


def test_a_carried_mesh_goes_through_its_frames(tmp_path: Path, carried: list[Frame]) -> None:
    colors = torch.rand(len(carried[0].mesh.vertices), 3)
    write_glb_advected(tmp_path / "m.glb", carried, 3.0, Attributes(colors=colors))
    info = require_valid(tmp_path / "m.glb")
    assert info["hasMorphTargets"]
    assert info["drawCallCount"] == 1
    gltf = read(tmp_path / "m.glb")
    primitive, sampler = gltf.meshes[0].primitives[0], gltf.animations[0].samplers[0]
    assert sampler.interpolation == "LINEAR"
    moments = values(gltf, sampler.input)[:, 0]
    assert moments == pytest.approx([0, 0.75, 3])
    weights = values(gltf, sampler.output).reshape(len(moments), -1)
    for number, frame in enumerate(carried):
        for name, wanted in (("POSITION", frame.mesh.vertices), ("NORMAL", frame.normals)):
            blended = values(gltf, getattr(primitive.attributes, name)).astype(float)
            for weight, target in zip(weights[number], primitive.targets, strict=True):
                blended = blended + weight * values(gltf, target[name])
            assert np.abs(blended - wanted.numpy()).max() < 1e-6
    stored = values(gltf, primitive.attributes.COLOR_0) / 65535
    assert stored[:, :3] == pytest.approx(linear_from_srgb(colors).numpy(), abs=0.51 / 65535)
    assert (stored[:, 3] == 1).all()
    base = trimesh.load(tmp_path / "m.glb", process=False, force="mesh")
    assert np.abs(base.vertices - carried[0].mesh.vertices.numpy()).max() < 1e-6


def test_a_texture_travels_inside(tmp_path: Path, carried: list[Frame]) -> None:
    uv = torch.rand(len(carried[0].mesh.vertices), 2)
    picture = Image.new("RGB", (4, 4), "red")
    write_glb_advected(tmp_path / "m.glb", carried, 3.0, Attributes(uv=uv, texture=picture))
    assert require_valid(tmp_path / "m.glb")["hasTextures"]
    mesh = trimesh.load(tmp_path / "m.glb", process=False, force="mesh")
    assert np.abs(mesh.visual.uv - uv.numpy()).max() < 1e-6
    assert mesh.visual.material.baseColorTexture.getpixel((1, 1)) == (255, 0, 0)


def test_an_open_surface_is_seen_from_both_sides(tmp_path: Path, extracted: list[Frame]) -> None:
    frame = extracted[0]
    cut = SimplexMesh(frame.mesh.vertices, frame.mesh.simplices[20:])
    assert is_closed(frame.mesh)
    assert not is_closed(cut)
    write_glb_frames(tmp_path / "m.glb", [frame, extracted[1]._replace(mesh=cut, normals=frame.normals)], 1.0)
    require_valid(tmp_path / "m.glb")
    gltf = read(tmp_path / "m.glb")
    sides = [gltf.materials[mesh.primitives[0].material].doubleSided for mesh in gltf.meshes]
    assert sides == [False, True]


def test_frames_without_a_surface_or_a_slope_are_valid_too(tmp_path: Path, extracted: list[Frame]) -> None:
    nothing = SimplexMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long))
    gone = Frame(0.5, 0.0, nothing, torch.zeros(0, 3))
    flat = extracted[2]._replace(normals=torch.zeros_like(extracted[2].normals))
    write_glb_frames(tmp_path / "m.glb", [extracted[0], gone, flat], 1.0)
    assert require_valid(tmp_path / "m.glb")["drawCallCount"] == 2
    write_glb_frames(tmp_path / "one.glb", extracted[:1], 1.0)
    assert require_valid(tmp_path / "one.glb")["animationCount"] == 0
    write_glb_advected(tmp_path / "still.glb", extracted[:1], 1.0, Attributes())
    assert require_valid(tmp_path / "still.glb")["animationCount"] == 0


def test_times_must_increase(tmp_path: Path, extracted: list[Frame]) -> None:
    with pytest.raises(InputError, match="`times` must be a list of increasing numbers"):
        write_glb_frames(tmp_path / "m.glb", reversed(extracted), 1.0)
    assert not list(tmp_path.iterdir())
    assert playing_times([0.5], 3.0).tolist() == [0.0]
    assert playing_times([0.5, 0.75, 1.0], 3.0).tolist() == [0.0, 1.5, 3.0]


def test_the_validator_is_pinned_and_names_no_place_of_its_own() -> None:
    lock = json.loads((VALIDATOR / "package-lock.json").read_text())
    packages = [package for name, package in lock["packages"].items() if name]
    assert all(package["integrity"].startswith("sha512-") for package in packages)
    assert all(
        package.get("resolved", "https://registry.npmjs.org/").startswith("https://registry.npmjs.org/")
        for package in packages
    )
