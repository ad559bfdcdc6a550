"""Shapes from files of any kind, which the ending and the content of a file tell."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

from nsm.cli.errors import InputError
from nsm.io.checkpoint import load_shape
from nsm.shapes import LabelVolume, MeshFile, PointCloud, Shape, Silhouette, Similarity, SirenFile
from nsm.shapes.download import resolve
from nsm.shapes.mesh_reading import FORMATS as MESH_FORMATS
from nsm.shapes.point_files import POINT_FORMATS
from nsm.shapes.silhouette import PICTURE_FORMATS
from nsm.shapes.similarity import Pose
from nsm.shapes.volume_files import VOLUME_FORMATS

#: Endings of networks, and of checkpoints of this package.
NETWORK_FORMATS, CHECKPOINT_FORMATS = (".pth", ".pt"), (".ckpt",)
#: Bytes of a PLY file that hold its header.
_HEADER = 65536
#: Settings of `read_shape` that one kind of files alone takes, and what that kind is called.
_OWN_SETTINGS = {
    "label": ("labels", "volumes of labels"),
    "spacing": ("labels", "volumes of labels"),
    "threshold": ("silhouette", "images"),
    "omega": ("network", "networks"),
}


def read_shape(
    path: str | os.PathLike[str],
    fit: float | None = 0.8,
    pose: Pose = None,
    up: Sequence[float] | None = None,
    label: int | Sequence[int] | None = None,
    spacing: Sequence[float] | None = None,
    threshold: float | None = None,
    omega: float | None = None,
) -> Shape:
    """Read a shape from a file of any kind.

    Args:
        path: Mesh, point cloud, volume of labels, image or drawing, published network, checkpoint of a run with
            ``task=sdf`` or the folder of such a run, or a public name.
        fit: Half of the longest side after fitting; None keeps the coordinates of the file, as those of networks and
            checkpoints are kept in any case.
        pose: Rotation, translation, and scale given to the shape after that.
        up: Direction in the coordinates of the file that becomes +y, before all else; None if it is +y already.
        label: Label, or labels, of a volume (`nsm.shapes.LabelVolume`).
        spacing: Distances between the voxels of a volume, in place of those in the file.
        threshold: Opacity or brightness in (0, 1) at which the inside of an image begins (`nsm.shapes.Silhouette`).
        omega: ω of a network, which its file does not say; None is that of the published ones.

    Returns:
        The shape.

    Raises:
        InputError: If the kind of the file is unknown, a setting does not belong to it, or it cannot be read.

    Example:
        >>> from nsm.io.shape_file import read_shape
        >>> read_shape("brain.nii.gz", label=3).volume()  # doctest: +SKIP
        0.7341
    """
    kind = shape_kind(path)
    own = {"label": label, "spacing": spacing, "threshold": threshold, "omega": omega}
    given = {name: value for name, value in own.items() if value is not None}
    for name, value in given.items():
        if _OWN_SETTINGS[name][0] != kind:
            raise InputError(
                f"`{name}` must be null for {path}, which is no file of {_OWN_SETTINGS[name][1]}, got {value}. Try "
                f"`{name}=null`."
            )
    if kind == "checkpoint":
        return _from_checkpoint(path, pose, up)
    placing = {"pose": pose, "up": up} if kind == "network" else {"fit": fit, "pose": pose, "up": up}
    return _READERS[kind](str(path), **given, **placing)


def shape_kind(path: str | os.PathLike[str]) -> str:
    """Tell what a file holds: mesh, points, labels, silhouette, network, or checkpoint (also the folder of a run).

    A PLY file without faces holds points, and a TIFF file of several pages is a volume of labels.

    Raises:
        InputError: If there is no such file, or its ending is unknown.
    """
    if Path(path).expanduser().is_dir():
        return "checkpoint"
    name = str(path).lower()
    kinds = [kind for kind, endings in ENDINGS.items() if name.endswith(endings)]
    if not kinds:
        known = "; ".join(f"{kind}: {', '.join(endings)}" for kind, endings in ENDINGS.items())
        raise InputError(
            f"The name of a file of a shape must end as one of these kinds does ({known}), got {path}. Try a mesh "
            "such as `a.obj`."
        )
    if len(kinds) == 1:
        return kinds[0]
    file = resolve(path)
    if name.endswith(".ply"):
        return "mesh" if _ply_faces(file) else "points"
    return "labels" if _pages(file) > 1 else "silhouette"


def _from_checkpoint(path: str | os.PathLike[str], pose: Pose, up: Sequence[float] | None) -> Shape:
    shape = load_shape(Path(path).expanduser())
    return shape.transformed(Similarity.read(pose, shape.dim).after(Similarity.upright(up, shape.dim)))


def _ply_faces(file: Path) -> int:
    """Number of faces that the header of a PLY file promises."""
    with file.open("rb") as stream:
        header = stream.read(_HEADER).split(b"end_header")[0]
    counts = [line.split()[-1] for line in header.splitlines() if line.startswith(b"element face")]
    return int(counts[0]) if counts and counts[0].isdigit() else 0


def _pages(file: Path) -> int:
    """Number of pages of a TIFF file; 1 if it cannot be read, which the reader then says."""
    from PIL import Image

    try:
        with Image.open(file) as image:
            return int(getattr(image, "n_frames", 1))
    except OSError:
        return 1


#: Endings of the names of files by what they hold; those that two kinds share are told by the content.
ENDINGS: dict[str, tuple[str, ...]] = {
    "mesh": MESH_FORMATS,
    "points": POINT_FORMATS,
    "labels": VOLUME_FORMATS,
    "silhouette": PICTURE_FORMATS,
    "network": NETWORK_FORMATS,
    "checkpoint": CHECKPOINT_FORMATS,
}
_READERS: dict[str, Callable[..., Shape]] = {
    "mesh": MeshFile,
    "points": PointCloud,
    "labels": LabelVolume,
    "silhouette": Silhouette,
    "network": SirenFile,
}
