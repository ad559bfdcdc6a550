"""The library without configuration files: what tools/two_meshes_to_film.py shows, on small meshes."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import imageio.v3 as imageio
import pytest
import trimesh

SCRIPT = Path(__file__).resolve().parents[2] / "tools" / "two_meshes_to_film.py"
SMALL = (
    *("--steps", "250", "--points", "1000", "--width", "32", "--layers", "2"),
    *("--resolution", "24", "--seconds", "0.2", "--size", "160", "120"),
)


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "NSM_CACHE_DIR": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def meshes(tmp_path: Path) -> tuple[str, str]:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.obj")
    trimesh.creation.box((2, 1.6, 1.6)).export(tmp_path / "box.ply")
    return "ball.obj", "box.ply"


def test_two_meshes_become_a_film(tmp_path: Path, meshes: tuple[str, str]) -> None:
    done = run(tmp_path, *meshes, "film.mp4", *SMALL)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "wrote film.mp4, film.csv, film.png, film.json"
    frames = imageio.imread(tmp_path / "film.mp4")
    assert frames.shape[1:] == (120, 160, 3)
    assert frames.std() > 10
    figures = json.loads((tmp_path / "film.json").read_text())["figures"]
    assert 0 < figures["chamfer t=0"] < 0.05
    assert 0 <= figures["volume std"] < 0.1
    rows = list(csv.DictReader((tmp_path / "film.csv").read_text().splitlines()))
    assert (float(rows[0]["time"]), float(rows[-1]["time"])) == (0, 1)


def test_what_is_no_mesh_ends_in_one_sentence(tmp_path: Path, meshes: tuple[str, str]) -> None:
    done = run(tmp_path, meshes[0], "none.obj", "film.mp4", *SMALL)
    assert done.returncode == 1
    assert done.stderr == "There is no file none.obj: give the path of an existing file.\n"
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("film*"))
