"""Shapes from files of any kind: which reader takes which file, and what no reader takes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate
from omegaconf import OmegaConf
from PIL import Image
from runs import STILL, TINY, train_here

from nsm.cli.configuration import CONF
from nsm.cli.errors import InputError
from nsm.io.shape_file import read_shape, shape_kind
from nsm.shapes import Ball, LabelVolume, MeshFile, PointCloud, Silhouette, SirenFile, SirenShape

SPHERE = trimesh.creation.icosphere(4, radius=2.0)


def _image(path: Path) -> Path:
    pixels = np.full((60, 60), 255, dtype=np.uint8)
    pixels[20:40, 15:45] = 0
    Image.fromarray(pixels).save(path)
    return path


def _volume(path: Path, labels: tuple[int, ...] = (1,)) -> Path:
    values = np.zeros((24, 24, 24), dtype=np.uint8)
    for number, label in enumerate(labels):
        values[4:20, 4:20, 4 + 8 * number : 12 + 8 * number] = label
    if path.suffix == ".tif":
        pytest.importorskip("tifffile").imwrite(path, values, photometric="minisblack")
    elif path.suffix == ".nrrd":
        pytest.importorskip("nrrd").write(str(path), values)
    else:
        nibabel = pytest.importorskip("nibabel")
        nibabel.save(nibabel.Nifti1Image(values, np.eye(4)), path)
    return path


def _points(path: Path) -> Path:
    trimesh.PointCloud(trimesh.sample.sample_surface_even(SPHERE, 3000, seed=0)[0]).export(path)
    return path


def _mesh(path: Path) -> Path:
    if path.suffix == ".gii":
        nibabel = pytest.importorskip("nibabel")
        intents = {
            "NIFTI_INTENT_POINTSET": np.float32(SPHERE.vertices),
            "NIFTI_INTENT_TRIANGLE": np.int32(SPHERE.faces),
        }
        arrays = [nibabel.gifti.GiftiDataArray(data, intent=intent) for intent, data in intents.items()]
        nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)
    elif path.suffix == ".pial":
        pytest.importorskip("nibabel").freesurfer.write_geometry(str(path), SPHERE.vertices, SPHERE.faces)
    elif path.suffix in (".vtk", ".vtp", ".vtu"):
        surface = pytest.importorskip("pyvista").wrap(SPHERE)
        (surface.cast_to_unstructured_grid() if path.suffix == ".vtu" else surface).save(path)
    else:
        SPHERE.export(path)
    return path


@pytest.mark.parametrize("ending", ["obj", "ply", "stl", "off", "glb", "gltf", "vtk", "vtp", "vtu", "gii", "pial"])
def test_a_mesh_is_read_from_every_format(ending: str, tmp_path: Path, generator: torch.Generator) -> None:
    if ending == "gltf":
        (path := tmp_path / "a.gltf").parent.mkdir(exist_ok=True)
        for name, content in trimesh.exchange.gltf.export_gltf(SPHERE.scene()).items():
            (tmp_path / ("a.gltf" if name.endswith(".gltf") else name)).write_bytes(content)
    else:
        path = _mesh(tmp_path / f"a.{ending}")
    shape = read_shape(path)
    assert isinstance(shape, MeshFile)
    x = 2 * torch.rand(1000, 3, generator=generator) - 1
    torch.testing.assert_close(shape(x), Ball(0.8)(x), atol=3e-3, rtol=0)


def test_content_tells_meshes_from_points_and_volumes_from_images(tmp_path: Path) -> None:
    assert shape_kind(_mesh(tmp_path / "mesh.ply")) == "mesh"
    assert shape_kind(_points(tmp_path / "points.ply")) == "points"
    assert shape_kind(_volume(tmp_path / "volume.tif")) == "labels"
    assert shape_kind(_image(tmp_path / "image.tif")) == "silhouette"
    assert shape_kind("never_read.NII.GZ") == "labels"
    assert isinstance(read_shape(tmp_path / "points.ply"), PointCloud)
    assert isinstance(read_shape(tmp_path / "volume.tif"), LabelVolume)
    assert isinstance(read_shape(tmp_path / "image.tif"), Silhouette)


def test_settings_reach_the_reader_that_takes_them(tmp_path: Path) -> None:
    path = _volume(tmp_path / "a.nii.gz", (3, 7))
    both = read_shape(path, label=[3, 7], fit=None).volume()
    assert read_shape(path, label=7, fit=None).volume() == pytest.approx(both / 2, rel=0.02)
    assert read_shape(path, label=[3, 7], spacing=[2, 2, 2], fit=None).volume() == pytest.approx(8 * both, rel=1e-6)
    turned = read_shape(_image(tmp_path / "a.png"), pose={"rotation": 90}, fit=0.6)
    torch.testing.assert_close(turned.bounds(), torch.tensor([[-0.4, -0.6], [0.4, 0.6]]))


def test_published_networks_and_the_folders_of_runs_are_shapes(data_dir: Path, tmp_path: Path) -> None:
    published = read_shape("official/ni/kitten.pth", up=[0, 0, 1])
    assert isinstance(published, SirenFile)
    assert train_here(*STILL, f"hydra.run.dir={tmp_path}", "sdf.steps=5") == 0
    x = torch.rand(9, 2)
    fitted = read_shape(tmp_path)
    assert isinstance(fitted, SirenShape)
    torch.testing.assert_close(read_shape(tmp_path / "checkpoints/best.ckpt")(x), fitted(x))


def test_what_no_reader_takes_meets_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(path: Path | str, words: str, **settings: object) -> None:
        with pytest.raises(InputError, match=words) as error:
            read_shape(path, **settings)
        assert "\n" not in str(error.value)

    refused("a.docx", r"must end as one of these kinds does \(mesh: .obj, .* points: .* labels: .*\), got a.docx")
    refused("nowhere.stl", "must be an existing file.* got nowhere.stl")
    refused("nowhere.ply", "must be an existing file.* got nowhere.ply")
    refused(tmp_path, "which has no checkpoints")
    refused(
        _mesh(tmp_path / "a.obj"), "`label` must be null for .*a.obj, which is no file of volumes of labels", label=1
    )
    refused(_image(tmp_path / "a.png"), "`omega` must be null for .*a.png, which is no file of networks", omega=30)
    (tmp_path / "bad.vtp").write_text("hello")
    (tmp_path / "bad.gii").write_text("hello")
    refused(tmp_path / "bad.vtp", "must contain a mesh|must contain triangles")
    refused(tmp_path / "bad.gii", "must contain a mesh in the format")
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(tmp_path / "bad.vtp", r"Reading .vtp needs `pyvista`, .* Try `pip install 'nsm\[render\]'`")


#: A file for every configuration in conf/shape that has no path of its own, and the settings that it needs.
WITHOUT_PATH = {
    "mesh": lambda folder: _mesh(folder / "a.obj"),
    "points": lambda folder: _points(folder / "a.ply"),
    "labels": lambda folder: _volume(folder / "a.nii.gz"),
    "silhouette": lambda folder: _image(folder / "a.png"),
    "file": lambda folder: _volume(folder / "a.nrrd"),
}


def _without_path() -> set[str]:
    return {p.stem for p in (CONF / "shape").glob("*.yaml") if "path: ???" in p.read_text()}


def test_every_kind_of_file_has_a_configuration_that_is_tried() -> None:
    assert _without_path() == {*WITHOUT_PATH, "siren", "fitted"}  # those two are tried where networks are made


@pytest.mark.parametrize("name", WITHOUT_PATH)
def test_every_kind_of_file_can_be_named_in_a_command(name: str, tmp_path: Path) -> None:
    path = WITHOUT_PATH[name](tmp_path)
    made = instantiate(OmegaConf.merge(OmegaConf.load(CONF / "shape" / f"{name}.yaml"), {"path": str(path)}))
    other = "ball" if made.dim == 3 else "disk"
    bare = [option for option in TINY if not option.startswith("callbacks.")]
    ends = (f"shape@source={name}", f"source.path={path}", f"shape@target={other}")
    small = ("steps=1", "optimizer.lr=1e-6", "validations=1", "callbacks=none", f"hydra.run.dir={tmp_path}/run")
    assert train_here(*bare, *ends, *small) == 0


def test_a_silhouette_and_a_volume_make_no_pair(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ends = (f"source.path={_image(tmp_path / 'a.png')}", f"target.path={_volume(tmp_path / 'a.nii.gz')}")
    assert train_here("shape@source=file", "shape@target=file", *ends, f"hydra.run.dir={tmp_path}/run") == 2
    assert "`shape@target` must have the dimension of the source, 2D, got a shape in 3D" in capsys.readouterr().err
