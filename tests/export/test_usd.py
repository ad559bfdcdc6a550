"""USD stages, read back: time samples, what varies and what does not, and what frames them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from problems import MOTIONS
from pxr import Usd, UsdGeom, UsdValidation

from nsm.cli.errors import InputError
from nsm.export.usd import BOX, RATE, SUFFIXES, Space, space_of, write_usd_advected, write_usd_frames
from nsm.io.palette import linear_from_srgb
from nsm.morphs.surfaces import Frame, extract_frame
from nsm.shapes import Ball
from nsm.shapes.textured import Attributes
from nsm.types import SimplexMesh

TIMES = [0.0, 0.25, 1.0]
CODES = [0.0, 0.25 * 2 * RATE, 2 * RATE]


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    motion = MOTIONS["squashed_ball"](3)
    return [extract_frame(motion, time, 16) for time in TIMES]


def findings(stage: Usd.Stage) -> list[str]:
    """What usdchecker has to say about a stage."""
    rules = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [error.GetMessage() for error in UsdValidation.ValidationContext(rules).Validate(stage)]


def read(path: Path) -> UsdGeom.Mesh:
    """The only mesh of a stage."""
    stage = Usd.Stage.Open(str(path))
    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert len(meshes) == 1
    assert stage.GetDefaultPrim() == meshes[0].GetParent()
    read.stage = stage  # which must outlive its prims
    return UsdGeom.Mesh(meshes[0])


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_surfaces_are_read_back_at_their_times(tmp_path: Path, frames: list[Frame], suffix: str) -> None:
    write_usd_frames(tmp_path / f"m{suffix}", frames, 2.0)
    assert [p.name for p in tmp_path.iterdir()] == [f"m{suffix}"]
    mesh = read(tmp_path / f"m{suffix}")
    stage = read.stage
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, 2 * RATE)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == RATE
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) > 0
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetNormalsInterpolation() == "vertex"
    for attribute in (
        mesh.GetPointsAttr(),
        mesh.GetFaceVertexIndicesAttr(),
        mesh.GetNormalsAttr(),
        mesh.GetExtentAttr(),
    ):
        assert attribute.GetTimeSamples() == pytest.approx(CODES)
    for code, frame in zip(CODES, frames, strict=True):
        assert np.array(mesh.GetPointsAttr().Get(code)) == pytest.approx(frame.mesh.vertices.numpy(), abs=1e-6)
        assert np.array(mesh.GetNormalsAttr().Get(code)) == pytest.approx(frame.normals.numpy(), abs=1e-6)
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(code)).reshape(-1, 3)
        assert (faces == frame.mesh.simplices.numpy()).all()
        assert (np.array(mesh.GetFaceVertexCountsAttr().Get(code)) == 3).all()
        extent = torch.stack([frame.mesh.vertices.amin(0), frame.mesh.vertices.amax(0)])
        assert np.array(mesh.GetExtentAttr().Get(code)) == pytest.approx(extent.numpy(), abs=1e-6)


def test_of_a_carried_mesh_only_points_vary(tmp_path: Path, frames: list[Frame]) -> None:
    first = frames[0]
    moved = [
        first._replace(time=t, mesh=SimplexMesh((1 + t) * first.mesh.vertices, first.mesh.simplices)) for t in TIMES
    ]
    count = len(first.mesh.vertices)
    look = Attributes(colors=torch.rand(count, 3), uv=torch.rand(count, 2))
    write_usd_advected(tmp_path / "m.usdc", moved, 2.0, look)
    mesh = read(tmp_path / "m.usdc")
    assert mesh.GetFaceVertexIndicesAttr().GetTimeSamples() == []
    assert mesh.GetPointsAttr().GetTimeSamples() == pytest.approx(CODES)
    assert not mesh.GetDoubleSidedAttr().Get()
    halfway = np.array(mesh.GetPointsAttr().Get((CODES[1] + CODES[2]) / 2))
    assert halfway == pytest.approx(1.625 * first.mesh.vertices.numpy(), abs=1e-6)
    primvars = UsdGeom.PrimvarsAPI(mesh)
    colors, places = primvars.GetPrimvar("displayColor"), primvars.GetPrimvar("st")
    assert colors.GetInterpolation() == places.GetInterpolation() == "vertex"
    assert np.array(colors.Get()) == pytest.approx(linear_from_srgb(look.colors).numpy(), abs=1e-6)
    assert np.array(places.Get()) == pytest.approx(look.uv.numpy(), abs=1e-6)


def test_a_time_without_a_surface_is_empty(tmp_path: Path, frames: list[Frame]) -> None:
    nothing = SimplexMesh(torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.long))
    write_usd_frames(tmp_path / "m.usda", [frames[0], Frame(1.0, 0.0, nothing, torch.zeros(0, 3))], 1.0)
    mesh = read(tmp_path / "m.usda")
    assert len(mesh.GetPointsAttr().Get(RATE)) == len(mesh.GetFaceVertexIndicesAttr().Get(RATE)) == 0
    assert len(mesh.GetPointsAttr().Get(0)) == len(frames[0].mesh.vertices)


def test_what_cannot_be_written_is_said(tmp_path: Path, frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"must end in \.usdc or \.usda or \.usdz"):
        write_usd_frames(tmp_path / "m.xyz", frames, 1.0)
    with pytest.raises(InputError, match="`times` must be a list of increasing numbers"):
        write_usd_frames(tmp_path / "m.usdc", frames[::-1], 1.0)
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(InputError, match=r"needs `pxr`, .* Try `pip install 'nsm\[usd\]'`\.$"):
        write_usd_frames(tmp_path / "m.usdc", frames, 1.0)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_usdchecker_finds_nothing(tmp_path: Path, frames: list[Frame], suffix: str) -> None:
    write_usd_frames(tmp_path / f"frames{suffix}", frames, 2.0)
    still = [frames[0]._replace(time=time) for time in TIMES]
    colors = Attributes(colors=torch.rand(len(frames[0].mesh.vertices), 3))
    write_usd_advected(tmp_path / f"advected{suffix}", still, 2.0, colors)
    for name in ("frames", "advected"):
        assert findings(Usd.Stage.Open(str(tmp_path / f"{name}{suffix}"))) == []
    nameless = Usd.Stage.CreateInMemory()
    nameless.DefinePrim("/a", "Mesh")
    assert any("upAxis" in finding for finding in findings(nameless))  # the check can fail


def test_a_stage_in_the_coordinates_of_a_file_has_its_units_and_its_upward_axis(
    tmp_path: Path, frames: list[Frame]
) -> None:
    motion = MOTIONS["squashed_ball"](3)
    motion.source = Ball(0.4, pose={"rotation": [-90, 0, 0], "scale": 0.01})  # z of the file becomes +y
    motion.target = Ball(0.4, pose={"rotation": [0, 70, 0]})
    motion.provenance = {"source": {"kind": "labels"}, "target": {"kind": "mesh"}}
    assert space_of(motion, "source") == Space("Z", 0.001)
    assert space_of(motion, "target") == Space("Y", 0.01)
    assert space_of(motion, "morph") == BOX
    write_usd_frames(tmp_path / "m.usda", frames, 2.0, Space("Z", 0.001))
    stage = Usd.Stage.Open(str(tmp_path / "m.usda"))
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Z", 0.001)
