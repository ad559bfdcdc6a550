"""Landmarks: read from tables and meshes, and carried into the box with the shapes."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from pathlib import Path

import pytest
import torch
import trimesh

from nsm.cli.errors import InputError
from nsm.shapes import Ball, LandmarkPairs, LandmarkPoints, LandmarkTable, LandmarkVertices, Similarity
from nsm.shapes.landmarks import warn_of_distant

ROOT = Path(__file__).resolve().parents[2]


def test_a_table_has_one_pair_a_row_under_names_or_not(tmp_path: Path) -> None:
    for head in ("", "x,y,u,v\n"):
        (tmp_path / "pairs.csv").write_text(head + "0,1,2,3\n\n4, 5, 6, 7.5\n")
        pairs = LandmarkTable(str(tmp_path / "pairs.csv")).read(2)
        assert pairs.source.tolist() == [[0, 1], [4, 5]]
        assert pairs.target.tolist() == [[2, 3], [6, 7.5]]


@pytest.mark.parametrize(
    ("source", "target", "words"),
    [
        ([], [[0, 1]], "`landmarks.source` must be a list of points of 2 finite coordinates each, got .."),
        ([[0, 1]], [[0, 1, 2]], "`landmarks.target` must be a list of points of 2 finite coordinates each"),
        ([[0, 1]], [[0, float("nan")]], "`landmarks.target` must be a list of points of 2 finite coordinates each"),
        ([[0, 1]], [[0, 1], [1, 1]], "must have a point for each of the 1 of the source, got 2"),
    ],
)
def test_points_that_do_not_correspond_are_told(source: list, target: list, words: str) -> None:
    with pytest.raises(InputError, match=words):
        LandmarkPoints(source, target).read(2)


def test_landmarks_go_where_their_shapes_go(tmp_path: Path) -> None:
    (tmp_path / "pairs.csv").write_text("1,0,1,0\n")
    source = Ball(0.5, [0.0, 0.0], pose={"scale": 0.5})
    target = Ball(0.5, [0.0, 0.0], pose={"rotation": 90, "translation": [0.25, 0]})
    pairs = LandmarkTable(str(tmp_path / "pairs.csv")).read(2)
    placed = pairs.place(source, target)
    torch.testing.assert_close(placed.source, torch.tensor([[0.5, 0.0]]))
    torch.testing.assert_close(placed.target, torch.tensor([[0.25, 1.0]]))
    scaled = target.transformed(Similarity.scaling(0.5, 2))
    moved = pairs.place(source, scaled)
    torch.testing.assert_close(moved.target, torch.tensor([[0.125, 0.5]]))


def test_landmarks_far_from_their_shapes_are_named(caplog: pytest.LogCaptureFixture) -> None:
    ball = Ball(0.5, [0.0, 0.0])
    near, far = torch.tensor([[0.5, 0.0], [0.0, 0.45]]), torch.tensor([[0.5, 0.0], [0.0, 5.5]])
    with caplog.at_level(logging.WARNING):
        warn_of_distant(LandmarkPairs(near, near), ball, ball)
        assert not caplog.messages
        warn_of_distant(LandmarkPairs(near, far), ball, ball)
    assert [message.partition(",")[0] for message in caplog.messages] == [
        "Landmark 2 lies 5 from the surface of the target"
    ]


@pytest.mark.parametrize(("count", "kept"), [(3, 3), (5001, 2501)])
def test_what_a_checkpoint_keeps_of_landmarks_reads_back_as_them(count: int, kept: int) -> None:
    pairs = LandmarkPairs(*torch.rand(2, count, 3, dtype=torch.float64))
    values = json.loads(json.dumps(pairs.provenance()))
    again = LandmarkPairs.read_provenance(values)
    stride = -(-count // kept)
    assert len(again.source) == kept
    torch.testing.assert_close(again.source, pairs.source[::stride], rtol=0, atol=0)
    torch.testing.assert_close(again.target, pairs.target[::stride], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "got no rows"),
        ("x,y,z,u,v,w\n", "got no rows"),
        ("0,1,2,3,4,5\n0,1,2\n", "got other content in row 2"),
        ("0,1,2,3,4,5\na,b,c,d,e,f\n", "got other content in row 2"),
        ("0,1,2,3,4,nan\n0,1,2,3,4,5,6\n", "got other content in row 1"),
    ],
)
def test_a_table_must_have_numbers_in_each_row(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "pairs.csv").write_text(text)
    with pytest.raises(InputError, match=f"must have 6 numbers in each row.*{words}"):
        LandmarkTable(str(tmp_path / "pairs.csv")).read(3)
    with pytest.raises(InputError, match="must be a readable CSV file"):
        LandmarkTable(str(tmp_path / "nowhere.csv")).read(3)


def test_vertices_of_two_meshes_belong_together_by_their_numbers(tmp_path: Path) -> None:
    box = trimesh.creation.box()
    box.export(tmp_path / "a.ply")
    moved = box.copy()
    moved.apply_translation([1, 0, 0])
    moved.export(tmp_path / "b.ply")
    files = str(tmp_path / "a.ply"), str(tmp_path / "b.ply")
    pairs = LandmarkVertices(*files).read(3)
    torch.testing.assert_close(pairs.target - pairs.source, torch.tensor([1.0, 0, 0]).double().expand(8, 3))
    some = LandmarkVertices(*files, [0, 3], [3, 0]).read(3)
    torch.testing.assert_close(some.source.flip(0) + torch.tensor([1.0, 0, 0]).double(), some.target)
    with pytest.raises(InputError, match=r"must refer to vertices 0 to 7 of .*, got 8\."):
        LandmarkVertices(*files, [8], [0]).read(3)
    with pytest.raises(InputError, match=r"got 2 of .*a.ply and 1 of .*b.ply"):
        LandmarkVertices(*files, [0, 1], [0]).read(3)


def test_a_twisted_mesh_keeps_its_volume_and_knows_where_each_vertex_went(tmp_path: Path) -> None:
    source, target = str(tmp_path / "a.obj"), str(tmp_path / "b.obj")
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.apply_scale([1, 0.8, 1.5])
    ball.export(source)
    command = [sys.executable, str(ROOT / "tools" / "twist_mesh.py"), source, target, "--degrees", "90", "--axis", "z"]
    subprocess.run(command, check=True, capture_output=True)
    assert trimesh.load_mesh(target).volume == pytest.approx(ball.volume, rel=1e-3)
    before, after = LandmarkVertices(source, target).read(3)
    torch.testing.assert_close(after[:, 2], before[:, 2], atol=1e-6, rtol=0)
    place = [torch.complex(points[:, 0], points[:, 1]) for points in (before, after)]
    turned = torch.polar(torch.ones(len(before)).double(), torch.pi / 2 * before[:, 2] / 3)
    torch.testing.assert_close(place[1], place[0] * turned, atol=1e-6, rtol=0)
