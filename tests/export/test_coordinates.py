"""Results in the coordinates and units of either file: meshes, volumes, velocities, and correspondences."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import torch
import trimesh
from analytic import FREQUENCY, bowl, run_here, save, turning
from problems import MOTIONS

from nsm.cli.errors import InputError
from nsm.export import __main__ as export
from nsm.fields import SourceInit
from nsm.geometry.volume import volume
from nsm.io.checkpoint import load_morph
from nsm.morphs.file_coordinates import FileCoordinates
from nsm.morphs.neural import NeuralMorph
from nsm.morphs.surfaces import extract_frame
from nsm.shapes import Ball, MeshFile, RigidAlignment, SharedCoordinates, Similarity, SimilarityAlignment, SirenShape
from nsm.train.tasks import SdfFit, prepare_keys

NO_FIT = mock.Mock(spec=SdfFit)
#: What a scanner of other units may do to a mesh.
MOVES = [
    Similarity.read({"rotation": [70, -30, 110], "translation": [100, -100, 100], "scale": scale}, 3)
    for scale in (1.0, 1000.0)
]


def write(file: Path, vertices: torch.Tensor, faces: np.ndarray) -> str:
    rows = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in vertices.tolist()]
    file.write_text("\n".join([*rows, *(f"f {a} {b} {c}" for a, b, c in faces + 1)]) + "\n")
    return str(file)


@pytest.mark.parametrize("move", MOVES)
def test_an_aligned_mesh_returns_to_its_own_file(move: Similarity, data_dir: Path, tmp_path: Path) -> None:
    mesh = trimesh.load(data_dir / "meshes" / "spot.obj", force="mesh", process=False)
    vertices = torch.tensor(np.array(mesh.vertices))
    moved = move.apply(vertices)
    source = MeshFile(write(tmp_path / "a.obj", vertices, mesh.faces))
    target = MeshFile(write(tmp_path / "b.obj", moved, mesh.faces))
    align = RigidAlignment() if move.scale == 1 else SimilarityAlignment()
    ends = prepare_keys([source, target], NO_FIT, align=align)
    x = torch.rand(200, 3) - 0.5
    torch.testing.assert_close(ends.target(x), ends.source(x), atol=1e-4, rtol=0)  # they coincide in the box
    for shape, own in ((ends.source, vertices), (ends.target, moved)):
        morph = NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False)
        end = "source" if shape is ends.source else "target"
        in_file = FileCoordinates(morph, end)
        size = float((own.amax(0) - own.amin(0)).max())
        assert (in_file.source if end == "source" else in_file.target)(own[:500]).abs().max() < 1e-6 * size
    stored = ends.provenance["target"]["alignment"]["transformation"]
    found = Similarity.read(stored, 3).after(move)
    torch.testing.assert_close(found.apply(vertices[:100]), vertices[:100], atol=1e-3, rtol=0)


@pytest.mark.parametrize("move", MOVES)
def test_an_export_lands_on_the_aligned_targets_file(move: Similarity, tmp_path: Path) -> None:
    shape = partial(SirenShape.from_network, bowl(3, 2.5), origin={"kind": "network", "path": "bowl"})
    pose = Similarity.read({"rotation": [10, 20, 30]}, 3)
    # the file of the target holds the same shape after the move, and its pose undoes a part of it
    target = shape(pose=move.inverse())
    ends = prepare_keys([shape().transformed(pose), target], NO_FIT, align=SimilarityAlignment())
    morph = NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False)
    SourceInit()(morph.field, ends.source.folded())
    file = save(morph, tmp_path / "a.ckpt", provenance=ends.provenance)
    settings = ("times=1", "resolution=64", "coordinates=target", f"output={tmp_path}/target")
    assert run_here(export, f"checkpoint={file}", *settings) == 0
    mesh = trimesh.load(tmp_path / "target" / "frame_0000.ply", force="mesh", process=False)
    vertices = move.inverse().apply(torch.tensor(np.array(mesh.vertices), dtype=torch.float64))
    # the surface of the network, Σ cos(k y) = 5/2
    assert (torch.cos(FREQUENCY * vertices).sum(1) - 2.5).abs().max() < 5e-3
    loaded = FileCoordinates(load_morph(file), "target")
    frame = extract_frame(loaded, 1.0, 64)
    assert volume(partial(loaded, t=1.0), loaded.bounds, 64) == pytest.approx(abs(mesh.volume), rel=5e-3)
    torch.testing.assert_close(
        torch.stack([frame.mesh.vertices.amin(0), frame.mesh.vertices.amax(0)]).double(),
        torch.tensor(mesh.bounds),
        atol=2e-2 * move.scale,
        rtol=0,
    )


def test_shared_coordinates_survive_a_morph_and_its_export(tmp_path: Path) -> None:
    balls = []
    for name, radius, x in (("a", 20.0, 900.0), ("b", 15.0, 910.0)):
        ball = trimesh.creation.icosphere(4, radius)
        ball.apply_translation([x, 50, 0])
        balls.append(MeshFile(write(tmp_path / f"{name}.obj", torch.tensor(np.array(ball.vertices)), ball.faces)))
    ends = prepare_keys(balls, NO_FIT, equal=False, align=SharedCoordinates())
    torch.testing.assert_close(ends.source.similarity.translation, ends.target.similarity.translation)
    assert ends.source.similarity.scale == pytest.approx(ends.target.similarity.scale)
    in_mm = FileCoordinates(
        NeuralMorph(bowl(3, 2.5, 0.0), None, ends.source, ends.target).requires_grad_(False), "source"
    )
    x = torch.tensor([[900.0, 50, 0], [910.0, 50, 0], [930.0, 50, 0]], dtype=torch.float64)
    torch.testing.assert_close(in_mm.source(x), torch.tensor([-20.0, -10, 10]).double(), atol=0.05, rtol=0)
    torch.testing.assert_close(in_mm.target(x), torch.tensor([-5.0, -15, 5]).double(), atol=0.05, rtol=0)


def test_correspondences_are_in_the_coordinates_of_both_files(tmp_path: Path) -> None:
    poses = [{"rotation": [0, 0, 90], "scale": 0.01}, {"scale": 2.0}]
    ends = [Ball(0.4 / pose["scale"], pose=pose) for pose in poses]
    morph = turning(3, 0.7)
    morph.source, morph.target = ends
    file = save(morph, tmp_path / "a.ckpt")
    settings = ("advect=true", "project=false", "times=2", "resolution=12", f"output={tmp_path}/o")
    assert run_here(export, f"checkpoint={file}", *settings) == 0
    with np.load(tmp_path / "o" / "correspondences.npz") as found:
        source, target = found["source_points"], found["target_points"]
        # back from the box: a quarter turn the other way and a hundredfold size; half the size
        quarter = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
        assert np.allclose(found["source_in_file"], 100 * source @ quarter.T, rtol=1e-5, atol=1e-4)
        assert np.allclose(found["target_in_file"], target / 2, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize("dim", [2, 3])
def test_a_motion_in_other_units_obeys_the_level_set_equation(name: str, dim: int) -> None:
    motion = MOTIONS[name](dim)
    pose = {"rotation": 25 if dim == 2 else [20, -35, 50], "translation": [7.0] * dim, "scale": 0.02}
    motion.source = Ball(0.3, [0.0] * dim, pose=pose)
    in_file = FileCoordinates(motion, "source")
    back = Similarity.read(pose, dim).inverse()
    inner = 0.8 * (2 * torch.rand(100, dim, dtype=torch.float64) - 1)
    y = back.apply(inner)
    torch.testing.assert_close(in_file(y, 0.4), back.scale * motion(inner, 0.4))
    torch.testing.assert_close(in_file.gradient(y, 0.4), motion.gradient(inner, 0.4) @ back.rotation.T)
    moved = back.apply(inner + 1e-6 * motion.velocity(inner, 0.4))
    torch.testing.assert_close(in_file.velocity(y, 0.4), (moved - y) / 1e-6, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(in_file.divergence(y, 0.4), motion.divergence(inner, 0.4))
    wanted = motion.volume(0.4) * back.scale**dim
    assert volume(partial(in_file, t=0.4), in_file.bounds, 96) == pytest.approx(wanted, rel=1e-2)


def test_a_morph_of_no_file_has_no_coordinates_of_it() -> None:
    motion = next(iter(MOTIONS.values()))(3)
    with pytest.raises(InputError, match="`morph` must have a target with a file"):
        FileCoordinates(motion, "target")
    with pytest.raises(InputError, match=r"`end` must be source or target, got box"):
        FileCoordinates(turning(3, 0.1), "box")
