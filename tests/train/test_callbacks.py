"""What a run keeps besides its checkpoints, and what it gives to loggers."""

from __future__ import annotations

import csv
import os
import signal
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh
from problems import translating_ball
from runs import BARE, DISK, files, train_here

from nsm.io.mesh import write_mesh
from nsm.morphs.surfaces import extract_frame
from nsm.train.tasks import MorphTask


@pytest.fixture(autouse=True, scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NSM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
        yield


def history(folder: Path) -> list[int]:
    """Steps of the validations in the volume history."""
    with (folder / "volume_history.csv").open() as file:
        return sorted({int(row["step"]) for row in csv.DictReader(file)})


def test_a_frame_is_the_surface_with_the_normals_of_f(tmp_path: Path) -> None:
    file = tmp_path / "t.ply"
    _, _, mesh, normals = extract_frame(translating_ball(3), 0.5, 24)
    write_mesh(file, mesh, normals)
    read = trimesh.load(file, process=False)
    torch.testing.assert_close(torch.as_tensor(read.vertices), mesh.vertices.double(), atol=1e-6, rtol=0)
    center = torch.tensor([0.0, 0.0, 0.0]).double()
    radial = torch.nn.functional.normalize(mesh.vertices - center, dim=1)
    torch.testing.assert_close(torch.as_tensor(read.vertex_normals.copy()), radial, atol=1e-5, rtol=0)


def test_meshes_of_every_fifth_validation_and_of_the_best(tmp_path: Path) -> None:
    run = (*DISK, "steps=13", "validations=6", "callbacks.meshes.times=[0.5]", f"hydra.run.dir={tmp_path}")
    assert train_here(*run) == 0
    assert {name for name in files(tmp_path) if name.startswith("meshes")} == {
        "meshes/step_000010/t_0.500.obj",
        "meshes/best/t_0.500.obj",
    }
    assert history(tmp_path) == [2, 4, 6, 8, 10, 12, 13]


def test_the_volume_history_survives_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    undisturbed = MorphTask.training_step

    def disturbed(self: MorphTask, batch: Any, index: int) -> Any:
        if self.global_step == 8 and not (tmp_path / "stopped").exists():
            (tmp_path / "stopped").touch()
            os.kill(os.getpid(), signal.SIGTERM)
        return undisturbed(self, batch, index)

    monkeypatch.setattr(MorphTask, "training_step", disturbed)
    assert train_here(*DISK, f"hydra.run.dir={tmp_path}") == 143
    assert "strip.png" not in files(tmp_path)
    assert train_here(*DISK, f"hydra.run.dir={tmp_path}", "resume=true") == 0
    assert set(history(tmp_path)) >= {6, 12}
    assert "strip.png" in files(tmp_path)


def test_terms_are_logged_only_where_a_row_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noted: list[int] = []
    undisturbed = MorphTask.log

    def counted(self: MorphTask, name: str, *args: Any, **kwargs: Any) -> None:
        noted.extend([self.global_step] if name == "train/loss" else [])
        undisturbed(self, name, *args, **kwargs)

    monkeypatch.setattr(MorphTask, "log", counted)
    assert train_here(*BARE, "trainer.log_every_n_steps=5", f"hydra.run.dir={tmp_path}") == 0
    with (tmp_path / "log" / "metrics.csv").open(newline="") as file:
        written = [int(row["step"]) for row in csv.DictReader(file) if row["train/loss"]]
    assert written == [4, 9, 11]
    assert noted == [5, 10, 12]
