"""The examples run, with budgets and grids so small that they take seconds."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
import trimesh
from analytic import save, shrinking, turning
from nbclient import NotebookClient
from test_library import TINY

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def run(name: str, folder: Path, **settings: Any) -> list[str]:
    """Execute a notebook with other settings than its own; returns what its cells print and show."""
    book = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    (cell,) = (cell for cell in book.cells if "parameters" in cell.metadata.get("tags", []))
    own = {target.id for node in ast.walk(ast.parse(cell.source)) if isinstance(node, ast.Assign)
           for target in ast.walk(node) if isinstance(target, ast.Name)}  # fmt: skip
    assert own == set(settings)
    cell.source = "\n".join(f"{key} = {value!r}" for key, value in settings.items())
    NotebookClient(book, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in book.cells if cell.cell_type == "code" for output in cell.outputs]
    return [output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs]


@pytest.fixture(autouse=True)
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NSM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("PYTHONPATH", str(EXAMPLES.parent))


@pytest.fixture
def meshes(tmp_path: Path) -> tuple[str, str]:
    trimesh.creation.icosphere(subdivisions=2).export(tmp_path / "ball.obj")
    trimesh.creation.box((2, 1.6, 1.6)).export(tmp_path / "box.ply")
    return "ball.obj", "box.ply"


def test_the_notebook_of_two_meshes_makes_its_files(tmp_path: Path, meshes: tuple[str, str]) -> None:
    options = {"steps": 12, "ends": "network", **TINY}
    printed = run("two_meshes_to_film", tmp_path, source=meshes[0], target=meshes[1], options=options, resolution=16,
                  seconds=0.1, size=(96, 64))  # fmt: skip
    assert any("True" in text for text in printed)
    assert all((tmp_path / f"morph.{suffix}").stat().st_size > 0 for suffix in ("ckpt", "glb", "gif"))


def test_the_notebook_of_checkpoints_compares_them(tmp_path: Path) -> None:
    runs = {
        "still": str(save(turning(2, 0.1), tmp_path / "a.ckpt")),
        "shrinking": str(save(shrinking(2, 0.1), tmp_path / "b.ckpt")),
    }
    printed = run("compare_checkpoints", tmp_path, runs=runs,
                  protocol={"volume_resolution": 24, "surface_resolution": 24})  # fmt: skip
    text = "".join(printed)
    assert "still 2 True ball to ball" in text
    assert "shrinking 2 False ball to ball" in text
    assert "volume std" in text


def test_the_notebooks_are_committed_without_outputs() -> None:
    books = sorted(EXAMPLES.glob("*.ipynb"))
    assert len(books) == 2
    for path in books:
        for cell in nbformat.read(path, as_version=4).cells:
            assert not cell.get("outputs")
            assert cell.get("execution_count") is None


def test_the_script_says_in_one_sentence_what_it_cannot_read(tmp_path: Path, meshes: tuple[str, str]) -> None:
    command = [sys.executable, str(EXAMPLES / "two_meshes_to_film.py"), meshes[0], "none.obj", "film.mp4"]
    done = subprocess.run(command, cwd=tmp_path, env=os.environ, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "none.obj" in done.stderr
    assert "Traceback" not in done.stderr
