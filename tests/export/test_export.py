"""The export command: advected meshes, the formats of single files, exact ends, and its error messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from analytic import run_here, save, sentence, shrinking, turning, unreadable
from folders import names, read_mesh
from pygltflib import GLTF2

from nsm.export import __main__ as export
from nsm.export.formats import FORMATS
from nsm.io.mesh import write_mesh
from nsm.library.trained import RESOLUTION
from nsm.morphs.neural import NeuralMorph
from nsm.morphs.surfaces import extract_frame
from nsm.shapes import primitive
from nsm.shapes.textured import Attributes

#: Radians by which the carried ball turns.
SPIN = 0.7


@pytest.fixture(autouse=True)
def _somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _pushed(tmp_path: Path) -> tuple[NeuralMorph, Path]:
    """A ball that turns about the third axis, as a checkpoint."""
    morph = turning(3, SPIN)
    return morph, save(morph, tmp_path / "turning.ckpt")


@pytest.mark.parametrize("kind", ["ply", "glb"])
def test_an_advected_surface_keeps_its_triangles_and_its_colors(kind: str, tmp_path: Path) -> None:
    _, file = _pushed(tmp_path)
    command = (f"checkpoint={file}", "times=[0,0.5,1]", "resolution=12", f"format={kind}", "output=o")
    # without projection: the velocity turns the surface, and f does not
    assert run_here(export, *command, "advect=true", "project=false") == 0
    folder = tmp_path / "o"
    with np.load(folder / "correspondences.npz") as found:
        start, end, faces = found["source_points"], found["target_points"], found["simplices"]
    turn = np.array([[np.cos(SPIN), -np.sin(SPIN), 0], [np.sin(SPIN), np.cos(SPIN), 0], [0, 0, 1]])
    assert np.allclose(np.linalg.norm(end, axis=1), 0.4, atol=0.03)  # on the target, as coarse as it is
    directions = (start @ turn.T) / np.linalg.norm(start, axis=1, keepdims=True)
    assert ((end / np.linalg.norm(end, axis=1, keepdims=True) * directions).sum(1)).min() > 0.99
    pair = [read_mesh(folder / f"{end}.ply") for end in ("source", "target")]
    assert np.allclose(pair[0].vertices, start, atol=1e-6)
    assert (np.asarray(pair[0].visual.vertex_colors) == np.asarray(pair[1].visual.vertex_colors)).all()
    assert len(np.unique(np.asarray(pair[0].visual.vertex_colors), axis=0)) > 100
    if kind == "ply":
        meshes = [read_mesh(folder / f"frame_000{n}.ply") for n in range(3)]
        assert all((mesh.faces == faces).all() for mesh in meshes)
        assert np.allclose(meshes[2].vertices, np.asarray(meshes[0].vertices) @ turn.T, atol=1e-3)
        assert (np.asarray(meshes[2].visual.vertex_colors) == np.asarray(pair[0].visual.vertex_colors)).all()
    else:
        assert {p.name for p in folder.iterdir()} >= {"morph.glb", "morph.glb.json"}
        assert not list(folder.glob(".*"))


def test_a_given_mesh_is_advected_with_its_texture_coordinates(tmp_path: Path) -> None:
    morph, file = _pushed(tmp_path)
    surface = extract_frame(morph, 0.0, 10).mesh
    uv = torch.rand(len(surface.vertices), 2)
    write_mesh(tmp_path / "own.obj", surface, attributes=Attributes(uv=uv))
    command = (f"checkpoint={file}", "advect=true", "mesh=own.obj", "times=2", "resolution=10", "output=o")
    assert run_here(export, *command, "format=obj") == 0
    first, last = (read_mesh(tmp_path / "o" / f"frame_000{n}.obj") for n in range(2))
    assert (first.faces == last.faces).all()
    assert np.allclose(first.visual.uv, last.visual.uv)
    assert np.allclose(np.sort(first.visual.uv[:, 0]), np.sort(uv[:, 0].numpy()), atol=1e-6)


def test_a_glb_is_one_colored_mesh_with_morph_targets(tmp_path: Path) -> None:
    _, file = _pushed(tmp_path)
    command = (f"checkpoint={file}", "times=4", "resolution=12", "format=glb")
    assert run_here(export, *command, "output=one") == 0
    gltf = GLTF2().load(str(tmp_path / "one" / "morph.glb"))
    (primitive,) = (primitive for mesh in gltf.meshes for primitive in mesh.primitives)
    assert len(primitive.targets) == 3
    assert primitive.attributes.COLOR_0 is not None
    assert names(tmp_path / "one") == ["morph.glb", "morph.glb.json"]
    # a mesh per time where that is asked for, and where levels are
    for number, setting in enumerate(("advect=false", "exact_volume=true")):
        assert run_here(export, *command, setting, f"output={number}.glb") == 0
        assert len(GLTF2().load(f"{number}.glb").meshes) == 4


def test_a_glb_of_a_morph_without_velocity_has_a_mesh_per_time(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=3", "resolution=12", "format=glb", "output=m.glb") == 0
    assert "has no velocity to advect a mesh, so each time is a mesh of its own" in sentence(capfd.readouterr().out)
    assert len(GLTF2().load("m.glb").meshes) == 3


def test_an_animation_has_the_same_cells_from_every_command() -> None:
    assert {FORMATS[name].resolution for name in ("glb", "usd")} == {RESOLUTION}


@pytest.mark.parametrize("name", ["m.usdc", "m.usda", "folder"])
def test_usd_by_the_name_of_the_file(name: str, tmp_path: Path) -> None:
    file = save(shrinking(3, 0.2), tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=2", "resolution=8", "format=usd", f"output=o/{name}")
    assert run_here(export, *command) == 0
    expected = ["folder/morph.usdc", "folder/morph.usdc.json"] if name == "folder" else [name, f"{name}.json"]
    assert names(tmp_path / "o") == expected


def test_fields_are_written_next_to_the_run(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    save(shrinking(2, 0.2), run / "checkpoints" / "best.ckpt")
    assert run_here(export, f"checkpoint={run}", "format=safetensors") == 0
    assert names(run / "export") == ["morph.safetensors"]
    assert "wrote the fields to" in sentence("".join(capfd.readouterr()))


@pytest.mark.parametrize("ailment", ["missing", "cut", "text", "not ours", "format", "no run"])
def test_what_is_no_checkpoint(ailment: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file, words = unreadable(tmp_path)[ailment]
    before = names(tmp_path)
    assert run_here(export, f"checkpoint={file}", "output=frames") == 2
    assert words in sentence(capfd.readouterr().err)
    assert names(tmp_path) == before


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (("checkpoint=null",), "Try `python -m nsm.export checkpoint=outputs/demo`"),
        (("times=0",), "`times` must be a number of times or a list of times from 0 to 1, got 0"),
        (("times=-3",), "`times` must be a number of times or a list of times from 0 to 1, got -3"),
        (("times=2.5",), "`times` must be a number of times or a list of times from 0 to 1, got 2.5"),
        (("times=[]",), "must be a number of times or a list of times"),
        (("times=[0,1.5]",), "`times` must be a number of times or a list of times from 0 to 1, got [0, 1.5]"),
        (("times=many",), "`times` must be a number of times or a list of times from 0 to 1, got many"),
        (("resolution=0",), "`resolution` must be an integer of at least 2, got 0"),
        (
            ("format=gltf",),
            "`format` must be one of ply, obj, stl, glb, usd, nrrd, vti, labels, interior, safetensors, pt2, onnx, got",
        ),
        (("format=safetensor",), "Try `format=safetensors`"),
        (("format=ply",), "one of obj, nrrd, vti, interior, safetensors, pt2, onnx for a morph in 2D, got ply"),
        (("format=glb",), "for a morph in 2D, got glb. Try `format=obj`"),
        (("exact_volume=yes",), "`exact_volume` must be true or false, got yes"),
        (("seconds=0",), "`seconds` must be a number between 0 and 86400, got 0"),
        (("advect=true",), "must have a velocity to advect a surface"),
        (("advect=true", "exact_volume=true"), "`exact_volume=true` must come without `advect=true`"),
        (("mesh=ball.ply",), "Try `advect=true mesh=ball.ply`"),
        (
            ("format=onnx", "exact_volume=true"),
            "`exact_volume=true` must come with a format of surfaces, got `format=onnx`",
        ),
        (("format=pt2", "coordinates=source"), "`coordinates` must be morph for `format=pt2`"),
        (("labels=a.nii",), "`labels` must come with `format=labels`, got a.nii without it."),
        (("format=vti", "advect=true"), "got `format=vti`, which holds the fields on a grid"),
        (("format=nrrd", "exact_volume=true"), "got `format=nrrd`, which holds the fields on a grid"),
        (("format=interior",), "must have a velocity"),
        (("coordinates=world",), "`coordinates` must be one of morph, source, target, got world"),
        (("threads=-1",), "`threads` must be a positive integer, got -1"),
        (("ends=mesh",), "`ends` must be one of exact, network, got mesh. Try `ends=exact`."),
        (("checkpoint=null", "official=cow_dog"), "`official` must be one of kitten_fandisk"),
        (("output=a.ckpt",), "must be writable"),
    ],
)
def test_what_cannot_be_exported(
    overrides: tuple[str, ...], words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = save(shrinking(2, 0.1), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", *overrides) == 2
    assert words in sentence(capfd.readouterr().err)
    assert names(tmp_path) == ["a.ckpt"]


@pytest.mark.parametrize("ends", ["exact", "network"])
def test_the_first_frame_is_the_shape_or_its_network(ends: str, tmp_path: Path) -> None:
    source = primitive.Box([0.7, 0.6, 0.5])
    morph = turning(3, SPIN, source)
    file = save(morph, tmp_path / "a.ckpt")
    command = (f"checkpoint={file}", "times=[0,0.5]", "resolution=32", f"ends={ends}", "output=o")
    assert run_here(export, *command) == 0
    vertices = torch.tensor(np.array(read_mesh(tmp_path / "o" / "frame_0000.ply").vertices), dtype=torch.float32)
    away = {"exact": source(vertices), "network": morph(vertices, 0.0)}
    assert away[ends].abs().max() < 0.02
    assert away["exact" if ends == "network" else "network"].abs().max() > 0.1
    # a frame of other ends is another frame
    assert run_here(export, *command[:3], f"ends={'network' if ends == 'exact' else 'exact'}", "output=o") == 2


def test_formats_of_networks_hold_the_networks(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = save(turning(3, SPIN), tmp_path / "a.ckpt")
    assert run_here(export, f"checkpoint={file}", "format=safetensors", "output=o") == 0
    assert "`format=safetensors` holds the networks, so its ends are theirs" in sentence(capfd.readouterr().out)
    assert (tmp_path / "o" / "morph.safetensors").is_file()


def test_without_a_velocity_the_ends_are_those_of_the_network(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    morph = shrinking(3, 0.2)
    file = save(morph, tmp_path / "still" / "checkpoints" / "best.ckpt")
    assert run_here(export, f"checkpoint={file}", "times=[0]", "resolution=16", "output=o") == 0
    said = sentence(capfd.readouterr().out)
    assert "still has no velocity to advect detail, so its ends are those of the network" in said
    vertices = torch.tensor(np.array(read_mesh(tmp_path / "o" / "frame_0000.ply").vertices), dtype=torch.float32)
    assert morph(vertices, 0.0).abs().max() < 0.02


def test_one_morph_at_a_time(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    files = [save(shrinking(2, rise), tmp_path / f"{rise}.ckpt") for rise in (0.1, 0.2)]
    assert run_here(export, f"checkpoint=[{files[0]},{files[1]}]") == 2
    assert "must name one morph, got 2. Try one of them." in sentence(capfd.readouterr().err)
