"""Moving surfaces as USD stages with time samples, which film and modelling programs read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import nsm
from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import whole_file
from nsm.io.moving import CLAY, is_closed, linear_rgb, playing_times
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

#: Binary, text, and a package.
SUFFIXES = (".usdc", ".usda", ".usdz")
#: Time codes per second.
RATE = 24.0
#: A unit of the box in metres: a shape is then about as large as a chair.
_METRES = 0.5


def write_usd_frames(path: Path | str, frames: Iterable[Frame], seconds: float) -> None:
    """Write surfaces of any connectivity as one mesh whose points and faces have time samples.

    Args:
        path: where to write, with one of `SUFFIXES`.
        frames: 3D surfaces at increasing times; one without triangles hides the mesh.
        seconds: from the first frame to the last.

    Raises:
        InputError: if usd-core is not installed, the times do not increase, or the file cannot be written.
    """
    frames = list(frames)
    with _stage(path, frames, seconds) as (mesh, codes):
        _paint(mesh, Attributes(), all(is_closed(frame.mesh) for frame in frames))
        for code, frame in zip(codes, frames, strict=True):
            _set_faces(mesh, frame, code)
            _set_points(mesh, frame, code)


def write_usd_carried(path: Path | str, frames: Iterable[Frame], seconds: float, attributes: Attributes) -> None:
    """Write one surface whose vertices move as a mesh whose points alone have time samples.

    Args:
        path: where to write, with one of `SUFFIXES`.
        frames: 3D surfaces of the same connectivity at increasing times.
        seconds: from the first frame to the last.
        attributes: what moves along; colors as ``displayColor``, places on the texture as ``st``. The texture itself
            is left out, as USD keeps pictures in files of their own.

    Raises:
        InputError: if usd-core is not installed, the times do not increase, or the file cannot be written.
    """
    frames = list(frames)
    with _stage(path, frames, seconds) as (mesh, codes):
        _paint(mesh, attributes, is_closed(frames[0].mesh))
        _set_faces(mesh, frames[0])
        for code, frame in zip(codes, frames, strict=True):
            _set_points(mesh, frame, code)


@contextmanager
def _stage(path: Path | str, frames: list[Frame], seconds: float) -> Iterator[tuple[UsdGeom.Mesh, list[Usd.TimeCode]]]:
    """A stage with an empty mesh and the time codes of the frames; written when the block ends well."""
    require("pxr", extra="usd", task="A USD file")
    from pxr import Usd, UsdGeom, UsdUtils

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path.name} names no format of USD: let it end in {' or '.join(SUFFIXES)}")
    moments = playing_times([frame.time for frame in frames], seconds) * RATE
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, _METRES)
    stage.SetTimeCodesPerSecond(RATE)
    stage.SetFramesPerSecond(RATE)
    stage.SetStartTimeCode(moments[0])
    stage.SetEndTimeCode(moments[-1])
    stage.GetRootLayer().comment = f"nsm {nsm.__version__}"
    root = UsdGeom.Xform.Define(stage, "/morph")
    stage.SetDefaultPrim(root.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/morph/surface")
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    yield mesh, [Usd.TimeCode(moment) for moment in moments]
    with whole_file(path) as temporary:
        if path.suffix.lower() != ".usdz":
            stage.GetRootLayer().Export(str(temporary))
            return
        with whole_file(temporary.with_suffix(".usdc")) as layer:
            stage.GetRootLayer().Export(str(layer))
            UsdUtils.CreateNewUsdzPackage(str(layer), str(temporary))
        temporary.with_suffix(".usdc").unlink()


def _set_faces(mesh: UsdGeom.Mesh, frame: Frame, *code: Usd.TimeCode) -> None:
    """The triangles, at one time or at all."""
    from pxr import Vt

    faces = frame.mesh.simplices.cpu().numpy().astype(np.int32)
    mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)), *code)
    mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(faces.reshape(-1)), *code)


def _set_points(mesh: UsdGeom.Mesh, frame: Frame, code: Usd.TimeCode) -> None:
    """Vertices, normals and the box around them at one time."""
    from pxr import UsdGeom

    points = _vectors(frame.mesh.vertices)
    mesh.CreatePointsAttr().Set(points, code)
    mesh.CreateNormalsAttr().Set(_vectors(frame.normals), code)
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), code)


def _paint(mesh: UsdGeom.Mesh, attributes: Attributes, closed: bool) -> None:
    """Colors, or clay where there are none, and places on the texture."""
    from pxr import Sdf, UsdGeom, Vt

    mesh.CreateDoubleSidedAttr(not closed)
    if attributes.colors is None:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set([CLAY])
    else:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(_vectors(linear_rgb(attributes.colors)))
    if attributes.uv is not None:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        places = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
        places.Set(Vt.Vec2fArray.FromNumpy(attributes.uv.cpu().numpy().astype(np.float32)))


def _vectors(values: Any) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values.detach().cpu().numpy(), dtype=np.float32))
