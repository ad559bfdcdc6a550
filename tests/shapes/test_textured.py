"""Meshes with textures, colors, and other attributes of vertices."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from nsm.cli.errors import InputError
from nsm.shapes.textured import load_textured


def textured_obj(folder: Path) -> Path:
    """A square of two triangles with a texture; the corner at the origin has two places on the picture."""
    Image.new("RGB", (4, 4), (255, 128, 0)).save(folder / "skin.png")
    (folder / "skin.mtl").write_text("newmtl skin\nKd 1 1 1\nmap_Kd skin.png\n")
    lines = ["mtllib skin.mtl", "usemtl skin", "v 0 0 0", "v 1 0 0", "v 1 1 0", "v 0 1 0"]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "vt 0.5 0.5", "f 1/1 2/2 3/3", "f 1/5 3/3 4/4"]
    (folder / "square.obj").write_text("\n".join(lines) + "\n")
    return folder / "square.obj"


def test_an_obj_keeps_its_texture_and_its_seams(tmp_path: Path) -> None:
    mesh, look = load_textured(textured_obj(tmp_path))
    assert look.colors is None
    assert look.uv is not None
    assert look.texture is not None
    assert look.uv.shape == (len(mesh.vertices), 2)
    assert look.texture.size == (4, 4)
    assert look.texture.convert("RGB").getpixel((0, 0)) == (255, 128, 0)
    corners = {
        (tuple(place), tuple(uv))
        for place, uv in zip(
            mesh.vertices[mesh.simplices.flatten()].tolist(), look.uv[mesh.simplices.flatten()].tolist(), strict=True
        )
    }
    assert corners == {
        ((0, 0, 0), (0, 0)),
        ((1, 0, 0), (1, 0)),
        ((1, 1, 0), (1, 1)),
        ((0, 1, 0), (0, 1)),
        ((0, 0, 0), (0.5, 0.5)),
    }


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_ply_keeps_its_colors_and_values(tmp_path: Path, encoding: str) -> None:
    ball = trimesh.creation.icosphere(2)
    colors = np.random.default_rng(0).integers(0, 256, (len(ball.vertices), 4), dtype=np.uint8)
    ball.visual.vertex_colors = colors
    ball.vertex_attributes["weight"] = np.arange(len(ball.vertices), dtype=np.float32)
    ball.export(tmp_path / "ball.ply", encoding=encoding)
    mesh, look = load_textured(tmp_path / "ball.ply")
    assert torch.equal(mesh.simplices, torch.tensor(np.asarray(ball.faces)))
    torch.testing.assert_close(mesh.vertices, torch.tensor(np.asarray(ball.vertices)), rtol=0, atol=1e-6)
    assert look.colors is not None
    assert torch.equal((255 * look.colors).round(), torch.tensor(colors[:, :3]).double())
    assert set(look.others) == {"weight"}
    assert look.others["weight"].flatten().tolist() == list(range(len(ball.vertices)))


def test_a_bare_mesh_has_no_look_and_a_missing_file_a_sentence(tmp_path: Path) -> None:
    trimesh.creation.icosphere(1).export(tmp_path / "ball.stl")
    assert load_textured(tmp_path / "ball.stl").attributes[:3] == (None, None, None)
    with pytest.raises(InputError):
        load_textured(tmp_path / "nothing.obj")
