"""USD: animated surfaces as stages with time samples, which film and modeling programs read.

References:
    Pixar, Universal Scene Description, https://openusd.org
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

import nsm
from nsm.cli.errors import InputError
from nsm.cli.extras import require
from nsm.cli.files import atomic_write
from nsm.export.animation import Animation
from nsm.export.request import Request
from nsm.export.surfaces import similarity_to
from nsm.io.moving import is_closed, playing_times
from nsm.io.palette import CLAY, linear_from_srgb
from nsm.morphs.surfaces import Frame
from nsm.shapes.textured import Attributes
from nsm.types import Morph

if TYPE_CHECKING:
    from pxr import Usd, UsdGeom

#: Suffixes of binary files, text files, packages, and files of any kind, which are written as binary ones.
SUFFIXES = (".usdc", ".usda", ".usdz", ".usd")
#: Time codes per second.
RATE = 24.0
#: Provenance of a shape from a scanner, whose coordinates are millimeters.
_SCANNED = "labels"


class Space(NamedTuple):
    """Coordinates of a stage.

    Attributes:
        up: Axis that points upward, ``Y`` or ``Z``.
        meters: Meters per unit of length.
    """

    up: str
    meters: float


#: Coordinates of the box, in which a shape is about as large as a chair.
BOX = Space("Y", 0.5)
#: Meters per unit of a file: millimeters for scans, and centimeters, which USD assumes, for files without units.
_MILLIMETER, _CENTIMETER = 0.001, 0.01


class UsdAnimation(Animation):
    """A stage with one mesh, whose points (and triangles, unless it is advected) have time samples."""

    suffixes = SUFFIXES

    def write_extracted(self, path: Path, frames: Iterable[Frame], request: Request) -> None:
        write_usd_frames(path, frames, request.seconds, space_of(request.morph, request.coordinates))

    def write_advected(self, path: Path, frames: Iterable[Frame], request: Request, attributes: Attributes) -> None:
        space = space_of(request.morph, request.coordinates)
        write_usd_advected(path, frames, request.seconds, attributes, space)


def space_of(morph: Morph, coordinates: str) -> Space:
    """Return the coordinates of a stage for a coordinate system of `nsm.export.request.COORDINATES`.

    The upward axis of a file is the one of y and z that its fit and pose turn closer to the upward axis of the box.
    """
    if coordinates == "morph":
        return BOX
    upward = similarity_to(morph, coordinates).rotation[:, 1]
    scanned = morph.provenance.get(coordinates, {}).get("kind") == _SCANNED
    return Space("Z" if upward[2] > upward[1] else "Y", _MILLIMETER if scanned else _CENTIMETER)


def write_usd_frames(path: Path | str, frames: Iterable[Frame], seconds: float, space: Space = BOX) -> None:
    """Write surfaces of any connectivity as one mesh whose points and faces have time samples.

    Args:
        path: The file to write, with one of `SUFFIXES`.
        frames: 3D surfaces at increasing times; one without triangles hides the mesh.
        seconds: Seconds from the first frame to the last.
        space: Coordinates of the vertices.

    Raises:
        InputError: If usd-core is not installed, the times do not increase, or the file cannot be written.
    """
    frames = list(frames)
    with _stage(path, frames, seconds, space) as (mesh, codes):
        _paint(mesh, Attributes(), all(is_closed(frame.mesh) for frame in frames))
        for code, frame in zip(codes, frames, strict=True):
            _set_faces(mesh, frame, code)
            _set_points(mesh, frame, code)


def write_usd_advected(
    path: Path | str, frames: Iterable[Frame], seconds: float, attributes: Attributes, space: Space = BOX
) -> None:
    """Write one surface whose vertices move as a mesh whose points alone have time samples.

    Args:
        path: The file to write, with one of `SUFFIXES`.
        frames: 3D surfaces of the same connectivity at increasing times.
        seconds: Seconds from the first frame to the last.
        attributes: Attributes of the vertices: colors become ``displayColor``, texture coordinates ``st``. The texture
            itself is omitted, because USD keeps pictures in separate files.
        space: Coordinates of the vertices.

    Raises:
        InputError: If usd-core is not installed, the times do not increase, or the file cannot be written.
    """
    frames = list(frames)
    with _stage(path, frames, seconds, space) as (mesh, codes):
        _paint(mesh, attributes, is_closed(frames[0].mesh))
        _set_faces(mesh, frames[0])
        for code, frame in zip(codes, frames, strict=True):
            _set_points(mesh, frame, code)


@contextmanager
def _stage(
    path: Path | str, frames: list[Frame], seconds: float, space: Space
) -> Iterator[tuple[UsdGeom.Mesh, list[Usd.TimeCode]]]:
    """Provide an empty mesh on a stage and the time codes of the frames; the stage is written if the block succeeds."""
    require("pxr", extra="usd", task="A USD file")
    from pxr import Tf, Usd, UsdGeom, UsdUtils

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"The name of a USD file must end in {' or '.join(SUFFIXES)}, got {path.name}. Try `output=morph.usdc`."
        )
    moments = playing_times([frame.time for frame in frames], seconds) * RATE
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, space.up)
    UsdGeom.SetStageMetersPerUnit(stage, space.meters)
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
    with atomic_write(path) as temporary:
        layer = temporary.with_suffix(".usdc") if path.suffix.lower() == ".usdz" else temporary
        try:
            stage.GetRootLayer().Export(str(layer))
            if layer != temporary:
                UsdUtils.CreateNewUsdzPackage(str(layer), str(temporary))
                zipfile.ZipFile(temporary).testzip()  # USD does not notice when the disk is full
        except (Tf.ErrorException, zipfile.BadZipFile) as error:
            raise InputError(
                f"`{path}` must fit on its disk, got an error of USD on writing. Try to free space there, or another "
                "folder."
            ) from error


def _set_faces(mesh: UsdGeom.Mesh, frame: Frame, *code: Usd.TimeCode) -> None:
    """Set the triangles, at one time or for all times."""
    from pxr import Vt

    faces = frame.mesh.simplices.cpu().numpy().astype(np.int32)
    mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)), *code)
    mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(faces.reshape(-1)), *code)


def _set_points(mesh: UsdGeom.Mesh, frame: Frame, code: Usd.TimeCode) -> None:
    """Set vertices, normals, and their bounding box at one time."""
    from pxr import UsdGeom

    points = _vectors(frame.mesh.vertices)
    mesh.CreatePointsAttr().Set(points, code)
    mesh.CreateNormalsAttr().Set(_vectors(frame.normals), code)
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(points), code)


def _paint(mesh: UsdGeom.Mesh, attributes: Attributes, closed: bool) -> None:
    """Set colors, clay if there are none, and texture coordinates."""
    from pxr import Sdf, UsdGeom, Vt

    mesh.CreateDoubleSidedAttr(not closed)
    if attributes.colors is None:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant).Set(_vectors(linear_from_srgb(torch.tensor([CLAY]))))
    else:
        mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(_vectors(linear_from_srgb(attributes.colors)))
    if attributes.uv is not None:
        kind = Sdf.ValueTypeNames.TexCoord2fArray
        places = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
        places.Set(Vt.Vec2fArray.FromNumpy(attributes.uv.cpu().numpy().astype(np.float32)))


def _vectors(values: Any) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values.detach().cpu().numpy(), dtype=np.float32))
