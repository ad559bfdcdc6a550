"""The library: two shapes in, meshes, volumes, and files out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
import trimesh
from analytic import save, shrinking, turning

import nsm
from nsm.library.trained import OUTPUTS

#: Networks, batches, and grids so small that a run takes seconds.
TINY = {
    "init": "source",
    "network": {
        "field": {"hidden_features": 16, "hidden_layers": 2, "omega": 8},
        "velocity": {"hidden_features": 16, "hidden_layers": 2},
    },
    "sampler": {"size": 200, "pool": 500},
    "sdf": {"size": 200, "pool": 500, "steps": 120, "tolerance": 10.0},
    "task": {"volume_resolution": 16, "volume_times": 3},
    "optimizer": {"lr": 1e-4},
    "validations": 1,
    "threads": 1,
}


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=2)


@pytest.fixture(scope="module")
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((2, 1.6, 1.6))


@pytest.fixture(scope="module")
def trained(ball: trimesh.Trimesh, box: trimesh.Trimesh) -> nsm.TrainedMorph:
    return nsm.morph(ball, (box.vertices, box.faces), steps=12, **TINY)


@pytest.fixture
def loaded(tmp_path: Path) -> nsm.TrainedMorph:
    return nsm.load_morph(save(turning(3, 0.1), tmp_path / "run" / "checkpoints" / "best.ckpt"), ends="network")


def test_every_public_name_can_be_imported() -> None:
    assert all(hasattr(nsm, name) for name in nsm.__all__)
    assert set(nsm.__all__) <= set(dir(nsm))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = nsm.nothing


def test_no_module_hides_a_public_name() -> None:
    modules = {path.stem for path in Path(nsm.__file__).parent.iterdir()}
    assert not modules & set(nsm.__all__)


def test_importing_the_package_imports_nothing_heavy() -> None:
    code = "import nsm, sys; print([m for m in ('torch', 'lightning', 'hydra', 'trimesh') if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_the_morph_of_two_meshes_begins_at_the_first(trained: nsm.TrainedMorph, ball: trimesh.Trimesh) -> None:
    start = trained.mesh(0.0, resolution=48, coordinates="source")
    assert start.is_watertight
    np.testing.assert_allclose(start.bounds, ball.bounds, atol=0.03)
    assert start.volume == pytest.approx(ball.volume, rel=0.02)


def test_a_saved_morph_loads_as_the_same(trained: nsm.TrainedMorph, tmp_path: Path) -> None:
    x = torch.rand(20, 3) - 0.5
    again = nsm.load_morph(trained.save(tmp_path / "morph.ckpt"))
    for t in (0.0, 0.4):
        torch.testing.assert_close(again(x, t), trained(x, t))
        torch.testing.assert_close(again.gradient(x, t), trained.gradient(x, t))
        torch.testing.assert_close(again.velocity(x, t), trained.velocity(x, t))
    torch.testing.assert_close(again.source(x), trained(x, 0.0))


def test_points_in_memory_and_a_file_of_any_kind_make_a_morph(ball: trimesh.Trimesh, tmp_path: Path) -> None:
    points, _ = trimesh.sample.sample_surface_even(ball, 1500, seed=0)
    np.savetxt(tmp_path / "ball.xyz", 2 * points)
    made = nsm.morph(np.asarray(points), tmp_path / "ball.xyz", steps=1, ends="network", **TINY)
    assert made.source.provenance()["kind"] == made.target.provenance()["kind"] == "point cloud"


def test_the_output_folder_keeps_the_run(ball: trimesh.Trimesh, tmp_path: Path) -> None:
    kept = nsm.morph(ball, "torus", output=tmp_path, steps=2, ends="network", **TINY)
    x = torch.rand(9, 3)
    torch.testing.assert_close(nsm.load_morph(tmp_path, ends="network")(x, 0.5), kept(x, 0.5))
    assert {"checkpoints", "source.ply", "summary.json"} <= {path.name for path in tmp_path.iterdir()}


def test_landmarks_come_from_arrays_or_a_file(ball: trimesh.Trimesh, tmp_path: Path) -> None:
    pairs = ball.vertices[:3], ball.vertices[3:6]
    np.savetxt(tmp_path / "pairs.csv", np.hstack(pairs), delimiter=",", header="x,y,z,u,v,w", comments="")
    for given in (pairs, tmp_path / "pairs.csv"):
        made = nsm.morph(ball, ball, landmarks=given, steps=1, ends="network", **TINY)
        np.testing.assert_array_equal(made.provenance["landmarks"]["target"], pairs[1])
    with pytest.raises(nsm.InputError, match=r"^`landmarks` must be two arrays .*got \(3, 3\) and \(2, 3\)\. Try"):
        nsm.morph(ball, ball, landmarks=(pairs[0], pairs[1][:2]))


def test_a_choice_comes_with_its_settings(ball: trimesh.Trimesh) -> None:
    plane = ("plane", {"normal": [1, 1, 0]})
    made = nsm.morph(ball, ball, symmetry=plane, steps=1, ends="network", **TINY)
    x = torch.rand(9, 3) - 0.5
    mirrored = torch.stack([-x[:, 1], -x[:, 0], x[:, 2]], 1)
    torch.testing.assert_close(made(mirrored, 0.5), made(x, 0.5), atol=1e-5, rtol=0)
    with pytest.raises(
        nsm.InputError, match=r"^`symmetry.nomral` must be a known setting of `symmetry` .*Try `normal`"
    ):
        nsm.morph(ball, ball, symmetry=("plane", {"nomral": [1, 1, 0]}))


def test_meshes_volumes_and_frames_agree(loaded: nsm.TrainedMorph) -> None:
    meshes = list(loaded.frames(3, resolution=32))
    assert len(meshes) == 3
    for t, mesh in zip((0.0, 0.5, 1.0), meshes, strict=True):
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(loaded.volume(t, resolution=32), rel=0.01)
        facing = (mesh.vertex_normals * mesh.vertices).sum(1)
        assert (facing > 0).all()


def test_every_suffix_has_its_writer(loaded: nsm.TrainedMorph, tmp_path: Path) -> None:
    size = {"frames": 3, "resolution": 16, "seconds": 0.1, "size": (64, 64)}
    assert [file.name for file in sorted(loaded.save(tmp_path / "meshes", **size).glob("*.ply"))] == [
        f"frame_000{number}.ply" for number in range(3)
    ]
    assert loaded.save(tmp_path / "a.glb", **size).read_bytes()[:4] == b"glTF"
    assert imageio.imread(loaded.save(tmp_path / "a.gif", **size), index=None).shape[1:3] == (64, 64)
    assert imageio.imread(loaded.save(tmp_path / "a.png", **size)).std() > 10
    assert loaded.save(tmp_path / "a.usd", **size).read_bytes()[:8] == b"PXR-USDC"
    assert loaded.save(tmp_path / "a.safetensors", **size) == tmp_path / "a.safetensors"
    assert {".ckpt", ".glb", ".gif", ".png", ".usd", ".safetensors"} < set(OUTPUTS)
    with pytest.raises(nsm.InputError, match=r"^`path` must end in \.ckpt, .*\.onnx, or .* got .*a\.ply\. Try `"):
        loaded.save(tmp_path / "a.ply")


def test_a_morph_of_the_plane_has_a_volume_and_a_folder_of_curves(tmp_path: Path) -> None:
    flat = nsm.load_morph(save(shrinking(2, 0.1), tmp_path / "flat.ckpt"))
    assert flat.volume(0.0) > flat.volume(1.0) > 0
    assert sorted(path.suffix for path in flat.save(tmp_path / "curves", frames=2, resolution=32).iterdir()) == [
        ".json", ".obj", ".obj",
    ]  # fmt: skip
    with pytest.raises(nsm.InputError, match=r"^`mesh` must be called on a morph in 3D, got one in 2D\. Try `"):
        flat.mesh(0.5)
    with pytest.raises(nsm.InputError, match=r"^`path` must end in .*, got .*a\.glb\. Try `"):
        flat.save(tmp_path / "a.glb")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"stepz": 3}, r"^`stepz` must be a known option of training \(.*\)\. Try `steps`\.$"),
        ({"optimizer": {"lrr": 1}}, r"^`optimizer.lrr` must be a known setting of `optimizer` \(.*\)\. Try `lr`\.$"),
        ({"velocity": "nulldi"}, r"^`velocity` must be one of adadiv, .*, got nulldi\. Try `velocity=nulldiv`\.$"),
        ({"budget": "huge"}, r"^`budget` must be one of fast, full, plane, got huge\. Try `budget="),
        ({"ends": "loose"}, r"^`ends` must be one of exact, network, got loose\."),
        ({"steps": 0}, r"steps"),
    ],
)
def test_an_option_that_cannot_be_used_ends_in_one_sentence(options: dict, sentence: str) -> None:
    with pytest.raises(nsm.InputError, match=sentence):
        nsm.morph("cylinders", "torus", **options)


def test_a_shape_that_cannot_be_used_ends_in_one_sentence(ball: trimesh.Trimesh) -> None:
    with pytest.raises(nsm.InputError, match=r"none\.obj"):
        nsm.morph(ball, "none.obj", steps=1)
    with pytest.raises(nsm.InputError, match=r"^`target` must be vertices of shape \(v, 3\) .*got \(162, 2\)"):
        nsm.morph(ball, (ball.vertices[:, :2], ball.faces), steps=1)


def test_paths_with_any_characters_reach_the_training_command(ball: trimesh.Trimesh, tmp_path: Path) -> None:
    odd = tmp_path / "it's a, [mesh]=1.ply"
    ball.export(odd)
    assert nsm.morph(odd, str(odd), steps=1, ends="network", **TINY).network.source.provenance()["path"] == str(odd)
